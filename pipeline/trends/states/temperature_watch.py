"""Change of the effect of temperature since the baseline: the sensor, or the oil's curve."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from leakage.course.alarms import above_level, nights_since_good
from leakage.course.temperature_correction import (
    NIGHTS_OF_NOW,
    TemperatureCorrection,
    latest_slopes,
)
from pipeline.trends.baselines.eras import Era, era_at
from pipeline.trends.baselines.flow import gap_ratio
from pipeline.trends.figures.indicators import TEMPERATURE_EFFECT
from pipeline.trends.nights.history import History
from pipeline.trends.nights.segments import Segment
from pipeline.trends.states.words import day, falls_words, temperature_words
from pipeline.trends.states.zeros import nights_rule

Array = NDArray[np.float64]
Row = dict[str, Any]

# A change is told at so many times its ±: 0.02 false alarms a motor-year at most.
CERTAIN: Final = 2.0
NOT_TOLD = "the last good nights do not tell it"
NOT_KNOWN = "what it is at the baseline is not known yet"


@dataclass(frozen=True, slots=True, eq=False)
class TemperatureWatch:
    """Effect of temperature on the loss factors over a motor's nights; shape (n,) each."""

    # history, eras: the nights, and what is frozen with each baseline.
    history: History
    eras: tuple[Era, ...]
    # value, half: of the last 30 good nights, and half-width of its 95 % interval [1/K]; nan where
    # not known.
    value: Array
    half: Array
    evidence: Array  # change since the baseline over its ±; nan where not known
    state: tuple[str, ...]  # insufficient while no recent night tells it, ok or warning

    def words(self, place: int) -> str:
        """That the effect has changed by a night, in words; empty where it has not."""
        if self.state[place] != "warning":
            return ""
        raised = np.array(self.state[: place + 1]) == "warning"
        quiet = np.flatnonzero(~raised & ~(self.evidence[: place + 1] > CERTAIN))
        known = np.flatnonzero(np.isfinite(self.value[: place + 1]))
        frozen = self.frozen(place)
        assert frozen is not None
        return (
            "the temperature sensor or the oil's curve has changed since "
            f"{day(self.history.nights[int(quiet[-1]) + 1])}: "
            f"{falls_words(self.value[known[-1]])}, at the baseline "
            f"{falls_words(frozen.per_kelvin)}"
        )

    def row(self, place: int) -> Row | None:
        """Row of `trends` of a night; None where nothing is known of it."""
        frozen, known = self.frozen(place), bool(np.isfinite(self.value[place]))
        if frozen is None and not known:
            return None
        value, half = 100.0 * self.value[place], 100.0 * self.half[place]
        return {
            "indicator": TEMPERATURE_EFFECT,
            "unit": "%/K",
            "value": float(value) if known else None,
            "lower": float(value - half) if known else None,
            "upper": float(value + half) if known else None,
            "n_nights": NIGHTS_OF_NOW,
            "gated_reason": (NOT_KNOWN if frozen is None else None) if known else NOT_TOLD,
            "outside_fitted_range": False,
            "baseline_mean": None if frozen is None else 100.0 * frozen.per_kelvin,
            "state": self.state[place],
            "state_reason": None
            if frozen is None
            else self.words(place) or temperature_words(frozen) or None,
        }

    def frozen(self, place: int) -> TemperatureCorrection | None:
        """Effect that is frozen with the baseline; None while it is not known in a night."""
        era = era_at(self.eras, place)
        return era.temperature if place >= era.temperature_from else None

    @property
    def segments(self) -> tuple[Segment, ...]:
        """Nights that one baseline serves."""
        return tuple(era.segment for era in self.eras)


def temperature_watch(
    history: History, eras: Sequence[Era], changed: NDArray[np.bool_]
) -> TemperatureWatch:
    """Follow the effect of temperature; nights with another change, shape (n,), do not count."""
    n = len(history)
    value, half, evidence = (np.full(n, np.nan) for _ in range(3))
    state = np.full(n, "insufficient", dtype=object)
    for era in eras:
        frozen, here = era.temperature, era.segment.here
        if era.model is None:
            continue
        ratio = np.where(changed[here], np.nan, gap_ratio(history, era.segment, era.model))
        temperature = history.records["mean_temperature_c"][here]
        value[here], half[here] = latest_slopes(history.numbers[here], ratio, temperature)
        if frozen is None:
            continue
        moved = np.abs(value[here] - frozen.per_kelvin) / np.hypot(half[here], frozen.half_width)
        moved[: era.temperature_from - era.segment.first] = np.nan
        raised = above_level(moved, CERTAIN, 0.0, nights_rule(history.spec))
        evidence[here] = moved
        silent = nights_since_good(history.numbers[here], np.isfinite(moved))
        told = silent <= history.spec.settings.alarms.stale_after_nights
        state[here] = np.where(raised, "warning", np.where(told, "ok", "insufficient"))
    return TemperatureWatch(history, tuple(eras), value, half, evidence, tuple(state.tolist()))
