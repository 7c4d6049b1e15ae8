"""Rows of a night's fits, and of the tables below a fit."""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from leakage import Motor
from leakage.estimation.identifiability import ONE_BLOCK, LeakageJudgement
from leakage.estimation.sample_blocks import TRAINING, VALIDATION
from leakage.estimation.uncertainty import Interval
from leakage.estimation.validation import agreement, criteria
from pipeline.arrays import Array
from pipeline.clock import utc
from pipeline.config import MotorSpec
from pipeline.night.block_fit import REFERENCE, BlockFit, with_free_rollers
from pipeline.night.parameter_rows import parameter_rows
from pipeline.night.residuals import residual_columns, residual_test_rows
from pipeline.night.statistics import NightStatistics
from pipeline.night.stored_blocks import CHANNELS
from pipeline.schema import OF_NIGHT

Row = dict[str, Any]
Rows = dict[str, list[Row]]


def night_row(
    spec: MotorSpec,
    night: dt.date,
    data: Row,
    status: str,
    reason: str | None = None,
    code: str | None = None,
) -> Row:
    """The row of a night in `nights`, as far as the night itself fills it; `data` is of samples."""
    return {
        **dict.fromkeys(OF_NIGHT),
        **data,
        "motor_id": spec.motor_id,
        "night": night,
        "motor_type": spec.file.motor_type,
        "oil": spec.file.oil_on(night),
        "oil_circuit": spec.file.oil_circuit or None,
        "flushing_mode": spec.file.flushing.mode,
        "status": status,
        "reason": reason,
        "error_code": code,
    }


def unfitted_row(spec: MotorSpec, night: dt.date) -> Row:
    """Return the one row in `fits` of a night without a fit."""
    mode = spec.file.flushing.mode
    return {"motor_id": spec.motor_id, "night": night, "flushing_mode": mode, "is_primary": True}


def fit_rows(
    spec: MotorSpec,
    night: dt.date,
    statistics: NightStatistics,
    modes: Sequence[BlockFit],
    budget: Sequence[Row],
) -> Rows:
    """Return rows of `fits` and of all tables below a fit, for all modes of flushing."""
    samples = statistics.samples
    shared = {
        "window_start": utc(samples.time_us[0]),
        "window_end": utc(samples.time_us[-1]),
        "n_training": sum(block.n for block in statistics.blocks if block.part == TRAINING),
        "n_validation": sum(block.n for block in statistics.blocks if block.part == VALIDATION),
        **reference_columns(spec),
    }
    motor_night = {"motor_id": spec.motor_id, "night": night}
    rows: Rows = {
        "fits": [],
        "parameters": [],
        "error_budget": [motor_night | row for row in budget],
        "residual_tests": [],
    }
    for mode in modes:
        key = motor_night | {"flushing_mode": mode.name}
        own = _mode_columns(spec, statistics, mode)
        own |= {"is_primary": mode.name == spec.file.flushing.mode}
        rows["fits"].append(shared | key | own)
        rows["parameters"] += [key | row for row in parameter_rows(spec, mode)]
        tests = residual_test_rows(mode.residuals, samples.period_us / 1e6)
        rows["residual_tests"] += [key | row for row in tests]
    return rows


def of_fit(fits: Sequence[Row]) -> Row:
    """Return columns of `nights` that say how well the primary of a night's fits went."""
    (fit,) = [row for row in fits if row["is_primary"]]
    names = ("training_fit_percent", "validation_fit_percent")
    return {name: fit[name] for name in names} | {"rmse_l_per_min": math.sqrt(fit["cost"])}


def reference_columns(spec: MotorSpec) -> Row:
    """Return the fleet's reference conditions."""
    return {f"reference_{name}": getattr(spec.settings.reference, name) for name in CHANNELS}


def _mode_columns(
    spec: MotorSpec,
    statistics: NightStatistics,
    mode: BlockFit,
) -> Row:
    """Return the figures of one fit."""
    return {
        **agreement_columns(spec, mode, statistics.factor_of),
        **block_fit_columns(mode),
        **residual_columns(mode.residuals, statistics.samples.period_us / 1e6),
        **leakage_columns(mode),
    }


