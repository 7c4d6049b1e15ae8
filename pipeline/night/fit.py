"""The fit from stored blocks: of a night just read, of a night fitted anew, of nights together.

The total ± of a figure, of samples, sensors and model, is half the width of a 95 % interval; a
stated tolerance counts as two standard deviations. A motor that is compared with itself takes the
statistical part alone: what its sensors and its model do wrong is the same on all nights.
"""

from __future__ import annotations

import datetime as dt
import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from leakage import EstimationError, LeakageError, Motor, OperatingConditions, regressors
from leakage.estimation.block_fit import BlockEstimate, fit_blocks
from leakage.estimation.blocks import merge, with_free_known
from leakage.estimation.identifiability import (
    Excitation,
    Identification,
    Judgement,
    LeakageJudgement,
    identify,
    is_outside,
    judge_by_total,
    judge_leakage,
)
from leakage.estimation.misfit import COEFFICIENT_FACTOR, LEAKAGE_FACTOR, Misfit, model_errors
from leakage.estimation.proven_minimum import Fit, ProvenMinimum, fit
from leakage.estimation.sensitivities import (
    SENSORS,
    ChannelTolerance,
    Tolerances,
    error_budget,
)
from leakage.estimation.uncertainty import Interval
from pipeline.arrays import Array
from pipeline.config import MotorSpec
from pipeline.config.channels import Channel
from pipeline.night.statistics import NightStatistics, StoredBlocks
from pipeline.schema import Row

REFERENCE, OWN = "fitted_leakage", "own_conditions_leakage"
# ± of a change of all loss factors with temperature, which a single night cannot tell (model.md,
# section 5) [1/K].
UNKNOWN_PER_KELVIN = 0.01
PRESSURES = ("pressure_difference", "high_port_pressure", "low_port_pressure")
# EN 837-1, class 1: 1 % of the range, which is this where the config tells none [bar].
PRESSURE_CLASS, PRESSURE_RANGE_BAR = 0.01, 400.0
# IEC 60751, class B: 0.3 + 0.005 |t|, at 50 °C [K].
PT100_CLASS_B_K = 0.55
# Gear meters within their range: 1 % of the reading.
GEAR_METER = 0.01
# Channels of which a tolerance is assumed; of the speed none is.
ASSUMED = ("pressure_difference", "oil_temperature", "leakage_flow")
# Samples that carry the tolerances: the effects are smooth, and more would not move them.
SENSITIVITY_SAMPLES = 1500


@dataclass(frozen=True, slots=True)
class ErrorParts:
    """Half-widths of a figure, in its unit."""

    statistical: float | None  # of the interval from the samples; None without it
    sensor: float  # from tolerances of the sensors, stated or assumed
    model: float | None  # from the night's structured misfit; None where it is not known
    # From tolerances of constants, as far as they are not the same on all nights.
    constants: float = 0.0

    @property
    def beside_samples(self) -> float:
        """All parts but the statistical."""
        return math.hypot(self.sensor, self.model or 0.0, self.constants)

    @property
    def total(self) -> float | None:
        """Of all parts, by their squares; None without an interval from the samples."""
        if self.statistical is None:
            return None
        return math.hypot(self.statistical, self.beside_samples)


@dataclass(frozen=True, slots=True)
class BlockFit:
    """The fit under a mode of flushing."""

    name: str  # none, fixed or estimated
    # fit, identification: estimates from all kept samples; verdicts and intervals.
    fit: Fit
    # training: The fit to the training samples alone, which is validated on the others
    training: ProvenMinimum
    # Estimates of the model as it is stated: what the predictions and the misfit are of.
    stated: BlockEstimate
    identification: Identification
    block_s: float  # usual length of the blocks [s]
    duration_s: float  # time from the first sample to the last [s]
    reference_conditions: OperatingConditions  # where the reference leakage is evaluated
    reference: LeakageJudgement  # leakage there
    # ± from stated tolerances by indicator, in its unit; without those that have none.
    systematic: Mapping[str, float]
    errors: Mapping[str, ErrorParts]  # parts of the ± by indicator
    # Scale of the rollers' curve by the blocks, and the verdict on it, whether or not the fit uses
    # it; None without such a curve.
    roller: tuple[float, Judgement] | None


