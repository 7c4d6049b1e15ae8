"""The indicators of a motor's nights, each with its interval, or why it is gated."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from leakage import LeakageError, Motor, OperatingConditions, Parametrisation, regressors
from leakage.block_statistics import merge
from leakage.certificate import certify
from pipeline.config import MotorSpec
from pipeline.schema import PRESSURE_EDGES_BAR, SPEED_EDGES_RPM, TEMPERATURE_EDGES_C
from pipeline.trends.history import Estimates, History

Array = NDArray[np.float64]

REFERENCE, OWN_REFERENCE = "reference_leakage", "own_reference_leakage"
DEVIATION, PEER_DEVIATION = "baseline_deviation", "peer_deviation"
FLUSHING = "C_f"
# A figure that is known no better than this is no figure for a trend (model.md, section 5).
WIDEST_LEAKAGE = 0.02
# Scatter below which no baseline is believed, relative to the figure (model.md, section 7).
FLOOR_OF_LEAKAGE, FLOOR_OF_COEFFICIENT = 0.01, 0.05
TRUSTED = ("identified", "fixed")
LEVEL = 0.95


@dataclass(frozen=True, slots=True)
class Indicator:
    """A figure over a motor's nights; shape (n,) each.

    Attributes
    ----------
    name, unit
        As in `trends`.
    value
        nan where gated.
    lower, upper
        95 % interval; nan where there is none.
    gated
        Why a night does not count; empty where it does.
    floor
        Least standard deviation of its baseline, relative to the mean.
    outside
        Whether its conditions lie outside what the night's samples saw.
    n_nights
        Nights that were fitted together for each figure.
    """

    name: str
    unit: str
    value: Array
    lower: Array
    upper: Array
    gated: tuple[str, ...]
    floor: float
    outside: NDArray[np.bool_]
    n_nights: NDArray[np.int64]

    @property
    def counts(self) -> NDArray[np.bool_]:
        """Nights that count, shape (n,)."""
        return np.isfinite(self.value)

    @property
    def standard_error(self) -> Array:
        """Of each night's figure; nan where there is no interval."""
        error: Array = (self.upper - self.lower) / (2.0 * float(ndtri(0.5 + LEVEL / 2)))
        return error


@dataclass(frozen=True, slots=True)
class OwnConditions:
    """The conditions that a motor's own reference leakage is told at, frozen with its baseline."""

    pressure_bar: float
    temperature_c: float
    speed_rpm: float


def status_gates(history: History) -> tuple[str, ...]:
    """Why a night has no fit; empty where it has one."""
    return tuple(
        "" if status == "ok" else f"{status.replace('_', ' ')}: {reason}" if reason else status
        for status, reason in zip(history.words("status"), history.words("reason"), strict=True)
    )


def reference_leakage(history: History) -> Indicator:
    """Leakage at the fleet's reference conditions."""
    verdicts, reasons = history.words("reference_verdict"), history.words("reference_reason")
    gated = tuple(
        status or ("" if verdict in TRUSTED else reason or verdict.replace("_", " "))
        for status, verdict, reason in zip(status_gates(history), verdicts, reasons, strict=True)
    )
    return _indicator(
        REFERENCE,
        "l/min",
        history.column("reference_leakage_l_per_min"),
        history.column("reference_leakage_lower"),
        history.column("reference_leakage_upper"),
        gated,
        FLOOR_OF_LEAKAGE,
        outside=np.array([verdict == "outside_fitted_range" for verdict in verdicts]),
    )


def coefficients(history: History) -> Iterator[Indicator]:
    """K of each path, and the flushing where it is estimated: only where it is identified."""
    for name, found in history.parameters.items():
        if name == FLUSHING:
            if "identified" in found.verdict:
                yield _estimated(history, name, "l/min", found, FLOOR_OF_LEAKAGE)
        elif name.startswith("K_"):
            yield _estimated(history, name, "m3", found, FLOOR_OF_COEFFICIENT)


def _estimated(history: History, name: str, unit: str, found: Estimates, floor: float) -> Indicator:
    gated = tuple(
        status or ("" if verdict == "identified" else reason or verdict.replace("_", " "))
        for status, verdict, reason in zip(
            status_gates(history), found.verdict, found.reason, strict=True
        )
    )
    return _indicator(name, unit, found.value, found.lower, found.upper, gated, floor)


