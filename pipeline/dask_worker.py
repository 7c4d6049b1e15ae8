"""What runs on a Dask worker: a task whose staged rows come back with its result.

A worker may be on another machine, may die, or may be taken for dead and still run. So no task
writes where others can see it: it stages in a folder of its own, and the files travel to the run.
"""

from __future__ import annotations

import hashlib
import platform
import signal
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from pathlib import Path
from typing import Any, Generic, TypeVar

from pipeline.landing import scratch

Result = TypeVar("Result")

# What shapes the bytes of a result, beside the code itself.
PACKAGES = ("numpy", "polars", "pyarrow", "scipy")
SOURCES = ("leakage", "pipeline")


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What a worker must have in common with the run.

    Attributes
    ----------
    versions
        By name, from :func:`own_versions`.
    folders
        Folders that it must see: of the logs, and of the output.
    limit_s
        Longest time for a task [s]; then the worker ends itself. None: no limit.
    """

    versions: Mapping[str, str]
    folders: tuple[Path, ...] = ()
    limit_s: float | None = None


@dataclass(frozen=True, slots=True)
class Done(Generic[Result]):
    """A task's result, and what it has staged: contents by path below the staging folder."""

    result: Result
    staged: Mapping[str, bytes]


class StrangeWorkerError(Exception):
    """A worker that differs from the run; a task must go elsewhere. Carries its address and why."""


def own_versions() -> dict[str, str]:
    """Versions of this process: Python, the packages that shape figures, and a hash of the code."""
    return {**_package_versions(), "code of motor-leakage": _code_hash()}


@cache
def _package_versions() -> Mapping[str, str]:
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "absent"
    return found


@cache
def _code_hash() -> str:
    """Hash of the sources: two checkouts may differ under one version number."""
    digest = hashlib.sha256()
    for package in SOURCES:
        root = Path(str(files(package)))
        for path in sorted(root.rglob("*.py")):
            digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:12]


def differences(expected: Surroundings) -> list[str]:
    """What this process has not in common with the run, in words; empty: nothing."""
    own = own_versions()
    found = [
        f"{name} is {own.get(name, 'absent')} there and {wanted} here"
        for name, wanted in expected.versions.items()
        if own.get(name) != wanted
    ]
    return found + [
        f"there is no folder {folder} there" for folder in expected.folders if not folder.is_dir()
    ]


def do_task(
    function: Callable[[Any], Result],
    task: Any,
    expected: Surroundings,
    brought: Mapping[str, bytes],
) -> Done[Result]:
    """Do a task in a staging folder of its own, if the task has one, with what was brought there.

    Raises
    ------
    StrangeWorkerError
        If this worker differs from the run: it may have joined after the run had looked.
    """
    if strange := differences(expected):
        raise StrangeWorkerError(own_address(), "; ".join(strange))
    if not hasattr(task, "staging"):
        with _limited(expected.limit_s):
            return Done(function(task), {})
    with _limited(expected.limit_s), tempfile.TemporaryDirectory(prefix="motor-leakage-") as name:
        folder = Path(name)
        put(brought, folder)
        result = function(replace(task, staging=folder))
        staged = {
            path.relative_to(folder).as_posix(): path.read_bytes()
            for path in sorted(folder.rglob("*"))
            if path.is_file() and path.relative_to(folder).as_posix() not in brought
        }
    return Done(result, staged)


@contextmanager
def _limited(limit_s: float | None) -> Iterator[None]:
    """End this process when the time is up: a task that hangs cannot be stopped otherwise."""
    # Nobody handles SIGALRM in a worker, and what it does then is to end the process.
    signal.setitimer(signal.ITIMER_REAL, limit_s or 0.0)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def put(contents: Mapping[str, bytes], folder: Path) -> None:
    """Write files into folders of a folder."""
    for name, content in contents.items():
        with scratch(folder / name) as stream:
            stream.write(content)


def own_address() -> str:
    """Address of the worker that this runs on."""
    from distributed import get_worker

    return str(get_worker().address)
