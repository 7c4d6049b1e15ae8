"""Nights of another duty than the baseline's: against the baseline at that duty, or outside of it.

A wrong model gives other loss factors at another duty, so a night whose mean pressure, temperature
or speed is none of the baseline's is compared with the baseline's blocks, weighted until their
conditions are the night's (`leakage.course.balanced_baseline`). Each night is compared
once and keeps it.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from leakage import LeakageError
from leakage.course.balanced_baseline import (
    LEAST_BLOCKS,
    NIGHTS_OF_NOW,
    Comparison,
    DutyBlocks,
    Rises,
    compare,
    told_rises,
)
from pipeline.night.rows import upper_triangle
from pipeline.schema import PRESSURE_EDGES_BAR, SPEED_EDGES_RPM, TEMPERATURE_EDGES_C
from pipeline.trends.baselines.blocks import BlockFiles
from pipeline.trends.baselines.conditions import reference_conditions, regressor_row
from pipeline.trends.baselines.eras import Era
from pipeline.trends.baselines.flow import column_sums, expected_flow
from pipeline.trends.figures.baseline_model import bounds_of
from pipeline.trends.figures.indicators import DEVIATION, OWN_REFERENCE, REFERENCE, Indicator
from pipeline.trends.nights.history import History
from pipeline.trends.nights.records import (
    AS_BASELINE,
    BALANCED,
    HISTOGRAMS,
    OUTSIDE,
    whole_matrix,
)
from pipeline.trends.nights.segments import first_good, segments

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Places = NDArray[np.intp]

# A night's mean pressure [bar], temperature [°C] or speed [rpm] is another one from these standard
# deviations of the baseline's nights on, and from these differences on.
OTHER_SD, OTHER = 4.0, np.array([20.0, 10.0, 10.0])
# Share of the samples that the baseline is taken to have seen, and of a night that says it has not.
TAIL, MUCH = 0.005, 0.1
CHANNELS = (
    ("loads", "bar", PRESSURE_EDGES_BAR),
    ("temperatures", "°C", TEMPERATURE_EDGES_C),
    ("speeds", "rpm", SPEED_EDGES_RPM),
)
UNCERTAIN = "at this duty the baseline does not tell a rise from its own error"


def with_duty(history: History, until: dt.date, blocks: BlockFiles) -> History:
    """A history whose nights from one on are compared at their duty, those before as they are."""
    records = history.records.copy()
    begin = history.place_from(until)
    records["duty"][begin:] = AS_BASELINE
    for part in segments(history):
        first = first_good(history, part)
        if len(first):
            later = np.arange(int(first[-1]) + 1, part.end)
            elsewhere = later[_is_other(records, first, later)]
            if len(elsewhere) and elsewhere[-1] >= begin:
                _compare(history, records, first, elsewhere, begin, blocks)
    return replace(history, records=records)


def without_duty(history: History) -> History:
    """A history whose nights are all taken to be of their baseline's duty."""
    records = history.records.copy()
    records["duty"] = AS_BASELINE
    return replace(history, records=records)


def _is_other(records: Any, first: Places, later: Places) -> Mask:
    """Nights of another duty than the first."""
    before, now = records["own"][first], records["own"][later]
    before = before[np.isfinite(before).all(axis=1)]
    if len(before) < 2:
        return np.zeros(len(later), dtype=np.bool_)
    least = np.maximum(OTHER_SD * np.std(before, axis=0, ddof=1), OTHER)
    # Comparisons with nan are false: nothing is known of such a night.
    other: Mask = (np.abs(now - np.mean(before, axis=0)) > least).any(axis=1)
    return other


def _compare(
    history: History,
    records: Any,
    first: Places,
    elsewhere: Places,
    begin: int,
    blocks: BlockFiles,
) -> None:
    """Fill the records of nights of another duty from one on; short ones with those before them.

    Those without stored blocks stay as they are.
    """
    layout, spec = history.layout, history.spec
    model = records["model"][first[-1]].decode()
    nights = [history.nights[place] for place in first.tolist()]
    before = blocks.of_baseline(spec, layout, nights, model)
    bounds = bounds_of(history, first)
    labels = [history.nights[place] for place in elsewhere.tolist()]
    for at in np.flatnonzero(elsewhere >= begin).tolist():
        for length in range(1, min(at + 1, NIGHTS_OF_NOW) + 1):
            now = blocks.of(spec, layout, labels[at + 1 - length : at + 1], model)
            if now is None or len(now.nights) >= LEAST_BLOCKS:
                break
        if before is not None and now is not None:
            _keep(records[elsewhere[at]], _compared(before, now, bounds))


def _compared(
    before: DutyBlocks, now: DutyBlocks, bounds: tuple[Array, Array]
) -> Comparison | None:
    try:
        return compare(before, now, *bounds)
    except LeakageError:
        return None


