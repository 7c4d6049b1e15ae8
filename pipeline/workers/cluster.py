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
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from importlib.resources import files
from itertools import chain, islice
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

from pipeline.config import Execution
from pipeline.errors import EngineError
from pipeline.store.atomic_files import put
from pipeline.workers.process import Loss, Tried, do, loss_of

if TYPE_CHECKING:
    from distributed import Client, Future

log = logging.getLogger(__name__)

# What a task's bytes, and its way through the scheduler, depend on.
CODE = "code of motor-leakage"
PACKAGES = ("distributed", "msgpack", "numpy", "polars", "pyarrow", "scipy")
SCHEDULER_LOST = "scheduler_lost"
REMEDY = "start it anew with the same program, packages and folders, and --nthreads 1"
# How often to look whether there are workers while nothing finishes [s].
LOOK_S = 1.0
# Time to wait for scheduler and first worker.
WAIT_S = 30.0
# Most tasks at the scheduler: enough for its workers, and a few for it to hold.
TASKS_IN_FLIGHT = 256


@contextmanager
def open_cluster(execution: Execution, folders: Sequence[Path]) -> Iterator[Tried]:
    """The way to try tasks on the configured cluster, once that is fit for the run.

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
        yield partial(_tried, client, execution, expected)


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
    """Versions of this process: Python, packages, and a hash of the code that it has loaded."""
    versions = {name: version(name) for name in PACKAGES}
    return {"python": platform.python_version(), CODE: _LOADED, **versions}


def _code_hash() -> str:
    """Return hash of the sources: two checkouts may differ under the same version number."""
    digest = hashlib.sha256()
    for package in ("leakage", "pipeline"):
        root = Path(str(files(package)))
        for path in sorted((*root.rglob("*.py"), *root.rglob("*.csv"))):
            digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:12]


# By the first task, other code may lie on the disk.
_LOADED = _code_hash()


def do_on_worker(
    function: Callable[[Any], Any], task: Any, limits: Execution, expected: Mapping[str, str]
) -> tuple[Any, dict[str, bytes]]:
    """What came of a task, and what it has staged: contents by path below its staging folder."""
    if words := differences(expected):  # it joined later
        return Loss("scheduler_unfit", f"its worker is unfit: {words}; {REMEDY}"), {}
    with tempfile.TemporaryDirectory(prefix="motor-leakage-") as name:
        folder = Path(name)
        if hasattr(task, "staging"):
            task = replace(task, staging=folder)
        _, outcome, _ = do(function, task, limits)
        staged = (path for path in sorted(folder.rglob("*")) if path.is_file())
        return outcome, {path.relative_to(folder).as_posix(): path.read_bytes() for path in staged}


def _tried(
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
            return ended.get(timeout=min(LOOK_S, wait_s))
        with suppress(OSError):  # it does not answer for now
            if client.nthreads():
                until = time.monotonic() + wait_s
    return None


def _outcome(client: Client, future: Future[Any], task: Any) -> Any:
    """Result or loss of a task that has ended; its staged files are put where they belong."""
    from distributed import KilledWorker

    try:
        outcome, staged = future.result()
    except KilledWorker as error:
        return Loss("worker_died", f"{error.allowed_failures + 1} workers died of it")
    except Exception as error:
        is_there = client.status == "running"
        return loss_of(error) if is_there else Loss(SCHEDULER_LOST, str(error))
    for name, content in staged.items():
        put(task.staging / name, content, durable=False)
    return outcome
