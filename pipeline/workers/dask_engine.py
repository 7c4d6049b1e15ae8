"""Independent tasks over a Dask cluster: as `workers`, with the same results.

Tasks are submitted through a client, never more than a stated number at a time. A task of which
workers died goes to the end of the queue and is tried once more with nothing else under way: only
the one that kills its worker then fails. So does one that died, hung or raised in the process that
its worker has for it. Nothing waits for ever: not for a worker, and not for a scheduler that is
gone.
"""

from __future__ import annotations

import logging
import time
import warnings
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, TypeVar
from uuid import uuid4

from pipeline.config import Execution
from pipeline.errors import EngineError
from pipeline.workers.dask_worker import Staged, StrangeWorkerError, Surroundings, do_task, put_all
from pipeline.workers.process import Loss, loss_of

if TYPE_CHECKING:
    from distributed import Client, Future

log = logging.getLogger(__name__)

Task = TypeVar("Task")
Result = TypeVar("Result")

# How often to look whether there are workers while nothing finishes.
LOOK_S = 1.0
# Tasks that are sent, and results that are asked for, in one request: each costs scheduler and run
# some milliseconds. Joined chunks are large, and go and come alone.
TOGETHER = 32
# How long a result waits for others to be asked for with it.
GATHER_S = 0.02
# Tasks in flight for each worker where their own content is large.
AHEAD = 2
# How often a task is sent anew, for reasons that are not its own, before it counts as lost.
MOST_SENT = 10
DIED = "worker_died"


@dataclass(slots=True)
class DaskEngine:
    """Runs tasks over a cluster, through a client from `dask_cluster.connected`."""

    client: Client
    execution: Execution
    expected: Surroundings

    def run_tasks(
        self,
        function: Callable[[Task], Result],
        tasks: Sequence[Task],
        lost: Callable[[Task, Loss], Result],
        *,
        first: bool = False,
    ) -> Iterator[Result]:
        """Results as `RunTasks` says.

        Where a task has a ``staging`` folder, it stages elsewhere and the files are brought there;
        those that it names as its ``chunks`` travel with it.

        Raises EngineError (``scheduler_lost``) if the scheduler or all workers are gone before any
        task was done; StoreError if what a task staged cannot be written.
        """
        engine = replace(self, execution=self.execution.hasty) if first else self
        flight = _Flight(engine, function, dict(enumerate(tasks)), once=first)
        try:
            for number, outcome in flight.outcomes():
                task = tasks[number]
                if isinstance(outcome, Loss):
                    yield lost(task, outcome)
                    continue
                put_all(outcome.staged, getattr(task, "staging", Path()))
                yield outcome.result
        finally:
            flight.cancel()


def _needed(task: object) -> dict[str, bytes]:
    """Chunks that a task joins: they travel with it."""
    folder, names = getattr(task, "staging", None), getattr(task, "chunks", ())
    return {name: (folder / name).read_bytes() for name in names}


