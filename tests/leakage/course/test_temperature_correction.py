"""Correction for temperature: recovered where the sensor or the oil is wrong, and 0 otherwise."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from leakage.course.temperature_correction import (
    NIGHTS_OF_NOW,
    TemperatureCorrection,
    latest_slopes,
    temperature_correction,
    temperature_response,
)
from leakage.estimation.block_statistics import factors, merge
from leakage.estimation.certificate import certify
from leakage.estimation.multi_start import Parametrisation
from leakage.physics.motor import Motor, OperatingConditions, regressors
from leakage.physics.walther import kinematic_viscosity_mm2_per_s
from tests.leakage.made_nights import autoregression
from tests.leakage.made_samples import true_coefficients
from tests.leakage.placeholders import placeholder_motor, placeholder_oil

Array = NDArray[np.float64]
AtGap = Callable[[Array], Array]

MOTOR = placeholder_motor("CB560")
BLOCKS, SAMPLES = 20, 20


def nights_of(
    n: int, generator: np.random.Generator, at_gap: AtGap, motor: Motor = MOTOR
) -> tuple[Array, Array, NDArray[np.int64]]:
    """Factors, mean temperatures and nights of blocks; the gaps have a temperature of their own."""
    size = n * BLOCKS * SAMPLES
    of_night = np.repeat(50.0 + 3.0 * generator.standard_normal(n), BLOCKS)
    sensor = np.repeat(of_night + generator.uniform(-5.0, 5.0, n * BLOCKS), SAMPLES)
    pressure, speed = generator.uniform(20.0, 300.0, size), generator.uniform(3.0, 100.0, size)
    seen = regressors(MOTOR, OperatingConditions.from_bar(pressure, sensor, speed))
    real = regressors(motor, OperatingConditions.from_bar(pressure, at_gap(sensor), speed))
    flow = real[:, :-2] @ true_coefficients(MOTOR)[:-1] + seen[:, -1]
    gain = 1.0 + 0.003 * np.repeat(autoregression(n, 0.3, generator), BLOCKS * SAMPLES)
    flow = flow * gain + 0.02 * generator.standard_normal(size)
    borders = np.arange(0, size + 1, SAMPLES)
    blocks = factors(np.column_stack([seen, flow]), borders)
    return blocks, sensor[::SAMPLES], np.repeat(np.arange(n), BLOCKS)


def found_of(
    blocks: Array, temperature: Array, clusters: NDArray[np.int64]
) -> TemperatureCorrection:
    fit = certify(merge(blocks), *Parametrisation.of(MOTOR).coefficient_bounds())
    active = ~(fit.fixed | fit.at_lower | fit.at_upper)
    found = temperature_correction(blocks, temperature, clusters, fit.coefficients, active)
    assert found is not None
    return found


def sensor_away(share: float) -> AtGap:
    """The gaps take part in a share of what the sensor sees of a change."""
    return lambda sensor: 50.0 + share * (sensor - 50.0)


def test_a_factor_of_its_own_definition_is_recovered_exactly() -> None:
    generator = np.random.default_rng(1)
    blocks, temperature, nights = nights_of(6, generator, lambda sensor: sensor)
    theta = true_coefficients(MOTOR)
    mean = float(np.mean(temperature))
    # The measured column anew, without noise and with b = −1 % a kelvin.
    gaps = blocks[:, :, :-3] @ theta[:-1]
    warm = 1.0 - 0.01 * (temperature - mean)
    blocks[:, :, -1] = warm[:, None] * gaps + blocks[:, :, -2]
    found = temperature_correction(blocks, temperature, nights, 0.8 * theta, theta > 0.0)
    assert found is not None
    assert found.reference_c == pytest.approx(mean)
    assert found.per_kelvin == pytest.approx(-0.01, rel=1e-5)
    assert found.half_width < 1e-6
    assert found.factor(mean + 2.0) == pytest.approx(0.98)


def test_a_sensor_away_from_the_gaps_is_recovered() -> None:
    """The gaps follow 80 % of a change, so loss factors seem to fall by 20 % of the oil's law."""
    found = found_of(*nights_of(20, np.random.default_rng(2), sensor_away(0.8)))
    assert found.is_certain
    assert found.per_kelvin == pytest.approx(-0.2 * thinning("VG 68"), rel=0.12)


def thinning(grade: str) -> float:
    """Relative loss of viscosity with a kelvin at 50 °C [1/K]."""
    oil = placeholder_oil(grade)
    cold, warm = kinematic_viscosity_mm2_per_s(
        np.array([49.5, 50.5]), oil.walther_a, oil.walther_b
    ).tolist()
    return math.log(cold / warm)


