"""Rows of a night's fits, and of the tables below a fit."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from leakage.estimation.identifiability import ONE_BLOCK, OUTSIDE, LeakageJudgement
from leakage.estimation.proven_minimum import ProvenMinimum
from leakage.estimation.sample_blocks import TRAINING, VALIDATION
from leakage.estimation.validation import Agreement, agreement, criteria
from pipeline.arrays import Array
from pipeline.clock import utc
from pipeline.config import MotorSpec
from pipeline.night.block_fit import OWN, REFERENCE, BlockFit, in_form
from pipeline.night.parameter_rows import parameter_rows
from pipeline.night.residuals import residual_columns, residual_test_rows, residual_verdict_rows
from pipeline.night.statistics import NightStatistics, mean_charge_bar
from pipeline.night.stored_blocks import CHANNELS
from pipeline.night.time_base import Samples
from pipeline.night.viscosity import mean_ratio

Row = dict[str, Any]
Rows = dict[str, list[Row]]


def unfitted_row(
    spec: MotorSpec, night: dt.date, status: str, reason: str, code: str | None
) -> Row:
    """The one row in `fits` of a night without a fit."""
    return {
        "motor_id": spec.motor_id,
        "motor_type": spec.file.motor_type,
        "night": night,
        "flushing_mode": spec.file.flushing.mode,
        "is_primary": True,
        "status": status,
        "reason": reason,
        "error_code": code,
        "oil": spec.file.oil_on(night),
    }


def fit_rows(
    spec: MotorSpec,
    night: dt.date,
    statistics: NightStatistics,
    modes: Sequence[BlockFit],
    sensitivities: Sequence[Row],
) -> Rows:
    """Rows of `fits` and of all tables below a fit, for all modes of flushing."""
    shared = _shared_columns(spec, night, statistics)
    stated = spec.stated.motor(night, spec.file.flushing.mode)

    def judged_on(part: str | None = None) -> Array:
        return in_form(spec, stated, statistics.judged_on(part))

    motor_night = {"motor_id": spec.motor_id, "night": night}
    period_s = statistics.samples.period_us / 1e6
    rows: Rows = {
        "fits": [],
        "parameters": [],
        "sensitivities": [motor_night | row for row in sensitivities],
        "residual_tests": [],
        "residual_verdicts": [],
    }
    for mode in modes:
        key = motor_night | {"flushing_mode": mode.name}
        own = shared | key | _mode_columns(spec, statistics, mode, judged_on)
        rows["fits"].append(own)
        rows["parameters"] += [key | row for row in parameter_rows(spec, mode)]
        for name, made in (
            ("residual_tests", residual_test_rows),
            ("residual_verdicts", residual_verdict_rows),
        ):
            rows[name] += [key | row for row in made(mode.residuals, period_s)]
    mark_modes(rows["fits"], spec.file.flushing.mode)
    return rows


def _shared_columns(spec: MotorSpec, night: dt.date, statistics: NightStatistics) -> Row:
    """Columns that a night's fits have in common."""
    samples, model = statistics.samples, spec.settings.model
    share = "" if model.film_pressure == "slot" else f" {model.film_pressure_share:g}"
    return {
        "motor_type": spec.file.motor_type,
        "window_start": utc(samples.time_us[0]),
        "window_end": utc(samples.time_us[-1]),
        "status": "ok",
        "n_training": sum(one.n for one in statistics.blocks if one.part == TRAINING),
        "n_validation": sum(one.n for one in statistics.blocks if one.part == VALIDATION),
        "smoothing_s": spec.settings.smoothing.window_s,
        **reference_columns(spec),
        "mean_flow_l_per_min": float(samples.leakage_l_per_min.mean()),
        "kept_share": samples.kept_share,
        "film_pressure": f"{model.film_pressure}{share}",
        "two_sided": model.two_sided,
        "loss": spec.settings.estimation.loss,
        "oil": spec.file.oil_on(night),
        "model_hash": statistics.model_hash,
        "n_kept": len(samples.index),
        "sample_period_s": samples.period_us / 1e6,
        "mean_charge_over_case_bar": mean_charge_bar(spec, samples),
        "weight_inflation": statistics.inflation,
        "transport_delay_s": _mean_delay_s(samples),
        "is_refitted": False,
        "viscosity_ratio": mean_ratio(
            statistics.viscosity_ratios, [block.n for block in statistics.blocks]
        ),
    }


