"""Rows of a night's fits, and of the tables below a fit: how it went, and what it says.

And what the samples say beside it: of the fit's errors, cold oil, and the drain flow's lag.
"""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from statistics import fmean, stdev

import numpy as np

from leakage import Motor, regressors
from leakage.estimation.blocks import ROUNDING, TRAINING, VALIDATION, with_free_known
from leakage.estimation.identifiability import ONE_BLOCK, Judgement
from leakage.estimation.residual_analysis import LagTest, ResidualAnalysis, analyse_residuals
from leakage.estimation.transport_lag import transport_lag
from leakage.estimation.validation import agreement, criteria
from leakage.physics.motor import path_flows_l_per_min
from leakage.physics.paths import Law
from pipeline.arrays import Array, chosen_rows
from pipeline.clock import utc
from pipeline.config import MotorSpec
from pipeline.night.fit import REFERENCE, BlockFit, scale_of
from pipeline.night.statistics import CHANNELS, NightStatistics, StoredBlocks
from pipeline.schema import LAG_COLUMNS, OF_NIGHT, Row

Rows = dict[str, list[Row]]

MICROMETRE = 1e-6
# A share is identified where it is known to this much of the whole, or to half of itself.
WIDEST_SHARE = 0.02
ROLLER_COLUMNS = ("roller_scale", "roller_scale_lower", "roller_scale_upper", "roller_verdict")
INPUTS = ("pressure_difference", "oil_temperature", "speed")

# A motor that rested so long starts cold, and is warm after as long: the first of these after which
# there are pieces enough. Errors of the time between differ from later ones by this share of the
# flow, and by their scatter over pieces.
MINUTE = dt.timedelta(minutes=1)
WARM_UPS, PIECE = (30 * MINUTE, 20 * MINUTE, 10 * MINUTE), 10 * MINUTE
COLD_SHARE, COLD_SCATTERS, FEWEST_PIECES = 0.03, 3.0, 3


def night_row(
    spec: MotorSpec,
    night: dt.date,
    data: Row,
    status: str,
    reason: str | None = None,
    code: str | None = None,
) -> Row:
    """Return row of a night in `nights`, as far as the night fills it; `data` is of samples."""
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
    """Return the row in `fits` of a night without a fit."""
    mode = spec.file.flushing.mode
    return {"motor_id": spec.motor_id, "night": night, "flushing_mode": mode, "is_primary": True}


def fit_rows(
    spec: MotorSpec,
    night: dt.date,
    statistics: NightStatistics,
    blocks: StoredBlocks,
    modes: Sequence[BlockFit],
    residuals: Sequence[Mapping[str, ResidualAnalysis]],
    budget: Sequence[Row],
) -> Rows:
    """Return rows of `fits` and of all tables below a fit, for all modes of flushing."""
    samples, period_s = statistics.samples, statistics.samples.period_us / 1e6
    shared = {
        "window_start": utc(samples.time_us[0]),
        "window_end": utc(samples.time_us[-1]),
        "n_training": sum(block.n for block in statistics.blocks if block.part == TRAINING),
        "n_validation": sum(block.n for block in statistics.blocks if block.part == VALIDATION),
        **lag_columns(statistics),
    }
    motor_night = {"motor_id": spec.motor_id, "night": night}
    rows: Rows = {
        "fits": [],
        "parameters": [],
        "error_budget": [motor_night | row for row in budget],
        "residual_tests": [],
    }
    for mode, errors in zip(modes, residuals, strict=True):
        key = motor_night | {"flushing_mode": mode.name}
        own = fit_columns(spec, mode, blocks) | residual_columns(errors, period_s)
        own |= {"is_primary": mode.name == spec.file.flushing.mode}
        rows["fits"].append(shared | key | own)
        rows["parameters"] += [key | row for row in parameter_rows(spec, mode)]
        rows["residual_tests"] += [key | row for row in residual_test_rows(errors, period_s)]
    return rows


def of_fit(fits: Sequence[Row]) -> Row:
    """Return columns of `nights` that say how well the primary of a night's fits went."""
    (fit,) = [row for row in fits if row["is_primary"]]
    names = ("training_fit_percent", "validation_fit_percent")
    return {name: fit[name] for name in names} | {"rmse_l_per_min": math.sqrt(fit["cost"])}


def reference_columns(spec: MotorSpec) -> Row:
    """Return the fleet's reference conditions."""
    return {f"reference_{name}": getattr(spec.settings.reference, name) for name in CHANNELS}


