"""The rows of the fleet page: every motor, the one that needs attention most first."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.arrays import Array, keep_extremes
from pipeline.config import Fleet, MotorSpec
from pipeline.config.settings import ReferenceConditions
from pipeline.palette import COLOURS
from pipeline.report.tables import MotorHistory
from pipeline.report.words import figure
from pipeline.trends.motor_states import MotorState, urgency

Span = tuple[dt.date, dt.date]
RECENT_NIGHTS = 30
# Of the small picture of a motor's leakage.
WIDTH, HEIGHT, MARGIN = 120.0, 28.0, 2.5
POINTS = 90
# It is at least this share of the median high each way, so that noise looks like noise.
LEAST_REACH = 0.15
# Days without a value over which no line is drawn.
LONGEST_GAP = 7


@dataclass(frozen=True, slots=True)
class FleetRow:
    """A motor on the fleet page."""

    state: MotorState  # as `motor-leakage status` prints it
    motor_type: str
    newest_data: dt.datetime | None  # end of the newest data that were kept, UTC; None without any
    line: str  # its leakage at its own conditions as SVG; empty where there is none
    reference: tuple[float, float, float]  # reference conditions: bar, °C, rpm
    # n_recent_good, n_recent: fitted nights, and nights with a row, among its newest 30.
    n_recent_good: int
    n_recent: int


def fleet_rows(
    motors: Sequence[MotorHistory],
    specs: Mapping[str, MotorSpec],
    states: Sequence[MotorState],
    reference: ReferenceConditions,
) -> list[FleetRow]:
    """All motors, the most urgent first; those that the config has no more have no spec."""
    span = fleet_span(motors)
    rows = [
        _row(motor, specs.get(motor.motor_id), state, span, reference)
        for motor, state in zip(motors, states, strict=True)
    ]
    return sorted(rows, key=lambda row: urgency(row.state))


def fleet_span(motors: Sequence[MotorHistory]) -> Span | None:
    """The first and the newest night of all motors; None where there is none."""
    nights = [night for motor in motors for night in (*motor.nights[:1], *motor.nights[-1:])]
    return (min(nights), max(nights)) if nights else None


def _row(
    motor: MotorHistory,
    spec: MotorSpec | None,
    state: MotorState,
    span: Span | None,
    reference: ReferenceConditions,
) -> FleetRow:
    newest = motor.rows["last_sample"].max()
    assert newest is None or isinstance(newest, dt.datetime)
    first = motor.nights[-1] - dt.timedelta(days=RECENT_NIGHTS) if motor.nights else dt.date.max
    recent = motor.rows.filter(motor.rows["night"] > first)["status"].to_list()
    at = spec.settings.reference if spec else reference
    return FleetRow(
        state=state,
        motor_type=spec.file.motor_type if spec else str(state.row["motor_type"] or ""),
        newest_data=newest,
        line=sparkline(motor, span) if span else "",
        reference=(at.pressure_bar, at.temperature_c, at.speed_rpm),
        n_recent_good=recent.count("ok"),
        n_recent=len(recent),
    )


def overlay(fleet: Fleet, motors: Sequence[MotorHistory]) -> dict[str, Any]:
    """Return the leakage of all motors against their baselines, % by night, for one chart."""
    nights = sorted({night for motor in motors for night in motor.nights})
    named = [{"name": motor.motor_id, "y": _changes(motor, nights)} for motor in motors]
    level = fleet.settings.alarms.alarm_percent
    return {"nights": list(map(str, nights)), "motors": named, "alarm": level, "colours": COLOURS}


def _changes(motor: MotorHistory, nights: Sequence[dt.date]) -> list[float | None]:
    known = dict(motor.rows.select("night", "leakage_change_percent").iter_rows())
    changes = (known.get(night) for night in nights)
    return [None if change is None else round(change, 1) for change in changes]


def sparkline(motor: MotorHistory, span: Span) -> str:
    """A motor's leakage at its own conditions as SVG, broken over long gaps; empty without a value.

    `span` are the nights at the edges of the picture, the same for all motors of a fleet.
    """
    leakage, _, _ = motor.leakage
    known = np.flatnonzero(np.isfinite(leakage))
    if not len(known):
        return ""
    value = leakage[known]
    first, newest = (np.datetime64(edge) for edge in span)
    days = (motor.stamps[known] - first).astype(float)
    places = keep_extremes([value], POINTS)
    median = float(np.median(value))
    reach = max(float(np.abs(value - median).max()), LEAST_REACH * abs(median), 1e-9)

    def height(flow: Array) -> Array:
        inside: Array = np.clip((flow - median) / reach, -1.0, 1.0)
        return HEIGHT / 2 - inside * (HEIGHT / 2 - MARGIN)

    length = max(float((newest - first).astype(float)), 1.0)
    x = MARGIN + days[places] / length * (WIDTH - 2 * MARGIN)
    y = height(value[places])
    longest = max(LONGEST_GAP, 3 * length / POINTS)
    letters = np.where(np.diff(days[places], prepend=-np.inf) > longest, "M", "L")
    level = motor.level[np.isfinite(motor.level)]
    line = "".join(f"{letter}{a:.1f} {b:.1f}" for letter, a, b in zip(letters, x, y, strict=True))
    baseline = f"M{MARGIN:g} {height(level)[-1]:.1f}H{WIDTH - MARGIN:g}" if len(level) else ""
    text = f"Leakage {figure(value.min())} to {figure(value.max())} l/min"
    return (
        f'<svg class="sparkline" viewBox="0 0 {WIDTH:g} {HEIGHT:g}" role="img" aria-label="{text}">'
        f'<path class="level" d="{baseline}"/><path d="{line}"/>'
        f'<circle cx="{x[-1]:.1f}" cy="{y[-1]:.1f}" r="2.2"/></svg>'
    )
