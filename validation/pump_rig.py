"""The pump rig: what the program finds on its records, asked in six questions.

`python -m validation pump_rig FOLDER` reads the records of FOLDER, fits cuts of them with the
program's own command, and writes the tables and pictures of docs/real_machines.md.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from leakage import Motor, OperatingConditions, leakage_l_per_min, total_flow_l_per_min
from pipeline.config import load_fleet
from pipeline.notebook import Tables
from validation.fleet import DAY, FIRST, add_motor, fitted, label, new_fleet
from validation.pictures import draw
from validation.record import FLOW, PRESSURE, TEMPERATURE, TIME, Record, read_records, windows
from validation.tables import Table

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
    kinds: tuple[str, ...] = ("all", "ring")
    courses: tuple[str, ...] = ("step-10", "step-20", "step-30", "ramp-30")


def judge(
    folder: Path, work: Path, plan: Plan | None = None, pictures: Path | None = None
) -> list[Table]:
    """Fit cuts of every record of a folder, and answer the questions of the page."""
    plan = plan or Plan()
    records = read_records(folder)
    fleet = new_fleet("pump_rig", work / "cuts")
    for record in records:
        _add_cuts(fleet, record)
    cuts = fitted(fleet)
    fleet = new_fleet("pump_rig", work / "nights")
    known = [record for record in records if _labelled(cuts, record)]
    for record in known:
        _add_nights(fleet, record, cuts, plan)
    nights = fitted(fleet)
    for record in known:
        if pictures:
            law, coefficients = _law(fleet, cuts, record)
            flow = total_flow_l_per_min(law, _conditions(record.warm()), coefficients)
            draw(record, pl.Series(flow), cuts, nights, pictures)
    return [
        _records(records),
        _held_out(cuts, records),
        _labels(cuts, records),
        _stability(cuts, records),
        _coverage(cuts, records),
        _alarms(nights, records, plan),
    ]


VARIANTS = {
    "held-out-all": (
        "every sample",
        "[channels.leakage_flow]\nsource = 'Flow - leak line'\n"
        "unit = 'l/min'\nvalid_range = [0.0, 100.0]\n",
    ),
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
    if short := windows(warm, SHORT, STEP):
        quarter = (warm[TIME][-1] - warm[TIME][0]) / 4
        add_motor(fleet, f"{record.name}-quarters", windows(warm, quarter, quarter))
        add_motor(fleet, f"{record.name}-windows", short)


def _periods(rows: pl.DataFrame) -> str:
    """Alternate blocks: the first, third, … train, the others validate."""
    count = (rows[TIME][-1] - rows[TIME][0]) // BLOCK + 1
    pairs = [
        f"[{FIRST + i * BLOCK:%FT%TZ}, {FIRST + (i + 1) * BLOCK:%FT%TZ}]" for i in range(count)
    ]
    training, validation = ", ".join(pairs[::2]), ", ".join(pairs[1::2])
    return f"[periods]\ntraining = [{training}]\nvalidation = [{validation}]\n"


def _records(records: Sequence[Record]) -> Table:
    rows = [
        [
            one.name,
            one.state,
            f"{one.rows.height}",
            _range(one.rows[PRESSURE]),
            _range(one.rows[TEMPERATURE]),
            f"{100 * float((one.rows[FLOW] < METER_READS_FROM).to_numpy().mean()):.0f} %",
            "; ".join(one.notes) or "–",
        ]
        for one in records
    ]
    return Table(
        "records",
        (
            "record",
            "state",
            "samples",
            "bar (5–95 %)",
            "°C (5–95 %)",
            "meter at its floor",
            "notes",
        ),
        rows,
    )


def _range(values: pl.Series) -> str:
    return f"{values.quantile(0.05):.0f} to {values.quantile(0.95):.0f}"


def _held_out(tables: Tables, records: Sequence[Record]) -> Table:
    fits = {row["motor_id"]: row for row in tables.fits().collect().to_dicts()}
    rows = [
        [
            record.name,
            words,
            str(row["n_training"]),
            _percent(row["training_fit_percent"]),
            str(row["n_validation"]),
            _percent(row["validation_fit_percent"]),
        ]
        for record in records
        for variant, (words, _) in VARIANTS.items()
        if (row := fits.get(f"{record.name}-{variant}"))
    ]
    header = ("record", "samples", "training", "fit", "held out", "fit")
    return Table("held_out", header, rows)


def _percent(value: float | None) -> str:
    return "–" if value is None else f"{value:.1f} %"


def _labels(tables: Tables, records: Sequence[Record]) -> Table:
    """Leakage by labelled state, in rising order: the training blocks of each warm part."""
    found = [(record, row) for record in records for row in _labelled(tables, record)]
    found.sort(key=lambda pair: float(pair[1][VALUE]))
    rows = [
        [record.name, record.state, *_leakage(row), row["reference_verdict"]]
        for record, row in found
    ]
    return Table("labels", ("record", "state", "leakage", "± samples", "± total", "verdict"), rows)


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
            if row[VALUE] is not None
        ]
    header = (
        "record",
        "quarter",
        "°C",
        "K 1e-14 m³",
        "C l/min",
        "leakage",
        "samples",
        "total",
        "model",
    )
    return Table("stability", header, rows)


def _of(tables: Tables, motor_id: str) -> list[dict[str, Any]]:
    return tables.fits().filter(pl.col("motor_id") == motor_id).collect().to_dicts()


def _labelled(tables: Tables, record: Record) -> list[dict[str, Any]]:
    """Fit of the training blocks of the warm part; empty where it tells no leakage."""
    fits = _of(tables, f"{record.name}-held-out-warm")
    return [fit for fit in fits if fit[VALUE] is not None]


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
        pairs = [
            (row, found[night + apart]) for night, row in found.items() if night + apart in found
        ]
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


def growth(course: str, number: int, plan: Plan) -> float:
    """Growth of the leakage in a night, counted from the first one with wear, which is 0."""
    kind, percent = course.split("-")
    nights = plan.nights - plan.healthy
    share = float(number >= 0) if kind == "step" else max(number + 1, 0) / nights
    return share * float(percent) / 100.0


def _add_nights(fleet: Path, record: Record, tables: Tables, plan: Plan) -> None:
    """The same nights without wear, and with each kind and course of it."""
    nights = windows(record.warm(), plan.length, plan.nights)
    if not nights:
        return
    add_motor(fleet, f"{record.name}-steady", nights)
    mixed = np.random.default_rng(1).permutation(len(nights))
    add_motor(fleet, f"{record.name}-mixed", [nights[number] for number in mixed])
    law, coefficients = _law(fleet, tables, record)
    for kind in plan.kinds:
        flows = [_added(law, coefficients, night, kind) for night in nights]
        for course in plan.courses:
            worn = [
                night.with_columns(pl.col(FLOW) + growth(course, number, plan) * flow)
                for number, (night, flow) in enumerate(
                    zip(nights, flows, strict=True), start=-plan.healthy
                )
            ]
            add_motor(fleet, f"{record.name}-{kind}-{course}", worn)


def _law(fleet: Path, tables: Tables, record: Record) -> tuple[Motor, dict[str, float]]:
    """The motor type's law, and its coefficients from the training blocks of the warm part."""
    (fit,) = _labelled(tables, record)
    law = load_fleet(fleet).motors[0].motor(fit["night"], "estimated")
    return law, dict(zip((path.name for path in law.paths), fit["coefficients"], strict=True))


