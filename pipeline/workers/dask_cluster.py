"""The way to a Dask cluster: a scheduler at an address, or workers of this machine.

All that makes a cluster unfit is found before the first task, and is one error with a code.
"""

from __future__ import annotations

import logging
import os
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any

from pipeline.config import Execution
from pipeline.errors import EngineError
from pipeline.workers.dask_worker import CODE, Surroundings, differences

if TYPE_CHECKING:
    from distributed import Client

log = logging.getLogger(__name__)

# One thread a worker, for Polars and BLAS as well: with more, tasks of one process would share
# what `threadpool_limits` holds, and results could depend on their company.
ENVIRONMENT = {"POLARS_MAX_THREADS": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
# Workers of this machine say nothing of their own workings: the engine says what became of a task.
LOCAL_ENVIRONMENT = {**ENVIRONMENT, "DASK_LOGGING__DISTRIBUTED": "critical"}
# Packages of which client and scheduler must have the same version to understand each other.
PROTOCOL = ("distributed", "msgpack")
# Of the run's versions those that a scheduler must have to read a task.
READERS = ("python", CODE)


@contextmanager
def connected(execution: Execution, expected: Surroundings) -> Iterator[Client]:
    """A client of the configured cluster, once every worker there is fit for the run.

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
    with ExitStack() as stack:
        stack.enter_context(_quiet(logging.WARNING if execution.scheduler else logging.CRITICAL))
        where = execution.scheduler or stack.enter_context(_local(execution))
        client = _client(distributed, where, execution)
        stack.callback(client.close)
        _require_same_protocol(client, where)
        _require_same_program(client, where, expected)
        _require_workers(client, where, execution)
        _require_one_thread(client)
        _require_alike(client, expected)
        if execution.scheduler.startswith("tcp://"):
            log.warning(
                "nothing is encrypted or authenticated on the way to %s: whoever reaches it runs "
                "code on its workers; keep it in a closed network, or use tls://",
                execution.scheduler,
            )
        yield client


@contextmanager
def _quiet(level: int) -> Iterator[None]:
    """Keep what Dask says of its own workings from those who read what the run says."""
    dask = logging.getLogger("distributed")
    before = dask.level
    dask.setLevel(level)
    try:
        yield
    finally:
        dask.setLevel(before)


@contextmanager
def _local(execution: Execution) -> Iterator[Any]:
    """Workers of this machine; a task that killed its worker is tried again by the engine alone."""
    import dask
    from distributed import LocalCluster

    settings = {
        "distributed.scheduler.allowed-failures": 0,
        "distributed.nanny.pre-spawn-environ": LOCAL_ENVIRONMENT,
    }
    with _environment_kept(), dask.config.set(settings), ExitStack() as stack:
        try:
            cluster = LocalCluster(
                n_workers=execution.workers,
                threads_per_worker=1,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",
            )
        except (OSError, RuntimeError, TimeoutError) as error:
            raise EngineError(
                "scheduler_unreachable", f"no Dask cluster can be started on this machine: {error}"
            ) from error
        yield stack.enter_context(cluster)


@contextmanager
def _environment_kept() -> Iterator[None]:
    """Take back what is meant for workers: their nannies put it into this process as well."""
    before = dict(os.environ)
    try:
        yield
    finally:
        for name in os.environ.keys() - before.keys():
            del os.environ[name]
        os.environ.update(before)


def _client(distributed: Any, where: Any, execution: Execution) -> Client:
    try:
        with warnings.catch_warnings():
            # Versions that differ are an error of ours, said below.
            warnings.simplefilter("ignore", distributed.versions.VersionMismatchWarning)
            return distributed.Client(
                where,
                timeout=execution.scheduler_wait_s,
                set_as_default=False,
                name="motor-leakage",
            )
    except (OSError, ValueError, TypeError, RuntimeError) as error:
        raise EngineError(
            "scheduler_unreachable",
            f"no Dask scheduler answers at {where}: {error}; check execution.scheduler, and that "
            "the scheduler runs",
        ) from error


def _require_same_protocol(client: Client, where: Any) -> None:
    found = client.get_versions()
    here, there = found["client"], found["scheduler"]
    strange = [
        f"{name} is {there['packages'].get(name)} there and {here['packages'].get(name)} here"
        for name in PROTOCOL
        if there["packages"].get(name) != here["packages"].get(name)
    ]
    if strange:
        raise EngineError(
            "scheduler_versions",
            f"the scheduler at {where} has other versions: {'; '.join(strange)}; install the same",
        )


def _require_same_program(client: Client, where: Any, expected: Surroundings) -> None:
    """Refuse a scheduler that cannot read tasks: it unpickles them on their way."""
    versions = {name: expected.versions[name] for name in READERS}
    try:
        found = client.run_on_scheduler(differences, Surroundings(versions))
    except Exception as error:
        found = [f"{type(error).__name__}: {error}"]
    if found:
        raise EngineError(
            "scheduler_versions",
            f"the scheduler at {where} has not this program: {'; '.join(found)}; install the same "
            "motor-leakage there, and start it anew",
        )


def _require_workers(client: Client, where: Any, execution: Execution) -> None:
    try:
        client.wait_for_workers(1, timeout=execution.scheduler_wait_s)
    except TimeoutError as error:
        raise EngineError(
            "scheduler_no_workers",
            f"the scheduler at {where} had no worker for {execution.scheduler_wait_s:g} s; start "
            "one with: dask worker ADDRESS --nthreads 1",
        ) from error


def _require_one_thread(client: Client) -> None:
    for worker, threads in sorted(client.nthreads().items()):
        if threads != 1:
            raise EngineError(
                "scheduler_threads",
                f"the worker {worker} has {threads} threads, expected 1; start it with --nthreads "
                "1, and several of them with --nworkers",
            )


def _require_alike(client: Client, expected: Surroundings) -> None:
    """Refuse workers that would make other bytes, or would take absent logs for no logs."""
    for worker, found in sorted(client.run(differences, expected, on_error="return").items()):
        if isinstance(found, BaseException):
            raise EngineError(
                "scheduler_versions",
                f"the worker {worker} cannot run this program: {type(found).__name__}: {found}; "
                "install the same motor-leakage there",
            )
        if found:
            code, todo = _kind_of(found[0])
            raise EngineError(code, f"the worker {worker} is unfit: {'; '.join(found)}; {todo}")


def _kind_of(difference: str) -> tuple[str, str]:
    """The code of what makes a worker unfit, and what to do about it."""
    code, todo = "scheduler_versions", "install the same requirements/ there"
    if difference.startswith("there is no folder"):
        code = "scheduler_folders"
        todo = "mount the same folders there"
    elif difference.startswith("object store"):
        code = "scheduler_credentials"
        todo = "start it with the environment that the run has"
    return code, todo
