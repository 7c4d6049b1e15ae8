"""Eras of a motor: nights that are compared with one baseline.

Dated events, resets and changed settings of the statistics begin one.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from pipeline.config.nights import night as night_labelled
from pipeline.trends.nights.decisions import LEAKAGE, SENSORS
from pipeline.trends.nights.history import History

EVENT_WORDS = {
    "overhaul": "overhaul",
    "oil_change": "oil change",
    "flushing_change": "change of flushing",
    "motor_exchanged": "motor exchanged",
}
# What begins with a motor's first night.
FIRST_NIGHTS = "first nights"


@dataclass(frozen=True, slots=True)
class Era:
    """Places of its nights, half open, and what it begins with, in words."""

    first: int
    end: int
    reason: str


def eras_of(history: History, of_what: str = LEAKAGE) -> tuple[Era, ...]:
    """The eras of the leakage, or of a sensor's zero."""
    starts: dict[int, list[str]] = {0: []}
    found = [] if of_what in SENSORS else _changed_settings(history)
    for event in sorted(history.spec.file.baseline_events, key=lambda one: one.date):
        note = f": {event.note}" if event.note else ""
        # What happened before the first night is nothing that its nights show.
        if event.date >= history.nights[0]:
            words = f"{EVENT_WORDS[event.kind]} on {event.date}{note}"
            found.append((history.place_from(event.date), words))
    for one in history.decisions:
        if one.kind == "baseline_reset" and _is_of(one.indicator, of_what):
            note = f": {one.note}" if one.note else ""
            found.append((history.place_from(one.night), f"reset from {one.night}{note}"))
    for place, words in found:
        if place < len(history):
            starts.setdefault(place, []).append(words)
    borders = [*sorted(starts), len(history)]
    return tuple(
        Era(first, end, "; ".join(starts[first]) or FIRST_NIGHTS)
        for first, end in pairwise(borders)
    )


def era_at(eras: tuple[Era, ...], place: int) -> Era:
    """The era of a night; the last one's for nights to come."""
    return next((one for one in eras if place < one.end), eras[-1])


def _is_of(indicator: str, of_what: str) -> bool:
    """True if a reset is of the leakage (under any of its names) or of a sensor's zero."""
    return not indicator or (indicator if indicator in SENSORS else LEAKAGE) == of_what


def _changed_settings(history: History) -> list[tuple[int, str]]:
    """Nights whose statistics were shaped by other settings than those before.

    A changed setting makes all nights anew whose logs are there; where they are not, the flows
    before and after cannot be compared. The oil is dated by an event of its own, and periods set
    by hand are of their night alone.
    """
    models = history.records["model"]
    known = np.flatnonzero(models != b"")
    if len(np.unique(models[known])) < 2:
        return []
    spec, found = history.spec, []
    before: tuple[bytes, str] | None = None
    for place in known.tolist():
        label = history.nights[place]
        if spec.file.periods.within(night_labelled(label, spec.settings.nights)):
            continue
        now = bytes(models[place]), spec.file.oil_on(label)
        if before is not None and now[0] != before[0] and now[1] == before[1]:
            found.append((place, f"other settings from {label}"))
        before = now
    return found