def _conditions(rows: pl.DataFrame) -> OperatingConditions:
    return OperatingConditions.from_bar(
        rows[PRESSURE].to_numpy(), rows[TEMPERATURE].to_numpy(), SPEED_RPM
    )


def _added(law: Motor, coefficients: dict[str, float], night: pl.DataFrame, kind: str) -> pl.Series:
    """Flow to add for a growth of 1: the fitted leakage, or as much with the ring's pressures.

    Nothing is added where the meter stands at its floor and reads no flow at all.
    """
    reads = night[FLOW].to_numpy() >= METER_READS_FROM
    flow = np.where(reads, leakage_l_per_min(law, _conditions(night), coefficients), 0.0)
    if kind == "ring":
        shape = flow * np.exp(-3.0 * night[PRESSURE].to_numpy() / RING_BAR)
        flow = shape * flow.sum() / shape.sum()
    return pl.Series(flow)


def _alarms(tables: Tables, records: Sequence[Record], plan: Plan) -> Table:
    """First warning or alarm of each course of wear, and all of those without wear."""
    found = tables.alarms().filter(pl.col("to_state").is_in(RAISED)).collect().to_dicts()
    motors = tables.fits().collect()["motor_id"].unique()
    rows = []
    for record in records:
        for order in ("steady", "mixed"):
            if (motor_id := f"{record.name}-{order}") in motors:
                raised = [one for one in found if one["motor_id"] == motor_id]
                rows.append([record.name, "none", f"nights {order}", *_told(raised, 0, None, plan)])
        for kind in plan.kinds:
            for course in plan.courses:
                if (motor_id := f"{record.name}-{kind}-{course}") in motors:
                    raised = [one for one in found if one["motor_id"] == motor_id]
                    told = _told(raised, plan.healthy, course, plan)
                    rows.append([record.name, kind, course.replace("-", " +") + " %", *told])
    header = ("record", "wear", "course", "told in night", "at", "by", "the program says")
    return Table("alarms", header, rows)


def _told(
    raised: Sequence[dict[str, Any]], begin: int, course: str | None, plan: Plan
) -> tuple[str, str, str, str]:
    """Night of the first warning or alarm since the first worn night, growth by then, words."""
    since = [one for one in raised if one["night"] >= label(begin)]
    if not since:
        return "never", "–", "–", "–"
    first = since[0]
    number = (first["night"] - label(begin)).days
    grown = f"+{100 * growth(course, number, plan):.0f} %" if course else "–"
    said = first["reason"].split(";")[0]
    return f"{number + 1}", grown, f"{first['indicator']}, {first['way']}", said
