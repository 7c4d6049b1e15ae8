"""What the thesis adds to a night's fit, on request: its search, and information criteria.

The published estimate is the proven minimum's. Starts from several points show that the thesis's
search ends there, and how little its gap heights and eccentricities mean.
"""

from __future__ import annotations

import datetime as dt
import hashlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from leakage import Motor
from leakage.estimation.multi_start import Search, coefficients_at, free_parameters, search
from leakage.estimation.validation import criteria
from pipeline.config import Fleet, MotorSpec
from pipeline.schema import FITS
from pipeline.store.tables import read_rows


def audit(fleet: Fleet, motor_id: str, night: dt.date) -> list[str]:
    """The audit of a motor's fits of a night, in lines; none without a fit or a starting point."""
    spec = fleet.motor(motor_id)
    if not spec.settings.estimation.starting_points:
        return []
    rows = read_rows(fleet.output, FITS, [motor_id], nights=[night]).filter(status="ok")
    return [line for row in rows.to_dicts() for line in ("", *_lines(spec, row))]


def _lines(spec: MotorSpec, row: dict[str, Any]) -> Iterator[str]:
    mode = row["flushing_mode"]
    motor = spec.stated.motor(row["night"], mode)
    if list(motor.columns) != row["columns"]:
        motor = motor.with_free_standard()
    found = _searched(spec, motor, row)
    yield f"Audit, flushing {mode}"
    if found.starts:
        gap = "" if found.gap is None else f", the best {found.gap:+.1e}"
        yield (
            f"  search: {len(found.at_minimum)} of {len(found.starts)} starts end at the "
            f"proven minimum{gap}"
        )
        yield from (f"  {line}" for line in _spreads(motor, found))
    if row["weight_inflation"] != 1.0:
        return  # the criteria are those of a squared loss: a robust one has none of them
    cost = (row["training_rmse_l_per_min"] or 0.0) ** 2
    for name, of in (("n_training", "training samples"), ("n_effective", "effective")):
        one = criteria(cost, row["n_parameters"], row[name] or 0.0)
        if one.fpe is not None and one.aicc is not None:
            yield (
                f"  FPE {one.fpe:.4g} (l/min)², AIC {one.aic:.1f}, AICc {one.aicc:.1f}, "
                f"BIC {one.bic:.1f}: {row[name]:.0f} {of}"
            )


def _searched(spec: MotorSpec, motor: Motor, row: dict[str, Any]) -> Search:
    """The thesis's search over all kept samples of a night."""
    factor = np.zeros((len(motor.columns),) * 2)
    factor[np.triu_indices(len(factor))] = row["night_factor"]
    asked = spec.settings.estimation
    # The same draws for the same run seed, motor, night and mode.
    text = f"{asked.seed}|{spec.motor_id}|{row['night']}|{row['flushing_mode']}"
    seed = int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big")
    return search(
        factor,
        motor,
        np.random.default_rng(seed),
        starting_points=asked.starting_points,
    )


def _spreads(motor: Motor, found: Search) -> Iterator[str]:
    """Smallest and largest value of each parameter and coefficient over starts at the minimum."""
    if not found.at_minimum:
        return
    finals = np.array([start.final for start in found.at_minimum])
    thetas = coefficients_at(motor, finals)
    named = [
        (one.name, one.unit, of) for one, of in zip(free_parameters(motor), finals.T, strict=True)
    ]
    named += [
        (path.coefficient_name, path.coefficient_unit, of)
        for path, of in zip(motor.coefficient_paths, thetas.T, strict=True)
        if path is not None and path.is_free and len(path.parameters) > 1
    ]
    for name, unit, values in named:
        yield f"{name}: {values.min():.6g} to {values.max():.6g} {unit} over these starts"
