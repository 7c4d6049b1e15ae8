"""One small demo fleet for all tests, made and fitted once, however many workers there are."""

from __future__ import annotations

import fcntl
import functools
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Callable, Generator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import pytest
import typer.main
from hypothesis import settings

# A busy machine is no fault of the code: speed is for `benchmarks/`.
settings.register_profile("patient", deadline=None)
settings.register_profile("quick", deadline=None, max_examples=20)

# Where the system has Python write no bytecode, each process would compile the program anew.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# Each call of the command in this process would make it anew of its functions.
typer.main.get_command = functools.cache(typer.main.get_command)

# Sums as a run makes them: in threads, many small products wait for one another.
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

# No test cuts the power, so nothing waits for a disk: folders of tests lie in memory where there is
# enough of it.
os.fsync = lambda _: None  # type: ignore[assignment]
os.sync = lambda: None  # type: ignore[assignment]
MEMORY, ENOUGH_BYTES = Path("/dev/shm"), 4 << 30  # noqa: S108
if "TMPDIR" not in os.environ and MEMORY.is_dir() and shutil.disk_usage(MEMORY).free > ENOUGH_BYTES:
    os.environ["TMPDIR"] = tempfile.tempdir = str(MEMORY)

# In the background of a shell a process is born deaf to SIGINT, and so are its children.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

DEMO_NIGHTS = 3
DEMO_MINUTES = 42.0


def pytest_configure(config: pytest.Config) -> None:
    """`make test-full`, which selects nothing, draws more examples."""
    settings.load_profile("quick" if config.option.markexpr else "patient")


@pytest.hookimpl(wrapper=True)
def pytest_collect_file() -> Generator[None, list[pytest.Collector], list[pytest.Collector]]:
    """Look for examples in the docstrings of the product alone: tests have none."""
    collected = yield
    return [node for node in collected if type(node) is pytest.Module]


class OwnFleet(Protocol):
    """Copies motors of the demo, or their newest nights, into the test's own; its fleet file."""

    def __call__(self, *motors: str, fitted: bool = False, nights: int = DEMO_NIGHTS) -> Path: ...


@pytest.fixture(scope="session")
def shared_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that all workers of pytest-xdist share."""
    own = tmp_path_factory.getbasetemp()
    return own.parent if "PYTEST_XDIST_WORKER" in os.environ else own


@pytest.fixture(scope="session")
def demo_folder(shared_folder: Path) -> Path:
    """The demo fleet, 3 nights of 42 minutes; only to be read."""

    def make(folder: Path) -> None:
        from pipeline.demo.writing import write_demo

        write_demo(folder, nights=DEMO_NIGHTS, minutes=DEMO_MINUTES, workers=1)

    return made_once(shared_folder / "demo", make)


@pytest.fixture(scope="session")
def fitted_output(shared_folder: Path, demo_folder: Path) -> Path:
    """Output of a run over the demo fleet, motor after motor; read-only."""

    def make(folder: Path) -> None:
        from pipeline.config import load_fleet
        from pipeline.run.fleet import RunRequest, run_fleet

        fleet = load_fleet(demo_folder / "configs" / "fleet.toml")
        execution = fleet.execution.model_copy(update={"backend": "sequential"})
        run_fleet(RunRequest(replace(fleet, execution=execution, output=folder)))

    return made_once(shared_folder / "fitted", make)


@pytest.fixture
def own_fleet(demo_folder: Path, tmp_path: Path, request: pytest.FixtureRequest) -> OwnFleet:
    """Motors of the demo to be changed at will; output goes to ``out`` beside ``configs``."""

    def copy(*motors: str, fitted: bool = False, nights: int = DEMO_NIGHTS) -> Path:
        if fitted:
            shutil.copytree(request.getfixturevalue("fitted_output"), tmp_path / "out")
        return copy_motors(demo_folder, tmp_path, motors, nights)

    return copy


def copy_motors(demo: Path, folder: Path, motors: Sequence[str], nights: int = DEMO_NIGHTS) -> Path:
    """Copy config and newest logs of some of the demo's motors; returns their fleet file."""
    shutil.copytree(demo / "configs", folder / "configs")
    for file in (folder / "configs" / "motors").iterdir():
        if file.stem not in motors:
            file.unlink()
    for motor in motors:
        logs = folder / "demo" / "logs" / motor
        logs.mkdir(parents=True)
        for log in sorted((demo / "demo" / "logs" / motor).iterdir())[-nights:]:
            shutil.copy2(log, logs)
    return folder / "configs" / "fleet.toml"


def made_once(folder: Path, make: Callable[[Path], object]) -> Path:
    """Make a folder in whichever worker comes first; the others wait for it."""
    with folder.with_name(f"{folder.name}.lock").open("w", encoding="utf-8") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        done = folder.with_name(f"{folder.name}.done")
        if not done.exists():
            make(folder)
            done.touch()
    return folder
