"""Loss factors that change with temperature: known with the baseline, and taken off after it."""

from __future__ import annotations

import datetime as dt
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline.trends.figures.filtered_nights import with_filter
from pipeline.trends.rows.alarm_rows import alarm_rows
from pipeline.trends.states.standing import Standing
from pipeline.trends.states.temperature_watch import NOT_TOLD
from pipeline.trends.why.reasons import why_state
from tests.pipeline.trends.nights import PATHS, Nights, histories, motor, standing, standings

N, EFFECT = 150, -0.01
GAPS = ("K_piston_ring", "K_balance_piston", "K_balance_sleeve")


def temperatures(warm_from: int = 0) -> NDArray[np.float64]:
    """Nights about 50 °C that warm by 8 K over the nights from one on."""
    generator = np.random.default_rng(3)
    weather = 2.0 * generator.standard_normal(N)
    return 50.0 + weather + 8.0 * np.clip((np.arange(N) - warm_from) / 60.0, 0.0, 1.0)


def motor_with(effect: NDArray[np.float64] | float) -> Nights:
    """A healthy motor whose gaps all follow temperature by so much a kelvin."""
    warm = temperatures(70)
    generator = np.random.default_rng(5)
    factor = (1.0 + effect * (warm - 50.0)) * (1.0 + 0.003 * generator.standard_normal(N))
    return Nights(motor(), N, dict.fromkeys(PATHS, factor), operation={"mean_temperature_c": warm})


@pytest.fixture(scope="module")
def moved() -> Standing:
    return standing(motor_with(EFFECT))


@pytest.fixture(scope="module")
def unmoved() -> Standing:
    return standing(motor_with(0.0))


def test_it_is_frozen_with_the_baseline(moved: Standing, unmoved: Standing) -> None:
    found = moved.era(N - 1).temperature
    assert found is not None
    assert found.per_kelvin == pytest.approx(EFFECT, abs=found.half_width)
    assert found.is_certain
    assert found.half_width < 0.003
    none = unmoved.era(N - 1).temperature
    assert none is not None
    assert not none.is_certain


def test_warm_nights_are_no_fall_of_the_drain_flow(moved: Standing, unmoved: Standing) -> None:
    """8 K are −8 % of the gaps' leakage; without them taken off, a rise of 8 % would be hidden."""
    for name in ("baseline_deviation", "own_reference_leakage", "reference_leakage", *GAPS):
        raw = unmoved.watched[name].series
        told = moved.watched[name].series
        shift = np.nanmean(told[-15:]) / np.nanmean(told[:60])
        assert shift == pytest.approx(np.nanmean(raw[-15:]) / np.nanmean(raw[:60]), abs=0.02)
        assert set(moved.states[name][60:]) <= {"ok"}


def test_without_an_effect_no_figure_moves(unmoved: Standing) -> None:
    records = unmoved.history.records
    for number, name in enumerate(GAPS):
        values = unmoved.watched[name].indicator.value
        assert np.array_equal(values, records["figures"][:, number, 0], equal_nan=True)


def test_a_night_is_told_as_a_run_on_it_would_have(moved: Standing) -> None:
    nights = motor_with(EFFECT)
    for place in (20, 40, 80):
        then = standing(nights, tonight=place)
        assert len(then.history) == place + 1
        for name in GAPS:
            assert (
                then.watched[name].indicator.value[place]
                == moved.watched[name].indicator.value[place]
            )


def test_the_row_tells_the_effect(moved: Standing, unmoved: Standing) -> None:
    row = moved.temperature.row(N - 1)
    assert row is not None
    assert row["baseline_mean"] == pytest.approx(-1.0, abs=0.15)
    assert row["lower"] <= -1.0 <= row["upper"]
    assert row["state"] == "ok"
    assert row["state_reason"].endswith(
        "% a kelvin: the sensor is not where the gap is, or the oil's curve is off"
    )
    assert moved.temperature.row(3) is None
    none = unmoved.temperature.row(N - 1)
    assert none is not None
    assert none["state_reason"] is None


