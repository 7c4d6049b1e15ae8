"""A motor before and after a date, from the tables of a run."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.trends.comparing import compare_nights
from tests.pipeline.trends.nights import Nights, event, fleet_of, motor, named, night_of, step

N, AT = 40, 24
WORN = Nights(motor(), N, {"balance_sleeve": step(N, AT, 0.5)})


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return fleet_of(tmp_path_factory.mktemp("compared"), WORN, until=N)


def test_no_night_beyond_another_event_is_compared(fleet: tuple[Path, Path]) -> None:
    others = (event(4, "overhaul"), event(20, "note"), event(AT + 6, "overhaul"))
    spec = named(WORN.spec, "M1", events=others)
    found = compare_nights(fleet[1], spec, night_of(AT), most=60)
    assert found.before == tuple(night_of(place) for place in range(4, AT))
    assert found.after == tuple(night_of(place) for place in range(AT, AT + 6))
