"""Leakage at the fleet's reference conditions, and at the motor's own, frozen with its baseline.

Many motors never see the fleet's conditions; each sees its own.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from leakage import LeakageError, OperatingConditions, regressors
from leakage.course.baseline import LEAKAGE_FLOOR
from pipeline.schema import PRESSURE_EDGES_BAR, SPEED_EDGES_RPM, TEMPERATURE_EDGES_C
from pipeline.trends.figures.filtered_nights import WIDEST_LEAKAGE, Filtered, filtered
from pipeline.trends.figures.indicators import (
    NO_BASELINE,
    OWN_REFERENCE,
    REFERENCE,
    Indicator,
    with_filtered,
)
from pipeline.trends.figures.temperature import Effect
from pipeline.trends.nights.from_tables import WIDEST_ALONE, too_wide
from pipeline.trends.nights.history import History
from pipeline.trends.nights.records import HISTOGRAMS, triangle
from pipeline.trends.nights.segments import Segment

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LEVEL = 0.95
EDGES = (PRESSURE_EDGES_BAR, TEMPERATURE_EDGES_C, SPEED_EDGES_RPM)
OUTSIDE = "the motor's own reference conditions lie outside what the night saw"
NO_INTERVAL = "no intervals in this night"
# How far beyond what was seen so far a filtered leakage is told: bar, K, rpm.
REACH = (20.0, 10.0, 0.0)


@dataclass(frozen=True, slots=True)
class OwnConditions:
    """Conditions at which a motor's own reference leakage is told."""

    pressure_bar: float
    temperature_c: float
    speed_rpm: float
    charge_over_case_bar: float | None = None


@dataclass(frozen=True, slots=True)
class OwnLeakage:
    """Leakage at the own conditions of a segment's nights; shape (m,) each.

    Attributes
    ----------
    value, half
        Leakage and half-width of its interval [l/min]; nan where gated.
    gated
        Why a night does not count; empty where it does.
    outside
        Whether the conditions lie outside what a night's samples saw.
    filtered
        What the filter says of nights that are gated.
    """

    value: Array
    half: Array
    gated: tuple[str, ...]
    outside: Mask
    filtered: Filtered


def reference_leakage(history: History, effect: Effect) -> Indicator:
    """Leakage at the fleet's reference conditions, with the loss factors of T₀."""
    n = len(history)
    at = [reference_conditions(history, place) for place in range(n)]
    figures = _at_one_temperature(history, at, effect)
    alone = Indicator(
        REFERENCE,
        "l/min",
        "",
        figures[:, 0],
        figures[:, 1],
        figures[:, 2],
        history.why(np.isfinite(figures[:, 0])),
        LEAKAGE_FLOOR,
        history.records["outside"],
        np.ones(n, dtype=np.bool_),
        np.ones(n, dtype=np.int32),
    )
    found = _filtered_leakage(history, slice(0, n), at, np.isnan(figures[:, 0]))
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


def reference_conditions(history: History, place: int) -> OwnConditions:
    """The fleet's reference conditions, with a night's charge pressure."""
    if reference_conditions not in history.kept:
        history.kept[reference_conditions] = _last_known(history.records["charge"])
    asked = history.spec.settings.reference
    charge = float(history.kept[reference_conditions][place])
    return OwnConditions(
        asked.pressure_bar,
        asked.temperature_c,
        asked.speed_rpm,
        None if np.isnan(charge) else charge,
    )


def _last_known(values: Array) -> Array:
    """The last value that there was in each night; nan before the first."""
    last = np.maximum.accumulate(np.where(np.isfinite(values), np.arange(len(values)), -1))
    known: Array = np.where(last >= 0, values[last], np.nan)
    return known


def _filtered_leakage(
    history: History, here: slice, at: Sequence[OwnConditions], wanted: Mask
) -> Filtered:
    """Filtered leakage of some nights at the conditions of each, where the model holds there."""
    records = history.records[here]
    contrast = np.full(records["mean"].shape, np.nan)
    known = np.full(len(records), np.nan)
    reached = _reached(history, here, at[-1]) if at else np.zeros(0, dtype=np.bool_)
    for place in np.flatnonzero(wanted & records["informed"] & reached).tolist():
        row = regressor_row(history, here.start + place, at[place])
        if not isinstance(row, str):
            contrast[place], known[place] = np.append(row[:-2], 0.0), row[-1]
    return filtered(records, contrast, known)


def own_conditions(history: History, places: NDArray[np.intp]) -> OwnConditions | None:
    """Medians of the mean conditions of some nights; None where there are none."""
    figures = history.records["own"][places]
    figures = figures[np.isfinite(figures).all(axis=1)]
    if not len(figures):
        return None
    charge = history.records["charge"][places]
    charge = charge[np.isfinite(charge)]
    pressure, temperature, speed = np.median(figures, axis=0).tolist()
    above_case = float(np.median(charge)) if len(charge) else None
    return OwnConditions(pressure, temperature, speed, above_case)


