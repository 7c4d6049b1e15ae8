"""The rows of the fleet page: every motor, the one that needs attention most first."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from pipeline.report.history import MotorHistory
from pipeline.report.sparkline import Sparkline, sparkline
from pipeline.report.words import SENSORS
from pipeline.trends.rows.motor_states import MotorState, urgency

Span = tuple[dt.date, dt.date]
RECENT_NIGHTS = 30


@dataclass(frozen=True, slots=True)
class FleetRow:
    """A motor on the fleet page."""

    state: MotorState  # as `motor-leakage status` prints it
    page: str
    motor_type: str
    newest_data: dt.datetime | None  # end of the newest data that were kept, UTC; None without any
    line: Sparkline | None  # its leakage at its own conditions; None where there is none
    reference: tuple[float, float, float] | None  # reference conditions: bar, °C, rpm
    # n_recent_good, n_recent: fitted nights, and nights with a row, among the fleet's newest 30.
    n_recent_good: int
    n_recent: int
    sensors: str  # zeros of the sensors at halts, in words; empty where unknown


def fleet_rows(
    motors: Sequence[MotorHistory],
    pages: Mapping[str, str],
    types: Mapping[str, str],
    states: Mapping[str, MotorState],
) -> list[FleetRow]:
    """All motors, the most urgent first."""
    span = fleet_span(motors)
    rows = [_row(one, pages[one.motor_id], types, states[one.motor_id], span) for one in motors]
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
    newest = motor.fits["window_end"].max()
    assert newest is None or isinstance(newest, dt.datetime)
    named = motor.fits["motor_type"].drop_nulls()
    recent = [
        status
        for night, status in zip(motor.nights, motor.statuses, strict=True)
        if span and night > span[1] - dt.timedelta(days=RECENT_NIGHTS)
    ]
    at = motor.fits.select(
        "reference_pressure_bar", "reference_temperature_c", "reference_speed_rpm"
    ).drop_nulls()
    return FleetRow(
        state=state,
        page=page,
        motor_type=types.get(motor.motor_id) or (named[-1] if len(named) else ""),
        newest_data=newest,
        line=sparkline(motor, span) if span else None,
        reference=at.row(-1) if at.height else None,
        n_recent_good=recent.count("ok"),
        n_recent=len(recent),
        sensors=SENSORS.get(state.sensor_health or "", ""),
    )
