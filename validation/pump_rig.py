"""The pump rig: what the program finds on its records, in five tables.

`python -m validation pump_rig FOLDER` reads the records of FOLDER, fits cuts of them (held-out
blocks, quarters, windows) with the program's own command, and writes the tables and the picture of
docs/evidence.md.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from leakage import Motor, total_flow_l_per_min
from pipeline.config import load_fleet
from pipeline.notebook import Tables
from validation.fleet import DAY, FIRST, add_motor, fitted, new_fleet
from validation.record import (
    FLOW,
    METER_READS_FROM,
    PRESSURE,
    TEMPERATURE,
    TIME,
    Record,
    conditions,
    read_records,
    windows,
)
from validation.tables import NONE, Row, Table

Fit = dict[str, Any]
BLOCK = dt.timedelta(minutes=10)
SHORT = dt.timedelta(minutes=20)
STEP = dt.timedelta(minutes=5)
VALUE = "fitted_leakage_l_per_min"
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


def judge(folder: Path, work: Path, pictures: Path | None = None) -> list[Table]:
    """Fit cuts of every record of a folder, and answer the questions of the page."""
    records = read_records(folder)
    fleet = new_fleet("pump_rig", work / "cuts")
    for record in records:
        add_cuts(fleet, record)
    cuts = fitted(fleet)
    known = [record for record in records if labelled(cuts, record)]
    if pictures:
        from validation.pictures import draw  # by Matplotlib, of requirements/full.txt

        for record in known:
            law, coefficients = law_of(fleet, cuts, record)
            flow = total_flow_l_per_min(law, conditions(record.warm()), coefficients)
            draw(record, pl.Series(flow), cuts, pictures)
    rising = sorted(known, key=lambda record: float(labelled(cuts, record)[0][VALUE]))
    return [
        Table("records", [_record(record) for record in records]),
        Table("held_out", [row for record in records for row in _held_out(cuts, record)]),
        Table("labels", [_label(cuts, record) for record in rising]),
        Table("stability", [row for record in records for row in _quarters(cuts, record)]),
        Table("coverage", [row for record in records for row in _coverage(cuts, record)]),
    ]


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
    """Return the motor type's law, and its coefficients from training blocks of the warm part."""
    (fit,) = labelled(tables, record)
    law = load_fleet(fleet).motors[0].motor(fit["night"], "estimated")
    return law, dict(zip((path.name for path in law.paths), fit["coefficients"], strict=True))


def fits_of(tables: Tables, motor_id: str) -> list[dict[str, Any]]:
    temperature = tables.nights().select("motor_id", "night", "mean_temperature_c")
    rows = tables.fits().join(temperature, on=["motor_id", "night"], maintain_order="left")
    return rows.filter(pl.col("motor_id") == motor_id).collect().to_dicts()


def labelled(tables: Tables, record: Record) -> list[dict[str, Any]]:
    """Fit of the training blocks of the warm part; empty where it tells no leakage."""
    fits = fits_of(tables, f"{record.name}-held-out-warm")
    return [fit for fit in fits if fit[VALUE] is not None]


def _record(record: Record) -> Row:
    at_floor = float((record.rows[FLOW] < METER_READS_FROM).to_numpy().mean())
    return {
        "record": record.name,
        "state": record.state,
        "samples": str(record.rows.height),
        "bar (5–95 %)": _range(record.rows[PRESSURE]),
        "°C (5–95 %)": _range(record.rows[TEMPERATURE]),
        "meter at its floor": f"{100.0 * at_floor:.0f} %",
    }


def _range(values: pl.Series) -> str:
    return f"{values.quantile(0.05):.0f} to {values.quantile(0.95):.0f}"


def _held_out(tables: Tables, record: Record) -> list[Row]:
    return [
        {
            "record": record.name,
            "samples": words,
            "training": str(fit["n_training"]),
            "its fit": _percent(fit["training_fit_percent"]),
            "held out": str(fit["n_validation"]),
            "held-out fit": _percent(fit["validation_fit_percent"]),
        }
        for variant, (words, _) in VARIANTS.items()
        for fit in fits_of(tables, f"{record.name}-{variant}")
    ]


def _percent(value: float | None) -> str:
    return NONE if value is None else f"{value:.1f} %"


def _label(tables: Tables, record: Record) -> Row:
    (fit,) = labelled(tables, record)
    verdict = fit["fitted_leakage_verdict"]
    return {"record": record.name, "state": record.state, **_leakage(fit), "verdict": verdict}


def _quarters(tables: Tables, record: Record) -> list[Row]:
    quarters = enumerate(fits_of(tables, f"{record.name}-quarters"), start=1)
    return [
        {
            "record": record.name,
            "quarter": str(number),
            "°C": f"{fit['mean_temperature_c']:.1f}",
            "K, 1e-14 m³": f"{fit['coefficients'][0] * 1e14:.2f}",
            "offset, l/min": f"{fit['coefficients'][1]:.2f}",
            **_leakage(fit),
        }
        for number, fit in quarters
        if fit[VALUE] is not None
    ]


def _leakage(fit: Fit) -> Row:
    """Return reference leakage, and its ± from the samples and in total."""
    return {
        "leakage, l/min": f"{fit[VALUE]:.3f}",
        "± of samples": f"{fit['fitted_leakage_statistical_l_per_min']:.3f}",
        "total ±": f"{fit['fitted_leakage_total_l_per_min']:.3f}",
    }


def _coverage(tables: Tables, record: Record) -> list[Row]:
    """Windows whose interval holds the leakage of the window that begins where they end."""
    fits = fits_of(tables, f"{record.name}-windows")
    by_night = {fit["night"]: fit for fit in fits if fit[VALUE] is not None}
    apart = SHORT // STEP
    later = {night: by_night.get(night + apart * DAY) for night in by_night}
    pairs = [(by_night[night], fit) for night, fit in later.items() if fit is not None]
    kinds = {"every 5 minutes": pairs, "one after another": pairs[::apart]}
    return [
        {
            "record": record.name,
            "windows": words,
            "pairs": str(len(some)),
            "held by ± of samples": _held(some, "statistical"),
            "held by total ±": _held(some, "total"),
            "RMS change": _percent(_root_mean_square_change(some)),
            "leakage over temperature": f"{_slope_percent_per_k(some):+.2f} %/K",
        }
        for words, some in kinds.items()
        if len(some) > 1
    ]


def _held(pairs: Sequence[tuple[Fit, Fit]], part: str) -> str:
    """Share of pairs whose first interval holds the second's leakage."""
    name = f"fitted_leakage_{part}_l_per_min"
    held = sum(abs(now[VALUE] - then[VALUE]) <= then[name] for then, now in pairs)
    return f"{held} ({100 * held / len(pairs):.0f} %)"


def _root_mean_square_change(pairs: Sequence[tuple[Fit, Fit]]) -> float:
    changes = np.asarray([now[VALUE] / then[VALUE] - 1.0 for then, now in pairs])
    return 100.0 * float(np.sqrt(np.mean(changes**2)))


def _slope_percent_per_k(pairs: Sequence[tuple[Fit, Fit]]) -> float:
    """Return reference leakage of the first windows over their temperature."""
    temperatures = [then["mean_temperature_c"] for then, _ in pairs]
    logarithms = np.log([then[VALUE] for then, _ in pairs])
    return 100.0 * float(np.polyfit(temperatures, logarithms, 1)[0])
