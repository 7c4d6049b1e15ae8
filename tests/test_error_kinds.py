"""Errors of machines and sensors against their definitions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import t as student

from benchmarks.error_kinds import (
    dead_band,
    drifting_offset,
    heavy_tailed,
    lagging,
    night_wander,
    random_walk,
    warm_up,
)
from tests.pipeline.demo.test_noise import SERIES, white


def test_heavy_tails_have_variance_one_and_the_tails_of_student() -> None:
    drawn = heavy_tailed(np.random.default_rng(4), (400_000,), freedom=4.0)
    beyond = 2 * student.sf(4 * math.sqrt(2), 4)
    assert np.mean(np.abs(drawn) > 4) == pytest.approx(beyond, rel=0.1)
    assert np.var(heavy_tailed(np.random.default_rng(5), (400_000,), 8.0)) == pytest.approx(
        1.0, rel=0.02
    )


def test_random_walk_spreads_with_the_root_of_time() -> None:
    walk = random_walk(white(90), step_s=60.0, after_an_hour=0.02)
    assert walk[14].std() == pytest.approx(0.01, rel=0.03)
    assert walk[59].std() == pytest.approx(0.02, rel=0.03)
    assert np.corrcoef(walk[59] - walk[29], walk[29])[0, 1] == pytest.approx(0.0, abs=0.03)


def test_warm_up_halves_in_each_half_life() -> None:
    error = warm_up(600.0 * math.log(2.0) * np.arange(4), at_start=0.08)
    assert error == pytest.approx([0.08, 0.04, 0.02, 0.01])


def test_dead_band_takes_two_hundredths_below_40_bar_alone() -> None:
    flow = np.array([0.5, 0.5, 0.5, 0.5, 0.015])
    read = dead_band(flow, np.array([39.9, -10.0, 40.0, 250.0, 10.0]))
    assert read == pytest.approx([0.48, 0.48, 0.5, 0.5, 0.0])


def test_offset_drifts_by_its_size_about_zero() -> None:
    drift = drifting_offset(np.linspace(7.0, 3607.0, 361))
    assert drift[-1] - drift[0] == pytest.approx(0.3)
    assert np.diff(drift) == pytest.approx(0.3 / 360)
    assert drift.mean() == pytest.approx(0.0, abs=1e-12)


def test_lag_follows_a_step_to_63_percent_in_its_time_constant_and_leaves_rest_alone() -> None:
    step = np.where(np.arange(601) >= 1, 60.0, 50.0)
    lagged = lagging(step, 1.0, 120.0)
    assert lagged[0] == 50.0
    assert lagged[120] == pytest.approx(60.0 - 10.0 / math.e)
    assert lagged[600] == pytest.approx(60.0 - 10.0 * math.exp(-5.0))


def test_wander_has_its_sizes_and_memories() -> None:
    wander = night_wander(np.random.default_rng(6), (2, SERIES))
    for values, size, phi in (
        (wander.temperature_c, 0.3, 0.6),
        (wander.gain, 0.003, 0.6),
        (wander.pressure_bar, 0.3, 0.0),
    ):
        assert values.std() == pytest.approx(size, rel=0.03)
        assert np.corrcoef(values)[0, 1] == pytest.approx(phi, abs=0.03)


def test_arguments_stay_as_they_are() -> None:
    given = white(50, 3)
    before = given.copy()
    random_walk(given, 1.0)
    lagging(given, 1.0, 10.0)
    dead_band(given, given)
    assert np.array_equal(given, before)
