"""The pump rig: what the program finds on its records, asked in six questions.

`python -m validation pump_rig FOLDER` reads the records of FOLDER, fits cuts of them with the
program's own command, and writes the tables and pictures of docs/real_machines.md.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from leakage import Motor, OperatingConditions, leakage_l_per_min
from pipeline.config import load_fleet
from pipeline.notebook import Tables
from validation.fleet import DAY, FIRST, add_motor, fitted, label, new_fleet
from validation.record import FLOW, PRESSURE, TEMPERATURE, TIME, Record, read_records, windows

BLOCK = dt.timedelta(minutes=10)
SHORT = dt.timedelta(minutes=20)
STEP = dt.timedelta(minutes=5)
METER_READS_FROM = 1.7  # l/min, as in the config
SPEED_RPM = 1485.0
RING_BAR = 120.0  # deformation constant of a piston ring that leaks below some 100 bar
VALUE = "reference_leakage_l_per_min"
RAISED = ("warning", "alarm")


@dataclass(frozen=True, slots=True)
class Plan:
    """Nights cut from a record: so many, so long, wear after so many."""

    nights: int = 90
    length: dt.timedelta = dt.timedelta(minutes=60)
    healthy: int = 60


Course = Callable[[int, Plan], float]


@dataclass(frozen=True, slots=True)
class Table:
    """One answer: a heading, a table, and rows as text."""

    name: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]


def judge(folder: Path, work: Path, plan: Plan = Plan()) -> list[Table]:  # noqa: B008
    """Fit cuts of every record of a folder, and answer the questions of the page."""
    records = read_records(folder)
    fleet = new_fleet("pump_rig", work)
    for record in records:
        _add_cuts(fleet, record)
    first = fitted(fleet)
    tables = [
        _records(records),
        _held_out(first, records),
        _stability(first, records),
        _coverage(first, records),
    ]
    worn = new_fleet("pump_rig", work / "nights")
    for record in records:
        coefficients = _coefficients(first, f"{record.name}-held-out-warm")
        _add_nights(worn, record, coefficients, plan)
    return [*tables, _alarms(fitted(worn), records, plan)]


VARIANTS = {
    "held-out-all": ("every sample", "[channels.leakage_flow]\nsource = 'Flow - leak line'\n"
                     "unit = 'l/min'\nvalid_range = [0.0, 100.0]\n"),
    "held-out": ("meter reads", ""),
    "held-out-warm": ("meter reads, 48 °C and above", ""),
}


def _add_cuts(fleet: Path, record: Record) -> None:
    """Motors for held-out blocks, quarters of the warm part, and short windows."""
    warm = record.warm()
    for variant, (_, channel) in VARIANTS.items():
        rows = warm if variant.endswith("warm") else record.rows
        if not rows.is_empty():
            add_motor(fleet, f"{record.name}-{variant}", [rows], channel + _periods(rows))
    if not warm.is_empty():
        quarter = (warm[TIME][-1] - warm[TIME][0]) / 4
        add_motor(fleet, f"{record.name}-quarters", windows(warm, quarter, quarter))
        add_motor(fleet, f"{record.name}-windows", windows(warm, SHORT, STEP))


def _periods(rows: pl.DataFrame) -> str:
    """Alternate blocks: the first, third, … train, the others validate."""
    count = (rows[TIME][-1] - rows[TIME][0]) // BLOCK + 1
    pairs = [f"[{FIRST + i * BLOCK:%FT%TZ}, {FIRST + (i + 1) * BLOCK:%FT%TZ}]" for i in range(count)]
    training, validation = ", ".join(pairs[::2]), ", ".join(pairs[1::2])
    return f"[periods]\ntraining = [{training}]\nvalidation = [{validation}]\n"


def _records(records: Sequence[Record]) -> Table:
    rows = [
        [
            one.name,
            one.state,
            f"{one.rows.height}",
            f"{one.rows[PRESSURE].quantile(0.05):.0f} to {one.rows[PRESSURE].quantile(0.95):.0f}",
            f"{one.rows[TEMPERATURE].quantile(0.05):.0f} to {one.rows[TEMPERATURE].quantile(0.95):.0f}",
            f"{100 * (one.rows[FLOW] < METER_READS_FROM).mean():.0f} %",
            "; ".join(one.notes) or "–",
        ]
        for one in records
    ]
    return Table(
        "records",
        ("record", "state", "samples", "bar (5–95 %)", "°C (5–95 %)", "meter at its floor", "notes"),
        rows,
    )


def _held_out(tables: Tables, records: Sequence[Record]) -> Table:
    fits = {row["motor_id"]: row for row in tables.fits().collect().to_dicts()}
    rows = [
        [
            record.name,
            words,
            f"{row['n_training']}",
            f"{row['training_fit_percent']:.1f} %",
            f"{row['n_validation']}",
            f"{row['validation_fit_percent']:.1f} %",
            f"{row['validation_rmse_l_per_min']:.3f}",
        ]
        for record in records
        for variant, (words, _) in VARIANTS.items()
        if (row := fits.get(f"{record.name}-{variant}"))
    ]
    header = ("record", "samples", "training", "fit", "held out", "fit", "RMSE l/min")
    return Table("held_out", header, rows)


def _stability(tables: Tables, records: Sequence[Record]) -> Table:
    """K and the reference leakage by quarter of the warm part, and by temperature."""
    rows = []
    for record in records:
        quarters = _of(tables, f"{record.name}-quarters")
        rows += [
            [
                record.name,
                str(number),
                f"{row['own_temperature_c']:.1f}",
                f"{row['coefficients'][0] * 1e14:.2f}",
                f"{row['coefficients'][1]:.2f}",
                *_leakage(row),
                row["model_verdict"] or "–",
            ]
            for number, row in enumerate(quarters, start=1)
            if row["reference_leakage_l_per_min"] is not None
        ]
    header = ("record", "quarter", "°C", "K 1e-14 m³", "C l/min", "leakage", "samples", "total", "model")
    return Table("stability", header, rows)


def _of(tables: Tables, motor_id: str) -> list[dict[str, Any]]:
    return tables.fits().filter(pl.col("motor_id") == motor_id).collect().to_dicts()


def _leakage(row: dict[str, Any]) -> list[str]:
    """Reference leakage, and its ± from the samples and in total."""
    names = ("l_per_min", "statistical_half_width", "total_half_width")
    return [f"{row[f'reference_leakage_{name}']:.3f}" for name in names]


def _coverage(tables: Tables, records: Sequence[Record]) -> Table:
    """Windows whose interval holds the leakage of the window that begins where they end."""
    rows = []
    for record in records:
        found = {row["night"]: row for row in _of(tables, f"{record.name}-windows")}
        apart = SHORT // STEP * DAY
        pairs = [(row, found[night + apart]) for night, row in found.items() if night + apart in found]
        pairs = [pair for pair in pairs if None not in (pair[0][VALUE], pair[1][VALUE])]
        for words, kept in (
            ("overlapping, every 5 min", pairs),
            ("one after the other", pairs[:: SHORT // STEP]),
        ):
            changes = [now[VALUE] / then[VALUE] - 1.0 for then, now in kept]
            rows.append(
                [
                    record.name,
                    words,
                    f"{len(kept)}",
                    *(_held(kept, part) for part in ("statistical", "total")),
                    f"{100 * float(np.sqrt(np.mean(np.square(changes)))):.2f} %" if kept else "–",
                ]
            )
    header = ("record", "windows", "pairs", "held by ± of samples", "by total ±", "RMS change")
    return Table("coverage", header, rows)


def _held(pairs: Sequence[tuple[dict[str, Any], dict[str, Any]]], part: str) -> str:
    """Share of pairs whose first interval holds the second's figure."""
    name = f"reference_leakage_{part}_half_width"
    held = sum(abs(now[VALUE] - then[VALUE]) <= then[name] for then, now in pairs)
    return f"{held} ({100 * held / len(pairs):.0f} %)" if pairs else "–"


