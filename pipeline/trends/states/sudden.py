"""Sudden changes of a whole motor that no event in its file explains.

Wear grows, and damage takes one path. Where every path changes in one night, by different amounts,
a motor was exchanged or overhauled; where all flows change by one factor, another oil was filled in
or a sensor tells something else; and leakage that falls in a night does not do so by wear. The
baseline then says nothing of what there is now, so it is said until somebody dates the event.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from leakage.course.hypotheses import Posterior
from leakage.course.jumps import AFTER, LEAST_BEFORE, MOST_BEFORE, Jump, find_jumps, is_undone
from pipeline.trends.figures.indicators import DEVIATION, Indicator
from pipeline.trends.nights.history import History
from pipeline.trends.nights.segments import Segment, segments
from pipeline.trends.states.explanations import Why
from pipeline.trends.states.words import day, name_of, relative_change

Array = NDArray[np.float64]
Kind: TypeAlias = Literal["exchange", "alike", "circuit", "fall"]
KINDS: tuple[Kind, ...] = get_args(Kind)

# Smallest step of a coefficient, and least scatter of its nights, relative to it.
LEAST_STEP, LEAST_SCATTER = 0.05, 0.01
# A path took part if it moved by this many times the scatter of its nights.
TOOK_PART_SD = 2.0
# Steps whose logarithms differ by no more are alike.
ALIKE = 0.05
# Good nights that say whether it is undone.
NIGHTS_OF_NOW = 5
AS_THE_OTHERS = (
    "as in the other motors of the oil circuit: oil, temperature or charge pressure, not this motor"
)


@dataclass(frozen=True, slots=True)
class Sudden:
    """A sudden change that no event explains."""

    place: int  # of its first night
    # told, until: places of the nights from which, and before which, it stands.
    told: int
    until: int
    # ``exchange``: every path changed, by different amounts; ``alike``: all flows by one factor;
    # ``fall``: the drain flow fell, and nobody can tell through which path; ``circuit``: what the
    # other motors of the oil circuit did, too.
    kind: Kind
    words: str  # for people
    steps: Mapping[str, float]  # logarithm of the step of each indicator that tells it

    def undoes(self, earlier: Sudden) -> bool:
        """True if this change takes back an earlier one that still stood."""
        both = self.steps.keys() & earlier.steps.keys()
        return (
            earlier.place < self.place < earlier.until
            and bool(both)
            and all(abs(self.steps[name] + earlier.steps[name]) <= ALIKE for name in both)
        )

    def stands(self, place: int) -> bool:
        """True if this change is reported in a night."""
        return self.told <= place < self.until


def sudden_changes(
    history: History,
    indicators: Mapping[str, Indicator],
    why: Why,
) -> tuple[Sudden, ...]:
    """All sudden changes of a motor, in order of the nights on which they are told."""
    paths = {name: one for name, one in indicators.items() if one.path}
    found = [one for part in segments(history) for one in _of_paths(history, part, paths, why)]
    for part in segments(history, DEVIATION):
        found += _falls(history, part, indicators[DEVIATION], why)
    told = sorted(found, key=lambda one: (one.told, KINDS.index(one.kind)))
    return tuple(
        one for at, one in enumerate(told) if not any(one.undoes(before) for before in told[:at])
    )


def _jumps(history: History, part: Segment, series: Array, least: float) -> dict[int, Jump]:
    """Jumps of a series by their first night; places are those of the segment."""
    here = part.here
    longest = history.spec.settings.alarms.stale_after_nights
    jumps = find_jumps(history.numbers[here], series[here], least, LEAST_SCATTER, longest)
    return {one.place: one for one in jumps}


def _of_paths(
    history: History, part: Segment, paths: Mapping[str, Indicator], why: Why
) -> list[Sudden]:
    """Nights in which every path changed, as far as the second of them tells it."""
    jumps = {name: _jumps(history, part, one.watched, LEAST_STEP) for name, one in paths.items()}
    found = []
    for place in sorted({place for some in jumps.values() for place in some}):
        here = [(some[place].told, name) for name, some in jumps.items() if place in some]
        if len(here) < 2:
            continue
        # Judged once, by what is known in that night: later nights change nothing of it.
        told = sorted(here)[1][0]
        steps = _steps(part, place, told, paths)
        behind = why.at(part.first + told, part.first + place)
        kind = _kind(steps, len(paths), behind)
        if kind is None:
            continue
        members = [(paths[name].watched, jumps[name][place]) for at, name in here if at <= told]
        moved = {name: one.size for name, one in steps.items()}
        words = _words_of_paths(kind, history, part.first + place, moved, len(paths))
        until = _until(part, told, members)
        found.append(Sudden(part.first + place, part.first + told, until, kind, words, moved))
    return found


def _kind(steps: Mapping[str, _Step], n_paths: int, behind: Posterior | None) -> Kind | None:
    """Kind of change that the steps of a night's paths show; None if it may as well be damage."""
    if len(steps) < 2 or not all(one.took_part for one in steps.values()):
        return None
    if behind is not None and behind.taken_back:
        return None
    if behind is not None and behind.verdict == "common":
        return "circuit" if behind.is_of_tank else "alike"
    # What all flows share is no step of a path.
    shared = behind.factor.log if behind is not None and behind.is_common else 0.0
    own = [one.size - shared for one in steps.values()]
    scatter = [one.scatter for one in steps.values()]
    if any(abs(size) <= TOOK_PART_SD * one for size, one in zip(own, scatter, strict=True)):
        return None
    # Where only some paths are known, and all have grown, damage does that, too.
    return None if len(steps) < n_paths and min(own) > 0 else "exchange"


