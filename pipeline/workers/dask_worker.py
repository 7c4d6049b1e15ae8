"""A task on a Dask worker; its staged rows come back with its result.

A worker may be on another machine, may die, or may be taken for dead and still run. So no task
writes where others can see it: it stages in a folder of its own, and the files travel to the run.

The worker itself does no task: it has a process for that, as a run on one machine has several. So
the same limits hold, and what a task does to its process costs the worker nothing.
"""

from __future__ import annotations

import hashlib
import pickle
import platform
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from pathlib import Path
from typing import Any, Generic, TypeVar

from pipeline.config import Execution
from pipeline.errors import StoreError
from pipeline.store.atomic_files import put
from pipeline.store.object_store import ObjectStore
from pipeline.workers.local import Worker, run_task
from pipeline.workers.process import Done, Loss

Result = TypeVar("Result")

# What shapes the bytes of a result, beside the code itself.
PACKAGES = ("numpy", "polars", "pyarrow", "scipy")
CODE = "code of motor-leakage"
SOURCES = ("leakage", "pipeline")

# The process that does this worker's tasks; it has one at a time.
_process: Worker | None = None


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Things that a worker must have in common with the run."""

    versions: Mapping[str, str]  # by name, from :func:`own_versions`
    folders: tuple[Path, ...] = ()  # folders that it must see: of the logs, and of the output
    stores: tuple[str, ...] = ()  # URLs that it must have a client and credentials for


@dataclass(frozen=True, slots=True)
class Staged(Generic[Result]):
    """A task's result, and what it has staged: contents by path below the staging folder."""

    result: Result
    staged: Mapping[str, bytes]


class StrangeWorkerError(Exception):
    """A worker that differs from the run; a task must go elsewhere. Carries its address and why."""


def own_versions() -> dict[str, str]:
    """Versions of this process: Python, the packages that shape figures, and a hash of the code."""
    return {**_package_versions(), CODE: _LOADED}


@cache
def _package_versions() -> Mapping[str, str]:
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "absent"
    return found


def _code_hash() -> str:
    """Hash of the sources: two checkouts may differ under one version number."""
    digest = hashlib.sha256()
    for package in SOURCES:
        root = Path(str(files(package)))
        for path in sorted((*root.rglob("*.py"), *root.rglob("*.csv"))):
            digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:12]


# Of the code that this process has loaded: by the first task, another may lie on the disk.
_LOADED = _code_hash()


def differences(expected: Surroundings) -> list[str]:
    """Differences of this process from the run, in words."""
    own = own_versions()
    found = [
        f"{name} is {own.get(name, 'absent')} there and {wanted} here"
        for name, wanted in expected.versions.items()
        if own.get(name) != wanted
    ]
    found += [
        f"there is no folder {folder} there" for folder in expected.folders if not folder.is_dir()
    ]
    return found + [fault for url in expected.stores if (fault := _fault_of_store(url))]


@cache
def _fault_of_store(url: str) -> str:
    """The reason for no way to an object store; nothing is asked of the store."""
    try:
        ObjectStore.at(url)
    except StoreError as error:
        return f"object store: {error.message}"
    return ""


def do_task(
    task: Any,
    brought: Mapping[str, bytes],
    function: Callable[[Any], Result],
    expected: Surroundings,
    limits: Execution,
) -> Staged[Result] | Loss:
    """Do a task in a staging folder of its own, if the task has one, with what was brought there.

    Raises StrangeWorkerError if this worker differs from the run: it may have joined after the run
    had looked.
    """
    if strange := differences(expected):
        raise StrangeWorkerError(own_address(), "; ".join(strange))
    if not hasattr(task, "staging"):
        found = _in_a_process(function, task, limits)
        return found if isinstance(found, Loss) else Staged(found.result, {})
    with tempfile.TemporaryDirectory(prefix="motor-leakage-") as name:
        folder = Path(name)
        put_all(brought, folder)
        found = _in_a_process(function, replace(task, staging=folder), limits)
        if isinstance(found, Loss):
            return found
        staged = {
            path.relative_to(folder).as_posix(): path.read_bytes()
            for path in sorted(folder.rglob("*"))
            if path.is_file() and path.relative_to(folder).as_posix() not in brought
        }
    return Staged(found.result, staged)


def _in_a_process(
    function: Callable[[Any], Result], task: Any, limits: Execution
) -> Done[Result] | Loss:
    """Do a task in the process that this worker keeps for its tasks."""
    from distributed.protocol.pickle import dumps

    global _process
    if _process is None:
        _process = Worker()
    return run_task(_process, _call, dumps((function, task)), limits)


def _call(content: bytes) -> Any:
    """In the process: do a task, whichever it is."""
    function, task = pickle.loads(content)  # noqa: S301 - from the worker above it
    return function(task)


def put_all(contents: Mapping[str, bytes], folder: Path) -> None:
    """Write scratch files below a folder; raises as `put`."""
    for name, content in contents.items():
        put(folder / name, content, durable=False)


def own_address() -> str:
    """Address of the worker that this runs on."""
    from distributed import get_worker

    return str(get_worker().address)