def own_leakage(
    history: History, segment: Segment, own: OwnConditions, effect: Effect
) -> OwnLeakage:
    """Leakage of a segment's nights at the motor's own conditions, flushing excluded.

    From θ and its covariance, as the published intervals are those of other conditions; Student's t
    with as many degrees of freedom as the night has blocks beyond its coefficients.
    """
    here = slice(segment.first, segment.end)
    records = history.records[here]
    contrast, known, words = _regressors(history, segment, own)
    contrast = contrast / effect.factor[here, None]
    theta = records["theta"] + effect.per_kelvin[here, None] * records["response"]
    value = _row_sums(theta * contrast) + known
    variance = _quadratic_forms(records["covariance"], contrast)
    freedom = records["blocks"] - records["theta"].shape[1]
    quantile = stdtrit(np.fmax(freedom, 1.0), 0.5 + LEVEL / 2)
    half = quantile * np.sqrt(np.maximum(variance, 0.0))
    outside = history.fitted[here] & ~_seen(history, here, own)
    gated = [status or why for status, why in zip(history.statuses[here], words, strict=True)]
    for place in np.flatnonzero(history.fitted[here]).tolist():
        if gated[place]:
            continue
        if not np.isfinite(half[place]):
            gated[place] = NO_INTERVAL
        elif outside[place]:
            gated[place] = OUTSIDE
        elif not half[place] <= WIDEST_ALONE * abs(value[place]):
            gated[place] = too_wide(half[place] / abs(value[place]))
    counts = np.array([not one for one in gated], dtype=np.bool_)
    found = _filtered_leakage(history, here, [own] * len(gated), ~counts)
    return OwnLeakage(
        np.where(counts, value, np.nan),
        np.where(counts, half, np.nan),
        tuple(gated),
        outside,
        found,
    )


def _regressors(
    history: History, segment: Segment, own: OwnConditions
) -> tuple[Array, Array, list[str]]:
    """Contrast of θ and known flow of each night, or why the model does not hold there."""
    n, theta = segment.end - segment.first, len(history.layout.columns) - 2
    contrast, known = np.full((n, theta), np.nan), np.full(n, np.nan)
    words = [""] * n
    by_oil: defaultdict[str, list[int]] = defaultdict(list)
    for place in np.flatnonzero(history.fitted[segment.first : segment.end]).tolist():
        by_oil[history.spec.file.oil_on(history.nights[segment.first + place])].append(place)
    for places in by_oil.values():
        row = regressor_row(history, segment.first + places[0], own)
        if isinstance(row, str):
            for place in places:
                words[place] = row
        else:
            contrast[places] = np.append(row[:-2], 0.0)
            known[places] = row[-1]
    return contrast, known, words


def regressor_row(history: History, place: int, own: OwnConditions) -> Array | str:
    """Columns of the statistics at some conditions in a night, without the measured flow.

    A text where the model does not hold there, which says why. The night's oil decides: what else
    shapes them is the same for all nights.
    """
    spec, key = history.spec, (history.spec.file.oil_on(history.nights[place]), own)
    if key not in history.kept:
        try:
            motor = spec.motor(history.nights[place], spec.file.flushing.mode)
            at = OperatingConditions.from_bar(
                own.pressure_bar, own.temperature_c, own.speed_rpm, own.charge_over_case_bar
            )
            history.kept[key] = regressors(motor, at)[0]
        except LeakageError as error:
            history.kept[key] = str(error)
    row: Array | str = history.kept[key]
    return row


def _row_sums(products: Array) -> Array:
    """Sum of each row, in the same way however many rows there are: to the last bit."""
    total: Array = np.add.reduce(np.ascontiguousarray(products), axis=1)
    return total


def _quadratic_forms(upper: Array, contrast: Array) -> Array:
    """c'Cc of each night, from the upper triangle of C row by row."""
    first, second = _triangle(contrast.shape[1])
    weights = contrast[:, first] * contrast[:, second] * np.where(first == second, 1.0, 2.0)
    return _row_sums(upper * weights)


@lru_cache(maxsize=16)
def _triangle(size: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    first, second = np.triu_indices(size)
    assert len(first) == triangle(size)
    return first, second


def _seen(history: History, here: slice, own: OwnConditions) -> Mask:
    """Nights whose samples lie on both sides of some conditions, by their histograms."""
    return _within(history, here, own, so_far=False, reach=(0.0, 0.0, 0.0))


def _reached(history: History, here: slice, own: OwnConditions) -> Mask:
    """Nights until which some conditions had been seen, or nearly."""
    return _within(history, here, own, so_far=True, reach=REACH)


def _within(
    history: History, here: slice, own: OwnConditions, *, so_far: bool, reach: tuple[float, ...]
) -> Mask:
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


def joined_own_leakage(
    history: History,
    parts: list[tuple[Segment, int, OwnLeakage | None]],
) -> Indicator:
    """The indicator from its segments, each with the place from which on it is known."""
    n = len(history)
    nothing = np.full(n, np.nan)
    value, half, filtered_value, filtered_half = (nothing.copy() for _ in range(4))
    outside, told = np.zeros(n, dtype=np.bool_), np.zeros(n, dtype=np.bool_)
    gated = [status or NO_BASELINE for status in history.statuses]
    for segment, known_from, part in parts:
        told[known_from : segment.end] = True
        if part is not None:
            here = slice(segment.first, segment.end)
            value[here], half[here], outside[here] = part.value, part.half, part.outside
            filtered_value[here], filtered_half[here] = part.filtered.value, part.filtered.half
            gated[here] = part.gated
    alone = Indicator(
        OWN_REFERENCE,
        "l/min",
        "",
        value,
        value - half,
        value + half,
        tuple(gated),
        LEAKAGE_FLOOR,
        outside,
        told,
        np.ones(n, dtype=np.int32),
    )
    found = Filtered(filtered_value, filtered_half, history.records["followed"])
    return with_filtered(alone, found, WIDEST_LEAKAGE, np.abs(filtered_value))