def fit_columns(spec: MotorSpec, mode: BlockFit, blocks: StoredBlocks) -> Row:
    """Return columns of `fits` that are computed from blocks."""
    fit, proven_minimum = mode.fit, mode.fit.proven_minimum
    condition, misfit = proven_minimum.condition_number, mode.stated.misfit
    return {
        **reference_columns(spec),
        **_agreement_columns(spec, mode, blocks),
        "cost": proven_minimum.cost,
        "rank": proven_minimum.rank,
        "condition_number": condition if np.isfinite(condition) else None,
        "coefficient_names": coefficient_names(fit.motor),
        "coefficients": fit.coefficients.tolist(),
        "interval_status": _interval_status(mode),
        **_leakage_columns(mode),
        "model_misfit_percent": misfit and 100.0 * misfit.share,
        "model_noise_percent": misfit and 100.0 * misfit.noise_share,
        **_roller_columns(mode),
    }


def _agreement_columns(spec: MotorSpec, mode: BlockFit, blocks: StoredBlocks) -> Row:
    """Return how the training fit agrees with training and validation samples, and its criteria."""
    theta, resolution = mode.training.coefficients, spec.file.channels["leakage_flow"].resolution
    motor, of_parts = mode.stated.fit.motor, {}
    for part in (TRAINING, VALIDATION):
        factor = blocks.factor_of(part)
        if spec.roller_is_free and motor.standard is not None:
            factor = with_free_known(factor[None], *scale_of(motor))[0]
        of_parts[part] = agreement(factor, theta, resolution)
    row: Row = {
        f"{part}_{name}": getattr(of_part, name)
        for part, of_part in of_parts.items()
        for name in ("fit_percent", "rmse_l_per_min", "mean_error_l_per_min")
    }
    training = of_parts[TRAINING]
    cost = (training.rmse_l_per_min or 0.0) ** 2
    return row | asdict(criteria(cost, mode.training.n_estimated, training.n))


def coefficient_names(motor: Motor) -> list[str]:
    """Return names of θ's coefficients, as `parameters` has them."""
    return [path.coefficient_name if path else "C_f" for path in motor.coefficient_paths]


def _interval_status(mode: BlockFit) -> str:
    """Return ``ok``, how long slow errors remember, or why there are no intervals."""
    identification = mode.identification
    if identification.distribution is None and not mode.fit.proven_minimum.fixed.all():
        return ONE_BLOCK
    if not identification.slow.are_slow:
        return "ok"
    memory_s = identification.slow.memory_s(mode.block_s)
    minutes = memory_s / 60.0
    time = f"about {minutes:.0f} minutes" if minutes < 120 else f"about {minutes / 60:.0f} hours"
    if memory_s >= mode.duration_s:
        time = "longer than the log"
    return f"ok: the errors remember for {time}; the intervals allow for it"


def _leakage_columns(mode: BlockFit) -> Row:
    """Return leakage at the reference conditions by the night alone, where it is determined."""
    reference, parts = mode.reference, mode.errors[REFERENCE]
    value, interval = reference.leakage_l_per_min, reference.interval
    figures: Row = {
        "l_per_min": value,
        "lower": None if interval is None else value - interval.half_width,
        "upper": None if interval is None else value + interval.half_width,
        "statistical_l_per_min": parts.statistical,
        "sensor_l_per_min": parts.sensor,
        "model_l_per_min": parts.model,
        "total_l_per_min": parts.total,
    }
    if not reference.has_value:
        figures = dict.fromkeys(figures)
    words = {"verdict": reference.verdict, "reason": reference.reason or None}
    return {f"{REFERENCE}_{name}": figure for name, figure in (words | figures).items()}


def _roller_columns(mode: BlockFit) -> Row:
    """Return scale of the rollers' curve as the night shows it, whether or not the fit uses it."""
    row: Row = dict.fromkeys(ROLLER_COLUMNS)
    if mode.roller is not None:
        value, judgement = mode.roller
        row |= {"roller_scale": value, "roller_verdict": judgement.verdict}
        if judgement.interval is not None:
            row["roller_scale_lower"] = value - judgement.interval.half_width
            row["roller_scale_upper"] = value + judgement.interval.half_width
    return row


def parameter_rows(spec: MotorSpec, mode: BlockFit) -> list[Row]:
    """Return rows of `parameters`: coefficients, gaps by them, and shares of the leakage."""
    motor = mode.fit.motor
    places = {path.name: place for place, path in enumerate(motor.coefficient_paths) if path}
    rows: list[Row] = []
    for path in motor.paths:
        row = _coefficient_row(mode, path, places.get(path.name))
        if path is motor.standard:
            row["reason"] = _why_fixed(mode)
        rows += [row, *_derived_rows(spec, path, row)]
    return rows + _share_rows(mode)


