"""Room on the disk is looked at before a run, and a run without it touches nothing."""

from __future__ import annotations

import datetime as dt
import shutil
from pathlib import Path
from typing import NamedTuple

import pytest

from pipeline.config import load_fleet
from pipeline.errors import StoreError
from pipeline.run.disk_space import MIB, STAGING_FACTOR
from pipeline.run.fleet import RunRequest, run_fleet
from pipeline.schema import NIGHT_TABLES, NIGHTLY_TABLES, TREND_TABLES
from pipeline.store.tables import files_of
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


def test_less_than_the_reserve_ends_a_run_before_it_begins(
    workshop: Workshop, monkeypatch: pytest.MonkeyPatch
) -> None:
    leave(monkeypatch, 100 * MIB - 1)
    with pytest.raises(StoreError, match=r"minimum_free_mib is 100") as caught:
        run(workshop)
    assert caught.value.code == "disk_space"
    assert not workshop.output.exists()
    leave(monkeypatch, 100 * MIB)
    run(workshop)
    assert list(workshop.statuses().values()) == ["ok", "ok"]


def test_a_night_asks_for_what_the_largest_of_the_newest_took(
    workshop: Workshop, monkeypatch: pytest.MonkeyPatch
) -> None:
    run(workshop)
    needed = 100 * MIB
    for table in (*NIGHT_TABLES, *TREND_TABLES):
        # Its largest night, or its month once more and what is new of it.
        sizes = [path.stat().st_size for path in files_of(workshop.output, table)]
        needed += (STAGING_FACTOR if table in NIGHTLY_TABLES else 2) * max(sizes, default=0)
    leave(monkeypatch, needed - 1)
    with pytest.raises(StoreError, match="a night asks for 10"):
        run(workshop)
    leave(monkeypatch, needed)
    run(workshop)


def test_0_asks_for_nothing(workshop: Workshop, monkeypatch: pytest.MonkeyPatch) -> None:
    workshop.configure(fleet=QUICK + "minimum_free_mib = 0\n")
    leave(monkeypatch, 1)
    run(workshop)
    assert list(workshop.statuses().values()) == ["ok", "ok"]
