"""Running hours of a motor's nights, and how far a night saw what its baseline saw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.trends.nights.history import History
from pipeline.trends.nights.records import HISTOGRAMS

Array = NDArray[np.float64]

# Nights before, whose mean share a night without a log takes.
NIGHTS_BEFORE = 30


@dataclass(frozen=True, slots=True)
class RunningHours:
    """Running hours since the first night at the end of each; whether some are only estimated."""

    total: Array
    estimated: NDArray[np.bool_]


def running_hours(history: History) -> RunningHours:
    """Running hours at the end of each night; nights without a log take what the 30 before had."""
    hours: Array = history.records["running_hours"]
    logged = np.isfinite(hours)
    sums = np.concatenate([[0.0], np.cumsum(hours[logged])])
    # Logged nights before each night, and the mean of the last thirty of them.
    before = np.cumsum(logged) - logged
    first = np.maximum(before - NIGHTS_BEFORE, 0)
    usual = (sums[before] - sums[first]) / np.maximum(before - first, 1)
    total = np.cumsum(np.where(logged, hours, usual))
    return RunningHours(total, np.logical_or.accumulate(~logged))


def coverage(history: History, place: int, first: int, last: int) -> float | None:
    """Overlap of a night's operating conditions with those of a baseline, from 0 to 1.

    The smallest overlap Σ min(p, q) of the histograms of pressure, temperature and speed; None
    without samples. The baseline's nights are those from `first` to `last`, both included.
    """
    overlaps = []
    for name in HISTOGRAMS:
        column = history.records[name]
        here = column[place].astype(np.float64)
        before = column[first : last + 1].sum(axis=0, dtype=np.float64)
        if not here.any() or not before.any():
            return None
        overlaps.append(float(np.minimum(here / here.sum(), before / before.sum()).sum()))
    return min(overlaps)
