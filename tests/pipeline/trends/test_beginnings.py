"""From when on other motors see a new baseline: from its date, or from what was not told yet."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.trends.circuits import Circuit, beginnings, earlier_views
from pipeline.trends.nights import trend_record as record
from pipeline.trends.nights.decisions import Decision
from pipeline.trends.nights.trend_record import (
    Record,
    forget_records,
    read_record,
    trend_hash,
    write_record,
)
from tests.pipeline.trends.nights import Nights, event, history, motor, named, night_of, reset

SPEC = named(motor(), "M1", "tank", [event(20, "overhaul"), event(40, "motor_exchanged")])
SAID = (reset(30, "K_piston_ring"),)
OVERHAUL, EXCHANGED, RESET = (
    f"overhaul {night_of(20)}",
    f"motor_exchanged {night_of(40)}",
    f"baseline_reset {night_of(30)} K_piston_ring",
)
DATED = {OVERHAUL: night_of(20), EXCHANGED: night_of(40), RESET: night_of(30)}


def test_at_first_each_counts_from_its_date() -> None:
    assert beginnings(SPEC, SAID, None, None) == DATED
    # A record of an older version does not say.
    assert beginnings(SPEC, SAID, None, night_of(50)) == DATED


def test_what_is_dated_back_counts_from_the_first_night_that_was_not_told() -> None:
    found = beginnings(SPEC, SAID, {}, night_of(35))
    assert found == {OVERHAUL: night_of(36), EXCHANGED: night_of(40), RESET: night_of(36)}
    # Once seen, it stays.
    assert beginnings(SPEC, SAID, found, night_of(60)) == found
    assert beginnings(SPEC, (), found, night_of(60)).keys() == {OVERHAUL, EXCHANGED}


def test_another_oil_counts_from_its_date_as_the_figures_since_are_others() -> None:
    same, other = (event(20, "oil_change", oil=oil) for oil in (SPEC.file.oil, "vg46"))
    for one, night in ((same, 36), (other, 20)):
        spec = named(motor(), "M1", "tank", [one])
        assert list(beginnings(spec, (), {}, night_of(35)).values()) == [night_of(night)]


def test_an_earlier_view_is_without_what_came_later() -> None:
    seen = beginnings(SPEC, SAID, {OVERHAUL: night_of(25)}, night_of(35))
    whole = replace(history(Nights(SPEC, 50)), decisions=SAID)
    views = list(earlier_views(whole, seen))
    assert [
        (until, [one.kind for one in then.spec.file.events], then.decisions)
        for until, then in views
    ] == [
        (night_of(36), ["overhaul", "motor_exchanged"], ()),
        (night_of(25), ["motor_exchanged"], ()),
    ]
    assert list(earlier_views(whole, DATED)) == []


def test_a_record_keeps_it_where_the_trends_are_forgotten(tmp_path: Path) -> None:
    kept = Record("hash", night_of(50), None, DATED)
    for name in ("M1", "M2"):
        write_record(tmp_path, name, kept)
        assert read_record(tmp_path, name) == kept
    forget_records(tmp_path, {"M2"})
    assert read_record(tmp_path, "M1") == Record("", night_of(50), None, DATED)
    assert read_record(tmp_path, "M2") == kept


def test_a_motors_hash_is_made_once_and_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a circuit of 300, each was made 300 times."""
    made = []
    real = record.config_hash

    def counted(spec: object) -> str:
        made.append(spec)
        return real(spec)  # type: ignore[arg-type]

    monkeypatch.setattr(record, "config_hash", counted)
    specs = [named(motor(), f"M{number}", "tank") for number in range(5)]
    said: tuple[Decision, ...] = (reset(20, motor_id="M3"),)
    before = Circuit.of(tmp_path, specs, ())
    assert len(made) == len(specs)
    after = Circuit.of(tmp_path, specs, said)
    assert {one for one in before.hashes if before.hashes[one] != after.hashes[one]} == {"M3"}
    assert trend_hash(specs[0], ()) == before.hashes["M0"]
