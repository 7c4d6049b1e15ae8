"""Nights that hardly tell paths apart: last digits of their samples move no figure that is shown."""

from __future__ import annotations

import datetime as dt
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from leakage import OperatingConditions, regressors
from leakage.estimation.block_statistics import factors, merge
from leakage.estimation.certificate import certify
from leakage.estimation.multi_start import Parametrisation
from leakage.estimation.uncertainty import cluster_robust
from pipeline.night.rows import upper_triangle
from pipeline.trends.figures.filtered_nights import with_filter
from pipeline.trends.rows.trend_rows import trend_rows
from tests.pipeline.trends.nights import FIRST, PATHS, Nights, history, motor, standings

Array = NDArray[np.float64]
Row = dict[str, Any]

N, BLOCKS, SAMPLES = 20, 15, 60
# From one baseline to the next there is nothing to compare with.
INTERVALS = ("value", "lower", "upper")
FIGURES = ("baseline_mean", "deviation_percent", "cusum", "cusum_limit", "warning_limit")


def rows_at_one_pressure(disturbed_by: float) -> list[Row]:
    """Rows of `trends` of nights at 180 ± 0.3 bar, their samples disturbed by a relative noise."""
    spec = motor()
    nights = Nights(spec, N)
    truth, verdicts = nights.truth(), dict.fromkeys(PATHS, "not_excited")
    made, generator = spec.motor(FIRST, nights.mode), np.random.default_rng(0)
    changes = {}
    for place in range(N):
        drawn = np.random.default_rng(1 + place)
        n = BLOCKS * SAMPLES
        conditions = OperatingConditions.from_bar(
            drawn.normal(180.0, 0.3, n), drawn.uniform(45.0, 55.0, n), drawn.uniform(10.0, 60.0, n)
        )
        columns = regressors(made, conditions)
        flow = columns @ np.append(truth[place], 1.0) + 0.02 * drawn.standard_normal(n)
        z = np.column_stack([columns, flow])
        z *= 1.0 + disturbed_by * generator.standard_normal(z.shape)
        blocks = factors(z, np.arange(0, n + 1, SAMPLES))
        changes[place] = fitted(blocks, *Parametrisation.of(made).coefficient_bounds())
    unknown = {(place, f"K_{path}"): verdicts[path] for place in range(N) for path in PATHS}
    found = history(Nights(spec, N, changes=changes, verdicts=unknown))
    change = partial(with_filter, until=dt.date.min)
    return list(trend_rows(standings({"M1": found}, change=change)["M1"], range(N)))


def fitted(blocks: Array, lower: Array, upper: Array) -> Row:
    """Columns of `fits` of a night that does not see the reference conditions."""
    whole = merge(blocks)
    theta = certify(whole, lower, upper).coefficients
    distribution = cluster_robust(blocks, theta, lower < upper)
    assert distribution is not None
    root = np.zeros((len(theta),) * 2)
    root[np.ix_(distribution.active, distribution.active)] = distribution.covariance_root()
    return {
        "coefficients": theta.tolist(),
        "coefficient_covariance_root": upper_triangle(root),
        "night_factor": upper_triangle(whole),
        "n_interval_blocks": len(blocks),
        "own_pressure_bar": 180.0,
        "own_temperature_c": 50.0,
        "own_speed_rpm": 35.0,
        "reference_verdict": "outside_fitted_range",
        "reference_leakage_l_per_min": None,
    }


def test_last_digits_of_the_samples_move_no_shown_figure() -> None:
    """Beyond 1e-6 of itself, or a hundredth of its stated ±."""
    compared = set()
    for one, two in zip(rows_at_one_pressure(0.0), rows_at_one_pressure(1e-13), strict=True):
        key = one["indicator"], one["night"]
        assert key == (two["indicator"], two["night"])
        assert (one["state"], one.get("gated_reason")) == (two["state"], two.get("gated_reason"))
        half = 0.0
        if one.get("upper") is not None:
            half = one["upper"] - one["value"]
        for name in INTERVALS:
            assert one.get(name) == pytest.approx(two.get(name), rel=1e-6, abs=half / 100), key
        for name in FIGURES:
            assert one.get(name) == pytest.approx(two.get(name), rel=1e-6, abs=1e-9), (key, name)
            compared.update({(one["indicator"], name)} if one.get(name) is not None else ())
    # Both leakages have a baseline, and the paths, which no night tells, an interval.
    assert {("own_reference_leakage", "cusum"), ("reference_leakage", "cusum")} <= compared
