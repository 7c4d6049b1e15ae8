"""Tasks of a run over worker processes of this machine, a Dask cluster, or none of them.

On this machine joblib starts and feeds the workers. A worker that dies takes its whole pool with
it, whoever's fault that was: the tasks that were begun are tried again alone, the others go on in a
new call.

A worker of a cluster may be on another machine, may die, or may be taken for dead and still run. So
no task writes where others can see it: it stages in a folder of its own, and the files come back
with its result. Memory and deaths of these workers are the matter of their nannies.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import platform
import re
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import cache, partial
from importlib.metadata import version
from itertools import chain, islice
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Event, Thread
from typing import TYPE_CHECKING, Any

from pipeline.config import Execution
from pipeline.errors import EngineError
from pipeline.messages import counted
from pipeline.store.atomic_files import put
from pipeline.workers.process import (
    Loss,
    Mark,
    Result,
    Task,
    Tried,
    attempt,
    begin_worker,
    do,
    loss_of,
)

if TYPE_CHECKING:
    from distributed import Client, Future

log = logging.getLogger(__name__)

# Read by the libraries as a worker loads them. With all threads each, workers would fight for the
# cores; Arrow's own allocator reserves a gibibyte at once, which would count as used. The C library
# (glibc; others ignore it) keeps the pages of arrays of up to 64 MiB, as fresh ones take 8 % of a
# motor-day at 10 Hz, and asks for huge ones, with which two workers hinder each other less.
ENVIRONMENT: Mapping[str, str] = {
    "POLARS_MAX_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "ARROW_DEFAULT_MEMORY_POOL": "system",
    "MALLOC_MMAP_THRESHOLD_": str(1 << 26),
    "MALLOC_TRIM_THRESHOLD_": str(1 << 27),
}
HUGE_PAGES = "glibc.malloc.hugetlb=1"
# Memory that a worker may ask for, at least and at most: a day at 100 Hz asks for 2.3 GiB, and a
# hostile log is to end long before all of a large machine is taken [bytes].
LEAST_MEMORY, MOST_MEMORY = 4 << 30, 16 << 30
# So often the run looks at the marks [s].
LOOK_S = 0.25
# A worker that has not ended by itself so long after its time is killed [s].
GRACE_S = 2.0
# What allocators in C, C++ and Rust say before they abort.
NO_MEMORY = re.compile(
    r"^.*(memory allocation|bad_alloc|out of memory|cannot allocate|MemoryError).*$",
    re.IGNORECASE | re.MULTILINE,
)
# Of joblib: the end of a process.
END = re.compile(r"(SIG\w+|EXIT)\(-?\d+\)")
# What a task's bytes, and its way through the scheduler, depend on.
CODE = "code of motor-leakage"
PACKAGES = ("distributed", "msgpack", "numpy", "polars", "pyarrow", "scipy")
SCHEDULER_LOST = "scheduler_lost"
REMEDY = "start it anew with the same program, packages and folders, and --nthreads 1"
# How often to look whether there are workers while nothing finishes [s].
LOOK_AT_CLUSTER_S = 1.0
# Time to wait for scheduler and first worker.
WAIT_S = 30.0
# Most tasks at the scheduler: enough for its workers, and a few for it to hold.
TASKS_IN_FLIGHT = 256


@contextmanager
def open_workers(execution: Execution, folders: Sequence[Path] = ()) -> Iterator[Workers]:
    """Open the configured workers, for all tasks of a run.

    `folders` are what those of a cluster must see: logs and output. Raises EngineError if there are
    none: see `open_cluster`.
    """
    if execution.backend == "sequential":
        # In the run's own process: a task that hangs or dies takes the run with it.
        yield Workers(lambda function, tasks: ((task, attempt(function, task)) for task in tasks))
    elif execution.is_cluster:
        with open_cluster(execution, folders) as tried:
            yield Workers(tried)
    else:
        with open_pool(execution) as pool:
            yield Workers(pool.tried, pool.marks)


@dataclass(frozen=True, slots=True)
class Workers:
    """The way in which tasks are tried."""

    tried: Tried
    # Marks of tasks under way; a cluster gives none.
    marks: Callable[[], Sequence[Mark]] = tuple

    def run(
        self,
        function: Callable[[Task], Result],
        tasks: Iterable[Task],
        lost: Callable[[Task, Loss], Result],
        without: Callable[[Task, Loss], Task | None] = lambda *_: None,
    ) -> Iterator[Result]:
        """Yield results of tasks as they finish, in any order.

        A task may have been lost by its neighbour's fault: it is tried again when all others are
        done, with nothing beside it. If it is lost again, what it was lost in is left out.

        Tasks are plain data, drawn singly, and not always by this thread. `lost` gives the
        result of a lost task, `without` the task without the part that it was lost in; None where
        that is not known, or too much.
        """
        losses: list[tuple[Task, Loss]] = []
        for task, outcome in self.tried(function, tasks):
            if isinstance(outcome, Loss):
                losses.append((task, outcome))
            else:
                yield outcome
        for task, loss in losses:
            again: Task | None = task
            while again is not None and loss.code != "scheduler_lost":
                log.warning("%s: tried again, alone: %s", task, loss.how)
                task = again
                ((_, outcome),) = self.tried(function, [task])
                if not isinstance(outcome, Loss):
                    yield outcome
                    break
                loss, again = outcome, without(task, outcome)
            else:
                yield lost(task, loss)


def memory_of(n_workers: int) -> int:
    """Return the memory that each of some workers may take of this machine's [bytes]."""
    machine = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return min(max(machine // n_workers, LEAST_MEMORY), MOST_MEMORY)


@contextmanager
def open_pool(execution: Execution) -> Iterator[Pool]:
    """Open worker processes for all tasks of a run, started when there are tasks for them."""
    before = dict(os.environ)
    # Tunables of the C library are added to those that are set.
    tunables = ":".join(filter(None, (os.environ.get("GLIBC_TUNABLES"), HUGE_PAGES)))
    os.environ.update(ENVIRONMENT, GLIBC_TUNABLES=tunables)
    with tempfile.TemporaryDirectory(prefix="motor-leakage-") as folder:
        pool = Pool(execution, Path(folder))
        watch = Thread(target=pool.watch, daemon=True, name="watch over workers")
        watch.start()
        try:
            yield pool
        finally:
            if "joblib" in sys.modules:
                from joblib.externals.loky import get_reusable_executor

                # A task under way is dropped, and has published nothing.
                get_reusable_executor(reuse=True).shutdown(kill_workers=True)
            pool.left.set()
            watch.join()
            for name in (*ENVIRONMENT, "GLIBC_TUNABLES"):
                del os.environ[name]
            os.environ.update(before)


@dataclass(frozen=True, slots=True)
class Pool:
    """Workers, and the folder of their marks and last words."""

    execution: Execution
    folder: Path
    left: Event = field(default_factory=Event)

    def tried(
        self, function: Callable[[Any], Any], tasks: Iterable[Any]
    ) -> Iterator[tuple[Any, Any]]:
        """Yield each task with what came of it, as they finish; at most a worker each."""
        waiting: Iterator[tuple[int, Any]] = enumerate(tasks)
        under_way: dict[int, Any] = {}

        def calls(first: tuple[int, Any]) -> Iterator[Any]:
            for number, task in chain([first], waiting):
                under_way[number] = task
                yield delayed(do)(function, task, self.execution, number)

        while (first := next(waiting, None)) is not None:
            from joblib import Parallel, delayed  # which takes its time, and is not always needed

            parallel = Parallel(
                # A single worker would be the run's own process.
                n_jobs=max(2, self.execution.workers),
                pre_dispatch=self.execution.workers,
                batch_size=1,
                return_as="generator_unordered",
                # Otherwise arrays go through shared memory, which may be small.
                max_nbytes=None,
                initializer=begin_worker,
                initargs=(os.getpid(), str(self.folder), memory_of(self.execution.workers)),
            )
            results: Generator[tuple[int, Any, str]] = parallel(calls(first))
            begun: set[int] = set()
            try:
                for number, outcome, words in results:
                    sys.stderr.write(words)
                    yield under_way.pop(number), outcome
            except BrokenProcessPool as error:
                begun, loss = self._loss(str(error))
            finally:
                with warnings.catch_warnings():  # that it is not at its end
                    warnings.simplefilter("ignore")
                    results.close()
            # Where none could be begun, all are lost.
            for number in begun.intersection(under_way) or list(under_way):
                yield under_way.pop(number), loss
            waiting, under_way = chain(list(under_way.items()), waiting), {}

    def _loss(self, error: str) -> tuple[set[int], Loss]:
        """Return tasks that a dead pool had begun, and their loss by a mark and last words."""
        marks = {mark.number: mark for _, mark in self._marks() if mark.number >= 0}
        mark = next(iter(marks.values()), Mark())
        words = "".join(path.read_text("utf-8", "replace") for path in self.folder.glob("*.words"))
        sys.stderr.write(words)
        for place in self.folder.iterdir():
            place.unlink()
        no_memory, end = NO_MEMORY.search(words), END.search(error)
        log_name = ""
        if time.monotonic() > mark.until_s:
            code, log_name = "log_no_answer" if mark.log else "task_timeout", mark.log
            how = f"{mark.log} did not answer" if mark.log else "not done"
            how += f" within {mark.limit_s:g} s"
        else:
            code = "task_memory" if no_memory else "worker_died"
            how = f"its worker process ended with {end.group() if end else 'no word'}"
            how += f": {no_memory.group().strip()}" if no_memory else ""
        how += f", at {mark.part}" if mark.part else ""
        return {*marks}, Loss(code, how, mark.part, log_name)

    def _marks(self) -> Iterator[tuple[int, Mark]]:
        """Yield marks of workers by their process."""
        for place in self.folder.glob("*.mark"):
            with suppress(ValueError, OSError):
                line = place.read_bytes().partition(b"\n")[0]
                yield int(place.stem), Mark(*json.loads(line))

    def marks(self) -> list[Mark]:
        """Return the marks of tasks under way."""
        return [mark for _, mark in self._marks() if mark.number >= 0]

    def watch(self) -> None:
        """Kill workers that cannot end by themselves."""
        while not self.left.wait(LOOK_S):
            for pid, mark in self._marks():
                if time.monotonic() > mark.until_s + GRACE_S:
                    with suppress(ProcessLookupError):
                        os.kill(pid, signal.SIGKILL)


@contextmanager
def open_cluster(execution: Execution, folders: Sequence[Path]) -> Iterator[Tried]:
    """Open the way to try tasks on the configured cluster, once that is fit for the run.

    Raises EngineError: ``dask_missing``: the extra is not installed; ``scheduler_unreachable``:
    nothing answers at the address, or it has no worker; ``scheduler_unfit``: it cannot read tasks,
    would make other bytes, or would take absent logs for none.
    """
    try:
        from distributed import Client
        from distributed.versions import VersionMismatchWarning
    except ImportError as error:
        raise EngineError(
            "dask_missing",
            f"execution.backend is a Dask scheduler, which needs the extra `dask` ({error}): "
            "pip install 'motor-leakage[dask]'",
        ) from error
    logging.getLogger("distributed").setLevel(logging.WARNING)
    # Versions that differ are an error of ours, said below.
    warnings.simplefilter("ignore", VersionMismatchWarning)
    where, wait_s, expected = execution.backend, WAIT_S, own_versions()
    with ExitStack() as stack:
        try:
            client = stack.enter_context(Client(where, timeout=wait_s, set_as_default=False))
            client.wait_for_workers(1, timeout=wait_s)
        except (OSError, ValueError, TypeError, RuntimeError) as error:
            raise EngineError(
                "scheduler_unreachable",
                f"no Dask scheduler with a worker answers at {where}: {error}; check "
                "execution.backend, and that both run: dask worker ADDRESS --nthreads 1",
            ) from error
        refusals = client.run(differences, expected, folders, on_error="return")
        threads = client.nthreads().items()
        refusals |= {worker: f"it has {n} threads" for worker, n in threads if n != 1}
        try:
            refusals["the scheduler"] = client.run_on_scheduler(differences, expected)
        except Exception as error:  # it has not even the program
            refusals["the scheduler"] = repr(error)
        for who, words in refusals.items():
            if words:
                raise EngineError("scheduler_unfit", f"{who} is unfit: {words}; {REMEDY}")
        yield partial(_try_on_cluster, client, execution, expected)


def differences(expected: Mapping[str, str], folders: Sequence[Path] = ()) -> str:
    """Return the differences of this process from what a run needs, in words."""
    own = own_versions()
    differing = [
        f"{name} is {own[name]} there and {wanted} here"
        for name, wanted in expected.items()
        if own[name] != wanted
    ]
    differing += [f"there is no folder {folder} there" for folder in folders if not folder.is_dir()]
    return "; ".join(differing)


def own_versions() -> Mapping[str, str]:
    """Return versions of this process: Python, packages and a hash of the loaded code."""
    versions = {name: version(name) for name in PACKAGES}
    return {"python": platform.python_version(), CODE: _code_hash(), **versions}


@cache
def _code_hash() -> str:
    """Return hash of the sources: two checkouts may differ under the same version number.

    Made once: by the first task, other code may lie on the disk.
    """
    digest = hashlib.sha256()
    for package in ("leakage", "pipeline"):
        root = Path(__file__).parents[2] / package
        for path in sorted((*root.rglob("*.py"), *root.rglob("*.csv"))):
            digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:12]


def do_on_worker(
    function: Callable[[Any], Any], task: Any, limits: Execution, expected: Mapping[str, str]
) -> tuple[Any, dict[str, bytes]]:
    """Return what came of a task and what it has staged: contents by path below its staging."""
    if words := differences(expected):  # it joined later
        return Loss("scheduler_unfit", f"its worker is unfit: {words}; {REMEDY}"), {}
    with tempfile.TemporaryDirectory(prefix="motor-leakage-") as name:
        folder = Path(name)
        if hasattr(task, "staging"):
            task = replace(task, staging=folder)
        _, outcome, _ = do(function, task, limits)
        staged = (path for path in sorted(folder.rglob("*")) if path.is_file())
        return outcome, {path.relative_to(folder).as_posix(): path.read_bytes() for path in staged}


def _try_on_cluster(
    client: Client,
    execution: Execution,
    expected: Mapping[str, str],
    function: Callable[[Any], Any],
    tasks: Iterable[Any],
) -> Iterator[tuple[Any, Any]]:
    """Yield each task with what came of it, as they finish; never more than stated under way.

    Raises StoreError if what a task staged cannot be written.
    """
    waiting, wait_s = iter(tasks), WAIT_S
    under_way: dict[Future[Any], Any] = {}
    ended: SimpleQueue[Future[Any]] = SimpleQueue()
    arguments = {"limits": execution, "expected": expected, "pure": False}
    try:
        while client.status == "running":
            for task in islice(waiting, TASKS_IN_FLIGHT - len(under_way)):
                future = client.submit(do_on_worker, function, task, **arguments)
                under_way[future] = task
                future.add_done_callback(ended.put)
            if not under_way:
                return
            if (ready := _next(client, ended, wait_s)) is None:
                break
            outcome = _outcome(client, ready, under_way[ready])
            yield under_way.pop(ready), outcome
        lost = Loss(SCHEDULER_LOST, f"the scheduler or its workers are gone for {wait_s:g} s")
        for number, task in enumerate(chain(under_way.values(), waiting)):
            if number == 0:
                log.warning("%s; what is finished is kept", lost.how)
            yield task, lost
    finally:
        if under_way and client.status == "running":
            with suppress(OSError):
                client.cancel(list(under_way), force=True)


def _next(client: Client, ended: SimpleQueue[Future[Any]], wait_s: float) -> Future[Any] | None:
    """Return the next task that ended, however it did; None where none can end any more."""
    until = time.monotonic() + wait_s
    while client.status == "running" and time.monotonic() < until:
        with suppress(Empty):
            return ended.get(timeout=min(LOOK_AT_CLUSTER_S, wait_s))
        with suppress(OSError):  # it does not answer for now
            if client.nthreads():
                until = time.monotonic() + wait_s
    return None


def _outcome(client: Client, future: Future[Any], task: Any) -> Any:
    """Return result or loss of a task that has ended; put its staged files into place."""
    from distributed import KilledWorker

    try:
        outcome, staged = future.result()
    except KilledWorker as error:
        n_died = counted(error.allowed_failures + 1, "worker")
        return Loss("worker_died", f"{n_died} died of it")
    except Exception as error:
        is_there = client.status == "running"
        return loss_of(error) if is_there else Loss(SCHEDULER_LOST, str(error))
    for name, content in staged.items():
        put(task.staging / name, content, durable=False)
    return outcome
