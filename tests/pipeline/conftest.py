"""Fixtures of several rooms: real files, a cluster, an object store, the command."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from pipeline.cli import main
from pipeline.config import MotorSpec
from pipeline.messages import FORM
from tests.pipeline.calling import Call, Called
from tests.pipeline.dask_processes import Processes, scheduler_with
from tests.pipeline.s3_server import Server, s3_server
from tests.pipeline.simulated import load_motor, motor_toml
from tests.pipeline.workshop import Workshop

VARIABLE = "MOTOR_LEAKAGE_TEST_DATA"
DEFAULT = Path(__file__).parents[3] / "shared" / "data"


@pytest.fixture(scope="session")
def foreign_files() -> Path:
    """Folder of recordings and malformed files from other projects' own tests."""
    folder = Path(os.environ.get(VARIABLE, DEFAULT))
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there: set {VARIABLE} to the folder of real files")
    return folder


@pytest.fixture(scope="session")
def _cluster() -> Iterator[Processes]:
    with scheduler_with(2) as processes:
        yield processes


@pytest.fixture
def two_workers(_cluster: Processes) -> Processes:
    """Two workers; their nannies start them again where a test before has killed one."""
    _cluster.wait_for(2)
    return _cluster


@pytest.fixture
def spec(tmp_path: Path) -> MotorSpec:
    """The motor M1 of a shipped type, without a log."""
    return load_motor(tmp_path, motor_toml("M1"))


@pytest.fixture
def workshop(tmp_path: Path) -> Workshop:
    """A motor without a log yet."""
    return Workshop.at(tmp_path)


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[Server]:
    """An object store with an empty bucket."""
    with s3_server(monkeypatch) as found:
        yield found


@pytest.fixture
def call(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Iterator[Call]:
    """Runs the command in this process; its code, and what it said on stdout and stderr."""
    before = signal.getsignal(signal.SIGTERM)
    monkeypatch.setenv(FORM, "")

    def run(*arguments: str | Path) -> Called:
        monkeypatch.setattr(sys, "argv", ["motor-leakage", *map(str, arguments)])
        capfd.readouterr()
        with pytest.raises(SystemExit) as caught:
            main()
        out, err = capfd.readouterr()
        assert isinstance(caught.value.code, int)
        return caught.value.code, out, err

    yield run
    signal.signal(signal.SIGTERM, before)
