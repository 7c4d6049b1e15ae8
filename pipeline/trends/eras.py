"""Quantities frozen with a motor's baseline: its own reference conditions and its model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from leakage.temperature_correction import TemperatureCorrection
from pipeline.trends.baseline_flow import baseline_model, deviation, log_ratio
from pipeline.trends.decisions import Decision
from pipeline.trends.history import History
from pipeline.trends.indicators import REFERENCE, Indicator, coefficients
from pipeline.trends.own_conditions import (
    OwnConditions,
    joined_own_leakage,
    known_at_reference,
    own_conditions,
    own_leakage,
    reference_leakage,
)
from pipeline.trends.segments import Segment, first_good, segments
from pipeline.trends.temperature import NIGHTS, correction_of, warming

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Era:
    """A stretch of nights between two events that begin everything anew.

    Attributes
    ----------
    segment
        Its nights.
    known_from
        Place of the first night on which it is known what is frozen; the end of the segment where
        it never is.
    own
        The motor's own reference conditions; None while they are not known.
    model
        θ of the first good nights together; None likewise.
    temperature
        Correction of loss factors for temperature, of the first good nights that tell it; None
        where they do not.
    temperature_from
        Place of the last of those nights.
    """

    segment: Segment
    known_from: int
    own: OwnConditions | None
    model: Array | None
    temperature: TemperatureCorrection | None = None
    temperature_from: int = 0


def eras_of(history: History, decisions: Sequence[Decision]) -> tuple[Era, ...]:
    """The eras of a motor; each is known from its first good nights, as a provisional baseline."""
    return tuple(_era(history, segment) for segment in segments(history, decisions))


def _era(history: History, segment: Segment) -> Era:
    first = first_good(history, segment)
    if not len(first):
        return Era(segment, segment.end, None, None)
    model = baseline_model(history, first)
    era = Era(segment, int(first[-1]), own_conditions(history, first), model)
    wider = segment.first + np.flatnonzero(history.fitted[segment.first : segment.end])[:NIGHTS]
    if model is None or len(wider) < NIGHTS:
        return era
    found = correction_of(history, wider, model)
    return replace(era, temperature=found, temperature_from=int(wider[-1]))


def indicators_of(history: History, eras: Sequence[Era]) -> dict[str, Indicator]:
    """All indicators of a motor that are watched, by name.

    Which there are depends on the motor's config alone: the rate of false alarms is shared by all
    of them, whatever the nights so far have shown.
    """
    warm = _warming(history, eras)
    found = [_at_one_temperature(history, reference_leakage(history), warm)]
    found.append(
        joined_own_leakage(
            history,
            [
                (
                    era.segment,
                    era.known_from,
                    None if era.own is None else own_leakage(history, era.segment, era.own, warm),
                )
                for era in eras
            ],
        )
    )
    found.append(
        deviation(
            history,
            [
                (
                    era.segment,
                    era.known_from,
                    None if era.model is None else log_ratio(history, era.segment, era.model, warm),
                )
                for era in eras
            ],
        )
    )
    found += [
        _at_one_temperature(history, one, warm) if one.path else one
        for one in coefficients(history)
    ]
    return {one.name: one for one in found}


def _warming(history: History, eras: Sequence[Era]) -> Array:
    """Loss factors of each night over those at its era's T₀, shape (n,).

    1 until that is known: what was told stays, and over the nights behind it, it is 1 on the mean.
    """
    factor = np.ones(len(history))
    for era in eras:
        here = slice(era.temperature_from + 1, era.segment.end)
        if era.temperature is not None:
            factor[here] = warming(history, here, era.temperature)
    return factor


def _at_one_temperature(history: History, own: Indicator, warm: Array) -> Indicator:
    """An indicator with the effect of temperature taken off what the gaps have of it."""
    if (warm == 1.0).all():
        return own
    known = known_at_reference(history) if own.name == REFERENCE else 0.0

    def corrected(figure: Array) -> Array:
        return known + (figure - known) / warm

    return replace(
        own, value=corrected(own.value), lower=corrected(own.lower), upper=corrected(own.upper)
    )
