"""What is frozen with a motor's baseline: its own reference conditions, and its model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.trends.baseline_flow import baseline_model, deviation, log_ratio
from pipeline.trends.decisions import Decision
from pipeline.trends.history import History
from pipeline.trends.indicators import Indicator, coefficients
from pipeline.trends.own_conditions import (
    OwnConditions,
    joined_own_leakage,
    own_conditions,
    own_leakage,
    reference_leakage,
)
from pipeline.trends.segments import Segment, segments

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
    """

    segment: Segment
    known_from: int
    own: OwnConditions | None
    model: Array | None


def eras_of(history: History, decisions: Sequence[Decision]) -> tuple[Era, ...]:
    """The eras of a motor; each is known from its first good nights, as a provisional baseline."""
    return tuple(_era(history, segment) for segment in segments(history, decisions))


def _era(history: History, segment: Segment) -> Era:
    needed = history.spec.settings.trend.provisional_nights
    places = segment.first + np.flatnonzero(history.fitted[segment.first : segment.end])
    if len(places) < needed:
        return Era(segment, segment.end, None, None)
    first = places[:needed]
    return Era(
        segment,
        int(first[-1]),
        own_conditions(history, first),
        baseline_model(history, first),
    )


def indicators_of(history: History, eras: Sequence[Era]) -> dict[str, Indicator]:
    """All indicators of a motor that are watched, by name.

    Which there are depends on the motor's config alone: the rate of false alarms is shared by all
    of them, whatever the nights so far have shown.
    """
    found = [reference_leakage(history)]
    found.append(
        joined_own_leakage(
            history,
            [
                (
                    era.segment,
                    era.known_from,
                    None if era.own is None else own_leakage(history, era.segment, era.own),
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
                    None if era.model is None else log_ratio(history, era.segment, era.model),
                )
                for era in eras
            ],
        )
    )
    return {one.name: one for one in (*found, *coefficients(history))}