def reference_columns(spec: MotorSpec) -> Row:
    """The fleet's reference conditions."""
    return {f"reference_{name}": getattr(spec.settings.reference, name) for name in CHANNELS}


def _mean_delay_s(samples: Samples) -> float | None:
    """Mean transport delay of the kept samples; None where it is off."""
    if samples.delay_s is None:
        return None
    return float(samples.delay_s[samples.index - samples.first_index].mean())


def _covariance_columns(mode: BlockFit) -> Row:
    """Covariance of θ and its root; a coefficient without a distribution has zeros."""
    names, found = ("coefficient_covariance", "coefficient_covariance_root"), mode.identification
    if found.distribution is None:
        return dict.fromkeys(names)
    row, on = {}, np.ix_(found.distribution.active, found.distribution.active)
    matrices = found.distribution.covariance(), found.distribution.covariance_root()
    for name, matrix in zip(names, matrices, strict=True):
        whole = np.zeros((len(mode.fit.coefficients),) * 2)
        whole[on] = matrix
        row[name] = upper_triangle(whole)
    return row


def upper_triangle(matrix: Array) -> list[float]:
    """The upper triangle of a square matrix, row by row, as tables hold it."""
    values: list[float] = matrix[np.triu_indices(len(matrix))].tolist()
    return values


def _mode_columns(
    spec: MotorSpec,
    statistics: NightStatistics,
    mode: BlockFit,
    judged_on: Callable[..., Array],
) -> Row:
    """Figures of one fit."""
    agrees = judged_on, mode.training
    # As of a night fitted from its weighted blocks, which cannot tell how the samples agree.
    if spec.settings.estimation.loss != "squared":
        agrees = statistics.judged_on, mode.stated.training
    return {
        "correlation_time_s": mode.memory_s,
        "columns": list(mode.fit.motor.columns),
        "night_factor": upper_triangle(judged_on()),
        **agreement_columns(spec, *agrees),
        **block_fit_columns(mode),
        **residual_columns(mode.residuals),
        **leakage_columns(spec, mode),
    }


def agreement_columns(
    spec: MotorSpec, judged_on: Callable[[str], Array], fitted: ProvenMinimum
) -> Row:
    """Agreement of the training fit with the training and the validation samples, and its criteria.

    The criteria are those of a squared loss: a robust one has none of them.
    """
    theta, resolution = fitted.coefficients, spec.file.channels["leakage_flow"].resolution
    training, validation = (
        agreement(judged_on(part), theta, resolution) for part in (TRAINING, VALIDATION)
    )
    row = _agreement(TRAINING, training) | _agreement(VALIDATION, validation)
    if spec.settings.estimation.loss == "squared":
        cost = (training.rmse_l_per_min or 0.0) ** 2
        row |= asdict(criteria(cost, fitted.n_estimated, training.n))
    return row


def _agreement(of: str, found: Agreement) -> Row:
    return {
        f"{of}_fit_percent": found.fit_percent,
        f"{of}_rmse_l_per_min": found.rmse_l_per_min,
        f"{of}_mean_error_l_per_min": found.mean_error_l_per_min,
    }


def previous_model_columns(
    spec: MotorSpec, night_factor: Array, previous: tuple[float, ...] | None
) -> Row:
    """Agreement of the model before, if any, with all samples, given their factor."""
    found = Agreement(0, None, None, None)
    if previous is not None and len(previous) == len(night_factor) - 2:
        resolution = spec.file.channels["leakage_flow"].resolution
        found = agreement(night_factor, np.array(previous), resolution)
    return _agreement("previous_model", found)