def scaled(indicator: Indicator, name: str, unit: str, factor: float) -> Indicator:
    """The same over the nights times a constant: a path's leakage from its K."""
    return replace(
        indicator,
        name=name,
        unit=unit,
        value=factor * indicator.value,
        lower=factor * indicator.lower,
        upper=factor * indicator.upper,
    )


def gap_change(indicator: Indicator, name: str, baseline: float) -> Indicator:
    """Change of a gap in %, (K/K_baseline)^⅓ − 1: it needs no geometry."""

    def change(k: Array) -> Array:
        percent: Array = 100.0 * (np.cbrt(k / baseline) - 1.0)
        return percent

    return replace(
        indicator,
        name=name,
        unit="%",
        value=change(indicator.value),
        lower=change(indicator.lower),
        upper=change(indicator.upper),
    )


def at_conditions(spec: MotorSpec, history: History, own: OwnConditions) -> Indicator:
    """Leakage at the motor's own reference conditions, flushing excluded.

    From θ and its covariance: the published intervals are those of other conditions.
    """
    n = len(history.nights)
    value, half, outside = np.full(n, np.nan), np.full(n, np.nan), np.zeros(n, dtype=np.bool_)
    gated = list(status_gates(history))
    charge = history.column("mean_charge_over_case_bar")
    rows: dict[object, Array | str] = {}
    for place in range(n):
        if gated[place]:
            continue
        above = None if np.isnan(charge[place]) else float(charge[place])
        key = (spec.file.oil_on(history.nights[place]), above)
        if key not in rows:
            rows[key] = _row_at(spec, history, place, own, above)
        row = rows[key]
        outside[place] = not _seen(history, place, own)
        if isinstance(row, str):
            gated[place] = row
        elif (reason := history.fits["interval_status"][place]) != "ok":
            gated[place] = str(reason)
        elif outside[place]:
            gated[place] = "the motor's own reference conditions lie outside what the night saw"
        else:
            value[place], half[place] = _leakage(history, place, row)
            if not half[place] <= WIDEST_LEAKAGE * abs(value[place]):
                gated[place] = (
                    f"known to ± {100 * half[place] / abs(value[place]):.1f} % only; "
                    f"{100 * WIDEST_LEAKAGE:.0f} % are needed"
                )
    return _indicator(
        OWN_REFERENCE,
        "l/min",
        value,
        value - half,
        value + half,
        tuple(gated),
        FLOOR_OF_LEAKAGE,
        outside=outside,
    )


def _row_at(
    spec: MotorSpec, history: History, place: int, own: OwnConditions, above: float | None
) -> Array | str:
    """Regressors at the own conditions; where the model does not hold there, why."""
    night, mode = history.nights[place], str(history.fits["flushing_mode"][place])
    try:
        motor = spec.motor(night, mode)
        at = OperatingConditions.from_bar(own.pressure_bar, own.temperature_c, own.speed_rpm, above)
        row: Array = regressors(motor, at)[0]
    except LeakageError as error:
        return str(error)
    return row


def _leakage(history: History, place: int, row: Array) -> tuple[float, float]:
    """Leakage and half-width of its interval at some conditions; nan where there is none."""
    theta = np.array(history.fits["coefficients"][place], dtype=np.float64)
    if len(theta) != len(row) - 1:
        return np.nan, np.nan
    contrast = np.append(row[:-2], 0.0)
    covariance = _symmetric(history.fits["coefficient_covariance"][place], len(theta))
    error = np.nan if covariance is None else np.sqrt(contrast @ covariance @ contrast)
    leakage = float(contrast @ theta + row[-1])
    return leakage, float(ndtri(0.5 + LEVEL / 2) * error)


def _symmetric(upper: Sequence[float] | None, size: int) -> Array | None:
    """A symmetric matrix from its upper triangle, row by row."""
    if upper is None or len(upper) != size * (size + 1) // 2:
        return None
    matrix = np.zeros((size, size))
    matrix[np.triu_indices(size)] = upper
    return matrix + np.triu(matrix, 1).T


def covariance_of(history: History, place: int) -> Array | None:
    """Covariance of θ of a night, shape (p + 1, p + 1); None without intervals."""
    theta = history.fits["coefficients"][place]
    if theta is None:
        return None
    return _symmetric(history.fits["coefficient_covariance"][place], len(theta))


