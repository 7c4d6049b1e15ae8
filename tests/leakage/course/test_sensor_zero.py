"""Drift of sensors' zeros, as the halts tell it."""

from __future__ import annotations

import numpy as np
import pytest

from leakage.course.sensor_zero import zero_course


def halts(drift: float, seed: int, n: int = 60) -> np.ndarray:
    generator = np.random.default_rng(seed)
    return 0.01 + 0.005 * generator.standard_normal(n) + drift * np.linspace(0, 1, n)


def test_a_drift_beyond_the_tolerance_is_named_and_a_smaller_one_is_not() -> None:
    errors = np.full(60, 0.002)
    found = zero_course(halts(0.08, 2), errors, tolerance=0.02)
    assert found.drifts[-1]
    # Halves of a straight drift differ by half of it.
    assert found.change_lower[-1] < 0.04 < found.change_upper[-1]
    assert not zero_course(halts(0.02, 2), errors, tolerance=0.02).drifts[-1]
    down = zero_course(halts(-0.08, 2), errors, tolerance=0.02)
    assert down.drifts[-1]
    assert down.change[-1] < 0


def test_steady_sensors_are_rarely_accused_without_a_tolerance() -> None:
    errors = np.full(40, 0.001)
    told = sum(
        bool(zero_course(halts(0.0, seed, 40), errors, 0.0).drifts[-1]) for seed in range(300)
    )
    assert 3 <= told <= 27


def test_errors_of_halts_count_where_the_halts_agree_by_chance() -> None:
    found = zero_course(np.zeros(20), np.full(20, 0.03), 0.0)
    assert found.change_upper[-1] == pytest.approx(2.1009 * 0.03 * np.sqrt(2 / 10), rel=1e-4)


def test_halts_without_a_zero_do_not_count() -> None:
    zeros = np.where(np.arange(20) == 4, np.nan, 0.01)
    found = zero_course(zeros, np.full(20, 0.001), 0.02)
    assert found.zero[-1] == pytest.approx(0.01)
    assert not found.drifts[-1]


def test_few_halts_say_nothing() -> None:
    for n in (0, 1, 9):
        found = zero_course(np.zeros(n), np.full(n, 0.01), 0.02)
        assert len(found.zero) == n
        assert np.isnan(found.zero).all()
