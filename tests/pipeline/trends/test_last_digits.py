"""Nights that hardly tell paths apart: last digits of their samples move no shown figure."""

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
INTERVAL = ("value", "lower", "upper")


def rows_at_one_pressure(disturbed_by: float) -> list[Row]:
    """Rows of `trends` of nights at 180 ± 0.05 bar, their samples disturbed by a relative noise."""
    spec = motor()
    made, truth = spec.motor(FIRST, "none"), Nights(spec, 1).truth()[0]
    generator, changes = np.random.default_rng(0), {}
    for place in range(N):
        drawn = np.random.default_rng(1 + place)
        n = BLOCKS * SAMPLES
        conditions = OperatingConditions.from_bar(
            drawn.normal(180.0, 0.05, n), drawn.uniform(45.0, 55.0, n), drawn.uniform(10.0, 60.0, n)
        )
        columns = regressors(made, conditions)
        flow = columns @ np.append(truth, 1.0) + 0.02 * drawn.standard_normal(n)
        z = np.column_stack([columns, flow])
        z *= 1.0 + disturbed_by * generator.standard_normal(z.shape)
        blocks = factors(z, np.arange(0, n + 1, SAMPLES))
        changes[place] = fitted(blocks, *Parametrisation.of(made).coefficient_bounds())
    verdicts = {(place, f"K_{path}"): "not_excited" for place in range(N) for path in PATHS}
    found = history(Nights(spec, N, changes=changes, verdicts=verdicts))
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
        assert one.keys() == two.keys()
        half = one["upper"] - one["value"] if one.get("upper") is not None else 0.0
        for name in one:
            if not isinstance(one[name], float):
                assert one[name] == two[name], (key, name)
                continue
            slack = half / 100 if name in INTERVAL else 1e-9
            assert one[name] == pytest.approx(two[name], rel=1e-6, abs=slack), (key, name)
            compared.add((one["indicator"], name))
    # The motor's own leakage has a baseline, and each path, which no night tells, an interval.
    assert ("own_reference_leakage", "cusum") in compared
    assert {(f"leakage_{path}", "upper") for path in PATHS} <= compared


def test_a_night_of_before_tells_its_errors_by_the_covariance_alone() -> None:
    """Its blocks and logs may be gone; the flushing, which is held, has no variance."""
    upper = np.triu(np.random.default_rng(3).normal(size=(4, 4)))
    upper[:, -1] = 0.0
    root = upper * [1e-13, 1e-14, 1e-14, 1.0]
    changes: dict[int, Row] = {
        0: {"coefficient_covariance_root": upper_triangle(root)},
        1: {
            "coefficient_covariance_root": None,
            "coefficient_covariance": upper_triangle(root.T @ root),
        },
    }
    one, two = history(Nights(motor(), 2, changes=changes)).records
    assert np.isfinite(one["noise"][:-1]).all()
    assert two["noise"] == pytest.approx(one["noise"], rel=1e-9, nan_ok=True)
