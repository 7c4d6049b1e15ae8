"""Watches that users would make of the same stored blocks, each with a limit to be calibrated.

Each gives one figure a night: the night's mean drain flow, or that over what a model of the
baseline's blocks expects of it. Its scatter is that of the baseline's nights, of which each was
expected by a model of the others (five parts), so that no model is judged by what it has learnt.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.signal import lfilter

from benchmarks.watch.simulator import PATHS, PISTON, THETA
from leakage.watch import NightBlocks as Night
from pipeline.arrays import Array

Predict = Callable[[Sequence[Night]], list[Array]]

PARTS = 5
# Weight of the last night in a moving mean.
EWMA_WEIGHT = 0.2
# Chosen on healthy motors of seeds of their own, by the scatter of nights that were left out.
BOOSTING = {"max_iter": 200, "learning_rate": 0.05, "max_leaf_nodes": 8, "min_samples_leaf": 20}


def regression(nights: Sequence[Night]) -> Predict:
    """Least squares on ΔP/η, ΔP, ΔP²/η, ω ΔP/η and a constant."""

    def columns(of: Sequence[Night]) -> Array:
        drive = _drive(of)
        _, pressure, speed = np.concatenate([one.conditions for one in of]).T / 100.0
        ones = np.ones(len(drive))
        return np.column_stack([ones, drive, pressure, drive * pressure, drive * speed])

    found, *_ = np.linalg.lstsq(columns(nights), _flow(nights), rcond=None)
    return lambda of: _by_night(columns(of) @ found, of)


def boosting(nights: Sequence[Night]) -> Predict:
    """Gradient boosting on pressure, temperature, speed and ΔP/η."""
    from sklearn.ensemble import HistGradientBoostingRegressor  # type: ignore[import-untyped]

    def columns(of: Sequence[Night]) -> Array:
        conditions = np.concatenate([one.conditions for one in of])
        return np.column_stack([conditions, _drive(of)])

    model = HistGradientBoostingRegressor(early_stopping=False, random_state=0, **BOOSTING)
    model.fit(columns(nights), _flow(nights))
    return lambda of: _by_night(model.predict(columns(of)), of)


def _drive(nights: Sequence[Night]) -> Array:
    """ΔP/η, as the rigid pistons' drive has it, about 1."""
    place = PATHS.index(PISTON)
    drive: Array = np.concatenate([one.drives[:, place] for one in nights]) * THETA[place]
    return drive


def _flow(nights: Sequence[Night]) -> Array:
    return np.concatenate([one.flow for one in nights])


def _by_night(values: Array, nights: Sequence[Night]) -> list[Array]:
    return np.split(values, np.cumsum([len(one.flow) for one in nights])[:-1])


def mean_flow(nights: Sequence[Night], baseline: int) -> Array:
    """Mean drain flow of each night over the baseline's, shape (n,)."""
    flow = np.array([one.flow.mean() for one in nights])
    change: Array = flow / flow[:baseline].mean() - 1.0
    return change


def over_expected(
    nights: Sequence[Night], baseline: int, learn: Callable[[Sequence[Night]], Predict]
) -> Array:
    """Mean drain flow of each night over what a model of the baseline's expects, shape (n,)."""
    change = np.empty(len(nights))

    def changes(places: Sequence[int], predict: Predict) -> None:
        of = [nights[place] for place in places]
        for place, night, expected in zip(places, of, predict(of), strict=True):
            change[place] = night.flow.mean() / expected.mean() - 1.0

    for left_out in range(PARTS):
        others = [nights[place] for place in range(baseline) if place % PARTS != left_out]
        changes(range(left_out, baseline, PARTS), learn(others))
    changes(range(baseline, len(nights)), learn(nights[:baseline]))
    return change


def chart(change: Array, baseline: int, weight: float = 1.0) -> Array:
    """Distance of each night from the baseline in its standard deviations, shape (n,).

    Below a weight of 1, of the moving mean, which begins at the baseline's mean.
    """
    mean, sd = change[:baseline].mean(), change[:baseline].std(ddof=1)
    z = (change - mean) / sd
    z[baseline:] = lfilter([weight], [1.0, weight - 1.0], z[baseline:])
    moved: Array = z / np.sqrt(weight / (2.0 - weight))
    return moved


def charts(nights: Sequence[Night], baseline: int) -> dict[str, Array]:
    """All of them: distance of each night from the baseline, shape (n,)."""
    flow = mean_flow(nights, baseline)
    return {
        "mean flow, Shewhart": chart(flow, baseline),
        "mean flow, EWMA": chart(flow, baseline, EWMA_WEIGHT),
        "regression, EWMA": chart(
            over_expected(nights, baseline, regression), baseline, EWMA_WEIGHT
        ),
        "boosting, EWMA": chart(over_expected(nights, baseline, boosting), baseline, EWMA_WEIGHT),
    }
