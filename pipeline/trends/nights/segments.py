"""Segments of a motor's history, begun by dated events, resets and changes of the fit's setup."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pipeline.config.nights import night as night_labelled
from pipeline.trends.nights.history import History

Places = NDArray[np.intp]

EVENT_WORDS = {
    "overhaul": "overhaul",
    "oil_change": "oil change",
    "flushing_change": "change of flushing",
    "motor_exchanged": "motor exchanged",
}
# What begins with a motor's first night.
FIRST_NIGHTS = "first nights"


@dataclass(frozen=True, slots=True)
class Segment:
    """Nights that are compared with one baseline, half open, and what they begin with, in words."""

    first: int
    end: int
    reason: str

    @property
    def here(self) -> slice:
        """Its places."""
        return slice(self.first, self.end)


def segments(history: History, indicator: str = "") -> tuple[Segment, ...]:
    """The nights of an indicator by the baseline that they are compared with."""
    starts: dict[int, list[str]] = {}
    for place, reason in history.once(_changed_settings):
        starts.setdefault(place, []).append(reason)
    for event in sorted(history.spec.file.events, key=lambda one: one.date):
        note = f": {event.note}" if event.note else ""
        words = f"{EVENT_WORDS[event.kind]} on {event.date}{note}"
        # What happened before the first night is nothing that its nights show.
        if event.date >= history.nights[0]:
            _begin(starts, history, event.date, words)
    for one in history.decisions:
        if one.kind == "baseline_reset" and one.indicator in ("", indicator):
            note = f": {one.note}" if one.note else ""
            _begin(starts, history, one.night, f"reset from {one.night}{note}")
    starts.setdefault(0, [FIRST_NIGHTS])
    borders = [*sorted(starts), len(history)]
    return tuple(Segment(first, end, "; ".join(starts[first])) for first, end in pairwise(borders))


def segment_at(parts: Sequence[Segment], place: int) -> Segment:
    """The segment of a night."""
    return next(one for one in parts if place < one.end)


def first_good(history: History, segment: Segment) -> Places:
    """Places of a segment's first nights that say something, as many as a provisional baseline has.

    Empty while there are fewer.
    """
    needed = history.spec.settings.trend.provisional_nights
    places = segment.first + np.flatnonzero(history.fitted[segment.first : segment.end])[:needed]
    return places if len(places) == needed else places[:0]


def _begin(starts: dict[int, list[str]], history: History, date: dt.date, words: str) -> None:
    if (place := history.place_from(date)) < len(history):
        starts.setdefault(place, []).append(words)


def _changed_settings(history: History) -> list[tuple[int, str]]:
    """Nights whose statistics were shaped by other settings than those before.

    A changed setting makes all nights anew whose logs are there; where they are not, the figures
    before and after cannot be compared. The oil is dated by an event of its own, and periods set by
    hand are of their night alone.
    """
    models, modes = history.records["model"], history.records["mode"]
    known = np.flatnonzero(models != b"")
    changes = (models[known[1:]] != models[known[:-1]]) | (modes[known[1:]] != modes[known[:-1]])
    if not changes.any():
        return []
    spec, found = history.spec, []
    before: tuple[bytes, bytes, str] | None = None
    for place in known.tolist():
        label = history.nights[place]
        if spec.file.periods.within(night_labelled(label, spec.settings.nights)):
            continue
        now = (bytes(models[place]), bytes(modes[place]), spec.file.oil_on(label))
        if before is not None and now != before and now[2] == before[2]:
            how = "flushing is fitted in another way" if now[1] != before[1] else "other settings"
            found.append((place, f"{how} from {label}"))
        before = now
    return found