def test_another_oil_curve_shows_and_the_right_one_does_not() -> None:
    """Of VG 46 under VG 68: the oil in use loses less with a kelvin than the stated one."""
    other = replace(MOTOR, oil=placeholder_oil("VG 46"))
    wrong = found_of(*nights_of(20, np.random.default_rng(3), lambda sensor: sensor, other))
    right = found_of(*nights_of(20, np.random.default_rng(3), lambda sensor: sensor))
    assert wrong.per_kelvin == pytest.approx(thinning("VG 46") - thinning("VG 68"), rel=0.15)
    assert wrong.is_certain
    assert not right.is_certain


@pytest.mark.parametrize("share", [1.0, 0.8])
def test_the_interval_holds_the_truth(share: float) -> None:
    generator = np.random.default_rng(4)
    long = found_of(*nights_of(200, generator, sensor_away(share)))
    truth = 0.0 if share == 1.0 else long.per_kelvin
    tries = [found_of(*nights_of(15, generator, sensor_away(share))) for _ in range(60)]
    held = sum(abs(one.per_kelvin - truth) <= one.half_width for one in tries)
    assert held >= 52


def test_where_temperature_does_not_vary_nothing_is_said() -> None:
    blocks, temperature, nights = nights_of(5, np.random.default_rng(5), lambda sensor: sensor)
    theta = true_coefficients(MOTOR)
    same = np.full_like(temperature, 50.0)
    assert temperature_correction(blocks, same, nights, theta, theta > 0.0) is None


def test_wear_in_a_spell_that_warms_is_no_effect_of_temperature() -> None:
    generator = np.random.default_rng(6)
    blocks, temperature, nights = nights_of(12, generator, lambda sensor: sensor)
    theta, warmer = true_coefficients(MOTOR), temperature + nights
    gaps = blocks[:, :, :-3] @ theta[:-1]
    blocks[:, :, -1] = (1.0 + 0.01 * nights)[:, None] * gaps + blocks[:, :, -2]
    time = nights.astype(np.float64)
    worn = temperature_correction(blocks, warmer, nights, theta, theta > 0.0)
    told = temperature_correction(blocks, warmer, nights, theta, theta > 0.0, time)
    assert worn is not None
    assert told is not None
    assert worn.per_kelvin > 0.003
    assert told.per_kelvin == pytest.approx(0.0, abs=1e-6)


def test_a_night_is_brought_to_its_mean_temperature() -> None:
    """A night that warms by 20 K under b = −1 % a kelvin, without noise: θ + b dθ/db is θ."""
    generator = np.random.default_rng(7)
    blocks, _, nights = nights_of(1, generator, lambda sensor: sensor)
    theta = true_coefficients(MOTOR)
    above = np.linspace(-10.0, 10.0, len(nights))
    gaps = blocks[:, :, :-3] @ theta[:-1]
    blocks[:, :, -1] = (1.0 - 0.01 * above)[:, None] * gaps + blocks[:, :, -2]
    free = theta > 0.0
    found = certify(merge(blocks), *Parametrisation.of(MOTOR).coefficient_bounds()).coefficients
    moved = found - 0.01 * temperature_response(blocks, found, free, above)
    before, after = (np.abs(one[free] / theta[free] - 1.0).max() for one in (found, moved))
    assert before > 0.01
    assert after < 0.2 * before


def test_the_slope_over_temperature_is_that_of_the_latest_nights() -> None:
    generator = np.random.default_rng(8)
    nights = np.arange(100)
    warm = 50.0 + 2.0 * generator.standard_normal(100)
    line = 1.0 + 0.001 * nights
    ratio = line + np.where(nights < 50, 0.0, -0.01) * (warm - 50.0)
    ratio[10] = np.nan
    slope, half = latest_slopes(nights, ratio, warm)
    # One night lacks a ratio; the wander of a sensor stays in the ± of what has no noise.
    assert np.flatnonzero(np.isfinite(slope))[0] == NIGHTS_OF_NOW
    assert np.abs(slope[NIGHTS_OF_NOW:50]).max() < 1e-10
    assert slope[-1] == pytest.approx(-0.01)
    # Temperatures without memory differ by more once whitened as the wander is.
    variance = 2.0**2 * (1.0 + 0.6**2) / (1.0 - 0.6**2)
    assert half[-1] == pytest.approx(0.07 * 0.3**2 / variance, rel=0.5)
    nothing, _ = latest_slopes(nights, ratio, np.full(100, 50.0))
    assert np.isnan(nothing).all()


def test_what_is_left_of_an_effect_is_its_interval() -> None:
    certain, small = (
        TemperatureCorrection(-0.01, 0.004, 50.0),
        TemperatureCorrection(1e-3, 0.002, 50.0),
    )
    unknown = TemperatureCorrection(0.001, 0.008, 50.0)
    assert (certain.taken_off, certain.left) == (-0.01, 0.004)
    assert (small.taken_off, small.left) == (0.0, 0.003)
    assert (certain.is_known, small.is_known, unknown.is_known) == (True, True, False)
    # Nights that differ by 0.3 K, as much as a sensor wanders, tell nothing.
    assert certain.with_wander(0.3**2).half_width == pytest.approx(0.07, rel=0.01)