def _keep(record: Any, found: Comparison | None) -> None:
    record["duty"] = OUTSIDE if found is None else BALANCED
    if found is not None:
        record["duty_then"], record["duty_now"] = found.then, found.now
        record["duty_root"] = upper_triangle(found.root)
        record["duty_flow"], record["duty_share"] = found.log_ratio, found.effective_share


def at_duty(history: History, eras: Sequence[Era], own: Indicator) -> Indicator:
    """An indicator with what its nights of another duty are compared as.

    A rise that is certain is put on the level of the baseline, one that is not counts as none, and
    a night between the two does not count. The drain flow acts in every night.
    """
    duty = history.records["duty"]
    if not duty.any():
        return own
    series, plain = own.watched.copy(), own.watched
    for era in eras:
        here = np.arange(era.segment.first, era.segment.end)
        if own.name != DEVIATION:
            series[here[duty[here] == OUTSIDE]] = np.nan
        balanced = here[(duty[here] == BALANCED) & np.isfinite(plain[here])]
        if len(balanced):
            found = _rises(history, era, own, balanced)
            level = _level(history, era, plain)[balanced - era.segment.first]
            nights = history.spec.settings.trend.provisional_nights
            series[balanced] = level * (1.0 + told_rises(found, nights))
    return replace(own, compared=series)


def _rises(history: History, era: Era, own: Indicator, places: Places) -> Rises:
    records = history.records[places]
    flow, share, part = np.expm1(records["duty_flow"]), records["duty_share"], np.ones(len(places))
    if own.name == DEVIATION:
        return Rises(flow, np.zeros(len(places)), part, flow, share)
    rows = _contrasts(history, era, own, places)
    contrast, known = rows[:, :-1], rows[:, -1]
    then = np.einsum("ni,ni->n", contrast, records["duty_then"]) + known
    now = np.einsum("ni,ni->n", contrast, records["duty_now"]) + known
    root = whole_matrix(records["duty_root"], contrast.shape[1])
    error = np.linalg.norm(np.einsum("nij,nj->ni", root, contrast), axis=1)
    if own.path:
        sums = column_sums(history, places)
        column = history.layout.paths.index(own.path)
        expected = expected_flow(sums, records["duty_then"].T)[1]
        part = then * sums[:, column] / expected
    # A loss factor of 0 is nothing to be relative to.
    then = np.where(then > 0.0, then, np.nan)
    return Rises(now / then - 1.0, error / then, part, flow, share)


def _contrasts(history: History, era: Era, own: Indicator, places: Places) -> Array:
    """Contrast of θ that an indicator is in some nights, and the known flow; shape (m, p + 2).

    nan where the model does not hold.
    """
    found = np.full((len(places), len(history.layout.free) + 1), np.nan)
    if own.name not in (REFERENCE, OWN_REFERENCE):
        found[:] = 0.0
        found[:, history.layout.coefficients.index(own.name)] = 1.0
        return found
    for row, place in zip(found, places.tolist(), strict=True):
        at = era.own if own.name == OWN_REFERENCE else reference_conditions(history, place)
        columns = "" if at is None else regressor_row(history, place, at)
        if not isinstance(columns, str):
            row[:] = (*columns[:-2], 0.0, columns[-1])
    return found


def _level(history: History, era: Era, series: Array) -> Array:
    """Mean of the baseline's nights before each night of an era, as its indicator has it."""
    here = era.segment.here
    same = np.isfinite(series[here]) & (history.records["duty"][here] == AS_BASELINE)
    same &= np.cumsum(same) <= history.spec.settings.trend.baseline_nights
    with np.errstate(invalid="ignore"):
        level: Array = np.cumsum(np.where(same, series[here], 0.0)) / np.cumsum(same)
    return level


def duty_words(history: History, era: Era, place: int) -> str:
    """Duty that the baseline of a night has not seen, in words; empty where it has."""
    if history.records["duty"][place] != OUTSIDE:
        return ""
    first = first_good(history, era.segment)
    missing = []
    for name, (what, unit, edges) in zip(HISTOGRAMS, CHANNELS, strict=True):
        before, now = history.records[name][first].sum(axis=0), history.records[name][place]
        if not before.any() or not now.any():
            continue
        seen = np.cumsum(before) / before.sum()
        low, high = int(np.argmax(seen > TAIL)), int(np.argmax(seen >= 1.0 - TAIL)) + 1
        if now[high:].sum() > MUCH * now.sum():
            missing.append(f"at {what} above {edges[high]:g} {unit}")
        if now[:low].sum() > MUCH * now.sum():
            missing.append(f"at {what} below {edges[low]:g} {unit}")
    where = " or ".join(missing) or "where loads, temperatures and speeds meet as they do now"
    return f"duty outside the baseline: no baseline {where}"
