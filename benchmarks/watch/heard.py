"""What the watch says of a motor, night by night, as it goes through its history."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from benchmarks.watch.history import History
from leakage.watch import Change, Estimate, NightBlocks, Verdict, Watch, WatchSettings
from pipeline.arrays import Array

SETTLED = 10  # nights after which a cause has settled
# A change of the temperature's effect alone is a notice; and what ends is no alarm.
NOTICES = ("temperature_effect", "back_as_before")


@dataclass(frozen=True, slots=True)
class Said:
    """What was said of a change in a night."""

    night: int
    cause: str  # or cannot_be_told
    likeliest: str
    probability: float
    since: tuple[int, int, int]  # lower, middle, upper
    size: tuple[float, float, float]  # value, lower, upper
    goes_on: bool  # the same again


@dataclass(frozen=True, slots=True)
class Told:
    """A change: as it was detected, and as it was settled ten nights later.

    What a notice becomes is detected when it becomes that.
    """

    is_notice: bool
    first: Said
    settled: Said


@dataclass(frozen=True, slots=True)
class Heard:
    """All that the watch said of a motor."""

    told: tuple[Told, ...]
    newest_night: (
        Array  # each night's change with its interval, shape (nights, 3); nan before the first
    )
    lack_of_fit: float  # of the baseline
    leakages: tuple[tuple[float, float, float], ...] = ()  # those asked for, with intervals


def heard(histories: Sequence[History], baseline: int) -> list[Heard]:
    """Of motors on one tank: what the others say of all flows is known to each."""
    settings = WatchSettings(baseline_nights=baseline)
    watches = [Watch.begin(one.machine, one.nights[:baseline], settings) for one in histories]
    verdicts: list[list[Verdict]] = [[] for _ in histories]
    for place in range(baseline, len(histories[0].nights)):
        watches = [
            watch.after(one.nights[place], partial(_earlier, one.nights[: place + 1]))
            for watch, one in zip(watches, histories, strict=True)
        ]
        watches = [_on_tank(watch, watches) for watch in watches]
        for watch, found in zip(watches, verdicts, strict=True):
            found.append(watch.verdict())
    return [_heard(*one) for one in zip(histories, watches, verdicts, strict=True)]


def _earlier(nights: Sequence[NightBlocks], day: int) -> Sequence[NightBlocks]:
    return [one for one in nights if one.day >= day]


def _on_tank(watch: Watch, tank: Sequence[Watch]) -> Watch:
    """The watch that knows what the others say since its change."""
    change, others = watch.verdict().change, [one for one in tank if one is not watch]
    if change is None or not others:
        return watch
    said = _tank(others, change.since)
    return watch if said is None else watch.with_tank(said)


def _tank(others: Sequence[Watch], since: int) -> Estimate | None:
    """What others on the tank say of all flows since a night, each weighted by its variance."""
    found = [one for one in (other.change_since(since) for other in others) if one is not None]
    if not found:
        return None
    weights = np.array([one.sd**-2 for one in found])
    value = float(weights @ [one.value for one in found] / weights.sum())
    return Estimate(value, float(weights.sum() ** -0.5))


def _heard(history: History, watch: Watch, verdicts: Sequence[Verdict]) -> Heard:
    newest_night = np.full((len(history.nights), 3), np.nan)
    for place, verdict in enumerate(verdicts, start=len(history.nights) - len(verdicts)):
        newest_night[place] = _with_interval(verdict.newest_night)
    leakages = (
        _with_interval(watch.leakage_at(one.drives, one.conditions)) for one in history.asked
    )
    return Heard(_told(verdicts), newest_night, verdicts[0].lack_of_fit, tuple(leakages))


def _told(verdicts: Sequence[Verdict]) -> tuple[Told, ...]:
    """Changes by the night on which they were told."""
    found: dict[int, list[Said]] = {}
    for verdict in verdicts:
        if verdict.change is not None:
            said = _said(verdict.day, verdict.change)
            found.setdefault(verdict.change.told_on, []).append(said)
    return tuple(_as_told(told_on, said) for told_on, said in found.items())


def _as_told(told_on: int, said: Sequence[Said]) -> Told:
    alarms = [one for one in said if one.cause not in NOTICES]
    first = (alarms or said)[0]
    until = max(told_on + SETTLED, first.night)
    return Told(not alarms, first, [one for one in said if one.night <= until][-1])


def _said(night: int, change: Change) -> Said:
    likeliest = max(change.candidates, key=change.candidates.__getitem__, default=change.cause)
    since = (change.since_lower, change.since, change.since_upper)
    size = _with_interval(change.size)
    return Said(night, change.cause, likeliest, change.probability, since, size, change.goes_on)


def _with_interval(found: Estimate) -> tuple[float, float, float]:
    return found.value, found.lower, found.upper