def _why_fixed(mode: BlockFit) -> str:
    """Return reason why the scale of the rollers' curve is held as configured."""
    if mode.roller is not None and mode.roller[1].reason:
        return f"configured, as speed varies too little: {mode.roller[1].reason}"
    return "configured, as most of a baseline's first nights do not identify it yet"


def _coefficient_row(mode: BlockFit, path: Law, place: int | None) -> Row:
    """Return row of a coefficient: the configured value, else estimate and verdict."""
    if place is None:
        value, judgement = path.configured_coefficient, Judgement("fixed", "configured", None)
    else:
        value = float(mode.fit.coefficients[place])
        judgement = mode.identification.coefficients[place]
    row: Row = {
        "parameter": path.coefficient_name,
        "unit": path.coefficient_unit,
        "value": value,
        "verdict": judgement.verdict,
        "reason": judgement.reason or None,
    }
    if judgement.verdict != "fixed" and judgement.interval is not None:
        row |= _interval(value, judgement.interval.half_width)
        row["systematic"] = mode.systematic.get(path.coefficient_name)
    return row


def _interval(value: float, half_width: float) -> Row:
    return {"lower": value - half_width, "upper": value + half_width}


def _derived_rows(spec: MotorSpec, path: Law, coefficient: Row) -> list[Row]:
    """Return rows of the figures that a coefficient implies, each a value or a feasible range."""
    first, second = spec.motor_type.surface_roughness_um
    limits = (coefficient["lower"], coefficient["upper"]) if "lower" in coefficient else None
    rows: list[Row] = []
    for figure in path.derived_figures(
        coefficient["value"], limits, (first * MICROMETRE, second * MICROMETRE)
    ):
        row: Row = {
            "parameter": figure.name,
            "value": figure.lowest if figure.lowest == figure.highest else None,
            "unit": figure.unit,
            "feasible_min": figure.lowest,
            "feasible_max": figure.highest,
            "verdict": coefficient["verdict"],
            "reason": coefficient["reason"],
        }
        if figure.combination and coefficient["verdict"] != "fixed":
            row["verdict"] = "only_in_combination"
            row["reason"] = f"only {figure.combination} shows in the data"
        if figure.limits is not None:
            row["lower"], row["upper"] = figure.limits
        rows.append(row)
    return rows


def _share_rows(mode: BlockFit) -> list[Row]:
    """Return share of each path in the reference leakage, where the data determine it.

    With L = Σ K_i φ_i + known, K within bounds, the share Q_j / L has the gradient
    φ_i (δ_ij L − Q_j) / L².
    """
    reference, motor, at = mode.reference, mode.fit.motor, mode.reference_conditions
    names = [path.name for path in motor.paths if path is not motor.constant]
    rows: list[Row] = [{"parameter": f"share_{name}", "unit": "1", "value": None} for name in names]
    if not reference.has_value:
        return [row | {"verdict": reference.verdict, "reason": reference.reason} for row in rows]
    flows = path_flows_l_per_min(motor, at, mode.fit.coefficients_by_path)
    total = sum(float(flow[0]) for flow in flows.values())
    slopes = np.append(regressors(motor, at)[0, :-2], 0.0)
    places = {path.name: place for place, path in enumerate(motor.column_paths)}
    for name, row in zip(names, rows, strict=True):
        flow = float(flows[name][0])
        gradient = -slopes * flow / total**2
        if name in places:
            gradient[places[name]] += slopes[places[name]] / total
        row |= _share(mode, flow / total, gradient)
    return rows


def _share(mode: BlockFit, share: float, gradient: Array) -> Row:
    """Return value and verdict of a share, from its gradient."""
    if mode.reference.verdict == "fixed":
        return {"value": share, "verdict": "fixed", "reason": mode.reference.reason}
    distribution = mode.identification.distribution
    interval = None if distribution is None else distribution.interval(gradient)
    if interval is None:
        reason = "the samples do not span it"
        return {"value": share, "verdict": "not_identified", "reason": reason}
    if interval.half_width > max(WIDEST_SHARE, share / 2):
        reason = f"known to ± {100 * interval.half_width:.0f} % of the leakage only"
        return {"verdict": "not_identified", "reason": reason}
    return {"value": share, "verdict": "identified"} | _interval(share, interval.half_width)