def fit_modes(
    spec: MotorSpec, night: dt.date, statistics: NightStatistics, blocks: StoredBlocks
) -> tuple[list[BlockFit], list[Row]]:
    """Return a fit for each mode of flushing, the primary first, and rows of `error_budget`.

    Raises EstimationError if there are fewer samples than free coefficients.
    """
    at = conditions(spec, blocks)
    fits, rows = [], []
    for mode in spec.file.flushing.modes:
        motor = spec.stated.motor(night, mode)
        budget = list(_budget_rows(spec, statistics, motor, at, night))
        fits.append(fit_stored_blocks(spec, night, mode, blocks, at, budget))
        rows += [{"flushing_mode": mode} | row for row in budget]
    return fits, rows


def fit_stored_blocks(
    spec: MotorSpec,
    night: dt.date,
    mode: str,
    blocks: StoredBlocks,
    at: tuple[OperatingConditions, OperatingConditions],
    budget: Sequence[Mapping[str, Any]],
) -> BlockFit:
    """Fit a motor to blocks; `at` are its :func:`conditions`, `budget` rows of the mode.

    Raises EstimationError if there are fewer training samples than free
    coefficients.
    """
    motor = spec.stated.motor(night, mode)
    samples = blocks.sample_blocks()
    stated = fit_blocks(samples, motor)
    made = stated
    if spec.roller_is_free and motor.standard is not None:
        free, samples = motor.with_free_standard(), samples.with_free_known(*scale_of(motor))
        made = fit_blocks(samples, free)
    fitted, excitation = made.fit, samples.excitation
    identification = made.identify(excitation)
    where = dict(zip((REFERENCE, OWN), at, strict=True))
    misfits = made.misfit, stated.misfit
    errors = _errors(made, identification, excitation, misfits, where, budget)
    beside = errors[REFERENCE].beside_samples
    total = {
        place: errors[path.coefficient_name].total
        for place, path in enumerate(fitted.motor.coefficient_paths)
        if path is not None and path.coefficient_name in errors
    }
    return BlockFit(
        name=mode,
        fit=fitted,
        training=made.training,
        stated=stated,
        identification=judge_by_total(fitted, identification, total),
        block_s=samples.block_s,
        duration_s=blocks.duration_s,
        reference_conditions=at[0],
        reference=judge_leakage(fitted, identification, excitation, at[0], beside),
        systematic=by_squares(row for row in budget if not row["is_assumed"]),
        errors=errors,
        roller=_roller(motor, made, identification, excitation),
    )


def conditions(
    spec: MotorSpec, blocks: StoredBlocks
) -> tuple[OperatingConditions, OperatingConditions]:
    """Return the reference conditions, and the mean ones of some blocks."""
    charge_bar = blocks.charge_bar
    return (
        spec.settings.reference.conditions(charge_bar).operating,
        OperatingConditions.from_bar(*blocks.means(), charge_bar),
    )


def scale_of(motor: Motor) -> tuple[int, float]:
    """Return place of the scale of a motor's standard once it is free, and its configured value."""
    assert motor.standard is not None
    place = motor.with_free_standard().columns.index(motor.standard.name)
    return place, motor.standard.configured_coefficient


def _roller(
    motor: Motor,
    made: BlockEstimate,
    identification: Identification,
    excitation: Excitation,
) -> tuple[float, Judgement] | None:
    """Return scale of the rollers' curve of a motor as stated, from whitened blocks."""
    if motor.standard is None:
        return None
    place, configured = scale_of(motor)
    fitted = made.fit
    if fitted.motor.columns == motor.columns:
        factors = with_free_known(made.whitened, place, configured)
        try:
            fitted = fit(merge(factors), motor.with_free_standard())
        except EstimationError:
            return None
        identification = identify(fitted, factors, excitation, made.slow)
    return float(fitted.coefficients[place]), identification.coefficients[place]


