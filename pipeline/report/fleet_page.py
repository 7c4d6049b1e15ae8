"""The rows of the fleet page: every motor, the one that needs attention most first."""

from __future__ import annotations

import datetime as dt
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.report.history import COMPARABLE, OWN_REFERENCE, REFERENCE, Course, MotorHistory
from pipeline.report.sparkline import STEP, Sparkline, sparkline, strip
from pipeline.report.words import SENSORS, STATUSES
from pipeline.trends.motor_states import MotorState, urgency

Span = tuple[dt.date, dt.date]
ONE_DAY = dt.timedelta(days=1)
RECENT_NIGHTS = 30


@dataclass(frozen=True, slots=True)
class FleetRow:
    """A motor on the fleet page.

    Attributes
    ----------
    state
        As `motor-leakage status` prints it.
    leakage_kind
        Conditions of the leakage that is drawn: `reference`, `frozen` or `own`.
    validation_fit, previous_fit
        Of the last good night, percent.
    kept_percent
        Median share of samples kept in the recent fitted nights.
    strip, strip_words
        Outcomes of the recent nights of the fleet's calendar, as pictures and as words.
    sensors
        Zeros of the sensors at halts, in words; empty where unknown.
    """

    state: MotorState
    page: str
    motor_type: str
    leakage_kind: str
    line: Sparkline | None
    validation_fit: float | None
    previous_fit: float | None
    kept_percent: float | None
    n_recent_good: int
    n_recent: int
    strip: Mapping[str, str]
    strip_width: int
    strip_words: str
    sensors: str


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
    kind, course, baseline = _drawn(motor, state)
    good = motor.fits.filter(status="ok")
    last = good.row(-1, named=True) if good.height else {}
    days = np.array([night.toordinal() for night in motor.nights], dtype=np.int64)
    recent = _calendar(motor, span[1] if span else None)
    known = [status for status in recent if status is not None]
    ends = (span[0].toordinal(), span[1].toordinal()) if span else None
    kept = good["kept_share"].tail(RECENT_NIGHTS).median() if good.height else None
    return FleetRow(
        state=state,
        page=page,
        motor_type=_motor_type(motor, types),
        leakage_kind=kind,
        line=sparkline(days, course, ends, baseline) if ends else None,
        validation_fit=last.get("validation_fit_percent"),
        previous_fit=last.get("previous_model_fit_percent"),
        kept_percent=100.0 * kept if isinstance(kept, float) else None,
        n_recent_good=known.count("ok"),
        n_recent=len(known),
        strip=strip(recent),
        strip_width=STEP * RECENT_NIGHTS,
        strip_words=_in_words(known),
        sensors=SENSORS.get(state.sensor_health or "", ""),
    )


def _drawn(motor: MotorHistory, state: MotorState) -> tuple[str, Course, float | None]:
    """Kind and course of the leakage to draw, and its baseline: that of the state if it has one."""
    kinds = {REFERENCE: "reference", OWN_REFERENCE: "frozen", COMPARABLE: "comparable"}
    kind = kinds.get(state.leakage_indicator or "") or motor.leakage_kind
    course = motor.leakages.get(kind)
    # A figure of the filter has no course of its own: what the fits know best is drawn.
    drawn = kind if course is not None and course.is_known.any() else motor.leakage_kind
    baselines = next((motor.baselines.get(name) for name in kinds if kinds[name] == drawn), None)
    return kind, motor.leakages[drawn], baselines[-1][1] if baselines else None


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
    """Number of nights by outcome.

    Examples
    --------
    >>> _in_words(["ok", "ok", "failed"])
    '2 fitted, 1 failed'
    """
    counts = Counter(STATUSES.get(status, status) for status in statuses)
    return ", ".join(f"{n} {words}" for words, n in counts.most_common()) or "none"
