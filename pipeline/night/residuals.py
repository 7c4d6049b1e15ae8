"""Residual analysis of a night's fit: each part, on the unsmoothed columns and on the smoothed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leakage.residual_analysis import ResidualAnalysis, analyse_residuals
from leakage.sample_blocks import TRAINING, VALIDATION
from leakage.smoothing import smooth
from leakage.validation import lag_one_autocorrelation
from pipeline.arrays import chosen_rows
from pipeline.config import Smoothing
from pipeline.night.statistics import NightStatistics

Array = NDArray[np.float64]

INPUTS = ("pressure_difference", "oil_temperature", "speed")
# Errors below this share of the flow are rounding.
ROUNDING = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class PartResiduals:
    """Residual analysis of one part of a night.

    Attributes
    ----------
    part
        training or validation.
    smoothed
        Whether columns and inputs were smoothed as for the fit.
    analysis
        What was found.
    lag_one_autocorrelation
        Correlation of each error with the one before it; None where there is no pair, or no spread.
    """

    part: str
    smoothed: bool
    analysis: ResidualAnalysis
    lag_one_autocorrelation: float | None


def night_residuals(
    statistics: NightStatistics,
    coefficients: Array,
    correlation_time_s: float,
    smoothing: Smoothing,
) -> tuple[PartResiduals, ...]:
    """Residual analyses of a fit: of training and validation, unsmoothed and, if any, smoothed."""
    samples = statistics.samples
    error_of = -np.concatenate([coefficients, (1.0, -1.0)])
    inputs = np.stack(
        [
            np.abs(samples.pressure_difference_bar),
            samples.oil_temperature_c,
            np.abs(samples.speed_rpm),
        ]
    )
    columns = [(False, statistics.unsmoothed, inputs)]
    if statistics.z is not statistics.unsmoothed:
        columns.append((True, statistics.z, _smoothed(inputs, statistics, smoothing)))
    memory = correlation_time_s * 1e6 / samples.period_us
    rounding = ROUNDING * float(np.abs(samples.leakage_l_per_min).max())
    found = []
    for smoothed, z, seen in columns:
        error = z @ error_of
        for part in (TRAINING, VALIDATION):
            rows = chosen_rows(statistics.rows_of(part))
            chosen, index = error[rows], samples.index[rows]
            by_name = dict(zip(INPUTS, seen[:, rows], strict=True))
            analysis = analyse_residuals(chosen, by_name, index, memory, rounding)
            lag_one = lag_one_autocorrelation(chosen, np.diff(index) == 1)
            found.append(PartResiduals(part, smoothed, analysis, lag_one))
    return tuple(found)


def _smoothed(inputs: Array, statistics: NightStatistics, smoothing: Smoothing) -> Array:
    """Inputs, shape (3, n), averaged with the rest, or as they are where only the flow was."""
    if smoothing.apply_to == "leakage":
        return inputs
    samples = statistics.samples
    return smooth(
        inputs.T, samples.index, statistics.short_block, samples.period_us, smoothing.window_s
    ).T
