"""A day that is going on: what a look tells, when, and that it tells it once."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import numpy as np
import pytest

from pipeline.config import load_fleet
from pipeline.errors import LockedError
from pipeline.look import look as module
from pipeline.look.comparison import NightsBefore
from pipeline.store.locks import locked
from tests.pipeline.faults.crash import FAULTS, Fault, victim_in
from tests.pipeline.look.fleet import (
    BEGIN,
    HEADER,
    MINUTES,
    TODAY,
    Growing,
    configured,
    made_watch,
    night_rows,
)
from tests.pipeline.remembered import look_of

RISE = 30.0
SECONDS = 60


@pytest.fixture(scope="module")
def before(tmp_path_factory: pytest.TempPathFactory) -> NightsBefore:
    return made_watch(configured(tmp_path_factory.mktemp("made")).spec)


@pytest.fixture
def fleet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, before: NightsBefore) -> Growing:
    """One motor whose last published night ends before today's log begins."""
    made = configured(tmp_path / "fleet")
    monkeypatch.setattr(module, "nights_before", lambda *_: before)
    return made


def day(fleet: Growing, rise: float = 0.8, motor: int = 0) -> list[str]:
    return night_rows(load_fleet(fleet.fleet).motors[motor], TODAY, 500 + motor, rise, RISE)


def states(fleet: Growing) -> list[tuple[str, str]]:
    return [(str(row["from_state"]), str(row["to_state"])) for row in fleet.looks()]


BEGUN = [("not_ready", "blind"), ("blind", "clear")]
TOLD = [*BEGUN, ("clear", "look_now")]


def test_a_broken_ring_is_told_within_ten_minutes_of_its_first_sample(fleet: Growing) -> None:
    rows = day(fleet)
    fleet.append(rows[: 32 * SECONDS])
    minute = 32
    while not fleet.told() and minute < MINUTES:
        fleet.append(rows[minute * SECONDS : (minute + 1) * SECONDS])
        minute += 1
        fleet.look(minute)
    assert minute <= RISE + 10
    (told,) = fleet.told()
    assert told["to_state"] == "look_now"
    assert 50.0 < told["change_lower"] < told["change_upper"] < 110.0
    began = BEGIN + dt.timedelta(minutes=RISE)
    assert abs(dt.datetime.fromisoformat(str(told["since"])) - began) <= dt.timedelta(minutes=6)


def test_looks_each_minute_tell_what_one_look_at_the_end_tells(
    fleet: Growing, tmp_path: Path
) -> None:
    rows = day(fleet)
    other = fleet.copy(tmp_path / "other")
    for minute in range(0, 50, 7):
        fleet.append(rows[minute * SECONDS : (minute + 7) * SECONDS])
        fleet.look(minute + 7)
    other.append(rows)
    other.look()
    assert states(fleet) == TOLD
    assert fleet.looks() == other.looks()
    assert len(fleet.told()) == 1
    check_same(fleet, other)


def check_same(*fleets: Growing) -> None:
    ours, theirs = (look_of(one.output, "M1").blocks for one in fleets)
    np.testing.assert_allclose(ours, theirs, rtol=1e-9)


def test_a_healthy_motor_is_clear_and_blind_when_its_log_ends(fleet: Growing) -> None:
    fleet.append(day(fleet, rise=0.0))
    fleet.look()
    fleet.look(MINUTES + 50)
    assert states(fleet) == BEGUN
    fleet.look(MINUTES + 70)
    assert states(fleet) == [*BEGUN, ("clear", "blind")]
    assert "no new samples" in str(fleet.looks()[-1]["reason"])
    assert fleet.told() == []


def test_a_rise_that_ends_is_taken_back(fleet: Growing) -> None:
    rows, well = day(fleet), day(fleet, rise=0.0)
    fleet.append([*rows[: 36 * SECONDS], *well[36 * SECONDS :]])
    fleet.look()
    assert states(fleet) == [*TOLD, ("look_now", "clear")]
    assert [one["to_state"] for one in fleet.told()] == ["look_now", "clear"]


