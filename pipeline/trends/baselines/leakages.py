"""Indicators against a motor's baselines: leakage at some conditions, drain flow, coefficients."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from leakage.course.baseline import LEAKAGE_FLOOR
from pipeline.schema import PRESSURE_EDGES_BAR, SPEED_EDGES_RPM, TEMPERATURE_EDGES_C
from pipeline.trends.baselines.conditions import OwnConditions, reference_conditions, regressor_row
from pipeline.trends.baselines.eras import Era, effect_of
from pipeline.trends.baselines.flow import deviation
from pipeline.trends.figures.filtered_nights import WIDEST_LEAKAGE, Filtered, filtered
from pipeline.trends.figures.indicators import (
    NO_BASELINE,
    OWN_REFERENCE,
    REFERENCE,
    Indicator,
    coefficients,
    with_filtered,
)
from pipeline.trends.figures.temperature import Effect
from pipeline.trends.nights.from_tables import WIDEST_ALONE, too_wide
from pipeline.trends.nights.history import History
from pipeline.trends.nights.records import FLUSHING, HISTOGRAMS, whole_matrix
from pipeline.trends.nights.segments import Segment

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LEVEL = 0.95
EDGES = (PRESSURE_EDGES_BAR, TEMPERATURE_EDGES_C, SPEED_EDGES_RPM)
OUTSIDE = "the motor's own reference conditions lie outside what the night saw"
NO_INTERVAL = "no intervals in this night"
# How far beyond what was seen so far a filtered leakage is told: bar, K, rpm.
REACH = (20.0, 10.0, 0.0)


def indicators_of(history: History, eras: Sequence[Era]) -> dict[str, Indicator]:
    """All indicators of a motor that are watched, by name.

    Which there are depends on the motor's config alone: the rate of false alarms is shared by all
    of them, whatever the nights so far have shown.
    """
    effect = effect_of(history, eras)
    found = [
        reference_leakage(history, effect),
        own_reference_leakage(history, eras, effect),
        deviation(history, eras, effect),
        *coefficients(history, effect),
    ]
    return {
        one.name: one if one.name == FLUSHING else one.with_allowance(effect.left) for one in found
    }


def reference_leakage(history: History, effect: Effect) -> Indicator:
    """Leakage at the fleet's reference conditions, with the loss factors of T₀."""
    n = len(history)
    at = [reference_conditions(history, place) for place in range(n)]
    figures = _at_one_temperature(history, at, effect)
    value, lower, upper = figures.T
    why = history.why(np.isfinite(value))
    alone = Indicator.of(
        REFERENCE,
        "l/min",
        value,
        why,
        LEAKAGE_FLOOR,
        lower=lower,
        upper=upper,
        outside=history.records["outside"],
    )
    found = _filtered_leakage(history, slice(0, n), at, np.isnan(value))
    return with_filtered(alone, found, WIDEST_LEAKAGE, np.abs(found.value))


def _at_one_temperature(history: History, at: Sequence[OwnConditions], effect: Effect) -> Array:
    """Leakage at the reference conditions with its ends, as `fits` has it, but at T₀."""
    figures = history.records["reference"].copy()
    if effect.is_taken_off:
        for place in np.flatnonzero(np.isfinite(figures[:, 0])).tolist():
            row = regressor_row(history, place, at[place])
            if not isinstance(row, str):
                moved = effect.per_kelvin[place] * (
                    row[:-2] @ history.records["response"][place, :-1]
                )
                figures[place] += moved - row[-1]
                figures[place] = figures[place] / effect.factor[place] + row[-1]
    return figures


def _filtered_leakage(
    history: History, here: slice, at: Sequence[OwnConditions], wanted: Mask
) -> Filtered:
    """Filtered leakage of some nights at the conditions of each, where the model holds there."""
    records = history.records[here]
    contrast = np.full(records["mean"].shape, np.nan)
    known = np.full(len(records), np.nan)
    reached = (
        _within(history, here, at[-1], so_far=True, reach=REACH)
        if at
        else np.zeros(0, dtype=np.bool_)
    )
    for place in np.flatnonzero(wanted & records["informed"] & reached).tolist():
        row = regressor_row(history, here.start + place, at[place])
        if not isinstance(row, str):
            contrast[place], known[place] = np.append(row[:-2], 0.0), row[-1]
    return filtered(records, contrast, known)


