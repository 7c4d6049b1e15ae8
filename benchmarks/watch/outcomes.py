"""The outcome of a motor of a cell: what was detected beside the truth, in numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any
from zlib import crc32

import numpy as np

from benchmarks.watch.cb560 import LAMINAR
from benchmarks.watch.cells import Cell
from benchmarks.watch.rivals import charts
from benchmarks.watch.simulator import History, drives_and_leakage
from leakage.watch import Change, Estimate, NightBlocks, Verdict, Watch, WatchSettings
from pipeline.arrays import Array

# Seeds of trials while building, and of the figures that are shown.
TRIAL, FRESH = 36, 20261129
REFERENCE = np.array([50.0, 200.0, 30.0])  # [°C], [bar], [rpm]
REACHED = 0.08  # change of the flow from which nights are counted
SETTLED = 10  # nights after which a cause has settled
# A change of the temperature's effect alone is a notice; and what ends is no alarm.
NOTICES = ("temperature_effect", "back_as_before")

Outcome = dict[str, Any]


def outcome(cell: Cell, number: int, base: int, limits: Mapping[str, float]) -> Outcome:
    """Return that of a motor of a cell, with its own seed by cell and number."""
    event = cell.event
    histories = cell.make((base, crc32(cell.key.encode()), number), event.nights)
    watch, verdicts = _watched(histories, cell.baseline)
    # Against the baseline's nights, in which wear may have begun.
    history = histories[0]
    at_first = 1.0 + history.change[: cell.baseline].mean()
    newest_night, change = (
        (1.0 + true) / at_first - 1.0 for true in (history.newest_night, history.change)
    )
    reached = np.flatnonzero(np.abs(history.change) >= REACHED)
    is_reached = len(reached) and event.begin is not None and "odd_nights" not in event.right
    reported: dict[int, list[tuple[int, Change]]] = {}
    for verdict in verdicts:
        if verdict.change is not None:
            dated = (verdict.day, verdict.change)
            reported.setdefault(verdict.change.detected_on, []).append(dated)
    result = {
        "reported": [_reported(first, of, change, cell) for first, of in reported.items()],
        "tonight": [*_missed(verdicts, newest_night), *_missed(verdicts, change)],
        "lack": round(verdicts[0].lack_of_fit, 4),
        "reached": int(reached[0]) if is_reached else None,
    }
    if cell.group == "laminar":
        # At reference conditions, and at the motor's own.
        first = np.concatenate([night.conditions for night in history.nights[: cell.baseline]])
        result["leakages"] = [_leakage(watch, at) for at in (REFERENCE, np.median(first, axis=0))]
    if cell.has_rivals:
        begin = max(cell.baseline, event.begin or 0)
        raised = {
            method: np.flatnonzero(values[begin:] > limits[method])
            for method, values in charts(history.nights, cell.baseline).items()
        }
        # Night of the first alarm since the change, 1 being its first, or since the baseline.
        result["rivals"] = {
            method: int(nights[0]) + 1 if len(nights) else None for method, nights in raised.items()
        }
    return result


def _watched(histories: Sequence[History], baseline: int) -> tuple[Watch, list[Verdict]]:
    """Return the watch of the first motor after its last night, and its verdict of each.

    What the others of its tank say of all flows is known to it.
    """
    settings = WatchSettings(baseline_nights=baseline)
    watches = [
        Watch.begin(history.machine, history.nights[:baseline], settings) for history in histories
    ]
    verdicts = []
    for place in range(baseline, len(histories[0].nights)):
        watches = [
            watch.after(history.nights[place], partial(_earlier, history.nights[: place + 1]))
            for watch, history in zip(watches, histories, strict=True)
        ]
        watches = [
            watch.beside([other for other in watches if other is not watch]) for watch in watches
        ]
        verdicts.append(watches[0].verdict())
    return watches[0], verdicts


def _earlier(nights: Sequence[NightBlocks], day: int) -> Sequence[NightBlocks]:
    return [night for night in nights if night.day >= day]


def _reported(
    detected_on: int, verdicts: Sequence[tuple[int, Change]], true: Array, cell: Cell
) -> Outcome:
    """A change as it was detected, and ten nights later; a notice, once it becomes an alarm."""
    alarms = [(day, change) for day, change in verdicts if change.cause not in NOTICES]
    night, first = (alarms or verdicts)[0]
    until = max(detected_on + SETTLED, night)
    last, settled = [(day, change) for day, change in verdicts if day <= until][-1]
    # Sized against the nights before its begin, or against the baseline.
    begin = cell.event.begin or 0
    before = true[begin - 1] if begin > cell.baseline else 0.0
    return {
        "night": night,
        "is_notice": not alarms,
        "continues": first.continues,
        "first": _named(first),
        "cause": _named(settled),
        "since": [settled.since_lower, settled.since, settled.since_upper],
        "size": [round(value, 4) for value in _with_interval(settled.size)],
        "true": round(float((1.0 + true[last]) / (1.0 + before) - 1.0), 4),
    }


def _named(change: Change) -> list[object]:
    """Return the cause that is named, the likeliest, and the probability."""
    likeliest = max(change.candidates, key=change.candidates.__getitem__, default=change.cause)
    return [change.cause, likeliest, round(change.probability, 3)]


def _missed(verdicts: Sequence[Verdict], true: Array) -> tuple[float, float]:
    """Of tonight's change: root mean square error, and share of nights within the interval."""
    value, lower, upper = np.array([_with_interval(verdict.newest_night) for verdict in verdicts]).T
    of = true[-len(value) :]
    inside = (lower <= of) & (of <= upper)
    return round(float(np.sqrt(np.mean((value - of) ** 2))), 4), round(float(inside.mean()), 4)


def _leakage(watch: Watch, at: Array) -> list[float]:
    """By the level of the last night over the truth, less 1, with its interval."""
    drives, true = drives_and_leakage(LAMINAR, at)
    leakage = _with_interval(watch.leakage_at(drives, at))
    return [round(value / true - 1.0, 4) for value in leakage]


def _with_interval(estimate: Estimate) -> tuple[float, float, float]:
    return estimate.value, estimate.lower, estimate.upper