def agreement_columns(spec: MotorSpec, mode: BlockFit, factor_of: Callable[[str], Array]) -> Row:
    """Return how the training fit agrees with training and validation samples, and its criteria.

    `factor_of` gives the factor of a part's samples, in the columns of the model as stated.
    """
    theta, resolution = mode.training.coefficients, spec.file.channels["leakage_flow"].resolution
    found = {
        part: agreement(
            with_free_rollers(spec, mode.stated.fit.motor, factor_of(part)), theta, resolution
        )
        for part in (TRAINING, VALIDATION)
    }
    row: Row = {
        f"{part}_{name}": getattr(of_part, name)
        for part, of_part in found.items()
        for name in ("fit_percent", "rmse_l_per_min", "mean_error_l_per_min")
    }
    training = found[TRAINING]
    cost = (training.rmse_l_per_min or 0.0) ** 2
    return row | asdict(criteria(cost, mode.training.n_estimated, training.n))


def block_fit_columns(mode: BlockFit) -> Row:
    """Return columns of a fit that are computed from its blocks."""
    proven_minimum, fit = mode.fit.proven_minimum, mode.fit
    condition = proven_minimum.condition_number
    return {
        "cost": proven_minimum.cost,
        "rank": proven_minimum.rank,
        "condition_number": condition if np.isfinite(condition) else None,
        "coefficient_names": coefficient_names(fit.motor),
        "coefficients": fit.coefficients.tolist(),
        "interval_status": _interval_status(mode),
    }


def coefficient_names(motor: Motor) -> list[str]:
    """Return names of θ's coefficients, as `parameters` has them."""
    return [path.coefficient_name if path else "C_f" for path in motor.coefficient_paths]


def _interval_status(mode: BlockFit) -> str:
    """Return ``ok``, how long slow errors remember, or why there are no intervals."""
    found = mode.identification
    if found.distribution is None and not mode.fit.proven_minimum.fixed.all():
        return ONE_BLOCK
    if not found.slow.are_slow:
        return "ok"
    memory_s = found.slow.memory_s(mode.block_s)
    minutes = memory_s / 60.0
    time = f"about {minutes:.0f} minutes" if minutes < 120 else f"about {minutes / 60:.0f} hours"
    if memory_s >= mode.duration_s:
        time = "longer than the log"
    return f"ok: the errors remember for {time}; the intervals allow for it"


def leakage_columns(mode: BlockFit) -> Row:
    """Leakage at the reference conditions by the night alone, where it is determined; misfit."""
    misfit, found = mode.stated.misfit, mode.reference
    return {
        "fitted_leakage_verdict": found.verdict,
        "fitted_leakage_reason": found.reason or None,
        **_leakage(found, mode),
        "model_misfit_percent": misfit and 100.0 * misfit.share,
        "model_noise_percent": misfit and 100.0 * misfit.noise_share,
        **_roller_columns(mode),
    }


def _leakage(found: LeakageJudgement, mode: BlockFit) -> Row:
    name, parts = "fitted_leakage", mode.errors[REFERENCE]
    value, interval = found.leakage_l_per_min, found.interval
    row: Row = {
        f"{name}_l_per_min": value,
        **_ends(name, value, interval),
        f"{name}_statistical_l_per_min": parts.statistical,
        f"{name}_sensor_l_per_min": parts.sensor,
        f"{name}_model_l_per_min": parts.model,
        f"{name}_total_l_per_min": parts.total,
    }
    return row if found.has_value else dict.fromkeys(row)


def _ends(name: str, value: float, interval: Interval | None) -> Row:
    if interval is None:
        return {f"{name}_lower": None, f"{name}_upper": None}
    half_width = interval.half_width
    return {f"{name}_lower": value - half_width, f"{name}_upper": value + half_width}


def _roller_columns(mode: BlockFit) -> Row:
    """Return scale of the rollers' curve as the night shows it, whether or not the fit uses it."""
    roller = mode.roller
    if roller is None:
        return dict.fromkeys(
            ("roller_scale", "roller_scale_lower", "roller_scale_upper", "roller_verdict")
        )
    return {
        "roller_scale": roller.value,
        **_ends("roller_scale", roller.value, roller.judgement.interval),
        "roller_verdict": roller.judgement.verdict,
    }