def own_reference_leakage(history: History, eras: Sequence[Era], effect: Effect) -> Indicator:
    """Leakage at the motor's own conditions, which are frozen with each baseline."""
    n = len(history)
    value, half, filtered_value, filtered_half = np.full((4, n), np.nan)
    outside, told = np.zeros((2, n), dtype=np.bool_)
    gated = [status or NO_BASELINE for status in history.statuses]
    for era in eras:
        here, own = era.segment.here, era.own
        told[era.known_from : era.segment.end] = True
        if own is not None:
            value[here], half[here], outside[here] = _own_leakage(history, era.segment, own, effect)
            gated[here] = _why_gated(history, here, own, value[here], half[here], outside[here])
            counts = np.array([not one for one in gated[here]], dtype=np.bool_)
            value[here], half[here] = np.where(counts, (value[here], half[here]), np.nan)
            found = _filtered_leakage(history, here, [own] * len(counts), ~counts)
            filtered_value[here], filtered_half[here] = found.value, found.half
    alone = Indicator.of(
        OWN_REFERENCE,
        "l/min",
        value,
        gated,
        LEAKAGE_FLOOR,
        lower=value - half,
        upper=value + half,
        outside=outside,
        told=told,
    )
    found = Filtered(filtered_value, filtered_half, history.records["followed"])
    return with_filtered(alone, found, WIDEST_LEAKAGE, np.abs(filtered_value))


def _own_leakage(
    history: History, segment: Segment, own: OwnConditions, effect: Effect
) -> tuple[Array, Array, Mask]:
    """Leakage, half-width and whether a night saw the conditions, of a segment; no flushing.

    From θ and its covariance, as the published intervals are those of other conditions; Student's t
    with as many degrees of freedom as the night has blocks beyond its coefficients.
    """
    here = segment.here
    records = history.records[here]
    contrast, known = _regressors(history, segment, own)
    contrast = contrast / effect.factor[here, None]
    theta = records["theta"] + effect.per_kelvin[here, None] * records["response"]
    root = whole_matrix(records["root"], contrast.shape[1])
    errors = _row_sums(root * contrast[:, None])
    freedom = records["blocks"] - records["theta"].shape[1]
    half = stdtrit(np.fmax(freedom, 1.0), 0.5 + LEVEL / 2) * np.sqrt(_row_sums(errors**2))
    outside = history.fitted[here] & ~_within(history, here, own)
    return _row_sums(theta * contrast) + known, half, outside


def _why_gated(
    history: History, here: slice, own: OwnConditions, value: Array, half: Array, outside: Mask
) -> list[str]:
    """Reason why each night of a segment does not count; empty where it does."""
    gated = list(history.statuses[here])
    for place in np.flatnonzero(history.fitted[here]).tolist():
        if gated[place]:
            continue
        if not np.isfinite(half[place]):
            row = regressor_row(history, here.start + place, own)
            gated[place] = row if isinstance(row, str) else NO_INTERVAL
        elif outside[place]:
            gated[place] = OUTSIDE
        elif not half[place] <= WIDEST_ALONE * abs(value[place]):
            gated[place] = too_wide(half[place] / abs(value[place]))
    return gated


def _regressors(history: History, segment: Segment, own: OwnConditions) -> tuple[Array, Array]:
    """Contrast of θ and known flow of each fitted night; nan where the model does not hold."""
    n, theta = segment.end - segment.first, len(history.layout.columns) - 2
    contrast, known = np.full((n, theta), np.nan), np.full(n, np.nan)
    for place in np.flatnonzero(history.fitted[segment.here]).tolist():
        row = regressor_row(history, segment.first + place, own)
        if not isinstance(row, str):
            contrast[place], known[place] = np.append(row[:-2], 0.0), row[-1]
    return contrast, known


def _row_sums(products: Array) -> Array:
    """Sum of each row, in the same way however many rows there are: to the last bit."""
    total: Array = np.add.reduce(np.ascontiguousarray(products), axis=-1)
    return total


def _within(
    history: History,
    here: slice,
    own: OwnConditions,
    *,
    so_far: bool = False,
    reach: tuple[float, ...] = (0.0, 0.0, 0.0),
) -> Mask:
    """Nights whose samples, or all so far, lie on both sides of some conditions, or nearly."""
    seen = np.ones(here.stop - here.start, dtype=np.bool_)
    for name, edges, value, more in zip(
        HISTOGRAMS, EDGES, (own.pressure_bar, own.temperature_c, own.speed_rpm), reach, strict=True
    ):
        filled = history.records[name][here] > 0
        if so_far:
            filled = np.logical_or.accumulate(filled, axis=0)
        borders = np.array(edges)
        lowest = borders[filled.argmax(axis=1)] - more
        highest = borders[filled.shape[1] - filled[:, ::-1].argmax(axis=1)] + more
        seen &= filled.any(axis=1) & (lowest <= value) & (value <= highest)
    return seen