def _steps(percent: float) -> Course:
    return lambda number, _: percent / 100.0 if number >= 0 else 0.0


def _ramp(percent: float) -> Course:
    return lambda number, plan: max(number + 1, 0) / (plan.nights - plan.healthy) * percent / 100.0


# Growth of the leakage by the number of the night since the last healthy one.
COURSES: dict[str, Course] = {
    "step-10": _steps(10.0),
    "step-20": _steps(20.0),
    "step-30": _steps(30.0),
    "ramp-30": _ramp(30.0),
}
KINDS = {"all": "all paths alike", "ring": "ring-like"}


def _add_nights(fleet: Path, record: Record, tables: Tables, plan: Plan) -> None:
    """The same nights without wear, and with each kind and course of it."""
    nights = windows(record.warm(), plan.length, plan.nights)
    if not nights:
        return
    add_motor(fleet, f"{record.name}-steady", nights)
    fit = _of(tables, f"{record.name}-held-out-warm")[0]
    law = load_fleet(fleet).motors[0].motor(fit["night"], "estimated")
    coefficients = {fit["columns"][0]: fit["coefficients"][0]}
    for kind in KINDS:
        flows = [_added(law, coefficients, night, kind) for night in nights]
        for name, course in COURSES.items():
            growths = [course(number - plan.healthy, plan) for number in range(len(nights))]
            worn = [
                night.with_columns(pl.col(FLOW) + growth * flow)
                for night, flow, growth in zip(nights, flows, growths, strict=True)
            ]
            add_motor(fleet, f"{record.name}-{kind}-{name}", worn)


def _added(law: Motor, coefficients: dict[str, float], night: pl.DataFrame, kind: str) -> pl.Series:
    """Flow to add for a growth of 1: the fitted leakage, or as much with the ring's pressures.

    Nothing is added where the meter stands at its floor and reads no flow at all.
    """
    pressure = night[PRESSURE].to_numpy()
    conditions = OperatingConditions.from_bar(pressure, night[TEMPERATURE].to_numpy(), SPEED_RPM)
    reads = night[FLOW].to_numpy() >= METER_READS_FROM
    flow = np.where(reads, leakage_l_per_min(law, conditions, coefficients), 0.0)
    if kind == "ring":
        shape = flow * np.exp(-3.0 * pressure / RING_BAR)
        flow = shape * flow.sum() / shape.sum()
    return pl.Series(flow)
