"""The rows that a motor's night leaves in each table."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from leakage import (
    AnnularGap,
    Fit,
    LeakagePath,
    Motor,
    OperatingConditions,
    Parametrisation,
    film_thickness_ratio,
    leakage_l_per_min,
    path_flows_l_per_min,
    speed_beyond_curve,
)
from leakage.block_statistics import merge
from leakage.validation import (
    agreement,
    criteria,
    effective_sample_count,
    lag_one_autocorrelation,
)
from pipeline.config import MotorSpec
from pipeline.resample import Quality, Samples
from pipeline.schema import PRESSURE_EDGES_BAR, SPEED_EDGES_RPM, TEMPERATURE_EDGES_C
from pipeline.windows import TRAINING, VALIDATION, Block

Array = NDArray[np.float64]
Row = dict[str, Any]
Rows = dict[str, list[Row]]

# Points a night in the table of predictions: enough for a plot, not for an analysis.
PREDICTION_POINTS = 400
MICROMETRE = 1e-6


@dataclass(frozen=True, slots=True)
class NightStatistics:
    """A night's kept samples with their columns and the statistics of its blocks.

    Attributes
    ----------
    samples
        The kept samples.
    z
        Their columns, smoothed where that was asked for; shape (n, c).
    blocks
        Blocks as they are stored.
    factors
        Triangular factor of each, shape (b, c, c).
    model_hash
        Hash of all that shaped them.
    """

    samples: Samples
    z: Array
    blocks: tuple[Block, ...]
    factors: Array
    model_hash: str

    def factor_of(self, part: str | None = None) -> Array:
        """Factor of all blocks of a part, or of the whole night; from the blocks as stored."""
        chosen = [part is None or block.part == part for block in self.blocks]
        return merge(self.factors[np.array(chosen, dtype=bool)])

    def rows_of(self, part: str) -> NDArray[np.bool_]:
        """Which of the kept samples belong to a part."""
        return np.repeat(
            [block.part == part for block in self.blocks], [block.n for block in self.blocks]
        )


@dataclass(frozen=True, slots=True)
class FittedMode:
    """The fit under one mode of flushing."""

    name: str
    fit: Fit


def utc(microseconds: int) -> dt.datetime:
    """A time stamp as the tables hold it."""
    return dt.datetime(1970, 1, 1, tzinfo=dt.UTC) + dt.timedelta(microseconds=int(microseconds))


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


def quality_rows(motor_id: str, night: dt.date, found: Sequence[Quality]) -> list[Row]:
    """Rows of `quality`: every rule that was applied, those that refused nothing too."""
    return [
        {
            "motor_id": motor_id,
            "night": night,
            "channel": one.channel,
            "reason": one.reason,
            "n_samples": one.n_samples,
            "n_refused": one.n_refused,
        }
        for one in found
    ]


def statistics_rows(
    motor_id: str, night: dt.date, motor: Motor, statistics: NightStatistics
) -> list[Row]:
    """Rows of `block_statistics`."""
    samples = statistics.samples
    beyond = speed_beyond_curve(motor, samples.speed_rpm)
    channels = {
        "pressure": ("bar", np.abs(samples.pressure_difference_bar), PRESSURE_EDGES_BAR),
        "temperature": ("c", samples.oil_temperature_c, TEMPERATURE_EDGES_C),
        "speed": ("rpm", np.abs(samples.speed_rpm), SPEED_EDGES_RPM),
    }
    upper = np.triu_indices(len(motor.columns))
    rows = []
    for block, r in zip(statistics.blocks, statistics.factors, strict=True):
        part = slice(block.first_row, block.end_row)
        row: Row = {
            "motor_id": motor_id,
            "night": night,
            "block_start": utc(block.start_us),
            "block_end": utc(block.end_us),
            "part": block.part,
            "n": block.n,
            "columns": list(motor.columns),
            "statistics": r[upper].tolist(),
            "share_reversed": float(np.mean(samples.speed_rpm[part] < 0)),
            "n_beyond_curve": int(beyond[part].sum()),
            "model_hash": statistics.model_hash,
        }
        for name, (unit, values, edges) in channels.items():
            row |= _spread(name, unit, values[part], edges)
        rows.append(row)
    return rows


def _spread(name: str, unit: str, values: Array, edges: tuple[float, ...]) -> Row:
    """Mean, limits and coarse histogram of a channel in a block; the end bins hold all beyond."""
    bins = np.searchsorted(edges, values, side="right") - 1
    counts = np.bincount(np.clip(bins, 0, len(edges) - 2), minlength=len(edges) - 1)
    return {
        f"mean_{name}_{unit}": float(values.mean()),
        f"minimum_{name}_{unit}": float(values.min()),
        f"maximum_{name}_{unit}": float(values.max()),
        f"{name}_histogram": counts.tolist(),
    }


def fit_rows(
    spec: MotorSpec,
    night: dt.date,
    statistics: NightStatistics,
    modes: Sequence[FittedMode],
    previous: Mapping[str, tuple[float, ...]],
) -> Rows:
    """Rows of `fits`, `parameters` and `starts` for all modes of flushing."""
    shared = _shared_columns(spec, night, statistics)
    rows: Rows = {"fits": [], "parameters": [], "starts": []}
    for mode in modes:
        key = {"motor_id": spec.motor_id, "night": night, "flushing_mode": mode.name}
        own = _mode_columns(spec, statistics, mode, previous.get(mode.name))
        primary = mode.name == spec.file.flushing.mode
        rows["fits"].append(shared | key | {"is_primary": primary} | own)
        rows["parameters"] += [key | row for row in parameter_rows(spec, mode.fit)]
        rows["starts"] += [key | row for row in start_rows(mode.fit)]
    return rows


def _shared_columns(spec: MotorSpec, night: dt.date, statistics: NightStatistics) -> Row:
    """What a night's fits have in common."""
    samples, model = statistics.samples, spec.settings.model
    used = statistics.rows_of(TRAINING) | statistics.rows_of(VALIDATION)
    reference = spec.settings.reference
    share = "" if model.film_pressure == "slot" else f" {model.film_pressure_share:g}"
    own = _own_conditions(samples)
    return {
        "motor_type": spec.file.motor_type,
        "window_start": utc(samples.time_us[used][0]),
        "window_end": utc(samples.time_us[used][-1]),
        "status": "ok",
        "n_training": int(statistics.rows_of(TRAINING).sum()),
        "n_validation": int(statistics.rows_of(VALIDATION).sum()),
        "smoothing_s": spec.settings.smoothing.window_s,
        "reference_pressure_bar": reference.pressure_bar,
        "reference_temperature_c": reference.temperature_c,
        "reference_speed_rpm": reference.speed_rpm,
        "own_pressure_bar": own[0],
        "own_temperature_c": own[1],
        "own_speed_rpm": own[2],
        "outside_fitted_range": _outside(spec, samples, statistics.rows_of(TRAINING)),
        "mean_flow_l_per_min": float(samples.leakage_l_per_min.mean()),
        "kept_share": samples.kept_share,
        "film_pressure": f"{model.film_pressure}{share}",
        "oil": spec.file.oil_on(night),
        "model_hash": statistics.model_hash,
    }


