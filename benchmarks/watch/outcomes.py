"""What is kept of a motor of a cell: what was detected of it beside the truth, in numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from benchmarks.watch.cb560 import CB560, LAMINAR
from benchmarks.watch.cells import Cell
from benchmarks.watch.rivals import charts
from benchmarks.watch.simulator import History, drives_and_leakage
from leakage.watch import Change, Estimate, NightBlocks, Verdict, Watch, WatchSettings
from pipeline.arrays import Array

# Seeds of trials while building, and of the figures that are shown.
TRIAL, FRESH = 36, 20261203
REFERENCE = np.array([50.0, 200.0, 30.0])  # [°C], [bar], [rpm]
SETTLED = 10  # nights after which a cause has settled
# A change of the temperature's effect alone is a notice; and what ends is no alarm.
NOTICES = ("temperature_effect", "back_as_before")

Outcome = dict[str, Any]
Dated = tuple[int, Change]


def outcome(cell: Cell, number: int, base: int, limits: Mapping[str, float]) -> Outcome:
    """Of one motor of a cell: a seed of its own, by cell and number."""
    histories = cell.make((base, crc32(cell.key.encode()), number), cell.event.nights)
    watch, verdicts = _watched(histories, cell.baseline)
    history = _against_baseline(histories[0], cell.baseline)
    found = {
        "told": [_told(told_on, said, history, cell) for told_on, said in _said(verdicts).items()],
        "tonight": _newest_night(verdicts, history),
        "lack": round(verdicts[0].lack_of_fit, 4),
        "reached": _reached(histories[0], cell),
    }
    if isinstance(cell.of, CB560) and cell.of is LAMINAR:
        # At reference conditions, and at the motor's own.
        first = np.concatenate([one.conditions for one in history.nights[: cell.baseline]])
        found["leakages"] = [
            _leakage(watch, cell.of, at) for at in (REFERENCE, np.median(first, axis=0))
        ]
    if cell.has_rivals:
        values = charts(history.nights, cell.baseline)
        found["rivals"] = {
            method: _first(values[method] > limits[method], cell) for method in values
        }
    return found


def _leakage(watch: Watch, of: CB560, at: Array) -> list[float]:
    """By the level of the last night over the true one, less 1, with its interval."""
    drives, true = drives_and_leakage(of, at)
    return [round(one / true - 1.0, 4) for one in _with_interval(watch.leakage_at(drives, at))]


def _watched(histories: Sequence[History], baseline: int) -> tuple[Watch, list[Verdict]]:
    """The watch of the first motor after its last night, and what it said of each.

    What the others of its tank say of all flows is known to it.
    """
    settings = WatchSettings(baseline_nights=baseline)
    watches = [Watch.begin(one.machine, one.nights[:baseline], settings) for one in histories]
    verdicts = []
    for place in range(baseline, len(histories[0].nights)):
        watches = [
            watch.after(one.nights[place], partial(_earlier, one.nights[: place + 1]))
            for watch, one in zip(watches, histories, strict=True)
        ]
        watches = [_on_tank(watch, watches) for watch in watches]
        verdicts.append(watches[0].verdict())
    return watches[0], verdicts


def _earlier(nights: Sequence[NightBlocks], day: int) -> Sequence[NightBlocks]:
    return [one for one in nights if one.day >= day]


def _on_tank(watch: Watch, tank: Sequence[Watch]) -> Watch:
    """The watch that knows what the others say since its change, weighted by their variances."""
    change = watch.verdict().change
    if change is None:
        return watch
    others = [one.change_since(change.since) for one in tank if one is not watch]
    if not (found := [one for one in others if one is not None]):
        return watch
    weights = np.array([one.sd**-2 for one in found])
    value = float(weights @ [one.value for one in found] / weights.sum())
    return watch.with_tank(Estimate(value, float(weights.sum() ** -0.5)))


def _against_baseline(history: History, baseline: int) -> History:
    """Changes against the baseline's nights, in which wear may have begun."""
    newest_night, change = (
        (1.0 + one) / (1.0 + history.change[:baseline].mean()) - 1.0
        for one in (history.newest_night, history.change)
    )
    return replace(history, newest_night=newest_night, change=change)


def _said(verdicts: Sequence[Verdict]) -> dict[int, list[Dated]]:
    """Changes in force night by night, by the night on which they were told."""
    found: dict[int, list[Dated]] = {}
    for verdict in verdicts:
        if verdict.change is not None:
            found.setdefault(verdict.change.told_on, []).append((verdict.day, verdict.change))
    return found


def _told(told_on: int, said: Sequence[Dated], history: History, cell: Cell) -> Outcome:
    """A change as it was detected, and ten nights later; a notice, once it becomes an alarm."""
    alarms = [one for one in said if one[1].cause not in NOTICES]
    night, first = (alarms or said)[0]
    last, settled = [one for one in said if one[0] <= max(told_on + SETTLED, night)][-1]
    # Told against the nights before its begin, or against the baseline.
    begin = cell.event.begin or 0
    before = history.change[begin - 1] if begin > cell.baseline else 0.0
    return {
        "night": night,
        "is_notice": not alarms,
        "goes_on": first.goes_on,
        "first": _named(first),
        "cause": _named(settled),
        "since": [settled.since_lower, settled.since, settled.since_upper],
        "size": [round(one, 4) for one in _with_interval(settled.size)],
        "true": round(float((1.0 + history.change[last]) / (1.0 + before) - 1.0), 4),
    }


def _named(change: Change) -> list[object]:
    """The cause that is told, the likeliest, and the probability."""
    likeliest = max(change.candidates, key=change.candidates.__getitem__, default=change.cause)
    return [change.cause, likeliest, round(change.probability, 3)]


def _with_interval(found: Estimate) -> tuple[float, float, float]:
    return found.value, found.lower, found.upper


def _newest_night(verdicts: Sequence[Verdict], history: History) -> list[float]:
    """Root mean square of the error, and share of nights within the interval.

    Against the truth at the night's conditions, and at the motor's own.
    """
    value, lower, upper = np.array([_with_interval(one.newest_night) for one in verdicts]).T
    found = []
    for true in (history.newest_night[-len(value) :], history.change[-len(value) :]):
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