def _errors(
    made: BlockEstimate,
    identification: Identification,
    excitation: Excitation,
    misfits: tuple[Misfit | None, Misfit | None],
    at: Mapping[str, OperatingConditions],
    budget: Sequence[Mapping[str, Any]],
) -> dict[str, ErrorParts]:
    """Return parts of the ± of each leakage, by the first misfit, of coefficients by the second."""
    fitted, distribution = made.fit, identification.distribution
    fixed = fitted.proven_minimum.fixed
    sensors = by_squares(row for row in budget if _is_sensor(row))
    rows = {name: regressors(fitted.motor, place)[0] for name, place in at.items()}
    leakages = {name: row[:-2] @ fitted.unbounded[:-1] + row[-1] for name, row in rows.items()}
    constants = 0.0
    if is_outside(excitation, at[REFERENCE]) and leakages[OWN] > 0.0:
        ratio = float(leakages[REFERENCE] / leakages[OWN])
        apart_k = float(at[REFERENCE].oil_temperature_c[0] - at[OWN].oil_temperature_c[0])
        gaps = float(leakages[REFERENCE] - rows[REFERENCE][-1])
        constants = math.hypot(
            of_extrapolation(budget, ratio),
            # The night is fitted before its motor's own change with temperature is known.
            UNKNOWN_PER_KELVIN * apart_k * gaps,
        )
    # Name, contrast, interval by the samples, misfit, and what a figure takes of the misfit.
    figures: list[tuple[str, Array, Interval | None, Misfit | None, float]] = []
    for name, row in rows.items():
        contrast = np.append(row[:-2], 0.0)
        interval = None if distribution is None else distribution.interval(contrast)
        figures.append((name, contrast, interval, misfits[0], LEAKAGE_FACTOR))
    for place, path in enumerate(fitted.motor.coefficient_paths):
        if path is not None and not fixed[place]:
            contrast = np.eye(len(fixed))[place]
            interval = identification.coefficients[place].information
            name = path.coefficient_name
            figures.append((name, contrast, interval, misfits[1], COEFFICIENT_FACTOR))
    reach = np.zeros(len(figures))
    if any(misfits):
        reach = model_errors(made.whole, fixed, np.array([figure[1] for figure in figures]), 1.0)
    return {
        name: ErrorParts(
            None if interval is None else interval.half_width,
            sensors.get(name, 0.0),
            None if misfit is None else float(factor * size * misfit.l_per_min),
            constants if name == REFERENCE else 0.0,
        )
        for (name, _, interval, misfit, factor), size in zip(figures, reach, strict=True)
    }


def by_squares(budget: Iterable[Mapping[str, Any]]) -> dict[str, float]:
    """Return ± of each indicator from the sources in some rows of `error_budget`."""
    effects: defaultdict[str, list[float]] = defaultdict(list)
    for row in budget:
        effects[row["indicator"]].append(row["effect"])
    return {indicator: math.hypot(*parts) for indicator, parts in effects.items()}


def of_extrapolation(budget: Iterable[Mapping[str, Any]], ratio: float) -> float:
    """Return ± of the reference leakage against the own, by constants, scaled by their ratio."""
    effects: defaultdict[str, float] = defaultdict(float)
    scale = {REFERENCE: 1.0, OWN: -ratio}
    for row in budget:
        if row["indicator"] in scale and not _is_sensor(row):
            effects[row["source"]] += row["effect"] * scale[row["indicator"]]
    return math.hypot(*effects.values())


def _is_sensor(row: Mapping[str, Any]) -> bool:
    return str(row["source"]).startswith(SENSORS)


