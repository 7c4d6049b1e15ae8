"""Tasks over a Dask cluster; what they stage comes back with their results.

A worker may be on another machine, may die, or may be taken for dead and still run. So no task
writes where others can see it: it stages in a folder of its own, and the files travel to the run.
Memory and deaths of workers are the matter of their nannies.
"""

from __future__ import annotations

import hashlib
import logging
import platform
import tempfile
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from itertools import islice
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

from pipeline.config import Execution
from pipeline.errors import EngineError, StoreError
from pipeline.store.atomic_files import put
from pipeline.store.object_store import ObjectStore
from pipeline.workers.process import Done, Limits, Loss, do, loss_of

if TYPE_CHECKING:
    from distributed import Client, Future

log = logging.getLogger(__name__)

# What a task's bytes, and its way through the scheduler, depend on.
CODE = "code of motor-leakage"
ON_THE_WAY = ("python", CODE, "distributed", "msgpack")
PACKAGES = ("distributed", "msgpack", "numpy", "polars", "pyarrow", "scipy")
TODO = {
    "scheduler_versions": "install the same motor-leakage and requirements.txt, and start it anew",
    "scheduler_folders": "mount the same folders there",
    "scheduler_credentials": "start it with the environment that the run has",
}
# How often to look whether there are workers while nothing finishes [s].
LOOK_S = 1.0


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Things that a worker must have in common with the run."""

    versions: Mapping[str, str]
    folders: tuple[Path, ...] = ()  # folders that it must see: of the logs, and of the output
    stores: tuple[str, ...] = ()  # URLs that it must have a client and credentials for


class StrangeWorkerError(Exception):
    """A worker that joined later and differs from the run. Carries its address and why."""


@contextmanager
def open_cluster(
    execution: Execution, folders: Sequence[Path], stores: Sequence[str]
) -> Iterator[Cluster]:
    """The configured cluster, once scheduler and workers are fit for the run.

    Raises EngineError: ``dask_missing``: the extra is not installed; ``scheduler_unreachable``:
    nothing answers at the address; ``scheduler_no_workers``; ``scheduler_versions``: scheduler or a
    worker has other versions; ``scheduler_threads``: a worker with several threads;
    ``scheduler_folders``: a worker that does not see logs or output; ``scheduler_credentials``: one
    that has no way to the logs' object store.
    """
    try:
        import distributed
    except ImportError as error:
        raise EngineError(
            "dask_missing",
            f'execution.backend = "dask" needs the extra `dask` ({error}): '
            "pip install 'motor-leakage[dask]'",
        ) from error
    logging.getLogger("distributed").setLevel(logging.WARNING)
    where, wait_s = execution.scheduler, execution.scheduler_wait_s
    expected = Surroundings(own_versions(), tuple(folders), tuple(stores))
    try:
        with warnings.catch_warnings():
            # Versions that differ are an error of ours, said below.
            warnings.simplefilter("ignore", distributed.versions.VersionMismatchWarning)
            client = distributed.Client(where, timeout=wait_s, set_as_default=False)
    except (OSError, ValueError, TypeError, RuntimeError) as error:
        raise EngineError(
            "scheduler_unreachable",
            f"no Dask scheduler answers at {where}: {error}; check execution.scheduler, and that "
            "the scheduler runs",
        ) from error
    with client:
        on_the_way = {name: expected.versions[name] for name in ON_THE_WAY}
        try:
            found = client.run_on_scheduler(differences, Surroundings(on_the_way))
        except Exception as error:
            found = error
        _require(f"the scheduler at {where}", found)
        try:
            client.wait_for_workers(1, timeout=wait_s)
        except TimeoutError as error:
            raise EngineError(
                "scheduler_no_workers",
                f"the scheduler at {where} had no worker for {wait_s:g} s; start one with: "
                "dask worker ADDRESS --nthreads 1",
            ) from error
        found = client.run(differences, expected, on_error="return")
        for worker, n_threads in sorted(client.nthreads().items()):
            if n_threads != 1:
                raise EngineError(
                    "scheduler_threads",
                    f"the worker {worker} has {n_threads} threads, expected 1; start it with "
                    "--nthreads 1, and several of them with --nworkers",
                )
            _require(f"the worker {worker}", found.get(worker, ()))
        if where.startswith("tcp://"):
            log.warning(
                "nothing is encrypted or authenticated on the way to %s: whoever reaches it runs "
                "code on its workers; keep it in a closed network, or use tls://",
                where,
            )
        yield Cluster(client, execution, expected)


def _require(who: str, found: Sequence[Loss] | BaseException) -> None:
    """Refuse who cannot read tasks, would make other bytes, or would take absent logs for none."""
    if isinstance(found, BaseException):
        found = [Loss("scheduler_versions", f"{type(found).__name__}: {found}")]
    if found:
        words = "; ".join(one.how for one in found)
        raise EngineError(found[0].code, f"{who} is unfit: {words}; {TODO[found[0].code]}")


def differences(expected: Surroundings) -> list[Loss]:
    """Differences of this process from the run."""
    own = own_versions()
    found = [
        Loss("scheduler_versions", f"{name} is {own.get(name, 'absent')} there and {wanted} here")
        for name, wanted in expected.versions.items()
        if own.get(name) != wanted
    ]
    found += [
        Loss("scheduler_folders", f"there is no folder {folder} there")
        for folder in expected.folders
        if not folder.is_dir()
    ]
    for url in expected.stores:
        try:
            ObjectStore.at(url)  # nothing is asked of it
        except StoreError as error:
            found.append(Loss("scheduler_credentials", f"object store: {error.message}"))
    return found


@cache
def own_versions() -> Mapping[str, str]:
    """Versions of this process: Python, packages, and a hash of the code that it has loaded."""
    found = {"python": platform.python_version(), CODE: _LOADED}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "absent"
    return found


def _code_hash() -> str:
    """Hash of the sources: two checkouts may differ under one version number."""
    digest = hashlib.sha256()
    for package in ("leakage", "pipeline"):
        root = Path(str(files(package)))
        for path in sorted((*root.rglob("*.py"), *root.rglob("*.csv"))):
            digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:12]


# By the first task, other code may lie on the disk.
_LOADED = _code_hash()


def do_on_worker(
    function: Callable[[Any], Any], task: Any, limits: Limits, expected: Surroundings
) -> tuple[Done[Any] | Loss, dict[str, bytes]]:
    """What came of a task, and what it has staged: contents by path below its staging folder.

    Raises StrangeWorkerError if this worker differs from the run.
    """
    if found := differences(expected):
        from distributed import get_worker

        raise StrangeWorkerError(get_worker().address, "; ".join(one.how for one in found))
    with tempfile.TemporaryDirectory(prefix="motor-leakage-") as name:
        folder = Path(name)
        if hasattr(task, "staging"):
            task = replace(task, staging=folder)
        _, outcome = do(function, task, limits)
        staged = (path for path in sorted(folder.rglob("*")) if path.is_file())
        return outcome, {path.relative_to(folder).as_posix(): path.read_bytes() for path in staged}


@dataclass(slots=True)
class Cluster:
    """A connected cluster, and its workers that no task is sent to."""

    client: Client
    execution: Execution
    expected: Surroundings
    refused: set[str] = field(default_factory=set)

    def tried(
        self, function: Callable[[Any], Any], tasks: Iterable[Any], at_a_time: int
    ) -> Iterator[tuple[Any, Done[Any] | Loss]]:
        """Each task with what came of it, as they finish; never more than so many under way.

        Raises EngineError (``scheduler_lost``) if the scheduler or all workers are gone before any
        task was done; StoreError if what a task staged cannot be written.
        """
        waiting = iter(tasks)
        under_way: dict[Future[Any], Any] = {}
        ended: SimpleQueue[Future[Any]] = SimpleQueue()
        limits = Limits(self.execution.timeout_s, self.execution.answer_s)
        n_done = 0
        try:
            while True:
                for task in islice(waiting, at_a_time - len(under_way)):
                    future = self.client.submit(
                        do_on_worker,
                        *(function, task, limits, self.expected),
                        pure=False,
                        workers=sorted(self._workers()) if self.refused else None,
                    )
                    under_way[future] = task
                    future.add_done_callback(ended.put)
                if not under_way:
                    return
                future = self._next(ended)
                outcome = self._outcome(future, under_way[future])
                n_done += 1
                yield under_way.pop(future), outcome
        except EngineError as error:
            if not n_done:
                raise
            log.warning("%s; what is finished is kept", error)
            lost = Loss(error.code, error.message)
            yield from ((task, lost) for task in (*under_way.values(), *waiting))
        finally:
            if under_way and self.client.status == "running":
                with suppress(OSError, TimeoutError):
                    self.client.cancel(list(under_way), force=True)

    def _next(self, ended: SimpleQueue[Future[Any]]) -> Future[Any]:
        """The next task that ended, however it did; gives up where none can end any more."""
        wait_s, seen = self.execution.scheduler_wait_s, time.monotonic()
        while True:
            with suppress(Empty):
                return ended.get(timeout=min(LOOK_S, wait_s))
            self._require_connection()
            if self._workers():
                seen = time.monotonic()
            elif time.monotonic() - seen >= wait_s:
                raise EngineError(
                    "scheduler_lost", f"the scheduler has had no worker for {wait_s:g} s"
                )

    def _require_connection(self) -> None:
        if self.client.status != "running":
            raise EngineError("scheduler_lost", "the connection to the scheduler is lost")

    def _workers(self) -> set[str]:
        """Workers that a task may go to; none while the scheduler does not answer."""
        try:
            return set(self.client.nthreads()) - self.refused
        except (OSError, TimeoutError) as error:
            log.warning("the scheduler does not answer: %s", error)
            return set()

    def _outcome(self, future: Future[Any], task: Any) -> Done[Any] | Loss:
        """Outcome of a task that has ended; its staged files are put where they belong."""
        from distributed import KilledWorker

        try:
            outcome: Done[Any] | Loss
            outcome, staged = future.result(timeout=self.execution.scheduler_wait_s)
        except KilledWorker as error:
            return Loss("worker_died", f"{error.allowed_failures + 1} workers died of it")
        except StrangeWorkerError as error:
            address, why = error.args
            log.warning("the worker %s joined and is unfit: %s", address, why)
            self.refused.add(address)
            return Loss("scheduler_versions", why)
        except Exception as error:
            self._require_connection()
            return loss_of(error)
        for name, content in staged.items():
            put(task.staging / name, content, durable=False)
        return outcome
