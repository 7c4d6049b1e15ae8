"""The model itself: its misfit over the last nights, and since when it is larger."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from leakage.course.alarms import above_level
from leakage.estimation.model_verdict import (
    DISPROVED_OVER_TEN,
    NIGHTS_TOGETHER,
    Misfit,
    StructuredMisfit,
    grown_misfit,
    model_verdict,
    structured_misfit,
    verdict_in_words,
)
from pipeline.trends.figures.indicators import MODEL_MISFIT
from pipeline.trends.nights.history import History
from pipeline.trends.nights.segments import Segment, segment_at, segments
from pipeline.trends.states.words import day
from pipeline.trends.states.zeros import nights_rule

Array = NDArray[np.float64]


def with_misfit(history: History, until: dt.date) -> History:
    """A history whose nights from one on have their misfit over ten, those before as they are."""
    records = history.records.copy()
    begin = history.place_from(until)
    records["misfit_of_ten"][begin:] = np.nan
    for part in segments(history):
        for place in range(max(begin, part.first), part.end):
            found = _misfit_at(records, part, place)
            if found is not None and found.n_nights == NIGHTS_TOGETHER:
                records["misfit_of_ten"][place] = found.share, found.noise_share
    return replace(history, records=records)


def _misfit_at(records: NDArray[np.void], part: Segment, place: int) -> StructuredMisfit | None:
    """Misfit of the last ten nights of a segment that tell it; None without one."""
    # A month is enough to find them, and a longer silence says nothing of now.
    rows = records[max(part.first, place - 3 * NIGHTS_TOGETHER) : place + 1]
    told = np.isfinite(rows["misfit"]).all(axis=1) & (rows["model"] == rows["model"][-1])
    known = rows["misfit"][told][-NIGHTS_TOGETHER:]
    return _misfit_of(tuple(row.tobytes() for row in known)) if len(known) else None


# A night is among the last ten of ten nights, and each of these is asked for again.
@lru_cache(maxsize=1024)
def _misfit_of(nights: tuple[bytes, ...]) -> StructuredMisfit:
    return structured_misfit([_misfit_of_night(one) for one in nights])


@lru_cache(maxsize=2 * NIGHTS_TOGETHER)
def _misfit_of_night(numbers: bytes) -> Misfit:
    return Misfit.of(np.frombuffer(numbers))


@dataclass(frozen=True, slots=True)
class ModelCourse:
    """A motor's model over its nights; shape (n,) each.

    `first` is the misfit of the first ten nights, over the mean leakage, from when it was known,
    else nan; `state` is insufficient, ok, or warning where it has grown by what disproves a model.
    """

    history: History
    segments: tuple[Segment, ...]
    first: Array
    state: tuple[str, ...]

    def at(self, place: int) -> StructuredMisfit | None:
        """Misfit of the last ten nights that tell it; None without one."""
        return _misfit_at(self.history.records, segment_at(self.segments, place), place)

    def words(self, place: int) -> str:
        """A model that is disproved, in words; with the night since when, if it once was not."""
        found = self.at(place)
        changed = self.state[place] == "warning"
        if found is None or not (changed or model_verdict(found) == "disproved"):
            return ""
        told = "the model does not describe this motor"
        if changed:
            told = f"the model no longer describes this motor since about {self._since(place)}"
        return f"{told}: {verdict_in_words(found, self.history.spec.low_side)}"

    def _since(self, place: int) -> str:
        before = [one for one in range(place) if self.state[one] != "warning"]
        return day(self.history.nights[max(before, default=-1) + 1])


def model_course(history: History) -> ModelCourse:
    """Misfit of a motor's model against that of its baseline."""
    share, noise = history.records["misfit_of_ten"].T
    first, state = np.full(len(history), np.nan), np.full(len(history), "insufficient", object)
    parts = segments(history, MODEL_MISFIT)
    for part in parts:
        known = part.first + np.flatnonzero(np.isfinite(share[part.first : part.end]))
        if not len(known):
            continue
        here = slice(known[0], part.end)
        first[here] = share[known[0]]
        told = grown_misfit(share[here], noise[here])
        is_on = above_level(told, DISPROVED_OVER_TEN, 0.0, nights_rule(history.spec))
        state[here] = np.where(is_on, "warning", "ok")
    return ModelCourse(history, parts, first, tuple(state.tolist()))
