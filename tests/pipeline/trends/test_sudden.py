"""Sudden changes that nobody has dated: named as what they may be, and never taken for wear."""

from __future__ import annotations

import re

import pytest

from pipeline.trends.figures.indicators import DEVIATION
from pipeline.trends.states.standing import RAISED, Standing
from pipeline.trends.why.reasons import path_behind, way_of, why_state
from tests.pipeline.trends.nights import (
    OIL,
    PATHS,
    Nights,
    event,
    motor,
    named,
    ramp,
    standing,
    step,
)

N, AT = 110, 70
OTHER_MOTOR = {
    "piston_ring": step(N, AT, -0.20),
    "balance_piston": step(N, AT, 0.25),
    "balance_sleeve": step(N, AT, 0.10),
}


def words(found: Standing, place: int = N - 1) -> str:
    return why_state(found, DEVIATION, place, path_behind(found, DEVIATION, place))


def test_a_motor_exchanged_under_its_old_name() -> None:
    found = standing(Nights(motor(), N, OTHER_MOTOR))
    (one,) = found.sudden
    assert (one.kind, one.place) == ("exchange", AT)
    # Three good nights from it on tell it.
    assert one.told == AT + 2
    # 0.8^⅓ = 0.928
    night = r"every path changed in the one night of 13 March 2026 \(piston ring gap -[78] %"
    assert re.match(night, one.words)
    assert "a motor exchanged or overhauled without a dated event is likely; date it" in one.words
    assert found.states[DEVIATION][one.told] in RAISED
    assert one.words in words(found)


def test_damage_to_every_path_at_once_is_not_ruled_out() -> None:
    worse = {
        "piston_ring": step(N, AT, 0.2),
        "balance_piston": step(N, AT, 0.6),
        "balance_sleeve": step(N, AT, 0.4),
    }
    (one,) = standing(Nights(motor(), N, worse)).sudden
    assert one.kind == "exchange"
    assert "or all were damaged at once" in one.words


def test_another_oil_or_a_sensor_moves_all_flows_by_one_factor() -> None:
    found = standing(Nights(motor(), N, {OIL: step(N, AT, 0.12)}))
    (one,) = found.sudden
    assert (one.kind, one.place) == ("alike", AT)
    assert (
        "as by another oil or a sensor, not by wear; date an oil change in the motor's" in one.words
    )
    assert "all flows × 1.12 ± " in words(found)


def test_leakage_that_falls_in_a_night_is_no_wear() -> None:
    """An overhaul of the sleeves alone: under the old baseline wear would not show for long."""
    found = standing(Nights(motor(), N, {"balance_sleeve": step(N, AT, -0.5)}))
    (one,) = found.sudden
    assert (one.kind, one.place, one.told) == ("fall", AT, AT + 2)
    assert found.states[DEVIATION][AT + 2 :] == ("warning",) * (N - AT - 2)
    assert way_of(found, DEVIATION, AT + 2) == "jump"
    assert words(found).startswith(one.words)
    assert (
        "which no wear does: a motor exchanged or overhauled, another oil or a sensor" in one.words
    )
    # Nothing else is blamed on it.
    assert all(set(found.states[f"K_{path}"]) <= {"insufficient", "ok"} for path in PATHS)


@pytest.mark.parametrize("kind", ["overhaul", "motor_exchanged", "flushing_change"])
def test_a_dated_event_explains_it(kind: str) -> None:
    spec = named(motor(), "M1", events=[event(AT, kind)])
    found = standing(Nights(spec, N, OTHER_MOTOR))
    assert found.sudden == ()
    assert found.states[DEVIATION][AT:] == ("insufficient",) * 15 + ("ok",) * (N - AT - 15)


@pytest.mark.parametrize("path", PATHS)
def test_damage_to_one_path_is_wear_and_not_an_exchange(path: str) -> None:
    found = standing(Nights(motor(), N, {path: step(N, AT, 0.5)}))
    assert found.sudden == ()
    assert found.states[f"K_{path}"][-1] == "alarm"


def test_dirt_that_wears_all_paths_slowly_is_no_exchange() -> None:
    dirt = {path: ramp(N, AT, 0.6) for path in PATHS}
    found = standing(Nights(motor(), N, dirt))
    assert found.sudden == ()
    assert found.states["reference_leakage"][-1] == "alarm"


@pytest.mark.parametrize("seed", range(6))
def test_a_healthy_motor_has_none(seed: int) -> None:
    assert standing(Nights(motor(), 120, seed=seed)).sudden == ()


def test_where_two_paths_of_three_are_known_their_damage_is_no_exchange() -> None:
    verdicts = {(place, "K_piston_ring"): "not_excited" for place in range(N)}
    worse = {"balance_piston": step(N, AT, 0.6), "balance_sleeve": step(N, AT, 0.3)}
    assert standing(Nights(motor(), N, worse, verdicts=verdicts)).sudden == ()
    other = {"balance_piston": step(N, AT, 0.6), "balance_sleeve": step(N, AT, -0.2)}
    (one,) = standing(Nights(motor(), N, other, verdicts=verdicts)).sudden
    assert one.words.startswith("every path that the nights tell changed in the one night of")


def test_what_is_undone_no_longer_stands() -> None:
    there_and_back = {path: step(N, AT, -0.25) / step(N, 90, -0.25) for path in PATHS}
    found = standing(Nights(motor(), N, there_and_back))
    assert found.states[DEVIATION][89] == "warning"
    assert found.states[DEVIATION][-1] == "ok"
    assert found.sudden_at(N - 1) is None


def test_after_weeks_of_silence_nobody_can_tell_what_was_sudden() -> None:
    silent = frozenset(range(AT - 20, AT))
    found = standing(Nights(motor(), N, OTHER_MOTOR, absent=silent))
    assert found.sudden == ()


def test_before_there_is_a_baseline_it_is_said_with_what_is_missing() -> None:
    early = {path: step(40, 8, -0.3) for path in PATHS}
    found = standing(Nights(motor(), 40, early))
    assert {one.place for one in found.sudden} == {8}
    assert found.states[DEVIATION][:15] == ("insufficient",) * 15
    assert set(found.states[DEVIATION][15:]) == {"warning"}
