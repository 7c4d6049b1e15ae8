"""Where a motor's history begins anew: dated events, resets, and changes of how it is fitted."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from pipeline.config import MotorSpec
from pipeline.decisions import Decision
from pipeline.trends.history import History

EVENT_WORDS = {
    "overhaul": "overhaul",
    "oil_change": "oil change",
    "flushing_change": "change of flushing",
    "motor_exchanged": "motor exchanged",
}


@dataclass(frozen=True, slots=True)
class Segment:
    """Nights that are compared with one baseline.

    Attributes
    ----------
    first, end
        Places of its nights in the history, half open.
    reason
        What it begins with, in words.
    """

    first: int
    end: int
    reason: str


def segments(
    spec: MotorSpec, history: History, decisions: Sequence[Decision], indicator: str
) -> tuple[Segment, ...]:
    """The nights of an indicator by the baseline that they are compared with.

    Parameters
    ----------
    spec
        The motor; its events are dated.
    history
        Its nights.
    decisions
        What people said of it; resets count.
    indicator
        A reset may be of one indicator alone.

    Returns
    -------
    tuple of Segment
        In order of time; together they are all nights.
    """
    starts: dict[int, str] = {0: "first nights"}
    nights = history.nights
    for place, reason in _changed_settings(spec, history):
        starts.setdefault(place, reason)
    for event in sorted(spec.file.events, key=lambda one: one.date):
        first = _first_from(nights, event.date)
        if first is not None:
            note = f": {event.note}" if event.note else ""
            starts[first] = f"{EVENT_WORDS[event.kind]} on {event.date}{note}"
    for one in decisions:
        if one.kind == "baseline_reset" and one.indicator in ("", indicator):
            first = _first_from(nights, one.night)
            if first is not None:
                starts[first] = f"reset from {one.night}" + (f": {one.note}" if one.note else "")
    borders = [*sorted(starts), len(nights)]
    return tuple(
        Segment(first, end, starts[first]) for first, end in pairwise(borders) if end > first
    )


def _first_from(nights: Sequence[dt.date], date: dt.date) -> int | None:
    return next((place for place, night in enumerate(nights) if night >= date), None)


def _changed_settings(spec: MotorSpec, history: History) -> list[tuple[int, str]]:
    """Nights whose statistics were shaped by other settings than those before, the oil apart.

    A changed setting makes all nights anew whose logs are there; where they are not, the figures
    before and after cannot be compared.
    """
    found: list[tuple[int, str]] = []
    known: tuple[str, str, str] | None = None
    rows = zip(
        history.words("model_hash"),
        history.words("flushing_mode"),
        history.nights,
        strict=True,
    )
    for place, (model_hash, mode, night) in enumerate(rows):
        if not model_hash:
            continue
        now = (model_hash, mode, spec.file.oil_on(night))
        if known is not None and now != known and now[2] == known[2]:
            what = "flushing is fitted in another way" if now[1] != known[1] else "other settings"
            found.append((place, f"{what} from {night}"))
        known = now
    return found