@dataclass(slots=True)
class _Flight:
    """Tasks on their way through a scheduler."""

    engine: DaskEngine
    function: Callable[[Any], Any]
    tasks: Mapping[int, Any]
    once: bool = False
    run: str = field(default_factory=lambda: uuid4().hex)
    waiting: deque[int] = field(default_factory=deque)
    suspects: deque[int] = field(default_factory=deque)
    under_way: dict[Future[Any], int] = field(default_factory=dict)
    ended: SimpleQueue[Future[Any]] = field(default_factory=SimpleQueue)
    refused: set[str] = field(default_factory=set)
    sent: Counter[int] = field(default_factory=Counter)
    alone: set[int] = field(default_factory=set)

    def outcomes(self) -> Iterator[tuple[int, Staged[Any] | Loss]]:
        """Each task once, by number: what it gave, or why it gave nothing."""
        self.waiting.extend(self.tasks)
        n_done = 0
        while self.waiting or self.suspects or self.under_way:
            self._submit()
            try:
                ended = self._next()
            except EngineError as error:
                if not n_done:
                    raise
                log.warning("%s; what is finished is kept", error)
                left = [*self.under_way.values(), *self.waiting, *self.suspects]
                loss = Loss(error.code, error.message)
                yield from ((number, loss) for number in sorted(left))
                return
            brought = self._brought_together(ended)
            for future in ended:
                number = self.under_way.pop(future)
                outcome = self._outcome(number, future, brought.get(future))
                if outcome is not None:
                    n_done += 1
                    yield number, outcome

    def _submit(self) -> None:
        """Fill up what is in flight; suspects go last, and each alone."""
        while together := self._may_send():
            self._send(together)
        if self.suspects and not self.under_way:
            number = self.suspects.popleft()
            self.alone.add(number)
            self._send([number])

    def _may_send(self) -> list[int]:
        """The next tasks to be sent in one request; none where enough are in flight."""
        if not self.waiting or not self.alone.isdisjoint(self.under_way.values()):
            return []
        room = self._most(self.waiting[0]) - len(self.under_way)
        together = 1 if self._is_large(self.waiting[0]) else TOGETHER
        return [self.waiting.popleft() for _ in range(min(room, together, len(self.waiting)))]

    def _is_large(self, number: int) -> bool:
        """True where much travels with a task and its result."""
        return bool(getattr(self.tasks[number], "chunks", ()))

    def _most(self, number: int) -> int:
        """Most tasks in flight; of those that carry much, no more than are done."""
        most = self.engine.execution.tasks_in_flight
        if self._is_large(number):
            return min(most, AHEAD * max(len(self._workers()), 1))
        return most

    def _send(self, numbers: Sequence[int]) -> None:
        self.sent.update(numbers)
        fit = None
        if self.refused:
            fit = sorted(self._workers()) or None
        tasks = [self.tasks[number] for number in numbers]
        with warnings.catch_warnings():
            # What a joining task is sent is large; scattered, it would be lost with its worker.
            warnings.filterwarnings("ignore", "Sending large graph", UserWarning)
            futures = self.engine.client.map(
                do_task,
                tasks,
                [_needed(task) for task in tasks],
                function=self.function,
                expected=self.engine.expected,
                limits=self.engine.execution,
                key=[
                    f"motor-leakage-{self.run}-{number}-{self.sent[number]}" for number in numbers
                ],
                workers=fit,
                # Never twice for one key by Dask itself unless a worker was lost.
                retries=0,
                pure=False,
            )
        for number, future in zip(numbers, futures, strict=True):
            self.under_way[future] = number
            future.add_done_callback(self.ended.put)

    def _next(self) -> list[Future[Any]]:
        """The next tasks that ended, however they did; gives up where none can end any more."""
        wait_s = self.engine.execution.scheduler_wait_s
        without_workers_since = None
        while True:
            if ended := self._ended():
                known = [future for future in dict.fromkeys(ended) if future in self.under_way]
                if known:
                    return known
                continue
            if self.engine.client.status != "running":
                raise EngineError("scheduler_lost", "the connection to the scheduler is lost")
            if self._workers():
                without_workers_since = None
                continue
            without_workers_since = without_workers_since or time.monotonic()
            if time.monotonic() - without_workers_since >= wait_s:
                raise EngineError(
                    "scheduler_lost", f"the scheduler has had no worker for {wait_s:g} s"
                )

    def _ended(self) -> list[Future[Any]]:
        """Tasks that have ended, with those that do a moment later; none where none did."""
        found: list[Future[Any]] = []
        with suppress(Empty):
            found.append(self.ended.get(timeout=LOOK_S))
            until = time.monotonic() + GATHER_S
            while len(found) < min(TOGETHER, len(self.under_way)):
                found.append(self.ended.get(timeout=max(0.0, until - time.monotonic())))
        return found

    def _brought_together(
        self, ended: Sequence[Future[Any]]
    ) -> dict[Future[Any], Staged[Any] | Loss]:
        """Results of several tasks in one request; none where any of it goes wrong."""
        client = self.engine.client
        finished = [
            one
            for one in ended
            if one.status == "finished" and not self._is_large(self.under_way[one])
        ]
        if len(finished) < 2:
            return {}
        try:
            results = client.sync(
                lambda: client.gather(finished, asynchronous=True),
                callback_timeout=self.engine.execution.scheduler_wait_s,
            )
        except Exception as error:  # each is asked for alone then, and told what it was
            log.info("results are asked for one by one: %s", error)
            return {}
        return dict(zip(finished, results, strict=True))

    def _workers(self) -> set[str]:
        """Workers that a task may go to; none while the scheduler does not answer."""
        try:
            return set(self.engine.client.nthreads()) - self.refused
        except (OSError, TimeoutError) as error:
            log.warning("the scheduler does not answer: %s", error)
            return set()

    def _outcome(
        self, number: int, future: Future[Any], brought: Staged[Any] | Loss | None
    ) -> Staged[Any] | Loss | None:
        """Outcome of a task; None where it is to be tried again."""
        from distributed import KilledWorker

        if future.status in ("finished", "lost"):
            # A worker may die with the result of a task that it had done; Dask then does it again.
            try:
                wait_s = self.engine.execution.scheduler_wait_s
                done: Staged[Any] | Loss = brought or future.result(timeout=wait_s)
            except Exception as error:
                return self._resend(number, f"its result was lost: {type(error).__name__}: {error}")
            return self._again(number, done) if isinstance(done, Loss) else done
        if future.status != "error":
            return self._resend(number, f"the scheduler gave it up ({future.status})")
        fault = future.exception()
        if isinstance(fault, StrangeWorkerError):
            address, why = fault.args
            log.warning("the worker %s joined and is unfit: %s", address, why)
            self.refused.add(address)
            return self._resend(number, why)
        if isinstance(fault, KilledWorker):
            how = f"{fault.allowed_failures + 1} workers died of it"
            return self._again(number, Loss(DIED, how))
        return self._again(number, loss_of(fault))

    def _resend(self, number: int, why: str) -> Loss | None:
        """Send a task anew that did nothing wrong, though not for ever."""
        if self.sent[number] >= MOST_SENT:
            return Loss(DIED, why)
        log.warning("task %d: %s; it is sent anew", number, why)
        self.waiting.append(number)
        return None

    def _again(self, number: int, loss: Loss) -> Loss | None:
        """Try a task once more, alone: it may have died of its neighbour."""
        if self.once or loss.log or number in self.alone:
            return loss
        self.suspects.append(number)
        log.warning("a task is lost and will be tried again, alone: %s", loss.how)
        return None

    def cancel(self) -> None:
        """Take back what is under way: the run was stopped."""
        if self.under_way and self.engine.client.status == "running":
            with suppress(OSError, TimeoutError):
                self.engine.client.cancel(list(self.under_way), force=True)
        self.under_way.clear()
