"""Cuts of a record as motors of a fleet: held-out blocks, quarters, windows."""

from __future__ import annotations

import datetime as dt
from pathlib import Path
from typing import Any

import polars as pl

from leakage import Motor, OperatingConditions
from pipeline.config import load_fleet
from pipeline.notebook import Tables
from validation.fleet import FIRST, add_motor
from validation.record import PRESSURE, TEMPERATURE, TIME, Record, windows

BLOCK = dt.timedelta(minutes=10)
SHORT = dt.timedelta(minutes=20)
STEP = dt.timedelta(minutes=5)
METER_READS_FROM = 1.7  # l/min, as in the config
SPEED_RPM = 1485.0
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


def law_of(fleet: Path, tables: Tables, record: Record) -> tuple[Motor, dict[str, float]]:
    """The motor type's law, and its coefficients from the training blocks of the warm part."""
    (fit,) = labelled(tables, record)
    law = load_fleet(fleet).motors[0].motor(fit["night"], "estimated")
    return law, dict(zip((path.name for path in law.paths), fit["coefficients"], strict=True))


def conditions(rows: pl.DataFrame) -> OperatingConditions:
    return OperatingConditions.from_bar(
        rows[PRESSURE].to_numpy(), rows[TEMPERATURE].to_numpy(), SPEED_RPM
    )


def fits_of(tables: Tables, motor_id: str) -> list[dict[str, Any]]:
    return tables.fits().filter(pl.col("motor_id") == motor_id).collect().to_dicts()


def labelled(tables: Tables, record: Record) -> list[dict[str, Any]]:
    """Fit of the training blocks of the warm part; empty where it tells no leakage."""
    fits = fits_of(tables, f"{record.name}-held-out-warm")
    return [fit for fit in fits if fit[VALUE] is not None]
