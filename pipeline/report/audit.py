"""What the thesis adds to a night's fit, on request: its search, and information criteria.

The published estimate is the certificate's. Starts from several points show that the thesis's
search ends there, and how little its gap heights and eccentricities mean.
"""

from __future__ import annotations

import datetime as dt
import hashlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from leakage import Motor
from leakage.estimation.least_squares import Fit, fit
from leakage.estimation.multi_start import Parametrisation, SearchSettings
from leakage.estimation.validation import Criteria, criteria
from pipeline.config import Fleet, MotorSpec
from pipeline.schema import FITS
from pipeline.schema.fits import OK
from pipeline.store.tables import read_rows

Row = dict[str, Any]


def audit(fleet: Fleet, motor_id: str, night: dt.date) -> list[str]:
    """The audit of a motor's fits of a night, in lines; none without a fit or a starting point."""
    spec = fleet.motor(motor_id)
    if not spec.settings.estimation.starting_points:
        return []
    columns = tuple(name for name in FITS.schema if name != "run_id")
    rows = read_rows(fleet.output, FITS, [motor_id], columns, f"{night:%Y-%m}").to_dicts()
    fitted = [row for row in rows if row["night"] == night and row["status"] == OK]
    return [line for row in fitted for line in ("", *_lines(spec, row))]


def _lines(spec: MotorSpec, row: Row) -> Iterator[str]:
    mode = row["flushing_mode"]
    found = _searched(spec, spec.stated.motor(row["night"], mode), row)
    yield f"Audit, flushing {mode}"
    if found.starts:
        gap = "" if found.certificate_gap is None else f", the best {found.certificate_gap:+.1e}"
        yield (
            f"  search: {len(found.starts_at_minimum)} of {len(found.starts)} starts end at the "
            f"proven minimum{gap}"
        )
        yield from (f"  {line}" for line in _spreads(found))
        failed = {start.reason for start in found.starts if np.isnan(start.cost)}
        yield from (f"  failed: {reason}" for reason in sorted(failed))
    # The criteria are those of a squared loss: a robust one has none of them.
    if row["weight_inflation"] == 1.0:
        cost, d = (row["training_rmse_l_per_min"] or 0.0) ** 2, row["n_parameters"]
        for n, of in ((row["n_training"], "training samples"), (row["n_effective"], "effective")):
            yield from _criteria(criteria(cost, d, n or 0.0), f"{n or 0:.0f} {of}")


def _searched(spec: MotorSpec, motor: Motor, row: Row) -> Fit:
    """A fit to all kept samples of a night, with its starts."""
    if list(motor.columns) != row["columns"]:
        motor = motor.with_free_standard()
    factor = np.zeros((len(motor.columns),) * 2)
    factor[np.triu_indices(len(factor))] = row["night_factor"]
    asked = spec.settings.estimation
    settings = SearchSettings(
        starting_points=asked.starting_points,
        step_tolerance=asked.step_tolerance,
        function_tolerance=asked.function_tolerance,
        maximum_iterations=asked.maximum_iterations,
    )
    seed = night_seed(asked.seed, spec.motor_id, row["night"], row["flushing_mode"])
    return fit(factor, motor, settings, np.random.default_rng(seed))


def _spreads(found: Fit) -> Iterator[str]:
    """Smallest and largest value of each parameter and coefficient over starts at the minimum."""
    if not found.starts_at_minimum:
        return
    parametrisation = Parametrisation.of(found.motor)
    finals = np.array([start.final for start in found.starts_at_minimum])
    thetas = parametrisation.coefficients(finals)
    named = [
        (one.name, one.unit, of) for one, of in zip(parametrisation.free, finals.T, strict=True)
    ]
    named += [
        (path.coefficient_name, path.coefficient_unit, of)
        for path, of in zip(parametrisation.paths, thetas.T, strict=True)
        if path is not None and path.is_free and len(path.parameters) > 1
    ]
    for name, unit, values in named:
        yield f"{name}: {values.min():.6g} to {values.max():.6g} {unit} over these starts"


def _criteria(found: Criteria, of: str) -> Iterator[str]:
    if found.fpe is not None and found.aicc is not None:
        yield (
            f"  FPE {found.fpe:.4g} (l/min)², AIC {found.aic:.1f}, AICc {found.aicc:.1f}, "
            f"BIC {found.bic:.1f}: {of}"
        )


def night_seed(seed: int, motor_id: str, night: dt.date, purpose: str) -> int:
    """Seed of a fit's draws: the same for the same run seed, motor, night and purpose."""
    text = "|".join((str(seed), motor_id, night.isoformat(), purpose))
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big")