def _budget_rows(
    spec: MotorSpec,
    statistics: NightStatistics,
    motor: Motor,
    at: tuple[OperatingConditions, OperatingConditions],
    night: dt.date,
) -> Iterator[Row]:
    """Yield rows of `error_budget` by evenly thinned samples; none beyond a law's validity."""
    n = len(statistics.samples.index)
    chosen = np.linspace(0, n - 1, min(SENSITIVITY_SAMPLES, n)).round().astype(np.int64)
    thinned = statistics.conditions.part(chosen)
    flow = statistics.samples.leakage_l_per_min[chosen]
    reference, own = at
    with suppress(LeakageError):
        budget = error_budget(motor, thinned, flow, tolerances(spec, night), [reference], [own])
        assumed = assumed_sensors(spec)
        for effect in budget.effects:
            figures = [
                (path.coefficient_name, path.coefficient_unit, float(effect.coefficients[place]))
                for place, path in enumerate(motor.coefficient_paths)
                if path is not None and path.is_free
            ]
            reference_effect, own_effect = effect.leakages_l_per_min.tolist()
            figures.append((REFERENCE, "l_per_min", reference_effect))
            figures.append((OWN, "l_per_min", own_effect))
            for indicator, unit, size in figures:
                yield {
                    "indicator": indicator,
                    "unit": unit,
                    "effect": size,
                    "source": effect.source.name,
                    "tolerance": effect.source.tolerance,
                    "tolerance_unit": effect.source.unit,
                    "is_assumed": effect.source.name.split()[0] in assumed,
                }


def tolerances(spec: MotorSpec, night: dt.date) -> Tolerances:
    """Return tolerances of channels, oil and model; of two ports the difference's, by squares."""
    oil, charge = spec.oil_on(night), spec.file.channels.get("charge_pressure")
    return Tolerances(
        pressure_bar=_of(spec, "pressure_difference"),
        temperature_c=_of(spec, "oil_temperature"),
        speed_rpm=_of(spec, "speed"),
        flow_l_per_min=_of(spec, "leakage_flow"),
        pressure_viscosity=oil.pressure_viscosity_tolerance_percent / 100,
        density=oil.density_tolerance_percent / 100,
        charge_pressure_bar=charge.offset_tolerance if charge else 0.0,
    )


def assumed_sensors(spec: MotorSpec) -> list[str]:
    """Return channels whose tolerance is that of their kind of sensor, as none is stated."""
    return [name for name in ASSUMED if not any(map(_is_stated, _channels(spec, name).values()))]


def _channels(spec: MotorSpec, name: str) -> dict[str, Channel]:
    """Return the channels that an input is read from."""
    names = PRESSURES if name == "pressure_difference" else (name,)
    return {key: spec.file.channels[key] for key in names if key in spec.file.channels}


def _is_stated(channel: Channel) -> bool:
    return bool(channel.offset_tolerance or channel.gain_tolerance_percent)


def _of(spec: MotorSpec, name: str) -> ChannelTolerance:
    channels = _channels(spec, name)
    if any(map(_is_stated, channels.values())):
        parts = [
            (channel.offset_tolerance, channel.gain_tolerance_percent / 100)
            for channel in channels.values()
        ]
    else:
        parts = [_assumed_tolerance(key, channel) for key, channel in channels.items()]
    offset, gain = (float(np.hypot.reduce(part)) for part in zip(*parts, strict=True))
    return ChannelTolerance(offset, gain)


def _assumed_tolerance(name: str, channel: Channel) -> tuple[float, float]:
    """Return offset and gain by the kind of sensor; of the speed none is assumed."""
    if name in PRESSURES:
        highest = channel.valid_range[1] if channel.valid_range else PRESSURE_RANGE_BAR
        return PRESSURE_CLASS * (channel.sensor_maximum or highest), 0.0
    if name == "oil_temperature":
        return PT100_CLASS_B_K, 0.0
    return 0.0, GEAR_METER if name == "leakage_flow" else 0.0