def test_motors_of_a_tank_that_rise_alike_are_said_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fleet: Growing
) -> None:
    tank = configured(tmp_path / "tank", ("M1", "M2"), circuit="tank")
    watches = {one.motor_id: made_watch(one) for one in load_fleet(tank.fleet).motors}
    monkeypatch.setattr(module, "nights_before", lambda _, spec, *__: watches[spec.motor_id])
    tank.append(day(tank), "M1")
    tank.append(day(tank, motor=1), "M2")
    tank.look()
    told = [row for row in tank.looks() if row["to_state"] == "look_now"]
    assert len(told) == 2
    assert all("all motors of its oil circuit" in str(row["reason"]) for row in told)


def test_without_a_watch_nothing_is_read_and_nobody_is_told(
    fleet: Growing, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "nights_before", lambda *_: "5 of 8 nights")
    fleet.append(day(fleet))
    (found,) = fleet.look()
    assert (found.state.state, found.state.reason) == ("not_ready", "5 of 8 nights")
    assert found.state.files == {}
    assert fleet.looks() == fleet.told() == []


def test_a_log_written_anew_under_the_reader_is_told_once(fleet: Growing, tmp_path: Path) -> None:
    rows, other = day(fleet), fleet.copy(tmp_path / "other")
    fleet.append(rows[: 20 * SECONDS])
    fleet.look(20)
    # Cut and written anew with what was there before, then rotated away under another name.
    fleet.today().write_text(HEADER + "".join(rows[: 41 * SECONDS]), "utf-8")
    fleet.look(41)
    fleet.today().rename(fleet.today().with_name("old.csv"))
    fleet.append(rows[41 * SECONDS :])
    fleet.look()
    assert states(fleet) == TOLD
    assert len(fleet.told()) == 1
    other.append(rows)
    other.look()
    check_same(fleet, other)


def test_neither_a_single_stamp_far_ahead_nor_a_nightly_run_blinds_and_a_second_look_is_refused(
    fleet: Growing,
) -> None:
    rows = day(fleet)
    ahead = BEGIN + dt.timedelta(hours=20)
    wrong = f"{ahead:%Y-%m-%dT%H:%M:%SZ}{rows[0][20:]}"
    fleet.append([*rows[: 20 * SECONDS], wrong])
    fleet.look(20)
    fleet.append(rows[20 * SECONDS :])
    with locked(fleet.output):
        fleet.look()
    with locked(fleet.output / "look"), pytest.raises(LockedError):
        fleet.look()
    assert states(fleet) == TOLD
    assert len(fleet.told()) == 1


def test_a_log_that_cannot_be_read_costs_no_other_motor_and_is_said(fleet: Growing) -> None:
    fleet.append(["\x00nothing\n"])
    (found,) = fleet.look()
    assert not found.fault
    assert found.state.state == "blind"
    fleet.today().unlink()
    fleet.append(day(fleet))
    fleet.look()
    assert states(fleet)[-1] == TOLD[-1]


def look(folder: Path, _: Path) -> None:
    """A look in a process of its own."""
    fleet = Growing(folder)
    before = made_watch(fleet.spec)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(module, "nights_before", lambda *_: before)
        fleet.look()


EVERY = [pytest.param(fault, 1, marks=pytest.mark.full) for fault in FAULTS]


@pytest.mark.parametrize(("fault", "every"), [("killed", 31), ("full", 31), *EVERY])
def test_a_look_that_is_broken_off_anywhere_is_made_up_for(
    fleet: Growing, tmp_path: Path, fault: Fault, every: int
) -> None:
    """Told once, and all of it, by the next look on a sound disk."""
    fleet.append(day(fleet))
    whole = fleet.copy(tmp_path / "whole")
    with victim_in(tmp_path) as victim:
        n = victim.crash_at(0, look, whole.folder, whole.output, fault).seen
        assert states(whole) == TOLD
        (told,) = whole.told()
        for point in range(1, n + 1, every):
            other = fleet.copy(tmp_path / str(point))
            victim.crash_at(point, look, other.folder, other.output, fault)
            other.look()
            assert other.looks() == whole.looks()
            assert {one["id"] for one in other.told()} == {told["id"]}
