"""The drain flow of a night against what the model of the baseline lets expect.

It needs no fit of the night, only its statistics, so it follows motors of which no coefficient can
be told.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from leakage.course.baseline import LEAKAGE_FLOOR
from pipeline.trends.baselines.eras import Era
from pipeline.trends.figures.indicators import DEVIATION, NO_BASELINE, Indicator
from pipeline.trends.figures.temperature import Effect
from pipeline.trends.nights.history import History
from pipeline.trends.nights.segments import Segment

Array = NDArray[np.float64]

NO_STATISTICS = "the night's statistics are of another kind than the baseline's"
NO_FLOW = "no flow beyond the flushing, measured or expected"


def column_sums(history: History, places: NDArray[np.intp] | slice) -> Array:
    """Sums of the statistics' columns over the kept samples of some nights, shape (m, c).

    The column of ones times all columns: R'R of it.
    """
    factors = history.factors(places)
    ones = factors[:, :, -3]
    sums: Array = np.zeros(factors.shape[::2])
    # Row by row, so that a night's sums do not hang on how many nights there are.
    for row in range(factors.shape[1]):
        sums += ones[:, row, None] * factors[:, row]
    return sums


def expected_flow(sums: Array, theta: Array) -> tuple[Array, Array]:
    """Measured and expected flow of some nights [l/min × samples], both without flushing.

    The sums are from :func:`column_sums`, shape (m, c). θ has shape (p + 1,), or (p + 1, m) where
    each night has its own; its last coefficient is the flushing.
    """
    measured = sums[:, -1] - theta[-1] * sums[:, -3]
    expected = sums[:, -2].copy()
    for column, coefficient in enumerate(theta[:-1]):
        expected += coefficient * sums[:, column]
    return measured, expected


def log_ratio(history: History, segment: Segment, theta: Array, warm: Array) -> Array:
    """ln (measured / expected flow) of a segment's nights; nan where there is no figure.

    `warm`: loss factors of each night over the model's, shape (n,).
    """
    here = segment.here
    sums = column_sums(history, here)
    measured, expected = expected_flow(sums, theta)
    known = sums[:, -2]
    expected = known + (expected - known) * warm[here]
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.log(measured / expected)
        some = history.fitted[here] & (measured > 0.0) & (expected > 0.0)
    result: Array = np.where(some, ratio, np.nan)
    return result


def gap_ratio(history: History, segment: Segment, theta: Array) -> Array:
    """Measured over expected flow of the gaps alone in a segment's nights; nan without a figure."""
    here = segment.here
    sums = column_sums(history, here)
    measured, expected = (one - sums[:, -2] for one in expected_flow(sums, theta))
    result: Array = np.full(len(sums), np.nan)
    some = history.fitted[here] & (expected > 0.0)
    result[some] = measured[some] / expected[some]
    return result


def deviation(history: History, eras: Sequence[Era], effect: Effect) -> Indicator:
    """Drain flow over what the model of each baseline lets expect, less 1."""
    n = len(history)
    value, told = np.full(n, np.nan), np.zeros(n, dtype=np.bool_)
    gated = [status or NO_BASELINE for status in history.statuses]
    for era in eras:
        told[era.known_from : era.segment.end] = True
        if era.model is None:
            continue
        here = era.segment.here
        value[here] = np.expm1(log_ratio(history, era.segment, era.model, effect.factor))
        same = np.isfinite(history.records["factor"][here]).all(axis=1)
        why = np.where(np.isfinite(value[here]), "", np.where(same, NO_FLOW, NO_STATISTICS))
        gated[here] = [
            status or one for status, one in zip(history.statuses[here], why.tolist(), strict=True)
        ]
    return Indicator.of(DEVIATION, "1", value, gated, LEAKAGE_FLOOR, told=told)
