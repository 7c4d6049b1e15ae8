"""What is kept of a motor of a cell: what was detected of it beside the truth, in numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from benchmarks.watch import heard
from benchmarks.watch.cells import Cell
from benchmarks.watch.history import History
from benchmarks.watch.rivals import charts
from pipeline.arrays import Array

# Seeds of trials while building, and of the figures that are shown.
TRIAL, FRESH = 36, 3636

Outcome = dict[str, Any]


def outcome(cell: Cell, number: int, base: int, limits: Mapping[str, float]) -> Outcome:
    """Of one motor of a cell: a seed of its own, by cell and number."""
    histories = cell.make((base, crc32(cell.key.encode()), number), cell.event.nights)
    said, history = heard.heard(histories, cell.baseline)[0], histories[0]
    against_baseline = _against_baseline(history, cell.baseline)
    found = {
        "told": [_told(one, against_baseline, cell) for one in said.told],
        "tonight": _newest_night(said.newest_night, against_baseline, cell.baseline),
        "lack": round(said.lack_of_fit, 4),
        "reached": _reached(history, cell),
    }
    if said.leakages:
        asked = zip(said.leakages, history.asked, strict=True)
        found["leakages"] = [
            [round(one / of.leakage - 1.0, 4) for one in told] for told, of in asked
        ]
    if cell.has_rivals:
        values = charts(history.nights, cell.baseline)
        found["rivals"] = {
            method: _first(values[method] > limits[method], cell) for method in values
        }
    return found


def _against_baseline(history: History, baseline: int) -> History:
    """Changes against the baseline's nights, in which wear may have begun."""
    newest_night, change = (
        (1.0 + one) / (1.0 + history.change[:baseline].mean()) - 1.0
        for one in (history.newest_night, history.change)
    )
    return replace(history, newest_night=newest_night, change=change)


def _told(told: heard.Told, history: History, cell: Cell) -> Outcome:
    first, settled = told.first, told.settled
    # Told against the nights before its begin, or against the baseline.
    begin = cell.event.begin or 0
    before = history.change[begin - 1] if begin > cell.baseline else 0.0
    return {
        "night": first.night,
        "is_notice": told.is_notice,
        "goes_on": first.goes_on,
        "first": [first.cause, first.likeliest, round(first.probability, 3)],
        "cause": [settled.cause, settled.likeliest, round(settled.probability, 3)],
        "since": [int(one) for one in settled.since],
        "size": [round(one, 4) for one in settled.size],
        "true": round(float((1.0 + history.change[settled.night]) / (1.0 + before) - 1.0), 4),
    }


def _newest_night(newest_night: Array, history: History, baseline: int) -> list[float]:
    """Root mean square of the error, and share of nights within the interval.

    Against the truth at the night's conditions, and at the motor's own.
    """
    value, lower, upper = newest_night[baseline:].T
    found = []
    for true in (history.newest_night[baseline:], history.change[baseline:]):
        inside = (lower <= true) & (true <= upper)
        found += [float(np.sqrt(np.mean((value - true) ** 2))), float(inside.mean())]
    return [round(one, 4) for one in found]


def _reached(history: History, cell: Cell) -> int | None:
    """First night in which the flow has changed by 8 %."""
    if "odd_nights" in cell.event.right:
        return None
    nights = np.flatnonzero(np.abs(history.change) >= 0.08)
    return int(nights[0]) if len(nights) and cell.event.begin is not None else None


def _first(raised: NDArray[np.bool_], cell: Cell) -> int | None:
    """Night of the first alarm since the change, 1 being its first, or since the baseline."""
    begin = max(cell.baseline, cell.event.begin or 0)
    later = np.flatnonzero(raised[begin:])
    return int(later[0]) + 1 if len(later) else None
