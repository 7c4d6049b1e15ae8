"""Watches that users would make of the same stored blocks, each with a limit to be calibrated.

Each gives a figure a night: the night's mean drain flow, or that over what a model of the
baseline's blocks expects of it. Its scatter is that of the baseline's nights, of which each was
expected by a model of the others (five parts), so that no model is judged by what it has learnt.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.signal import lfilter

from benchmarks.watch.simulator import PATHS, PISTON, THETA
from leakage.watch import NightBlocks
from pipeline.arrays import Array

# Learns from blocks' inputs, (n, 4), and flow, (n,), what it expects of inputs.
Learn = Callable[[Array, Array], Callable[[Array], Array]]

PARTS = 5
# Weight of the last night in a moving mean.
EWMA_WEIGHT = 0.2
# Chosen on healthy motors of seeds of their own, by the scatter of nights that were left out.
BOOSTING = {"max_iter": 200, "learning_rate": 0.05, "max_leaf_nodes": 8, "min_samples_leaf": 20}


def regression(inputs: Array, flow: Array) -> Callable[[Array], Array]:
    """Least squares on ΔP/η, ΔP, ΔP²/η, ω ΔP/η and a constant."""

    def columns(of: Array) -> Array:
        _, pressure, speed = of.T[:3] / 100.0
        drive = of[:, 3]
        ones = np.ones(len(drive))
        return np.column_stack([ones, drive, pressure, drive * pressure, drive * speed])

    coefficients, *_ = np.linalg.lstsq(columns(inputs), flow, rcond=None)
    return lambda of: columns(of) @ coefficients


def boosting(inputs: Array, flow: Array) -> Callable[[Array], Array]:
    """Gradient boosting on temperature, pressure, speed and ΔP/η."""
    from sklearn.ensemble import HistGradientBoostingRegressor  # type: ignore[import-untyped]

    model = HistGradientBoostingRegressor(early_stopping=False, random_state=0, **BOOSTING)
    predict: Callable[[Array], Array] = model.fit(inputs, flow).predict
    return predict


def over_expected(nights: Sequence[NightBlocks], baseline: int, learn: Learn) -> Array:
    """Mean drain flow of each night over what a model of the baseline's expects, shape (n,)."""
    number = np.repeat(np.arange(len(nights)), [len(night.flow) for night in nights])
    flow = np.concatenate([night.flow for night in nights])
    # ΔP/η, as the rigid pistons' drive has it, about 1.
    drive = np.concatenate([night.drives for night in nights])[:, PATHS.index(PISTON)] * THETA[1]
    inputs = np.column_stack([np.concatenate([night.conditions for night in nights]), drive])
    part = np.where(number < baseline, number % PARTS, PARTS)
    expected = np.empty_like(flow)
    for left_out in range(PARTS + 1):
        others = (part != left_out) & (part < PARTS)
        expected[part == left_out] = learn(inputs[others], flow[others])(inputs[part == left_out])
    change: Array = np.bincount(number, flow) / np.bincount(number, expected) - 1.0
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


def charts(nights: Sequence[NightBlocks], baseline: int) -> dict[str, Array]:
    """All of them: distance of each night from the baseline, shape (n,)."""
    flow = np.array([night.flow.mean() for night in nights])
    return {
        "mean flow, Shewhart": chart(flow, baseline),
        "mean flow, EWMA": chart(flow, baseline, EWMA_WEIGHT),
        **{
            f"{learn.__name__}, EWMA": chart(
                over_expected(nights, baseline, learn), baseline, EWMA_WEIGHT
            )
            for learn in (regression, boosting)
        },
    }