def night_residuals(
    statistics: NightStatistics, coefficients: Array
) -> dict[str, ResidualAnalysis]:
    """Return the analyses of the errors before smoothing, of training and validation samples."""
    samples, driving = statistics.samples, statistics.conditions
    flow = samples.leakage_l_per_min
    rounding = ROUNDING * float(max(flow.max(), -flow.min()))
    error = statistics.unsmoothed @ -np.concatenate([coefficients, (1.0, -1.0)])
    inputs = (driving.pressure_difference_pa, driving.oil_temperature_c, driving.speed_rpm)
    analyses = {}
    for part in (TRAINING, VALIDATION):
        rows = chosen_rows(statistics.rows_of(part))
        of_part = {name: values[rows] for name, values in zip(INPUTS, inputs, strict=True)}
        analyses[part] = analyse_residuals(error[rows], of_part, samples.index[rows], rounding)
    return analyses


def residual_test_rows(residuals: Mapping[str, ResidualAnalysis], period_s: float) -> Iterator[Row]:
    """Yield rows of `residual_tests`: a test with its correlations and bounds at each lag."""
    for part, analysis in residuals.items():
        tests = {("whiteness", "none"): analysis.whiteness}
        tests |= {("independence", name): test for name, test in analysis.independence.items()}
        for (name, of), test in tests.items():
            key = {"part": part, "test": name, "input": of, "n": analysis.n}
            yield key | _columns_of(test, period_s)


def residual_columns(residuals: Mapping[str, ResidualAnalysis], period_s: float) -> Row:
    """Return columns of `fits`: how many independent samples there are, and the errors' memory."""
    memory = residuals[TRAINING].memory
    return {
        "correlation_time_s": None if memory is None else memory * period_s,
        **{f"n_{part}_effective": residuals[part].n_effective for part in (TRAINING, VALIDATION)},
    }


def _columns_of(test: LagTest, period_s: float) -> Row:
    lag, value = test.largest or (None, None)
    return {
        "verdict": test.verdict,
        "reason": test.reason,
        "p_value": test.p_value,
        "largest_correlation": value,
        "largest_lag_s": None if lag is None else lag * period_s,
        "lags_s": (test.lags * period_s).tolist(),
        "correlations": _finite(test.values),
        "bounds": _finite(test.bounds),
    }


def _finite(values: Array) -> list[float | None]:
    return [value if math.isfinite(value) else None for value in values.tolist()]


def lag_columns(statistics: NightStatistics) -> dict[str, float | None]:
    """Return columns of `fits` on the drain flow's lag in a night; null where it has none.

    It follows the model's own columns, and of machines that the model lacks something of, speed and
    the root of the pressure.
    """
    samples = statistics.samples
    drivers = (
        *statistics.unsmoothed[:, :-1].T,
        np.abs(samples.speed_rpm),
        np.sqrt(np.abs(samples.pressure_difference_bar)),
    )
    lag = transport_lag(
        samples.leakage_l_per_min, drivers, samples.index, samples.period_us / 1e6, samples.delay_s
    )
    figures = (None, None) if lag is None else (lag.seconds, 100.0 * lag.gain)
    return dict(zip(LAG_COLUMNS, figures, strict=True))


def explain_warm_up(predictions: list[Row]) -> Iterator[str]:
    """Yield that errors go with the time since the motor's last cold start, where they do."""
    rows = sorted(predictions, key=lambda row: row["time"])
    for length in WARM_UPS:
        cold, means = _cold_and_warm(rows, length)
        if cold and len(means) >= FEWEST_PIECES:
            break
    else:
        return
    flow = fmean([row["measured_l_per_min"] for row in rows])
    apart = fmean(cold) - fmean(means)
    if abs(apart) > max(COLD_SHARE * flow, COLD_SCATTERS * stdev(means)):
        yield (
            f"errors go with the time since the start: {100 * apart / flow:+.0f} % of the flow in "
            f"the first {length // MINUTE} minutes against later; cleaning.warm_up_minutes leaves "
            "out the minutes in which the oil in the case is not yet the oil at the sensor"
        )


def _cold_and_warm(rows: list[Row], length: dt.timedelta) -> tuple[list[float], list[float]]:
    """Return errors within a time of starts from a rest as long, and means of later pieces."""
    cold: list[float] = []
    warm: dict[tuple[dt.datetime, int], list[float]] = {}
    last = start = dt.datetime.min.replace(tzinfo=dt.UTC)
    for row in rows:
        if row["time"] - last >= length:
            start = row["time"]
        last = row["time"]
        error = row["measured_l_per_min"] - row["predicted_l_per_min"]
        piece = start, (last - start) // PIECE
        (cold if last - start < length else warm.setdefault(piece, [])).append(error)
    return cold, [fmean(errors) for errors in warm.values()]