def test_a_change_of_the_effect_is_a_warning_that_names_sensor_and_oil() -> None:
    """2 % a kelvin over a weather of 2 K are 4 %, with no change on the mean of the nights."""
    generator = np.random.default_rng(3)
    warm = 50.0 + 2.0 * generator.standard_normal(N)
    effect = np.where(np.arange(N) < 90, 0.0, -0.02)
    factor = (1.0 + effect * (warm - 50.0)) * (1.0 + 0.003 * generator.standard_normal(N))
    weather = {"mean_temperature_c": warm}
    found = standing(Nights(motor(), N, dict.fromkeys(PATHS, factor), operation=weather))
    states = found.states["temperature_effect"]
    assert set(states[60:90]) == {"ok"}
    assert "warning" in states[90:121]
    place = states.index("warning")
    words = found.temperature.words(place)
    assert words.startswith("the temperature sensor or the oil's curve has changed since ")
    assert "K falls by" in words
    (row,) = [one for one in alarm_rows(found, [place]) if one["indicator"] == "temperature_effect"]
    assert (row["way"], row["reason"]) == ("drift", words)
    assert words in why_state(found, "baseline_deviation", place, None)


def test_nights_of_one_temperature_tell_nothing() -> None:
    found = standing(Nights(motor(), 60))
    assert found.era(59).temperature is None
    assert found.temperature.row(59) is None


def test_an_effect_that_the_last_nights_do_not_tell_is_insufficient() -> None:
    """Weather for 80 nights, and then a season alone: a straight line in time."""
    warm = np.where(np.arange(N) < 80, temperatures(N), 50.0 + 0.02 * np.arange(N))
    found = standing(Nights(motor(), N, operation={"mean_temperature_c": warm}))
    states = found.states["temperature_effect"]
    assert set(states[65:95]) == {"ok"}
    assert states[-1] == "insufficient"
    row = found.temperature.row(N - 1)
    assert row is not None
    assert (row["value"], row["upper"], row["gated_reason"]) == (None, None, NOT_TOLD)
    rows = alarm_rows(found, [states[:].index("insufficient", 95)])
    (ended,) = [one for one in rows if one["indicator"] == "temperature_effect"]
    assert (ended["to_state"], ended["reason"]) == ("insufficient", NOT_TOLD)


def test_while_it_is_unknown_a_warm_night_carries_what_it_may_be() -> None:
    """1 % a kelvin: 6 K above the baseline's nights are no rise below 6 %."""
    warm = np.where(np.arange(29) < 20, 50.0, 56.0)
    factor = np.where(np.arange(29) < 20, 1.0, 1.05)
    weather = {"mean_temperature_c": warm}
    found = standing(Nights(motor(), 29, dict.fromkeys(PATHS, factor), operation=weather))
    sleeve = found.watched["K_balance_sleeve"].indicator
    allowed = np.broadcast_to(sleeve.allowance, 29)
    assert allowed[20:] == pytest.approx(0.06)
    assert sleeve.upper[20] > 1.06 * sleeve.value[20]
    assert set(found.states["baseline_deviation"][20:]) == {"ok"}
    plain = standing(Nights(motor(), 29, dict.fromkeys(PATHS, factor)))
    assert "warning" in plain.states["baseline_deviation"]


def test_what_warm_nights_tell_the_filter_is_brought_to_one_temperature() -> None:
    """Nights that do not tell a K alone take the filter's; 8 K are −8 % of it without b."""
    nights = motor_with(EFFECT)
    hidden = {(place, GAPS[2]): "not_excited" for place in range(60, N)}
    found = standings(
        histories(replace(nights, verdicts=hidden)),
        change=lambda one: with_filter(one, dt.date.min),
    )["M1"]
    sleeve = found.watched[GAPS[2]].indicator
    assert (sleeve.n_nights[60:] > 1).all()
    assert np.mean(sleeve.value[-15:]) == pytest.approx(np.mean(sleeve.value[20:60]), rel=0.02)


def test_the_blocks_of_a_night_are_brought_to_its_mean_temperature() -> None:
    """θ + b dθ/db before it is brought to T₀, once b is known."""
    nights = motor_with(EFFECT)
    plain = standing(nights)
    theta = plain.history.records["theta"][0]
    response = {"coefficient_response": (2.0 * theta).tolist()}
    found = standing(replace(nights, changes=dict.fromkeys((10, N - 1), response)))
    frozen = found.era(N - 1).temperature
    assert frozen is not None
    moved = found.watched[GAPS[0]].indicator.value - plain.watched[GAPS[0]].indicator.value
    warm = nights.operation["mean_temperature_c"][N - 1]
    expected = frozen.per_kelvin * 2.0 * theta[0] / float(frozen.factor(warm))
    assert moved[10] == 0.0
    assert moved[N - 1] == pytest.approx(expected)
