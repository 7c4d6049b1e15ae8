"""Sudden changes of a whole motor that no event in its file explains.

Wear grows, and damage takes one path. Where every path changes in one night, by different amounts,
a motor was exchanged or overhauled; where all change alike, another oil was filled in or a sensor
tells something else; and leakage that falls in a night does not do so by wear. The baseline then
says nothing of what there is now, so it is said until somebody dates the event.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from leakage.jumps import AFTER, LEAST_BEFORE, MOST_BEFORE, Jump, find_jumps, is_undone
from pipeline.decisions import Decision
from pipeline.trends.history import History
from pipeline.trends.indicators import DEVIATION, Indicator
from pipeline.trends.peers import Peers
from pipeline.trends.segments import Segment, segments
from pipeline.trends.words import day, name_of

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


@dataclass(frozen=True, slots=True)
class Sudden:
    """A sudden change that no event explains.

    Attributes
    ----------
    place
        Of its first night.
    told, until
        Places of the nights from which, and before which, it stands.
    kind
        ``exchange``: every path changed, by different amounts; ``alike``: all by the same factor;
        ``fall``: the drain flow fell, and nobody can tell through which path; ``circuit``: a fall
        that the other motors of the oil circuit shared.
    words
        For people.
    """

    place: int
    told: int
    until: int
    kind: Kind
    words: str

    def stands(self, place: int) -> bool:
        """Whether it is told in a night."""
        return self.told <= place < self.until


def sudden_changes(
    history: History,
    decisions: Sequence[Decision],
    indicators: Mapping[str, Indicator],
    peers: Mapping[str, Peers],
) -> tuple[Sudden, ...]:
    """All sudden changes of a motor, in order of the nights on which they are told."""
    paths = {name: one for name, one in indicators.items() if one.path}
    found = [
        one for part in segments(history, decisions) for one in _of_paths(history, part, paths)
    ]
    flow, others = indicators[DEVIATION], peers.get(DEVIATION)
    for part in segments(history, decisions, DEVIATION):
        found += _falls(history, part, flow, others)
    return tuple(sorted(found, key=lambda one: (one.told, KINDS.index(one.kind))))


def _jumps(history: History, part: Segment, series: Array, least: float) -> dict[int, Jump]:
    """Jumps of a series by their first night; places are those of the segment."""
    here = slice(part.first, part.end)
    longest = history.spec.settings.alarms.stale_after_nights
    jumps = find_jumps(history.numbers[here], series[here], least, LEAST_SCATTER, longest)
    return {one.place: one for one in jumps}


def _of_paths(history: History, part: Segment, paths: Mapping[str, Indicator]) -> list[Sudden]:
    """Nights in which every path changed, as far as the second of them tells it."""
    jumps = {name: _jumps(history, part, one.value, LEAST_STEP) for name, one in paths.items()}
    found = []
    for place in sorted({place for some in jumps.values() for place in some}):
        here = [(some[place].told, name) for name, some in jumps.items() if place in some]
        if len(here) < 2:
            continue
        # Judged once, by what is known in that night: later nights change nothing of it.
        told = sorted(here)[1][0]
        steps = _steps(part, place, told, paths)
        if len(steps) < 2 or not all(took_part for _, took_part in steps.values()):
            continue
        moved = {name: step for name, (step, _) in steps.items()}
        spread = max(moved.values()) - min(moved.values())
        kind: Kind = "alike" if spread <= ALIKE else "exchange"
        members = [(paths[name].value, jumps[name][place]) for at, name in here if at <= told]
        words = _words(kind, history, part.first + place, moved)
        until = _until(part, told, members)
        found.append(Sudden(part.first + place, part.first + told, until, kind, words))
    return found


def _steps(
    part: Segment, place: int, told: int, paths: Mapping[str, Indicator]
) -> dict[str, tuple[float, bool]]:
    """By path that was known before and after: logarithm of its step, and whether it took part."""
    steps = {}
    for name, one in paths.items():
        series = one.value[part.first : part.first + told + 1]
        good = np.flatnonzero(np.isfinite(series))
        before = series[good[good < place]][-MOST_BEFORE:]
        after = series[good[good >= place]][:AFTER]
        if len(before) < LEAST_BEFORE or len(after) < AFTER:
            continue
        log_step = float(np.log(np.median(after) / np.median(before)))
        scatter = max(float(np.std(np.log(before), ddof=1)), LEAST_SCATTER)
        steps[name] = (log_step, abs(log_step) > TOOK_PART_SD * scatter)
    return steps


def _falls(history: History, part: Segment, flow: Indicator, peers: Peers | None) -> list[Sudden]:
    """Nights in which the drain flow fell by as much as a warning would have it rise."""
    least = history.spec.settings.alarms.warning_percent / 100.0
    found = []
    for place, jump in _jumps(history, part, flow.watched, least).items():
        if jump.relative > 0:
            continue
        # Before there is a baseline's model, there is no deviation to fall.
        known_from = part.first + int(np.argmax(flow.told[part.first : part.end]))
        told = max(part.first + jump.told, known_from)
        kind: Kind = "circuit" if _shared(part, jump, told, peers) else "fall"
        words = _words(kind, history, part.first + place, {DEVIATION: jump.log_step})
        until = _until(part, jump.told, [(flow.watched, jump)])
        found.append(Sudden(part.first + place, told, until, kind, words))
    return found


def _shared(part: Segment, jump: Jump, told: int, peers: Peers | None) -> bool:
    """Whether the other motors of the circuit fell alike, by half of it at least."""
    if peers is None or peers.known_from(part) > told:
        return False
    others = peers.others[part.first : part.end]
    before, after = others[: jump.place], others[jump.place : jump.told + 1]
    before, after = before[np.isfinite(before)][-MOST_BEFORE:], after[np.isfinite(after)]
    if not len(before) or not len(after):
        return False
    return float(np.median(after) - np.median(before)) <= jump.log_step / 2.0


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


def _words(kind: Kind, history: History, place: int, steps: Mapping[str, float]) -> str:
    night = day(history.nights[place])
    moved = ", ".join(
        f"{name_of(name)} {100 * np.expm1(step):+.0f} %" for name, step in steps.items()
    )
    if kind == "exchange":
        return (
            f"every path changed in the one night of {night} ({moved}): a motor exchanged or "
            "overhauled without a dated event is likely; date it in the motor's file"
        )
    if kind == "alike":
        return (
            f"every path changed alike in the one night of {night} ({moved}), as by another oil "
            "or a sensor, not by wear; date an oil change in the motor's file"
        )
    if kind == "circuit":
        return (
            f"{moved} in the one night of {night}, as in the other motors of the oil circuit: oil, "
            "temperature or charge pressure"
        )
    return (
        f"{moved} in the one night of {night}, which no wear does: a motor exchanged or "
        "overhauled, another oil or a sensor; without a dated event the baseline no longer holds"
    )
