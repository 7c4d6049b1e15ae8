"""A motor fitted to a frame of samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from leakage.arrays import Array, Mask
from leakage.errors import LeakageError, ShapeError
from leakage.estimation.block_fit import SampleBlocks, fit_blocks
from leakage.estimation.blocks import (
    NONE_CHOSEN,
    SECOND_US,
    TRAINING,
    VALIDATION,
    ChosenPeriods,
    CompressedSamples,
    Windows,
    compress,
    places_on_clock,
    split_into_blocks,
)
from leakage.estimation.identifiability import Excitation
from leakage.estimation.sensitivities import Tolerances
from leakage.estimation.validation import agreement
from leakage.frame.result import FrameFit
from leakage.frame.samples import FrameSamples, Period, read_samples
from leakage.physics.motor import Motor, regressors
from leakage.physics.paths import FLUSHING_PARAMETER, FLUSHING_PATH, Constant, Parameter

HIGHEST_FLUSHING_L_PER_MIN = 20.0
DAY_US = 86_400 * SECOND_US


def fit_frame(
    frame: Any,
    motor: Motor,
    *,
    flushing: float | Literal["none", "estimated"] | None = None,
    train: Period | Sequence[Period] | None = None,
    validate: Period | Sequence[Period] | None = None,
    columns: Mapping[str, str] | None = None,
    tolerances: Tolerances | None = None,
    windows: Windows | None = None,
    smoothing_s: float = 0.0,
) -> FrameFit:
    """Fit a motor to a frame of samples.

    The samples are taken as they are: ``pipeline.notebook.prepare`` cleans and resamples raw ones
    as the nightly run does, whose fit this is.

    Parameters
    ----------
    frame
        A frame of pandas, Polars, PyArrow or any other that narwhals knows, or arrays by name:
        ``time`` (dates, naive ones in UTC, or seconds), ``pressure_bar``, ``oil_temperature_c``,
        ``speed_rpm``, ``leakage_l_per_min`` (the measured drain flow), and ``charge_over_case_bar``
        where leakage is two-sided. Rows in which a value is missing are left out.
    motor
        The motor with its oil.
    flushing
        Flow that is added before the sensor: ``"none"``, a known flow [l/min], or ``"estimated"``.
        None: as the motor declares it.
    train, validate
        Periods that the motor is fitted to and judged on: begin and end, or several such pairs, in
        the frame's times. Only blocks that lie within a period as a whole count. None: estimates
        are from all samples; a fit to the first 80 % of them is judged on the others.
    columns
        Names of the columns in the frame, where they differ.
    tolerances
        Stated tolerances of sensors; they widen the total ± and may change verdicts.
    windows
        Length of a block, and the split; None: 120 s, and 80 % train.
    smoothing_s
        Length of a moving average of flow and regressors alike [s]; 0: none.

    Raises
    ------
    ShapeError
        If a column is missing, or in another unit by its name.
    StatisticsError
        If times fall or repeat, or no row is complete.
    EstimationError
        If there are fewer training samples than free coefficients.
    ValidityError
        If a temperature is outside of the range of the oil's viscosity.
    LeakageError
        ``period``: a period is empty, or holds no block; ``flushing``: it is none of these.

    Examples
    --------
    >>> from leakage import AnnularGap, Motor, Oil, Parameter
    >>> oil = Oil.from_reference_viscosities(
    ...     "VG 46", temperature_1_c=40.0, viscosity_1_mm2_per_s=46.0, temperature_2_c=100.0,
    ...     viscosity_2_mm2_per_s=6.8, density_15_c_kg_per_m3=880.0,
    ...     thermal_expansion_per_k=7e-4, pressure_viscosity_per_pa=2e-8)
    >>> gap = AnnularGap("gap", 9, 0.01, 0.03, Parameter("h_gap", "um", 15.0, 1.0, 60.0), None)
    >>> motor, rng = Motor("pump", (gap,), oil), np.random.default_rng(1)
    >>> samples = {"time": np.arange(7200.0), "pressure_bar": rng.uniform(50, 250, 7200),
    ...            "oil_temperature_c": rng.uniform(40, 55, 7200),
    ...            "speed_rpm": np.full(7200, 900.0)}
    >>> from leakage import OperatingConditions, total_flow_l_per_min
    >>> at = OperatingConditions.from_bar(*(samples[name] for name in list(samples)[1:]))
    >>> samples["leakage_l_per_min"] = total_flow_l_per_min(motor, at) + rng.normal(0, 0.002, 7200)
    >>> fitted = fit_frame(samples, motor)
    >>> fitted.judgements["K_gap"].verdict, bool(fitted.validation.fit_percent > 90)
    ('identified', True)
    """
    motor = _with_flushing(motor, flushing)
    if not motor.column_paths:
        raise ShapeError("motor_paths", f"{motor.motor_type} has no path that is free to estimate")
    samples, windows = read_samples(frame, columns), windows or Windows()
    chosen = ChosenPeriods(samples.stretches(train), samples.stretches(validate))
    if chosen and not chosen.training:
        raise LeakageError("period", "validate= is given without train=: say both, or neither")
    short = split_into_blocks(samples.time_us, 0, windows, chosen or NONE_CHOSEN)
    if chosen and all(block.part != TRAINING for block in short):
        raise LeakageError(
            "period",
            f"no block of {windows.block_s:g} s lies within the training period as a whole: the"
            " samples are of another time, or the period is too short",
        )
    days = 1 + int(samples.time_us[-1] - samples.time_us[0]) // DAY_US
    index, period_us = samples.index, samples.period_us
    made = compress(
        _columns(motor, samples),
        index,
        period_us,
        short,
        maximum_blocks=windows.maximum_blocks * days,
        smoothing_s=smoothing_s,
    )
    sizes = [block.n for block in made.blocks]
    used = np.array([not chosen or block.part == TRAINING for block in made.blocks])
    blocks = _sample_blocks(samples, made, used)
    estimate = fit_blocks(blocks, motor)
    theta = estimate.training.coefficients
    fitted = FrameFit(
        motor=motor,
        samples=samples,
        parts=np.repeat([block.part for block in made.blocks], sizes),
        used=np.repeat(used, sizes),
        blocks=blocks,
        estimate=estimate,
        training=agreement(made.factor_of(TRAINING), theta),
        validation=agreement(made.factor_of(VALIDATION), theta),
        tolerances=tolerances,
        identification=estimate.identify(blocks.excitation),
        beside_samples=np.zeros(len(theta)),
    )
    return fitted.with_errors_beside()


def _with_flushing(motor: Motor, flushing: float | str | None) -> Motor:
    if flushing is None:
        return motor
    others = tuple(path for path in motor.paths if not isinstance(path, Constant))
    if flushing == "none":
        return replace(motor, paths=others)
    if flushing == "estimated":
        limits = (0.0, 0.0, HIGHEST_FLUSHING_L_PER_MIN)
    elif isinstance(flushing, str):
        raise LeakageError("flushing", f'flushing {flushing!r}: say "none", "estimated" or a flow')
    else:
        limits = (float(flushing),) * 3
    flow = Parameter(FLUSHING_PARAMETER, "l_per_min", *limits, fixed=flushing != "estimated")
    return replace(motor, paths=(*others, Constant(FLUSHING_PATH, flow)))


def _columns(motor: Motor, samples: FrameSamples) -> Array:
    """Return columns of the samples as ``motor.columns``, shape (n, c)."""
    # Column by column in memory as in the nightly run: other sums differ in their last bits.
    z = np.empty((len(samples.time_us), len(motor.columns)), order="F")
    regressors(motor, samples.conditions, out=z[:, :-1])
    z[:, -1] = samples.measured_l_per_min
    return z


def _sample_blocks(samples: FrameSamples, made: CompressedSamples, used: Mask) -> SampleBlocks:
    """Return the blocks behind the estimates."""
    blocks = [block for block, is_used in zip(made.blocks, used, strict=True) if is_used]
    borders_us = np.array([(block.start_us, block.end_us) for block in blocks]).T
    channels = (samples.oil_temperature_c, samples.pressure_bar, samples.speed_rpm)
    parts = [[channel[block.first_row : block.end_row] for channel in channels] for block in blocks]
    celsius, bar, rpm = (
        (min(float(part.min()) for part in of), max(float(part.max()) for part in of))
        for of in zip(*parts, strict=True)
    )
    return SampleBlocks(
        made.factors[used],
        *places_on_clock(*borders_us),
        np.array([block.part == TRAINING for block in blocks]),
        np.array([[float(part.mean()) for part in of] for of in parts]),
        Excitation(bar, celsius, rpm),
    )
