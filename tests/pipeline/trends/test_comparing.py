"""A motor before and after a date, from the tables of a run."""

from __future__ import annotations

import datetime as dt
import json
from pathlib import Path

import pytest

from pipeline.errors import UsageError
from pipeline.trends.comparing import compare_nights
from tests.pipeline.conftest import Call
from tests.pipeline.trends.nights import Nights, event, fleet_of, motor, named, night_of, step

N, AT = 40, 24
WORN = Nights(motor(), N, {"balance_sleeve": step(N, AT, 0.5)})


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return fleet_of(tmp_path_factory.mktemp("compared"), WORN, until=N)


def test_a_worn_gap_is_named(fleet: tuple[Path, Path]) -> None:
    found = compare_nights(fleet[1], WORN.spec, night_of(AT), most=60)
    assert (len(found.before), len(found.after)) == (AT, N - AT)
    assert found.found.cause == "balance_sleeve"
    assert found.found.probability > 0.99
    assert "over 99 % probable" in found.lines[1]
    assert "balance sleeve over 99 %" in found.lines[2]


def test_nothing_is_said_of_a_cause_where_nothing_has_changed(fleet: tuple[Path, Path]) -> None:
    found = compare_nights(fleet[1], WORN.spec, night_of(AT - 10), most=10)
    assert (len(found.before), len(found.after)) == (10, 10)
    assert found.found.probability < 0.5
    assert found.found.change.holds_zero
    assert not any(line.startswith("cause") for line in found.lines)


def test_no_night_beyond_another_event_is_compared(fleet: tuple[Path, Path]) -> None:
    others = (event(4, "overhaul"), event(20, "note"), event(AT + 6, "overhaul"))
    spec = named(WORN.spec, "M1", events=others)
    found = compare_nights(fleet[1], spec, night_of(AT), most=60)
    assert found.before == tuple(night_of(place) for place in range(4, AT))
    assert found.after == tuple(night_of(place) for place in range(AT, AT + 6))


def test_too_few_nights_are_refused(fleet: tuple[Path, Path]) -> None:
    with pytest.raises(UsageError, match=r"M1, .* 5 nights before and 35 after"):
        compare_nights(fleet[1], WORN.spec, night_of(5), most=60)
    with pytest.raises(UsageError, match="0 after"):
        compare_nights(fleet[1], WORN.spec, night_of(N), most=60)


def test_the_command_prints_and_gives_plain_data(fleet: tuple[Path, Path], call: Call) -> None:
    asked = ("compare", fleet[0], "M1", "--at", str(night_of(AT)))
    code, out, _ = call(*asked)
    assert code == 0
    assert out.startswith(f"M1: {N - AT} nights")
    code, out, _ = call(*asked, "--json")
    record = json.loads(out)
    assert record["cause"] == "balance_sleeve"
    assert dt.date.fromisoformat(record["after"][0]) == night_of(AT)
    assert record["change_lower"] < record["change"] < record["change_upper"]
