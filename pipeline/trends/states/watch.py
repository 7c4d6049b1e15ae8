"""Every indicator of a motor against its own past: baselines and states, segment by segment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leakage.course.alarms import Levels, Limits
from leakage.course.baseline import Baseline, BaselineSettings
from leakage.course.cusum_limits import RATES
from leakage.course.monitoring import Monitoring, MonitorSettings, monitor
from pipeline.config import MotorSpec
from pipeline.trends.figures.indicators import REFERENCE, Indicator
from pipeline.trends.nights.history import History
from pipeline.trends.nights.segments import Segment, segment_at, segments

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Watched:
    """An indicator and what watching it has shown; `series` is what was watched, shape (n,).

    `found` holds its states over all segments; places are those of the history.
    """

    indicator: Indicator
    series: Array
    segments: tuple[Segment, ...]
    found: Monitoring
    settings: MonitorSettings

    def segment(self, place: int) -> Segment:
        """Segment of a night."""
        return segment_at(self.segments, place)

    def baseline(self, place: int) -> Baseline | None:
        """Baseline that serves a night; None before there is one."""
        return self.found.baseline_at(place) if self.found.has_baseline[place] else None


def watch(history: History, indicators: Mapping[str, Indicator]) -> dict[str, Watched]:
    """Watch every indicator of a motor."""
    watched = {}
    for name, indicator in indicators.items():
        parts = segments(history, name)
        settings = monitor_settings(history.spec, indicator, len(indicators))
        series, limited = indicator.watched, indicator.trusted
        allowance = np.broadcast_to(indicator.allowance, len(history))
        found = [
            monitor(history.numbers[here], series[here], settings, allowance[here], limited[here])
            for here in (part.here for part in parts)
        ]
        watched[name] = Watched(indicator, series, parts, _joined(parts, found), settings)
    return watched


def _joined(parts: Sequence[Segment], found: Sequence[Monitoring]) -> Monitoring:
    """States of all segments in one, its places those of the history."""
    pairs = list(zip(parts, found, strict=True))
    columns = ("deviation", "evidence", "severity", "limit_severity", "has_baseline", "since_good")
    return Monitoring(
        states=[state for one in found for state in one.states],
        baselines=tuple(baseline for one in found for baseline in one.baselines),
        served_from=tuple(part.first + place for part, one in pairs for place in one.served_from),
        onset=np.concatenate(
            [np.where(one.onset >= 0, part.first + one.onset, -1) for part, one in pairs]
        ),
        **{name: np.concatenate([getattr(one, name) for one in found]) for name in columns},
    )


def monitor_settings(spec: MotorSpec, indicator: Indicator, n_indicators: int) -> MonitorSettings:
    """Monitoring settings of an indicator; all of a motor's share its rate of false alarms."""
    trend, alarms = spec.settings.trend, spec.settings.alarms
    needed, of = alarms.on_nights
    limits = Limits()
    if indicator.name == REFERENCE:
        limits = Limits(
            spec.motor_type.limits.warning_l_per_min, spec.motor_type.limits.alarm_l_per_min
        )
    rate = alarms.false_alarms_per_year / n_indicators
    return MonitorSettings(
        # Beyond these no limit is calibrated.
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