def _seen(history: History, place: int, own: OwnConditions) -> bool:
    """Whether a night's samples lie on both sides of some conditions, by its histograms."""
    for name, edges, value in (
        ("pressure", PRESSURE_EDGES_BAR, own.pressure_bar),
        ("temperature", TEMPERATURE_EDGES_C, own.temperature_c),
        ("speed", SPEED_EDGES_RPM, own.speed_rpm),
    ):
        counts = history.operation[f"{name}_histogram"][place]
        if counts is None:
            return False
        filled = np.flatnonzero(np.array(counts))
        if not len(filled) or not edges[filled[0]] <= value <= edges[filled[-1] + 1]:
            return False
    return True


def own_conditions(history: History, chosen: NDArray[np.bool_]) -> OwnConditions | None:
    """Medians of the night's mean conditions over some nights; None where there are none."""
    figures = [
        history.column(name)[chosen]
        for name in ("own_pressure_bar", "own_temperature_c", "own_speed_rpm")
    ]
    if not len(figures[0]) or any(np.isnan(one).all() for one in figures):
        return None
    return OwnConditions(*(float(np.nanmedian(one)) for one in figures))


def baseline_model(spec: MotorSpec, history: History, chosen: NDArray[np.bool_]) -> Array | None:
    """θ fitted to some nights together, from their statistics; shape (p + 1,).

    None where their statistics are not of one kind or too few.
    """
    places = [
        place
        for place in np.flatnonzero(chosen)
        if history.fits["night_factor"][int(place)] is not None
    ]
    if not places:
        return None
    columns = {tuple(history.fits["columns"][int(place)]) for place in places}
    if len(columns) != 1:
        return None
    night, mode = history.nights[places[-1]], str(history.fits["flushing_mode"][int(places[-1])])
    motor: Motor = spec.motor(night, mode)
    if motor.columns != next(iter(columns)):
        return None
    size = len(motor.columns)
    factors = np.stack([_factor(history, int(place), size) for place in places])
    try:
        theta: Array = certify(
            merge(factors), *Parametrisation.of(motor).coefficient_bounds()
        ).coefficients
    except LeakageError:
        return None
    return theta


def _factor(history: History, place: int, size: int) -> Array:
    matrix = np.zeros((size, size))
    matrix[np.triu_indices(size)] = history.fits["night_factor"][place]
    return matrix


def log_ratio(history: History, theta: Array) -> Array:
    """ln (mean flow / mean flow that a model predicts), flushing of the model taken off both.

    Of each night's kept samples as they are: it needs no fit of the night, only its statistics.

    Returns
    -------
    ndarray
        Shape (n,); nan where there is no figure.
    """
    n = len(history.nights)
    result = np.full(n, np.nan)
    for place in range(n):
        numbers = history.fits["night_factor"][place]
        size = len(theta) + 2
        if numbers is None or len(numbers) != size * (size + 1) // 2:
            continue
        r = _factor(history, place, size)
        # Column of ones times all columns: sums over the samples.
        sums = r.T @ r[:, size - 3]
        measured = sums[-1] - theta[-1] * sums[size - 3]
        predicted = sums[: size - 3] @ theta[:-1] + sums[-2]
        if measured > 0 and predicted > 0:
            result[place] = np.log(measured / predicted)
    return result


def deviation(history: History, name: str, ratio: Array, reason: str) -> Indicator:
    """A logarithmic deviation from a baseline as an indicator; relative, 0 for none."""
    gated = tuple(
        status or ("" if np.isfinite(one) else reason)
        for status, one in zip(status_gates(history), ratio, strict=True)
    )
    value = np.expm1(ratio)
    nothing = np.full(len(value), np.nan)
    return _indicator(name, "1", value, nothing, nothing, gated, FLOOR_OF_LEAKAGE)


def _indicator(
    name: str,
    unit: str,
    value: Array,
    lower: Array,
    upper: Array,
    gated: tuple[str, ...],
    floor: float,
    *,
    outside: NDArray[np.bool_] | None = None,
) -> Indicator:
    counts = np.array([not reason for reason in gated], dtype=np.bool_) & np.isfinite(value)

    def only(figures: Array) -> Array:
        return np.where(counts, figures, np.nan)

    reasons = tuple(
        reason or ("" if there else "no figure")
        for reason, there in zip(gated, counts, strict=True)
    )
    n = len(value)
    return Indicator(
        name,
        unit,
        only(value),
        only(lower),
        only(upper),
        reasons,
        floor,
        np.zeros(n, dtype=np.bool_) if outside is None else outside,
        np.ones(n, dtype=np.int64),
    )
