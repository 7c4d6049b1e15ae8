"""The rows of the fleet page: every motor, the one that needs attention most first."""

from __future__ import annotations

import datetime as dt
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.report.attention import (
    GOOD,
    RECENT_NIGHTS,
    STALE_AFTER,
    Attention,
    Changes,
    attention,
    changes,
)
from pipeline.report.history import LAST_NIGHTS, Course, MotorHistory
from pipeline.report.sparkline import STEP, Sparkline, sparkline, strip
from pipeline.report.trends import Standing
from pipeline.report.words import SENSORS, STATUSES, plain

Span = tuple[dt.date, dt.date]
ONE_DAY = dt.timedelta(days=1)


@dataclass(frozen=True, slots=True)
class FleetRow:
    """A motor on the fleet page.

    Attributes
    ----------
    attention
        How it stands, and why.
    leakage_kind
        Conditions of the leakage: `reference`, `frozen` or `own`; see `MotorHistory.leakage`.
    leakage
        Newest value with its interval, l/min; None where nothing says what it is now.
    leakage_night
        Last night with a value; None where there never was one.
    leakage_change, gap_change
        Percent from the baseline, or since the first good nights where there is none; None where
        that cannot be told.
    gap_path
        Path of the gap that has changed most.
    last_good
        Newest night with a fit.
    sensors
        What the readings at halts say of the sensors' zeros, in words; empty where unknown.
    kept_percent
        Median share of samples kept in the recent fitted nights.
    strip, strip_words
        What came of the recent nights of the fleet's calendar, as pictures and as words.
    """

    motor_id: str
    page: str
    motor_type: str
    attention: Attention
    leakage_kind: str
    leakage: tuple[float, float | None, float | None] | None
    leakage_night: dt.date | None
    line: Sparkline | None
    leakage_change: float | None
    gap_change: float | None
    gap_path: str
    validation_fit: float | None
    previous_fit: float | None
    kept_percent: float | None
    n_recent_good: int
    n_recent: int
    strip: Mapping[str, str]
    strip_width: int
    strip_words: str
    last_good: dt.date | None
    sensors: str


def fleet_rows(
    motors: Sequence[MotorHistory],
    pages: Mapping[str, str],
    types: Mapping[str, str],
    standings: Mapping[str, Standing],
) -> list[FleetRow]:
    """All motors, the most urgent first."""
    span = fleet_span(motors)
    rows = [
        _row(motor, pages[motor.motor_id], types, standings.get(motor.motor_id), span)
        for motor in motors
    ]
    return sorted(rows, key=lambda row: (*row.attention.rank, row.motor_id))


def fleet_span(motors: Iterable[MotorHistory]) -> Span | None:
    """The first and the newest night of all motors; None where there is none."""
    ends = [(motor.nights[0], motor.nights[-1]) for motor in motors if motor.nights]
    return (min(first for first, _ in ends), max(last for _, last in ends)) if ends else None


def _row(
    motor: MotorHistory,
    page: str,
    types: Mapping[str, str],
    standing: Standing | None,
    span: Span | None,
) -> FleetRow:
    newest = span[1] if span else None
    changed = changes(motor)
    kind, course, is_now = _leakage(motor, standing, newest)
    good = motor.fits.filter(status=GOOD)
    last = good.row(-1, named=True) if good.height else {}
    known = np.flatnonzero(course.is_known)
    days = np.array([night.toordinal() for night in motor.nights], dtype=np.int64)
    recent = _calendar(motor, newest)
    told = [status for status in recent if status is not None]
    path, gap = _gap_change(motor, changed, standing, newest)
    kept = good["kept_share"].tail(RECENT_NIGHTS).median() if good.height else None
    return FleetRow(
        motor_id=motor.motor_id,
        page=page,
        motor_type=_motor_type(motor, types),
        attention=attention(motor, changed, standing, newest),
        leakage_kind=kind,
        leakage=_newest(course, known) if is_now else None,
        leakage_night=motor.nights[known[-1]] if len(known) else None,
        line=sparkline(days, course, *(night.toordinal() for night in span)) if span else None,
        leakage_change=_leakage_change(changed, standing) if is_now else None,
        gap_change=gap,
        gap_path=plain(path),
        validation_fit=last.get("validation_fit_percent"),
        previous_fit=last.get("previous_model_fit_percent"),
        kept_percent=100.0 * kept if isinstance(kept, float) else None,
        n_recent_good=told.count(GOOD),
        n_recent=len(told),
        strip=strip(recent),
        strip_width=STEP * RECENT_NIGHTS,
        strip_words=_in_words(told),
        last_good=last.get("night"),
        sensors=SENSORS.get(standing.sensor_health, "") if standing else "",
    )


