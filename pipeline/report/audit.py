"""What the thesis adds to a night's fit, on request: its search.

The published estimate is the proven minimum's. Starts from several points show that the thesis's
search ends there, and how little its gap heights and eccentricities mean.
"""

from __future__ import annotations

import datetime as dt
import hashlib
from collections.abc import Iterator
from typing import Any

import numpy as np
import polars as pl

from leakage import Motor
from leakage.estimation.blocks import merge, with_free_known
from leakage.estimation.proven_minimum import Search, coefficients_at, free_parameters, search
from pipeline.arrays import Array
from pipeline.config import Fleet, MotorSpec
from pipeline.night.fit import scale_of
from pipeline.night.rows import coefficient_names
from pipeline.night.stored_blocks import BLOCK_COLUMNS, StoredBlocks
from pipeline.schema import BLOCKS, FITS
from pipeline.store.tables import read_rows


def audit(fleet: Fleet, motor_id: str, night: dt.date) -> list[str]:
    """Return the audit of a motor's fits of a night, in lines; none without a fit."""
    spec = fleet.motor(motor_id)
    fits, blocks = (
        read_rows(fleet.output, table, [motor_id], columns, [night])
        for table, columns in ((FITS, ()), (BLOCKS, BLOCK_COLUMNS))
    )
    rows, blocks = fits.filter(pl.col("coefficients").is_not_null()), blocks.sort("block_start")
    return [line for row in rows.to_dicts() for line in ("", *_lines(spec, row, blocks))]


def _lines(spec: MotorSpec, row: dict[str, Any], blocks: pl.DataFrame) -> Iterator[str]:
    mode = row["flushing_mode"]
    motor = spec.stated.motor(row["night"], mode)
    stored = StoredBlocks.of(spec, blocks, motor.columns)
    if stored is None:
        return
    factors = stored.factors
    if coefficient_names(motor) != row["coefficient_names"]:
        factors = with_free_known(factors, *scale_of(motor))
        motor = motor.with_free_standard()
    outcome = _search(spec, motor, row, merge(factors))
    yield f"Audit, flushing {mode}"
    if outcome.starts:
        gap = "" if outcome.gap is None else f", the best {outcome.gap:+.1e}"
        yield (
            f"  search: {len(outcome.at_minimum)} of {len(outcome.starts)} starts end at the "
            f"proven minimum{gap}"
        )
        yield from (f"  {line}" for line in _spreads(motor, outcome))
    if row["fpe"] is not None and row["aicc"] is not None:
        yield (
            f"  FPE {row['fpe']:.4g} (l/min)², AIC {row['aic']:.1f}, AICc {row['aicc']:.1f}, "
            f"BIC {row['bic']:.1f}: {row['n_training']} training samples"
        )


def _search(spec: MotorSpec, motor: Motor, row: dict[str, Any], factor: Array) -> Search:
    """Search as the thesis does, over all samples of a night."""
    # The same draws for the same motor, night and mode.
    text = f"1|{spec.motor_id}|{row['night']}|{row['flushing_mode']}"
    seed = int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big")
    return search(factor, motor, np.random.default_rng(seed))


def _spreads(motor: Motor, outcome: Search) -> Iterator[str]:
    """Smallest and largest value of each parameter and coefficient over starts at the minimum."""
    if not outcome.at_minimum:
        return
    finals = np.array([start.final for start in outcome.at_minimum])
    thetas = coefficients_at(motor, finals)
    named = [
        (parameter.name, parameter.unit, of)
        for parameter, of in zip(free_parameters(motor), finals.T, strict=True)
    ]
    named += [
        (path.coefficient_name, path.coefficient_unit, of)
        for path, of in zip(motor.coefficient_paths, thetas.T, strict=True)
        if path is not None and path.is_free and len(path.parameters) > 1
    ]
    for name, unit, values in named:
        yield f"{name}: {values.min():.6g} to {values.max():.6g} {unit} over these starts"