@dataclass(frozen=True, slots=True)
class _Step:
    """Logarithm of the step of a path in a night, and scatter of the nights before it."""

    size: float
    scatter: float

    @property
    def took_part(self) -> bool:
        return abs(self.size) > TOOK_PART_SD * self.scatter


def _steps(
    part: Segment, place: int, told: int, paths: Mapping[str, Indicator]
) -> dict[str, _Step]:
    """By path that was known before and after, what it did."""
    steps = {}
    for name, one in paths.items():
        series = one.watched[part.first : part.first + told + 1]
        good = np.flatnonzero(np.isfinite(series))
        before = series[good[good < place]][-MOST_BEFORE:]
        after = series[good[good >= place]][:AFTER]
        if len(before) < LEAST_BEFORE or len(after) < AFTER:
            continue
        size = float(np.log(np.median(after) / np.median(before)))
        scatter = max(float(np.std(np.log(before), ddof=1)), LEAST_SCATTER)
        steps[name] = _Step(size, scatter)
    return steps


def _falls(history: History, part: Segment, flow: Indicator, why: Why) -> list[Sudden]:
    """Nights in which the drain flow fell by as much as a warning would have it rise."""
    least = history.spec.settings.alarms.warning_percent / 100.0
    found = []
    for place, jump in _jumps(history, part, flow.watched, least).items():
        if jump.relative > 0:
            continue
        # Before there is a baseline's model, there is no deviation to fall.
        known_from = part.first + int(np.argmax(flow.told[part.first : part.end]))
        told = max(part.first + jump.told, known_from)
        behind = why.at(told, part.first + place)
        is_of_tank = behind is not None and behind.is_of_tank
        kind: Kind = "circuit" if is_of_tank else "fall"
        moved = {DEVIATION: jump.log_step}
        words = _words_of_fall(kind, history, part.first + place, jump.log_step)
        until = _until(part, jump.told, [(flow.watched, jump)])
        found.append(Sudden(part.first + place, told, until, kind, words, moved))
    return found


def _until(part: Segment, told: int, members: Sequence[tuple[Array, Jump]]) -> int:
    """Place of the first night on which all of it is undone; the end of the segment where never."""
    good = {
        number: np.flatnonzero(np.isfinite(series[part.first : part.end]))
        for number, (series, _) in enumerate(members)
    }
    for place in range(told + NIGHTS_OF_NOW, part.end - part.first):
        recent = [
            series[part.first + good[number][good[number] <= place][-NIGHTS_OF_NOW:]]
            for number, (series, _) in enumerate(members)
        ]
        if all(is_undone(jump, now) for (_, jump), now in zip(members, recent, strict=True)):
            return part.first + place
    return part.end


def _moved_words(steps: Mapping[str, float]) -> str:
    return ", ".join(
        f"{name_of(name)} {100 * relative_change(name, np.expm1(step)):+.0f} %"
        for name, step in steps.items()
    )


def _words_of_paths(
    kind: Kind, history: History, place: int, steps: Mapping[str, float], n_paths: int
) -> str:
    every = "every path" if len(steps) == n_paths else "every path that the nights tell"
    night = f"in the one night of {day(history.nights[place])} ({_moved_words(steps)})"
    if kind == "circuit":
        return f"{every} changed {night}, {AS_THE_OTHERS}"
    if kind == "alike":
        return (
            f"{every} changed {night}, as by another oil or a sensor, not by wear; date an oil "
            "change in the motor's file"
        )
    damage = ", or all were damaged at once" if min(steps.values()) > 0 else ""
    return (
        f"{every} changed {night}: a motor exchanged or overhauled without a dated event is "
        f"likely{damage}; date it in the motor's file"
    )


def _words_of_fall(kind: Kind, history: History, place: int, log_step: float) -> str:
    fell = f"{_moved_words({DEVIATION: log_step})} in the one night of {day(history.nights[place])}"
    if kind == "circuit":
        return f"{fell}, {AS_THE_OTHERS}"
    return (
        f"{fell}, which no wear does: a motor exchanged or overhauled, another oil or a sensor; "
        "without a dated event the baseline no longer holds"
    )
