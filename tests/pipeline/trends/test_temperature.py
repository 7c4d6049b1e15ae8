"""Loss factors that change with temperature: known with the baseline, and taken off after it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline.trends.first_rows import temperature_row
from pipeline.trends.standing import Standing
from tests.pipeline.trends.nights import PATHS, Nights, motor, standing

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


def test_the_row_tells_the_effect_and_its_change(moved: Standing, unmoved: Standing) -> None:
    row = temperature_row(moved, N - 1)
    assert row is not None
    assert row["baseline_mean"] == pytest.approx(-1.0, abs=0.15)
    assert row["lower"] <= -1.0 <= row["upper"]
    assert row["state_reason"].endswith(
        "% a kelvin: the sensor is not where the gap is, or the oil's curve is off"
    )
    assert temperature_row(moved, 3) is None
    none = temperature_row(unmoved, N - 1)
    assert none is not None
    assert none["state_reason"] is None
    changed = temperature_row(standing(motor_with(np.where(np.arange(N) < 90, 0.0, -0.02))), N - 1)
    assert changed is not None
    assert changed["state_reason"].endswith("since the baseline: the sensor or the oil has changed")


def test_nights_of_one_temperature_tell_nothing() -> None:
    found = standing(Nights(motor(), 60))
    assert found.era(59).temperature is None
    assert temperature_row(found, 59) is None
