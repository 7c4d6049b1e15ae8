"""A motor's nights in order, as the tables have them: all that trends are made from."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pipeline.config import MotorSpec
from pipeline.config.nights import nights_between
from pipeline.schema.fits import NO_NEW_DATA
from pipeline.trends.nights.decisions import Decision
from pipeline.trends.nights.records import (
    GATED,
    Layout,
    NightWords,
    Records,
    blank_records,
    whole_matrix,
)

Nights = NDArray[np.int64]
Made = TypeVar("Made")
# Nights without a log after which nothing is said of a motor until it has one again.
LONGEST_SILENCE = 92
NO_LOG = f"{NO_NEW_DATA.replace('_', ' ')}: no log covers this night"


@dataclass(frozen=True)
class History:
    """A motor's nights, one record each, increasing, with people's decisions on it.

    `words` has by place why figures of a night do not count; of nights that are not to be published
    anew there may be none.
    """

    spec: MotorSpec
    layout: Layout
    records: Records
    words: Mapping[int, NightWords]
    decisions: tuple[Decision, ...] = ()

    def __len__(self) -> int:
        return len(self.records)

    @cached_property
    def kept(self) -> dict[Any, Any]:
        """Cache of values computed from the motor's model, so that not every night repeats them."""
        return {}

    def once(self, make: Callable[[History], Made]) -> Made:
        """Something made of it, made when it is first asked for."""
        if make not in self.kept:
            self.kept[make] = make(self)
        made: Made = self.kept[make]
        return made

    @cached_property
    def nights(self) -> tuple[dt.date, ...]:
        """Labels."""
        return tuple(self.records["night"].astype("M8[D]").tolist())

    @cached_property
    def numbers(self) -> Nights:
        """Days since the first night, shape (n,)."""
        days: Nights = self.records["night"].astype(np.int64)
        since: Nights = days - days[0]
        return since

    @cached_property
    def fitted(self) -> NDArray[np.bool_]:
        """Nights that say something, alone or to the filter, shape (n,)."""
        fitted: NDArray[np.bool_] = self.records["fitted"] | self.records["informed"]
        return fitted

    @cached_property
    def statuses(self) -> list[str]:
        """Reason why a whole night does not count, by night; empty where it does."""
        return self._told(self.fitted, lambda words: words.status)

    def factors(self, places: NDArray[np.intp] | slice) -> NDArray[np.float64]:
        """Triangular factors of all kept samples of some nights, shape (m, c, c)."""
        return whole_matrix(self.records["factor"][places], len(self.layout.columns))

    def place_of(self, number: int) -> int:
        """Place of a night by its number."""
        return int(np.searchsorted(self.numbers, number))

    def place_from(self, date: dt.date) -> int:
        """Place of the first night from a date on; behind the last where there is none yet."""
        return int(np.searchsorted(self.records["night"], np.datetime64(date)))

    def why(self, known: NDArray[np.bool_], coefficient: int | None = None) -> tuple[str, ...]:
        """Reason why a coefficient, or (None) the reference leakage, does not count, by night.

        Empty where it is known.
        """

        def of(words: NightWords) -> str:
            return words.reference if coefficient is None else words.coefficients[coefficient]

        return tuple(self._told(known, of))

    def _told(self, known: NDArray[np.bool_], of: Callable[[NightWords], str]) -> list[str]:
        told: list[str] = np.where(known, "", GATED).tolist()
        for place, words in self.words.items():
            if told[place]:
                told[place] = of(words)
        return told


def every_night(history: History, until: dt.date) -> History | None:
    """A history with every night up to one, those without a row as well; None where it has none.

    A night that no log covers is a night: what a run said of it then is said of it later, too. Of a
    motor that has been silent for long nothing is said any more: a clock was wrong, or it is gone.
    """
    known = history.records[history.records["night"] <= np.datetime64(until)]
    if not len(known):
        return None
    first = history.nights[0]
    numbers = np.arange((until - first).days + 1)
    silent = numbers - history.numbers[np.searchsorted(history.numbers, numbers, "right") - 1]
    every = nights_between(first, until)
    labels = [every[number] for number in np.flatnonzero(silent <= LONGEST_SILENCE)]
    if len(labels) == len(history):
        return history
    records = blank_records(history.layout, labels)
    places = np.searchsorted(records["night"], known["night"])
    records[places] = known
    nothing = NightWords(NO_LOG, NO_LOG, (NO_LOG,) * len(history.layout.coefficients))
    gaps = np.setdiff1d(np.arange(len(labels)), places)
    words = dict.fromkeys(gaps.tolist(), nothing)
    words |= {int(places[place]): one for place, one in history.words.items() if place < len(known)}
    return replace(history, records=records, words=words)
