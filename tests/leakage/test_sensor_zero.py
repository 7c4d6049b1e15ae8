"""Zeros of sensors in halts, and their drift."""

from __future__ import annotations

import numpy as np
import pytest

from leakage.errors import ParameterError, ShapeError
from leakage.sensor_zero import halt_zero, zero_drift
from tests.leakage.made_nights import autoregression


def test_the_zero_of_a_settled_halt_holds_the_truth() -> None:
    """Ten minutes at 1 Hz, errors that remember for some seconds."""
    generator = np.random.default_rng(1)
    held = settled = 0
    for _ in range(300):
        found = halt_zero(0.05 + 0.01 * autoregression(600, 0.8, generator), 0.0)
        settled += found.status == "ok"
        # Student's t of seven degrees of freedom.
        held += found.status == "ok" and abs(found.zero - 0.05) <= 2.365 * found.standard_error
    assert settled >= 270
    assert held / settled > 0.9


def test_a_sensor_in_steps_is_known_no_better_than_its_steps() -> None:
    found = halt_zero(np.full(1000, 0.02), resolution=0.02)
    assert (found.status, found.zero) == ("ok", pytest.approx(0.02))
    assert found.standard_error == pytest.approx(0.02 / np.sqrt(12))


def test_a_halt_that_has_not_settled_has_no_zero() -> None:
    seconds = np.arange(600.0)
    decaying = 0.4 * np.exp(-seconds / 200) + 0.001 * np.sin(seconds)
    found = halt_zero(decaying, resolution=0.001)
    assert found.status == "not_settled"
    assert np.isnan(found.zero)
    assert halt_zero(decaying[500:] * 0 + 0.01, 0.001).status == "ok"


def test_short_halts_and_gaps() -> None:
    assert halt_zero(np.zeros(79), 0.01).status == "too_short"
    assert halt_zero(np.empty(0), 0.01).status == "too_short"
    gappy = np.zeros(200)
    gappy[::3] = np.nan
    assert halt_zero(gappy, 0.01).status == "ok"
    assert halt_zero(np.full(200, np.nan), 0.01).status == "too_short"


def halts(drift: float, seed: int, n: int = 60) -> np.ndarray:
    generator = np.random.default_rng(seed)
    return 0.01 + 0.005 * generator.standard_normal(n) + drift * np.linspace(0, 1, n)


def test_a_drift_beyond_the_tolerance_is_named_and_a_smaller_one_is_not() -> None:
    nights, errors = np.arange(60), np.full(60, 0.002)
    drifts = zero_drift(nights, halts(0.08, 2), errors, tolerance=0.02)
    assert drifts.status == "drifts"
    # Halves of a straight drift differ by half of it.
    assert drifts.change_lower < 0.04 < drifts.change_upper
    assert zero_drift(nights, halts(0.02, 2), errors, tolerance=0.02).status == "steady"
    down = zero_drift(nights, halts(-0.08, 2), errors, tolerance=0.02)
    assert down.status == "drifts"
    assert down.change < 0


def test_steady_sensors_are_rarely_accused_without_a_tolerance() -> None:
    nights, errors = np.arange(40), np.full(40, 0.001)
    told = sum(
        zero_drift(nights, halts(0.0, seed, 40), errors, 0.0).status == "drifts"
        for seed in range(300)
    )
    assert 3 <= told <= 27


def test_errors_of_halts_count_where_the_halts_agree_by_chance() -> None:
    found = zero_drift(np.arange(20), np.zeros(20), np.full(20, 0.03), 0.0)
    assert found.change_upper == pytest.approx(2.1009 * 0.03 * np.sqrt(2 / 10), rel=1e-4)


def test_several_halts_a_night_and_halts_without_a_zero() -> None:
    nights = np.repeat(np.arange(10), 2)
    zeros = np.where(np.arange(20) == 4, np.nan, 0.01)
    found = zero_drift(nights, zeros, np.full(20, 0.001), 0.02)
    assert (found.status, found.n_halts) == ("steady", 19)


def test_few_halts_say_nothing() -> None:
    for n in (0, 1, 9):
        found = zero_drift(np.arange(n), np.zeros(n), np.full(n, 0.01), 0.02)
        assert (found.status, found.n_halts) == ("insufficient", n)
        assert np.isnan(found.zero)


def test_what_makes_no_sense_is_refused() -> None:
    with pytest.raises(ShapeError):
        zero_drift(np.arange(3), np.zeros(2), np.zeros(3), 0.02)
    with pytest.raises(ShapeError):
        zero_drift(np.array([3, 2]), np.zeros(2), np.zeros(2), 0.02)
    for tolerance in (-0.1, float("nan")):
        with pytest.raises(ParameterError):
            zero_drift(np.arange(3), np.zeros(3), np.zeros(3), tolerance)
