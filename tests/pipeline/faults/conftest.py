"""One tiny fleet for all tests of faults, made once, however many workers there are; outputs."""

from __future__ import annotations

import datetime as dt
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from pipeline.trends.decisions import Decision, record_decision
from tests.conftest import made_once
from tests.pipeline.faults.crash import Victim, victim_in
from tests.pipeline.faults.fleet import TinyFleet, remembered_fits
from tests.pipeline.simulated import NIGHT


@pytest.fixture(scope="session")
def tiny_fleet(shared_folder: Path) -> TinyFleet:
    """Two motors and two nights; only to be read."""
    return TinyFleet(made_once(shared_folder / "tiny", TinyFleet.at))


@pytest.fixture(scope="session")
def victim(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Victim]:
    with victim_in(tmp_path_factory.mktemp("victim")) as made:
        yield made


@pytest.fixture
def output(tiny_fleet: TinyFleet, tmp_path: Path) -> Path:
    """All that a run leaves; what is copied keeps its times."""
    return shutil.copytree(tiny_fleet.after, tmp_path / "out")


def say(output: Path) -> None:
    """Record three decisions."""
    for number in range(3):
        moment = dt.datetime(2026, 3, 4, 5 + number, tzinfo=dt.UTC)
        note = f"heard nothing, {number}"
        record_decision(output, Decision("M1", "", moment, "finding", NIGHT, "not_confirmed", note))


@pytest.fixture
def _quick() -> Iterator[None]:
    with remembered_fits():
        yield


@pytest.fixture
def without_logs(tiny_fleet: TinyFleet, tmp_path: Path) -> Callable[..., TinyFleet]:
    """The fleet with the logs of some motors alone."""

    def keep(*motors: str) -> TinyFleet:
        folder = tmp_path / "others"
        shutil.copytree(tiny_fleet.folder / "configs", folder / "configs")
        (folder / "logs").mkdir()
        for motor in motors:
            shutil.copytree(tiny_fleet.folder / "logs" / motor, folder / "logs" / motor)
        return TinyFleet(folder)

    return keep