def _own_conditions(samples: Samples) -> tuple[float, float, float]:
    """Mean pressure difference [bar], temperature [°C] and speed [rpm], as magnitudes."""
    return (
        float(np.abs(samples.pressure_difference_bar).mean()),
        float(samples.oil_temperature_c.mean()),
        float(np.abs(samples.speed_rpm).mean()),
    )


def _outside(spec: MotorSpec, samples: Samples, training: NDArray[np.bool_]) -> bool:
    """Whether the reference conditions lie outside what the training samples saw."""
    reference = spec.settings.reference
    return any(
        not values[training].min() <= wanted <= values[training].max()
        for values, wanted in (
            (np.abs(samples.pressure_difference_bar), reference.pressure_bar),
            (samples.oil_temperature_c, reference.temperature_c),
            (np.abs(samples.speed_rpm), reference.speed_rpm),
        )
    )


def _mode_columns(
    spec: MotorSpec,
    statistics: NightStatistics,
    mode: FittedMode,
    previous: tuple[float, ...] | None,
) -> Row:
    """Figures of one fit."""
    certificate, fit = mode.fit.certificate, mode.fit
    resolution = spec.file.channels["leakage_flow"].resolution
    training = agreement(statistics.factor_of(TRAINING), fit.coefficients, resolution)
    validation = agreement(statistics.factor_of(VALIDATION), fit.coefficients, resolution)
    before = None
    if previous is not None and len(previous) == len(fit.coefficients):
        before = agreement(statistics.factor_of(), np.array(previous), resolution).fit_percent
    d = certificate.n_free_off_bounds
    figures = criteria(certificate.cost, d, training.n)
    reference = spec.settings.reference
    at_reference = _leakage_at(
        fit, reference.pressure_bar, reference.temperature_c, reference.speed_rpm
    )
    condition = certificate.condition_number
    return {
        "training_fit_percent": training.fit_percent,
        "validation_fit_percent": validation.fit_percent,
        "previous_model_fit_percent": before,
        "training_rmse_l_per_min": training.rmse_l_per_min,
        "validation_rmse_l_per_min": validation.rmse_l_per_min,
        "fpe": figures.fpe,
        "aic": figures.aic,
        "aicc": figures.aicc,
        "bic": figures.bic,
        "n_effective": _effective(statistics, fit),
        "cost": certificate.cost,
        "certificate_gap": fit.certificate_gap,
        "dual_residual": certificate.dual_residual,
        "n_starts": len(fit.starts),
        "n_starts_at_minimum": len(fit.starts_at_minimum),
        "rank": certificate.rank,
        "condition_number": condition if np.isfinite(condition) else None,
        "n_free_off_bounds": d,
        "reference_leakage_l_per_min": at_reference,
        "own_conditions_leakage_l_per_min": _leakage_at(fit, *_own_conditions(statistics.samples)),
    }


