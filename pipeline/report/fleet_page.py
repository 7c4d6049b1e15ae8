"""The rows of the fleet page: every motor, the one that needs attention most first."""

from __future__ import annotations

import datetime as dt
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.report.history import Course, MotorHistory
from pipeline.report.sparkline import STEP, Sparkline, sparkline, strip
from pipeline.report.words import SENSORS, STATUSES
from pipeline.trends.rows.motor_states import MotorState, urgency

Span = tuple[dt.date, dt.date]
ONE_DAY = dt.timedelta(days=1)
RECENT_NIGHTS = 30


@dataclass(frozen=True, slots=True)
class FleetRow:
    """A motor on the fleet page."""

    state: MotorState  # as `motor-leakage status` prints it
    page: str
    motor_type: str
    flow_now: float | None  # newest mean drain flow as measured, l/min; None without one
    newest_data: dt.datetime | None  # end of the newest data that were kept, UTC; None without any
    line: Sparkline | None  # its leakage; the drain flow as measured where `is_flow`
    is_flow: bool
    validation_fit: float | None  # of the last good night, percent
    kept_percent: float | None  # median share of samples kept in the recent fitted nights
    n_recent_good: int
    n_recent: int
    # strip, strip_words: outcomes of the recent nights of the fleet's calendar, drawn and in words.
    strip: Mapping[str, str]
    strip_width: int
    strip_words: str
    sensors: str  # zeros of the sensors at halts, in words; empty where unknown


def fleet_rows(
    motors: Sequence[MotorHistory],
    pages: Mapping[str, str],
    types: Mapping[str, str],
    states: Mapping[str, MotorState],
) -> list[FleetRow]:
    """All motors, the most urgent first."""
    span = fleet_span(motors)
    rows = [
        _row(motor, pages[motor.motor_id], types, states[motor.motor_id], span) for motor in motors
    ]
    return sorted(rows, key=lambda row: urgency(row.state))


def fleet_span(motors: Iterable[MotorHistory]) -> Span | None:
    """The first and the newest night of all motors; None where there is none."""
    ends = [(motor.nights[0], motor.nights[-1]) for motor in motors if motor.nights]
    return (min(first for first, _ in ends), max(last for _, last in ends)) if ends else None


def _row(
    motor: MotorHistory,
    page: str,
    types: Mapping[str, str],
    state: MotorState,
    span: Span | None,
) -> FleetRow:
    is_flow = not motor.leakage.is_known.any()
    newest = motor.fits["window_end"].max()
    assert newest is None or isinstance(newest, dt.datetime)
    good = motor.fits.filter(status="ok")
    last = good.row(-1, named=True) if good.height else {}
    days = np.array([night.toordinal() for night in motor.nights], dtype=np.int64)
    recent = _calendar(motor, span[1] if span else None)
    there = [status for status in recent if status is not None]
    ends = (span[0].toordinal(), span[1].toordinal()) if span else None
    kept = good["kept_share"].tail(RECENT_NIGHTS).median() if good.height else None
    return FleetRow(
        state=state,
        page=page,
        motor_type=_motor_type(motor, types),
        flow_now=_newest(motor.flow),
        newest_data=newest,
        line=sparkline(days, motor.flow if is_flow else motor.leakage, ends, _level(motor))
        if ends
        else None,
        is_flow=is_flow,
        validation_fit=last.get("validation_fit_percent"),
        kept_percent=100.0 * kept if isinstance(kept, float) else None,
        n_recent_good=there.count("ok"),
        n_recent=len(there),
        strip=strip(recent),
        strip_width=STEP * RECENT_NIGHTS,
        strip_words=_in_words(there),
        sensors=SENSORS.get(state.sensor_health or "", ""),
    )


def _level(motor: MotorHistory) -> float | None:
    """Leakage of the newest baseline at the motor's own conditions, l/min; None without one."""
    known = motor.level[np.isfinite(motor.level)]
    return float(known[-1]) if len(known) else None


def _newest(course: Course) -> float | None:
    known = course.value[course.is_known]
    return float(known[-1]) if len(known) else None


def _motor_type(motor: MotorHistory, types: Mapping[str, str]) -> str:
    named = motor.fits["motor_type"].drop_nulls()
    return types.get(motor.motor_id) or (named[-1] if len(named) else "")


def _calendar(motor: MotorHistory, newest: dt.date | None) -> list[str | None]:
    """Outcome of each of the fleet's recent nights; None where the motor has no row."""
    if newest is None:
        return []
    by_night = dict(zip(motor.nights, motor.statuses, strict=True))
    first = newest - (RECENT_NIGHTS - 1) * ONE_DAY
    return [by_night.get(first + place * ONE_DAY) for place in range(RECENT_NIGHTS)]


def _in_words(statuses: list[str]) -> str:
    """Number of nights by outcome."""
    counts = Counter(STATUSES.get(status, status) for status in statuses)
    return ", ".join(f"{n} {words}" for words, n in counts.most_common()) or "none"
