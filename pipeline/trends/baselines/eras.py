"""Quantities frozen with a motor's baseline: its own reference conditions and its model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from leakage.course.baseline import BaselineSettings
from leakage.course.temperature_correction import UNKNOWN_PER_KELVIN, TemperatureCorrection
from pipeline.trends.baselines.conditions import OwnConditions, own_conditions
from pipeline.trends.figures.baseline_model import baseline_model
from pipeline.trends.figures.temperature import (
    Effect,
    frozen_correction,
    usual_temperatures,
    warming,
)
from pipeline.trends.nights.history import History
from pipeline.trends.nights.segments import Segment, first_good, segments

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Era:
    """A stretch of nights between two events that begin everything anew.

    `known_from` is the first night that knows `own`, the motor's own reference conditions, and
    `model`, θ of the first good nights together; the end of the segment where none does.
    `temperature` is the correction of loss factors by the good nights up to `temperature_from`,
    None where they do not tell it; that is the end of the segment while there are too few.
    """

    segment: Segment
    known_from: int
    own: OwnConditions | None
    model: Array | None
    temperature: TemperatureCorrection | None = None
    temperature_from: int = 0


def era_at(eras: Sequence[Era], place: int) -> Era:
    """The era of a night."""
    return next(one for one in eras if place < one.segment.end)


def eras_of(history: History) -> tuple[Era, ...]:
    """The eras of a motor; each is known from its first good nights, as a provisional baseline."""
    return tuple(_era(history, segment) for segment in segments(history))


def _era(history: History, segment: Segment) -> Era:
    first = first_good(history, segment)
    if not len(first):
        return Era(segment, segment.end, None, None)
    model = baseline_model(history, first)
    era = Era(segment, int(first[-1]), own_conditions(history, first), model, None, segment.end)
    found = frozen_correction(history, segment.first, segment.end)
    if found is None:
        return era
    return replace(era, temperature=found.correction, temperature_from=found.place)


def effect_of(history: History, eras: Sequence[Era]) -> Effect:
    """Effect of temperature on a motor's nights, as far as it was known in each."""
    n = len(history)
    effect = Effect(np.ones(n), np.zeros(n), np.zeros(n))
    trend = history.spec.settings.trend
    lengths = np.array(BaselineSettings(trend.baseline_nights, trend.provisional_nights).lengths)
    for era in eras:
        first, known_from = era.segment.first, era.temperature_from
        early = np.arange(era.known_from + 1, min(known_from + 1, era.segment.end))
        good = first + np.flatnonzero(history.fitted[first : era.segment.end])
        # Of the nights of the baseline that serves then.
        at = np.searchsorted(lengths, np.searchsorted(good, early), "right") - 1
        usual_c = usual_temperatures(history, good)[lengths[at] - 1]
        apart_k = history.records["mean_temperature_c"][early] - usual_c
        effect.left[early] = np.nan_to_num(UNKNOWN_PER_KELVIN * np.abs(apart_k))
        if era.temperature is not None:
            late = slice(known_from + 1, era.segment.end)
            effect.factor[late] = warming(history.records[late], era.temperature)
            effect.per_kelvin[late] = era.temperature.taken_off
            apart_k = history.records["mean_temperature_c"][late] - era.temperature.reference_c
            effect.left[late] = np.nan_to_num(era.temperature.left * np.abs(apart_k))
    return effect