def _leakage_at(fit: Fit, bar: float, celsius: float, rpm: float) -> float:
    """Leakage of a fitted motor at one condition, flushing excluded [l/min]."""
    conditions = OperatingConditions.from_bar(bar, celsius, rpm)
    return float(leakage_l_per_min(fit.motor, conditions, fit.coefficients_by_path)[0])


def _effective(statistics: NightStatistics, fit: Fit) -> float | None:
    """Effective number of training samples, from the lag-one correlation of their errors."""
    chosen = statistics.rows_of(TRAINING)
    error = statistics.z[chosen] @ np.concatenate([fit.coefficients, (1.0, -1.0)])
    consecutive = np.diff(statistics.samples.index[chosen]) == 1
    return effective_sample_count(len(error), lag_one_autocorrelation(error, consecutive))


def parameter_rows(spec: MotorSpec, fit: Fit) -> list[Row]:
    """Rows of `parameters`: every coefficient, what it says of gaps, and shares of the leakage."""
    certificate = fit.certificate
    columns = Parametrisation.of(fit.motor).paths
    places = {path.name: index for index, path in enumerate(columns) if path}
    spreads = _spreads(fit)
    rows: list[Row] = []
    for path in fit.motor.paths:
        place = places.get(path.name)
        value = path.configured_coefficient if place is None else certificate.coefficients[place]
        fixed = place is None or bool(certificate.fixed[place])
        bound = place is not None and bool(
            certificate.at_lower[place] or certificate.at_upper[place]
        )
        rows.append(
            {
                "parameter": path.coefficient_name,
                "value": float(value),
                "unit": path.coefficient_unit,
                "verdict": "fixed" if fixed else "at_bound" if bound else None,
                "reason": "held at its configured value"
                if fixed
                else "the minimum lies on a bound of the parameters"
                if bound
                else None,
                "spread_over_starts": None if fixed else spreads.get(path.coefficient_name),
            }
        )
        if isinstance(path, AnnularGap):
            rows += _gap_rows(spec, path, float(value), fixed, spreads)
    return rows + _share_rows(spec, fit)


def _gap_rows(
    spec: MotorSpec, path: AnnularGap, coefficient: float, fixed: bool, spreads: Mapping[str, float]
) -> list[Row]:
    """What a loss factor says of gap height, eccentricity and film thickness."""
    low, high = path.feasible_gap_um(coefficient)
    eccentricity = path.eccentricity
    alone = eccentricity is None or eccentricity.fixed
    known_e = 0.0 if eccentricity is None else eccentricity.value
    combination = f"only K_{path.name} ∝ h³(1 + 1.5e²) shows in the data"
    verdict = {
        "verdict": "fixed" if fixed else None if alone else "only_in_combination",
        "reason": None if fixed or alone else combination,
    }
    gap: Row = {
        "parameter": f"h_{path.name}",
        "value": low if alone or fixed else None,
        "unit": "um",
        "feasible_min": low,
        "feasible_max": high,
        "spread_over_starts": spreads.get(f"h_{path.name}"),
    } | verdict
    roughness = [um * MICROMETRE for um in spec.motor_type.surface_roughness_um]
    e_low, e_high = (
        (0.0, 0.0) if eccentricity is None else (eccentricity.lowest, eccentricity.highest)
    )
    ratios = film_thickness_ratio(
        np.array([low, high]) * MICROMETRE, np.array([e_high, e_low]), *roughness
    ).tolist()
    film: Row = {
        "parameter": f"film_thickness_ratio_{path.name}",
        "value": ratios[0] if alone or fixed else None,
        "unit": "1",
        "feasible_min": ratios[0],
        "feasible_max": ratios[1],
    } | verdict
    if eccentricity is None:
        return [gap, film]
    e_row: Row = {
        "parameter": f"e_{path.name}",
        "value": known_e if alone or fixed else None,
        "unit": "1",
        "feasible_min": e_low,
        "feasible_max": e_high,
        "spread_over_starts": spreads.get(f"e_{path.name}"),
        "verdict": "fixed" if alone or fixed else "only_in_combination",
        "reason": None if alone or fixed else combination,
    }
    return [gap, e_row, film]


