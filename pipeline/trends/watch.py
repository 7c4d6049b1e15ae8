"""Every indicator of a motor against its own past: baseline, states, and the nights behind them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leakage.alarms import Levels, Limits
from leakage.baseline import BaselineSettings
from leakage.cusum_limits import RATES
from leakage.monitoring import Monitoring, MonitorSettings, monitor
from pipeline.config import MotorSpec
from pipeline.decisions import Decision
from pipeline.trends.history import History
from pipeline.trends.indicators import (
    DEVIATION,
    OWN_REFERENCE,
    REFERENCE,
    Indicator,
    OwnConditions,
    at_conditions,
    baseline_model,
    coefficients,
    deviation,
    log_ratio,
    own_conditions,
    reference_leakage,
    status_gates,
)
from pipeline.trends.segments import Segment, segments

Array = NDArray[np.float64]
Nights = NDArray[np.int64]

# Indicators around 0 are watched as ratios around 1.
RATIOS = (DEVIATION,)


@dataclass(frozen=True, slots=True)
class Era:
    """What is frozen with a baseline, for the indicators that are relative to one.

    Attributes
    ----------
    segment
        Nights that it holds for.
    known_from
        Place of the first night on which it is known; the end of the segment where it never is.
    own
        The motor's own reference conditions; None while they are not known.
    """

    segment: Segment
    known_from: int
    own: OwnConditions | None


@dataclass(frozen=True, slots=True)
class Watched:
    """An indicator and what watching it has shown, segment by segment.

    Attributes
    ----------
    indicator
        Its figures over all nights.
    series
        What was watched, shape (n,): the values, or ratios around 1.
    segments, monitoring
        Nights by baseline, and the states within each.
    settings
        How it was watched.
    """

    indicator: Indicator
    series: Array
    segments: tuple[Segment, ...]
    monitoring: tuple[Monitoring, ...]
    settings: MonitorSettings


@dataclass(frozen=True, slots=True)
class MotorWatch:
    """A motor's indicators.

    Attributes
    ----------
    spec, history
        The motor and its nights.
    numbers
        Number of each night, days since the first, shape (n,).
    eras
        What is frozen with each baseline.
    watched
        By indicator.
    """

    spec: MotorSpec
    history: History
    numbers: Nights
    eras: tuple[Era, ...]
    watched: Mapping[str, Watched]


def night_numbers(history: History) -> Nights:
    """Days since the first night, shape (n,)."""
    first = history.nights[0]
    return np.array([(night - first).days for night in history.nights], dtype=np.int64)


def motor_indicators(
    spec: MotorSpec, history: History, decisions: Sequence[Decision]
) -> tuple[dict[str, Indicator], tuple[Era, ...]]:
    """The indicators of a motor's nights, and what is frozen with each baseline."""
    found = {REFERENCE: reference_leakage(history)}
    found |= {one.name: one for one in coefficients(history)}
    eras, own, relative = [], [], []
    for segment in segments(spec, history, decisions, ""):
        era, model = _era(spec, history, segment)
        eras.append(era)
        own.append(at_conditions(spec, history, era.own) if era.own else None)
        ratio = np.full(len(history.nights), np.nan) if model is None else log_ratio(history, model)
        relative.append(deviation(history, DEVIATION, ratio, "no baseline yet"))
    found[OWN_REFERENCE] = _joined(history, OWN_REFERENCE, "l/min", own, eras)
    found[DEVIATION] = _joined(history, DEVIATION, "1", relative, eras)
    return found, tuple(eras)


def _era(spec: MotorSpec, history: History, segment: Segment) -> tuple[Era, Array | None]:
    """The own conditions and the model of the first good nights of a segment."""
    needed = spec.settings.trend.provisional_nights
    fitted = np.array([not reason for reason in status_gates(history)])
    fitted[: segment.first] = False
    fitted[segment.end :] = False
    places = np.flatnonzero(fitted)
    if len(places) < needed:
        return Era(segment, segment.end, None), None
    chosen = np.zeros(len(fitted), dtype=np.bool_)
    chosen[places[:needed]] = True
    era = Era(segment, int(places[needed - 1]), own_conditions(history, chosen))
    return era, baseline_model(spec, history, chosen)


def _joined(
    history: History,
    name: str,
    unit: str,
    parts: Sequence[Indicator | None],
    eras: Sequence[Era],
) -> Indicator:
    """One indicator from those of all eras."""
    n = len(history.nights)
    value, lower, upper = (np.full(n, np.nan) for _ in range(3))
    outside = np.zeros(n, dtype=np.bool_)
    statuses = status_gates(history)
    gated = list(statuses)
    floor = 0.01
    for part, era in zip(parts, eras, strict=True):
        here = slice(era.segment.first, era.segment.end)
        if part is None:
            for place in range(here.start, here.stop):
                gated[place] = statuses[place] or "no baseline yet"
            continue
        floor = part.floor
        value[here], lower[here], upper[here] = part.value[here], part.lower[here], part.upper[here]
        outside[here] = part.outside[here]
        gated[here] = part.gated[here]
    return Indicator(
        name,
        unit,
        value,
        lower,
        upper,
        tuple(gated),
        floor,
        outside,
        np.ones(n, dtype=np.int64),
    )


def watch(
    spec: MotorSpec,
    history: History,
    decisions: Sequence[Decision],
    indicators: Mapping[str, Indicator],
    eras: tuple[Era, ...],
    others: Mapping[str, Array],
) -> MotorWatch:
    """Watch every indicator of a motor.

    Parameters
    ----------
    spec, history, decisions
        The motor, its nights, and what people said of it.
    indicators, eras
        From :func:`motor_indicators`.
    others
        By indicator, the common change of the other motors of the oil circuit, shape (n,); absent
        for a motor on its own.
    """
    numbers = night_numbers(history)
    watched = {}
    for name, indicator in indicators.items():
        series = indicator.value + 1.0 if name in RATIOS else indicator.value
        parts = segments(spec, history, decisions, name)
        settings = monitor_settings(spec, indicator, len(indicators))
        watched[name] = Watched(
            indicator,
            series,
            parts,
            tuple(
                monitor(
                    numbers[one.first : one.end],
                    series[one.first : one.end],
                    settings,
                    others[name][one.first : one.end] if name in others else None,
                )
                for one in parts
            ),
            settings,
        )
    return MotorWatch(spec, history, numbers, eras, watched)


def monitor_settings(spec: MotorSpec, indicator: Indicator, n_indicators: int) -> MonitorSettings:
    """How an indicator is watched: the motor's rate of false alarms is shared by all of them."""
    trend, alarms = spec.settings.trend, spec.settings.alarms
    needed, of = alarms.on_nights
    limits = Limits()
    if indicator.name == REFERENCE:
        limits = Limits(
            spec.motor_type.limits.warning_l_per_min, spec.motor_type.limits.alarm_l_per_min
        )
    rate = alarms.false_alarms_per_year / n_indicators
    return MonitorSettings(
        false_alarms_per_year=min(max(rate, RATES[0]), RATES[-1]),
        baseline=BaselineSettings(
            nights=trend.baseline_nights,
            provisional_nights=trend.provisional_nights,
            relative_floor=indicator.floor,
        ),
        levels=Levels(
            warning=alarms.warning_percent / 100,
            alarm=alarms.alarm_percent / 100,
            deadband=alarms.deadband_percent / 100,
            on_nights=needed,
            of_nights=of,
            off_nights=alarms.off_nights,
        ),
        limits=limits,
        stale_nights=alarms.stale_after_nights,
    )
