"""Structured misfit: nights made by the physics of another motor than the one fitted."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from leakage.estimation.blocks import factors, merge
from leakage.estimation.misfit import Misfit, misfit, model_errors
from leakage.estimation.proven_minimum import ProvenMinimum, certify
from leakage.physics.conditions import OperatingConditions
from leakage.physics.motor import Motor, regressors, total_flow_l_per_min
from leakage.physics.oil import FilmPressure
from leakage.physics.paths import SpeedCurve
from tests.leakage.made_samples import autoregression
from tests.leakage.placeholders import placeholder_motor, placeholder_oil

Array = NDArray[np.float64]

BLOCK, MINUTES = 120, 60
# Errors that are forgotten within 10 s, and within 10 min.
FAST, SLOW = math.exp(-1.0 / 10.0), math.exp(-1.0 / 600.0)
MODEL = placeholder_motor()
FIXED = np.array([False, False, False, True])


@dataclass(frozen=True, slots=True)
class Truth:
    """A motor and its sensors as they are: one sample a second."""

    motor: Motor = MODEL
    charge_bar: float | None = None
    temperature_lag_s: float = 0.0
    error_memory_s: float = 10.0
    error: float = 0.015


def lagged(values: Array, lag_s: float) -> Array:
    """First-order lag."""
    if not lag_s:
        return values
    phi = math.exp(-1.0 / lag_s)
    made: Array = lfilter([1.0 - phi], [1.0, -phi], values, zi=[phi * values[0]])[0]
    return made


def night(truth: Truth, generator: np.random.Generator) -> tuple[Array, Array]:
    """Block factors and mean temperature, pressure and speed: a warm-up under steps of load."""
    n = 60 * MINUTES
    pressure, speed = (
        lagged(np.repeat(generator.uniform(low, high, n // hold + 1), hold)[:n], 3.0)
        for low, high, hold in ((15.0, 300.0, 60), (3.0, 110.0, 90))
    )
    temperature = 58.0 - 14.0 * np.exp(-np.arange(n) / 1800.0) + autoregression(SLOW, n, generator)
    at = OperatingConditions.from_bar(pressure, temperature, speed, truth.charge_bar)
    noise = 0.015 * autoregression(FAST, n, generator)
    noise += truth.error * autoregression(math.exp(-1.0 / truth.error_memory_s), n, generator)
    # The sensors wander from night to night.
    gain = 1.0 + 0.003 * generator.standard_normal()
    flow = gain * total_flow_l_per_min(truth.motor, at) + noise
    read = lagged(temperature, truth.temperature_lag_s) + 0.3 * generator.standard_normal()
    columns = regressors(MODEL, OperatingConditions.from_bar(pressure, read, speed))
    seen = np.column_stack([read, pressure, speed])
    means = seen.reshape(-1, BLOCK, 3).mean(axis=1)
    return factors(np.column_stack([columns, flow]), np.arange(0, n + 1, BLOCK)), means


def fit_of(blocks: Array, most_flushing: float = 0.0) -> ProvenMinimum:
    return certify(merge(blocks), np.zeros(4), np.array([1e-9] * 3 + [most_flushing]))


def misfit_of(blocks: Array, means: Array, most_flushing: float = 0.0) -> Misfit:
    theta = fit_of(blocks, most_flushing).coefficients
    fixed = FIXED & (most_flushing == 0.0)
    return misfit(blocks, np.arange(len(blocks)), theta, fixed, means)


def misfits(truth: Truth, nights: int, seed: int = 1) -> list[Misfit]:
    generator = np.random.default_rng(seed)
    return [misfit_of(*night(truth, generator)) for _ in range(nights)]


def with_roller(factor: float) -> Motor:
    paths = tuple(
        replace(path, coefficients=tuple(factor * coefficient for coefficient in path.coefficients))
        if isinstance(path, SpeedCurve)
        else path
        for path in MODEL.paths
    )
    return replace(MODEL, paths=paths)


def test_a_misfit_is_clear_at_twice_what_noise_explains() -> None:
    assert not Misfit(0.02, 0.02, 0.01).is_clear
    assert Misfit(0.02, 0.0201, 0.01).is_clear


def test_a_right_model_leaves_little() -> None:
    shares = [misfit.share for misfit in misfits(Truth(), 60)]
    assert np.quantile(shares, 0.95) < 0.007


def test_a_misfit_is_the_same_in_any_unit_of_the_loss_factors() -> None:
    blocks, means = night(Truth(with_roller(1.3)), np.random.default_rng(2))
    theta = fit_of(blocks).coefficients
    # Columns of norms of 1e13 to 1e15, and of less than 1.
    unit = np.array([1e18] * 3 + [1.0])
    plain, other = (
        misfit(blocks / [*scale, 1.0, 1.0], np.arange(len(blocks)), theta * scale, FIXED, means)
        for scale in (np.ones(4), unit)
    )
    assert other.share == pytest.approx(plain.share, rel=1e-6)


@pytest.mark.parametrize("minutes", [5, 15, 60])
def test_slow_errors_alone_are_no_misfit(minutes: int) -> None:
    found = misfits(Truth(error_memory_s=60.0 * minutes, error=0.03), 30)
    assert sum(night.is_clear and night.share > 0.015 for night in found) <= 1


@pytest.mark.parametrize(
    "truth",
    [
        Truth(charge_bar=15.0),
        Truth(replace(MODEL, film_pressure=FilmPressure("slot"))),
        Truth(replace(MODEL, oil=placeholder_oil("VG 46"))),
        Truth(with_roller(0.6)),
    ],
    ids=["two-sided", "slot film", "VG 46", "roller"],
)
def test_a_wrong_model_leaves_much(truth: Truth) -> None:
    found = misfits(truth, 10)
    assert np.median([night.share for night in found]) > 0.015
    assert sum(night.is_clear for night in found) >= 8


def test_the_size_is_that_of_the_flow_which_the_fit_cannot_follow() -> None:
    """Without noise, τ² is at most V at the minimum, and most of it for a wrong roller."""
    truth = Truth(with_roller(0.6), error=0.0)
    generator = np.random.default_rng(3)
    blocks, means = night(truth, generator)
    cost = fit_of(blocks).cost
    assert 0.9 * cost < misfit_of(blocks, means).l_per_min ** 2 < cost


def test_a_shift_of_the_flow_moves_no_figure_further_than_the_model_error() -> None:
    blocks, _ = night(Truth(), np.random.default_rng(4))
    whole = merge(blocks)
    x, n = whole[:, :3], float(np.sum(whole[:, -3] ** 2))
    contrast = regressors(MODEL, OperatingConditions.from_bar(200.0, 50.0, 30.0))[0, :3]
    (bound,) = model_errors(merge(blocks), FIXED, np.append(contrast, 0.0)[None], 0.01)
    generator = np.random.default_rng(5)
    inverse = np.linalg.inv(x.T @ x)
    moved = []
    for shift in (*generator.standard_normal((50, len(x))), x @ inverse @ contrast):
        scaled = 0.01 * math.sqrt(n) * shift / np.linalg.norm(shift)
        moved.append(abs(contrast @ inverse @ x.T @ scaled))
    assert max(moved[:-1]) < bound
    assert moved[-1] == pytest.approx(bound)


def test_few_blocks_or_one_steady_state_tell_nothing_false() -> None:
    generator = np.random.default_rng(6)
    blocks, means = night(Truth(), generator)
    theta = np.array([path.configured_coefficient for path in MODEL.column_paths] + [0.0])
    # Nine columns, of two blocks each.
    for n, tells in ((17, False), (18, True)):
        judged = misfit(blocks[:n], np.arange(n), theta, FIXED, means[:n])
        assert (judged is not None) == tells
    alike = np.repeat(blocks[:1], 30, axis=0)
    steady = misfit(alike, np.arange(30), theta, FIXED, np.repeat(means[:1], 30, 0))
    assert steady is None or steady.share < 0.015


def test_flushing_that_is_estimated_is_no_misfit() -> None:
    truth = Truth(placeholder_motor(flushing="estimated", flushing_l_per_min=2.0))
    generator = np.random.default_rng(7)
    for most_flushing, is_clear in ((20.0, False), (0.0, True)):
        for _ in range(3):
            judged = misfit_of(*night(truth, generator), most_flushing)
            assert (judged.is_clear and judged.share > 0.015) == is_clear
