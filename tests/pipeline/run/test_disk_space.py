"""Room on the disk is looked at before a run, and a run without it touches nothing."""

from __future__ import annotations

import datetime as dt
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple, cast

import pytest

from pipeline.config import MotorSpec, load_fleet
from pipeline.errors import StoreError
from pipeline.run.disk_space import (
    MIB,
    NIGHT_BYTES,
    STAGING_FACTOR,
    bytes_a_night,
    new_files,
    require_space,
)
from pipeline.run.fleet import RunRequest, run_fleet
from pipeline.workers.local import Crew
from tests.pipeline.workshop import DAY, QUICK, Workshop

NIGHT = dt.date(2026, 3, 2)


class Usage(NamedTuple):
    total: int
    used: int
    free: int


@pytest.fixture
def workshop(tmp_path: Path) -> Workshop:
    made = Workshop.at(tmp_path)
    for number in range(2):
        made.log(NIGHT + number * DAY)
    return made


def leave(monkeypatch: pytest.MonkeyPatch, free: int) -> None:
    """A disk with so many bytes free."""
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(2 * free, free, free))


def run(workshop: Workshop) -> None:
    run_fleet(RunRequest(load_fleet(workshop.fleet)))


def test_too_little_room_ends_a_run_before_it_begins(
    workshop: Workshop, monkeypatch: pytest.MonkeyPatch
) -> None:
    # What is to stay free, and two nights of which nothing is known yet.
    needed = 100 * MIB + 2 * NIGHT_BYTES
    leave(monkeypatch, needed - 1)
    with pytest.raises(StoreError, match="2 new log files") as caught:
        run(workshop)
    assert caught.value.code == "disk_space"
    assert not workshop.output.exists()
    leave(monkeypatch, needed)
    run(workshop)
    assert list(workshop.statuses().values()) == ["ok", "ok"]


def test_without_new_logs_only_the_reserve_counts(
    workshop: Workshop, monkeypatch: pytest.MonkeyPatch
) -> None:
    run(workshop)
    leave(monkeypatch, 100 * MIB)
    run(workshop)
    leave(monkeypatch, 100 * MIB - 1)
    with pytest.raises(StoreError, match="0 new log files"):
        run(workshop)


def test_0_asks_for_nothing(workshop: Workshop, monkeypatch: pytest.MonkeyPatch) -> None:
    workshop.configure(fleet=QUICK + "minimum_free_mib = 0\n")
    leave(monkeypatch, 1)
    run(workshop)
    assert list(workshop.statuses().values()) == ["ok", "ok"]


def test_logs_are_looked_at_by_workers(workshop: Workshop, monkeypatch: pytest.MonkeyPatch) -> None:
    """One may be on a mount that hangs, which would hang the run itself."""

    class Workers:
        def run_tasks(
            self, _: object, specs: Sequence[MotorSpec], *__: object, first: bool
        ) -> Iterator[int]:
            assert first
            assert [spec.motor_id for spec in specs] == ["M1"]
            return iter([7])

    fleet = load_fleet(workshop.fleet)
    leave(monkeypatch, 100 * MIB)
    with pytest.raises(StoreError, match="7 new log files"):
        require_space(workshop.output, fleet.motors, fleet.execution, cast("Crew", Workers()))


def test_a_night_takes_what_the_largest_of_the_newest_took(workshop: Workshop) -> None:
    assert bytes_a_night(workshop.output) == NIGHT_BYTES
    run(workshop)
    sizes = [
        sum(path.stat().st_size for path in (workshop.output / "tables").rglob(f"{label}.parquet"))
        for label in (NIGHT, NIGHT + DAY)
    ]
    assert bytes_a_night(workshop.output) == STAGING_FACTOR * max(sizes)


def test_new_is_what_the_ledger_does_not_know(workshop: Workshop) -> None:
    (spec,) = load_fleet(workshop.fleet).motors
    assert new_files(workshop.output, spec) == 2
    run(workshop)
    assert new_files(workshop.output, spec) == 0
    workshop.log(NIGHT + 2 * DAY)
    first = workshop.logs / f"{NIGHT}.parquet"
    first.write_bytes(first.read_bytes() + b"more")
    assert new_files(workshop.output, spec) == 2
