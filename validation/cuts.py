"""Cuts of a record as motors of a fleet: held-out blocks, quarters, windows, nights with wear."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from leakage import Motor, OperatingConditions, leakage_l_per_min
from pipeline.config import load_fleet
from pipeline.notebook import Tables
from validation.fleet import FIRST, add_motor
from validation.record import FLOW, PRESSURE, TEMPERATURE, TIME, Record, windows

BLOCK = dt.timedelta(minutes=10)
SHORT = dt.timedelta(minutes=20)
STEP = dt.timedelta(minutes=5)
METER_READS_FROM = 1.7  # l/min, as in the config
SPEED_RPM = 1485.0
RING_BAR = 120.0  # deformation constant of a piston ring that leaks below some 100 bar
VALUE = "reference_leakage_l_per_min"
VARIANTS = {
    "held-out-all": (
        "every sample",
        "[channels.leakage_flow]\nsource = 'Flow - leak line'\n"
        "unit = 'l/min'\nvalid_range = [0.0, 100.0]\n",
    ),
    "held-out": ("meter reads", ""),
    "held-out-warm": ("meter reads, 48 °C and above", ""),
    "held-out-late-warm": (
        "the same, temperature 15 s earlier",
        "[channels.oil_temperature]\nsource = 'Temperature - leak line'\n"
        "unit = 'degC'\ntime_offset_s = -15.0\n",
    ),
}


@dataclass(frozen=True, slots=True)
class Plan:
    """Nights cut from a record: so many, so long, wear after so many."""

    nights: int = 90
    length: dt.timedelta = dt.timedelta(minutes=60)
    healthy: int = 60
    kinds: tuple[str, ...] = ("all", "ring")
    courses: tuple[str, ...] = ("step-10", "step-20", "step-30", "ramp-30")


def add_cuts(fleet: Path, record: Record) -> None:
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


def growth(course: str, number: int, plan: Plan) -> float:
    """Growth of the leakage in a night, counted from the first one with wear, which is 0."""
    kind, percent = course.split("-")
    nights = plan.nights - plan.healthy
    share = float(number >= 0) if kind == "step" else max(number + 1, 0) / nights
    return share * float(percent) / 100.0


def add_nights(fleet: Path, record: Record, tables: Tables, plan: Plan) -> None:
    """The same nights without wear, and with each kind and course of it."""
    nights = windows(record.warm(), plan.length, plan.nights)
    add_motor(fleet, f"{record.name}-steady", nights)
    mixed = np.random.default_rng(1).permutation(len(nights))
    add_motor(fleet, f"{record.name}-mixed", [nights[number] for number in mixed])
    law, coefficients = law_of(fleet, tables, record)
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


def law_of(fleet: Path, tables: Tables, record: Record) -> tuple[Motor, dict[str, float]]:
    """The motor type's law, and its coefficients from the training blocks of the warm part."""
    (fit,) = labelled(tables, record)
    law = load_fleet(fleet).motors[0].motor(fit["night"], "estimated")
    return law, dict(zip((path.name for path in law.paths), fit["coefficients"], strict=True))


def conditions(rows: pl.DataFrame) -> OperatingConditions:
    return OperatingConditions.from_bar(
        rows[PRESSURE].to_numpy(), rows[TEMPERATURE].to_numpy(), SPEED_RPM
    )


def _added(law: Motor, coefficients: dict[str, float], night: pl.DataFrame, kind: str) -> pl.Series:
    """Flow to add for a growth of 1: the fitted leakage, or as much with the ring's pressures.

    Nothing is added where the meter stands at its floor and reads no flow at all.
    """
    reads = night[FLOW].to_numpy() >= METER_READS_FROM
    flow = np.where(reads, leakage_l_per_min(law, conditions(night), coefficients), 0.0)
    if kind == "ring":
        shape = flow * np.exp(-3.0 * night[PRESSURE].to_numpy() / RING_BAR)
        flow = shape * flow.sum() / shape.sum()
    return pl.Series(flow)


def fits_of(tables: Tables, motor_id: str) -> list[dict[str, Any]]:
    return tables.fits().filter(pl.col("motor_id") == motor_id).collect().to_dicts()


def labelled(tables: Tables, record: Record) -> list[dict[str, Any]]:
    """Fit of the training blocks of the warm part; empty where it tells no leakage."""
    fits = fits_of(tables, f"{record.name}-held-out-warm")
    return [fit for fit in fits if fit[VALUE] is not None]