def block_fit_columns(mode: BlockFit) -> Row:
    """Columns of a fit that are computed from its blocks."""
    proven_minimum, fit, slow = mode.fit.proven_minimum, mode.fit, mode.identification.slow
    pressure, temperature, speed = mode.own_means
    rests_on = mode.reference.information
    condition = proven_minimum.condition_number
    return {
        "cost": proven_minimum.cost,
        "dual_residual": proven_minimum.dual_residual,
        "rank": proven_minimum.rank,
        "condition_number": condition if np.isfinite(condition) else None,
        "singular_values": proven_minimum.singular_values.tolist(),
        "coefficients": fit.coefficients.tolist(),
        **_covariance_columns(mode),
        "interval_status": _interval_status(mode),
        "n_interval_blocks": mode.identification.n_blocks,
        "n_parameters": mode.training.n_estimated,
        "own_pressure_bar": pressure,
        "own_temperature_c": temperature,
        "own_speed_rpm": speed,
        "slow_error_memory": slow.memory,
        "slow_error_ratio": slow.variance_ratio,
        "within_block_inflation": slow.within,
        "slow_error_evidence": slow.evidence,
        "reference_degrees_of_freedom": rests_on and rests_on.degrees_of_freedom,
        "reference_block_share": rests_on and rests_on.largest_block_share,
    }


def _interval_status(mode: BlockFit) -> str:
    """``ok``, how long slow errors remember, or why there are no intervals."""
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


def mark_modes(rows: Sequence[Row], primary: str) -> None:
    """Mark the primary fit of a night, and the one that is best on validation."""
    on_validation = [row["validation_fit_percent"] for row in rows]
    best = max((fit for fit in on_validation if fit is not None), default=None)
    for row in rows:
        row["is_primary"] = row["flushing_mode"] == primary
        row["is_best_on_validation"] = (
            None if best is None else row["validation_fit_percent"] == best
        )


def leakage_columns(spec: MotorSpec, mode: BlockFit) -> Row:
    """Reference leakage and leakage at own conditions, where they are told, with intervals."""
    misfit = mode.stated.misfit
    return {
        "reference_verdict": mode.reference.verdict,
        "reference_reason": mode.reference.reason or None,
        "outside_fitted_range": mode.reference.verdict in OUTSIDE,
        "own_conditions_verdict": mode.own.verdict,
        "own_conditions_reason": mode.own.reason or None,
        **_leakage(REFERENCE, mode.reference, mode),
        **_leakage(OWN, mode.own, mode),
        "model_misfit_percent": misfit and 100.0 * misfit.share,
        "model_noise_percent": misfit and 100.0 * misfit.noise_share,
        **_roller_columns(spec, mode),
    }


def _roller_columns(spec: MotorSpec, mode: BlockFit) -> Row:
    """Scale of the rollers' curve, as the night tells it, and whether the fit uses it."""
    row: Row = {"roller_is_free": spec.roller_is_free}
    row |= dict.fromkeys(("roller_scale", "roller_scale_half_width", "roller_verdict"))
    if mode.roller is None:
        return row
    judged = mode.roller.judgement
    return row | {
        "roller_scale": mode.roller.value,
        "roller_scale_half_width": judged.interval and judged.interval.half_width,
        "roller_verdict": judged.verdict,
    }


def _leakage(name: str, found: LeakageJudgement, mode: BlockFit) -> Row:
    parts = mode.errors[name].columns()
    ends = ("l_per_min", "lower", "upper", "systematic", *parts)
    row: Row = dict.fromkeys(f"{name}_{end}" for end in ends)
    if found.is_told:
        row |= {f"{name}_{end}": half_width for end, half_width in parts.items()}
        row[f"{name}_l_per_min"] = found.leakage_l_per_min
        row[f"{name}_systematic"] = mode.systematic.get(name)
        if found.interval is not None:
            row[f"{name}_lower"] = found.leakage_l_per_min - found.interval.half_width
            row[f"{name}_upper"] = found.leakage_l_per_min + found.interval.half_width
    return row