def _spreads(fit: Fit) -> dict[str, float]:
    """Largest minus smallest value of parameters and coefficients over starts at the minimum."""
    starts = fit.starts_at_minimum
    if not starts:
        return {}
    parametrisation = Parametrisation.of(fit.motor)
    finals = np.array([start.final for start in starts])
    thetas = np.array([parametrisation.coefficients(final)[0] for final in finals])
    names = [path.coefficient_name if path else "" for path in parametrisation.paths]
    spreads = dict(zip(names, np.ptp(thetas, axis=0).tolist(), strict=True))
    free = [parameter.name for parameter in parametrisation.free]
    return spreads | dict(zip(free, np.ptp(finals, axis=0).tolist(), strict=True))


def _share_rows(spec: MotorSpec, fit: Fit) -> list[Row]:
    """Share of each path in the reference leakage, flushing excluded."""
    reference = spec.settings.reference
    conditions = OperatingConditions.from_bar(
        reference.pressure_bar, reference.temperature_c, reference.speed_rpm
    )
    flows = path_flows_l_per_min(fit.motor, conditions, fit.coefficients_by_path)
    paths: list[LeakagePath] = [path for path in fit.motor.paths if path is not fit.motor.constant]
    total = sum(float(flows[path.name][0]) for path in paths)
    if total <= 0.0:
        return []
    return [
        {
            "parameter": f"share_{path.name}",
            "value": float(flows[path.name][0]) / total,
            "unit": "1",
        }
        for path in paths
    ]


def start_rows(fit: Fit) -> list[Row]:
    """Rows of `starts`."""
    names = [parameter.name for parameter in Parametrisation.of(fit.motor).free]
    reached = {start.number for start in fit.starts_at_minimum}
    return [
        {
            "start": start.number,
            "cost": start.cost if np.isfinite(start.cost) else None,
            "status": start.status,
            "reason": start.reason,
            "iterations": start.iterations,
            "at_minimum": start.number in reached,
            "parameters": names,
            "initial_values": start.initial.tolist(),
            "final_values": start.final.tolist(),
        }
        for start in fit.starts
    ]


def prediction_rows(
    motor_id: str, night: dt.date, statistics: NightStatistics, modes: Sequence[FittedMode]
) -> list[Row]:
    """Rows of `predictions`: evenly thinned kept samples, measured and predicted."""
    samples = statistics.samples
    n = len(samples.time_us)
    chosen = np.unique(np.linspace(0, n - 1, min(PREDICTION_POINTS, n)).round().astype(np.int64))
    parts = np.repeat(
        [block.part for block in statistics.blocks], [block.n for block in statistics.blocks]
    )[chosen].tolist()
    z = statistics.z[chosen]
    times = [utc(stamp) for stamp in samples.time_us[chosen].tolist()]
    inputs = {
        "pressure_difference_bar": np.abs(samples.pressure_difference_bar)[chosen].tolist(),
        "oil_temperature_c": samples.oil_temperature_c[chosen].tolist(),
        "speed_rpm": np.abs(samples.speed_rpm)[chosen].tolist(),
        "measured_l_per_min": z[:, -1].tolist(),
    }
    rows: list[Row] = []
    for mode in modes:
        predicted = (z[:, :-1] @ np.append(mode.fit.coefficients, 1.0)).tolist()
        key = {"motor_id": motor_id, "night": night, "flushing_mode": mode.name}
        columns = {"time": times, "part": parts, **inputs, "predicted_l_per_min": predicted}
        rows += [
            key | dict(zip(columns, values, strict=True))
            for values in zip(*columns.values(), strict=True)
        ]
    return rows