def _leakage(
    motor: MotorHistory, standing: Standing | None, newest: dt.date | None
) -> tuple[str, Course, bool]:
    """The leakage that stands for a motor, its kind, and whether it is known now."""
    courses = {"reference": motor.reference, "frozen": motor.frozen}
    for kind, course in courses.items():
        if _is_known_now(motor, course, standing, newest):
            return kind, course, True
    kind, course = motor.leakage
    return kind, course, kind == "own" and _is_known_now(motor, course, None, newest)


def _is_known_now(
    motor: MotorHistory, course: Course, standing: Standing | None, newest: dt.date | None
) -> bool:
    """Whether a leakage has a figure that says what it is now: as the trends say, if there are."""
    known = np.flatnonzero(course.is_known)
    if not len(known):
        return False
    night = motor.nights[known[-1]]
    if standing is not None and standing.leakage_night is not None:
        return standing.leakage_is_known and bool(night >= standing.leakage_night)
    return _is_recent(night, newest)


def _is_recent(night: dt.date, newest: dt.date | None) -> bool:
    """Whether a night is one of the fleet's last, so that its figures are of now."""
    return (newest or night) - night <= STALE_AFTER


def _leakage_change(changed: Changes, standing: Standing | None) -> float | None:
    if standing is not None and standing.deviation_percent is not None:
        return standing.deviation_percent
    return changed.leakage.percent if changed.leakage else None


def _gap_change(
    motor: MotorHistory, changed: Changes, standing: Standing | None, newest: dt.date | None
) -> tuple[str, float | None]:
    """The path whose gap has changed most, and how much in percent, by nights that tell of now."""
    if not motor.baselines:
        return (changed.gap[0], changed.gap[1].gap_percent) if changed.gap else ("", None)
    begin = (standing.change_start if standing else None) or dt.date.min
    medians = {}
    for name, course in motor.gap_changes().items():
        known = [place for place in np.flatnonzero(course.is_known) if motor.nights[place] >= begin]
        is_told = bool(motor.baselines.get(f"K_{name}")) and bool(known)
        if is_told and _is_recent(motor.nights[known[-1]], newest):
            medians[name] = float(np.median(course.value[known[-LAST_NIGHTS:]]))
    path = max(medians, key=lambda name: abs(medians[name]), default="")
    return path, medians.get(path)


def _motor_type(motor: MotorHistory, types: Mapping[str, str]) -> str:
    named = motor.fits["motor_type"].drop_nulls()
    return types.get(motor.motor_id) or (named[-1] if len(named) else "")


def _newest(
    course: Course, known: NDArray[np.int64]
) -> tuple[float, float | None, float | None] | None:
    if not len(known):
        return None
    place = known[-1]
    lower, upper = (
        float(end[place]) if np.isfinite(end[place]) else None
        for end in (course.lower, course.upper)
    )
    return float(course.value[place]), lower, upper


def _calendar(motor: MotorHistory, newest: dt.date | None) -> list[str | None]:
    """What came of each of the fleet's recent nights; None where the motor has no row."""
    if newest is None:
        return []
    by_night = dict(zip(motor.nights, motor.statuses, strict=True))
    first = newest - (RECENT_NIGHTS - 1) * ONE_DAY
    return [by_night.get(first + place * ONE_DAY) for place in range(RECENT_NIGHTS)]


def _in_words(statuses: list[str]) -> str:
    """How many nights came to what.

    Examples
    --------
    >>> _in_words(["ok", "ok", "failed"])
    '2 fitted, 1 failed'
    """
    counts = Counter(STATUSES.get(status, status) for status in statuses)
    return ", ".join(f"{n} {words}" for words, n in counts.most_common()) or "none"
