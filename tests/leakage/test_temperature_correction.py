"""Correction for temperature: recovered where the sensor or the oil is wrong, and 0 otherwise."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from leakage.block_statistics import factors, merge
from leakage.certificate import certify
from leakage.motor import Motor, OperatingConditions, regressors
from leakage.multi_start import Parametrisation
from leakage.temperature_correction import TemperatureCorrection, temperature_correction
from leakage.walther import kinematic_viscosity_mm2_per_s
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
