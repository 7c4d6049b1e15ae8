"""Baselines: what they withstand, and that they are as certain as they say."""

from __future__ import annotations

import numpy as np
import pytest

from leakage.course.autoregression import long_run_factor
from leakage.course.baseline import BaselineSettings, fit_baseline, floored_phi
from leakage.errors import ParameterError, ShapeError
from tests.leakage.made_nights import autoregression

BARE = BaselineSettings(relative_floor=0.0)


def test_of_normal_nights_it_is_mean_and_standard_deviation() -> None:
    generator = np.random.default_rng(1)
    values = 5.0 + 0.1 * generator.standard_normal(60)
    found = fit_baseline(np.arange(60), values, BARE)
    assert (found.status, found.n) == ("frozen", 60)
    assert found.mean == pytest.approx(np.mean(values), rel=1e-3)
    assert found.sd == pytest.approx(np.std(values, ddof=1), rel=1e-2)


def test_only_the_first_good_nights_count() -> None:
    values = np.full(200, 1.0)
    values[:60:2] = np.nan
    values[90:] = 7.0
    found = fit_baseline(np.arange(10, 210), values)
    assert (found.first_night, found.last_night, found.n, found.mean) == (11, 99, 60, 1.0)


def test_odd_nights_move_it_little() -> None:
    """Heavy tails of single nights: six of sixty ten standard deviations off."""
    generator = np.random.default_rng(2)
    clean = 1.0 + 0.03 * generator.standard_normal(60)
    spoilt = clean.copy()
    spoilt[::10] += 0.3
    before, after = (fit_baseline(np.arange(60), some, BARE) for some in (clean, spoilt))
    assert abs(after.mean - before.mean) < 0.5 * abs(spoilt.mean() - clean.mean())
    assert after.sd < 0.6 * np.std(spoilt)


def test_the_error_of_the_mean_is_what_means_scatter_by() -> None:
    generator = np.random.default_rng(3)
    nights = np.flatnonzero(generator.random(90) > 0.3)[:60]
    found = [
        fit_baseline(nights, autoregression(90, 0.5, generator)[nights], BARE) for _ in range(400)
    ]
    spread = np.std([one.mean for one in found])
    assert np.sqrt(np.mean([one.mean_error**2 for one in found])) == pytest.approx(spread, rel=0.12)


def test_wear_within_it_is_not_taken_for_memory() -> None:
    """A trend of three standard deviations has a raw correlation of 0.4 from night to night."""
    generator = np.random.default_rng(4)
    nights = np.arange(60)
    phis = [
        fit_baseline(nights, generator.standard_normal(60) + 0.05 * nights, BARE).phi
        for _ in range(100)
    ]
    raw = generator.standard_normal(60) + 0.05 * nights
    assert np.corrcoef(raw[1:], raw[:-1])[0, 1] > 0.25
    assert np.mean(phis) < 0.1


def test_a_baseline_with_a_slope_is_flagged_and_a_steady_one_is_not() -> None:
    generator = np.random.default_rng(5)
    nights = np.arange(60)
    noise = 0.004 * generator.standard_normal((100, 60))
    steady = [fit_baseline(nights, 1.0 + some) for some in noise]
    worn = [fit_baseline(nights, 1.0 + some + 0.0005 * nights) for some in noise]
    assert not any(one.sloped for one in steady)
    assert all(one.sloped for one in worn)
    assert "slope" in worn[0].reason
    # Certain, and less than sensors drift by themselves: no wear.
    assert not fit_baseline(nights, 1.0 + noise[0] + 0.0001 * nights).sloped


def test_the_floor_keeps_the_spread_of_long_sums() -> None:
    """σ² (1 + φ)/(1 − φ) of the nights and σ_f² − σ² of what has no memory, together."""
    for sd, phi in ((1.0, 0.6), (0.5, 0.6), (0.3, 0.9), (0.8, 0.0)):
        joined = long_run_factor(floored_phi(sd, 1.0, phi))
        assert joined == pytest.approx(sd**2 * long_run_factor(phi) + 1 - sd**2)
    assert floored_phi(0.0, 0.0, 0.5) == 0.0


def test_the_floor_is_a_share_of_the_mean_or_given() -> None:
    values = 2.0 + 1e-4 * np.random.default_rng(6).standard_normal(60)
    nights = np.arange(60)
    assert fit_baseline(nights, values).floored_sd == pytest.approx(0.02, rel=1e-3)
    given = BaselineSettings(relative_floor=0.0, absolute_floor=0.5)
    assert fit_baseline(nights, values, given).floored_sd == 0.5
    wide = 2.0 + np.random.default_rng(6).standard_normal(60)
    assert fit_baseline(nights, wide).floored_sd == fit_baseline(nights, wide).sd


def test_the_upper_bound_of_the_standard_deviation_holds() -> None:
    generator = np.random.default_rng(7)
    for n, phi in ((30, 0.0), (60, 0.6)):
        settings = BaselineSettings(nights=n, relative_floor=0.0)
        held = np.mean(
            [
                fit_baseline(np.arange(n), autoregression(n, phi, generator), settings).highest_sd()
                >= 1.0
                for _ in range(500)
            ]
        )
        assert 0.88 < held < 0.985


def test_too_few_good_nights_are_a_status() -> None:
    for n in (0, 1, 14):
        found = fit_baseline(np.arange(n), np.ones(n))
        assert (found.status, found.n) == ("insufficient", n)
        assert np.isnan(found.mean)
    gated = np.full(300, np.nan)
    gated[::25] = 1.0
    assert fit_baseline(np.arange(300), gated).status == "insufficient"
    some = fit_baseline(np.arange(45), np.random.default_rng(8).uniform(1, 2, 45))
    assert (some.status, some.n) == ("provisional", 45)
    assert some.reason == "provisional: 45 of 60 good nights"


def test_a_constant_series_has_a_baseline() -> None:
    found = fit_baseline(np.arange(60), np.full(60, 1.37))
    assert (found.mean, found.sd, found.phi) == (1.37, 0.0, 0.0)
    assert found.floored_sd == pytest.approx(0.0137)
    # More than half alike: the floor takes the place of a robust scale that is 0.
    values = np.full(60, 1.0)
    values[:5] = 9.0
    assert fit_baseline(np.arange(60), values).mean < 1.01


def test_settings_and_arrays_that_make_no_sense_are_refused() -> None:
    for wrong in (
        {"nights": 20, "provisional_nights": 30},
        {"provisional_nights": 10},
        {"relative_floor": -0.1},
        {"winsorised_at": 0.0},
    ):
        with pytest.raises(ParameterError) as caught:
            BaselineSettings(**wrong)
        assert caught.value.code == "baseline_settings"
    with pytest.raises(ShapeError):
        fit_baseline(np.arange(5)[::-1], np.ones(5))
