"""Residual analysis of a night's fit: each part, on the unsmoothed columns and on the smoothed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leakage.estimation.residual_analysis import ResidualAnalysis, analyse_residuals
from leakage.estimation.sample_blocks import TRAINING, VALIDATION
from leakage.estimation.smoothing import smooth
from leakage.estimation.validation import lag_one_autocorrelation
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
    fitted_error: Array,
    correlation_time_s: float,
    smoothing: Smoothing,
) -> tuple[PartResiduals, ...]:
    """Residual analyses of a fit: of training and validation, unsmoothed and, if any, smoothed.

    `fitted_error` are the errors of all samples in the columns that were fitted.
    """
    samples = statistics.samples
    driving = statistics.conditions
    inputs = [
        driving.pressure_difference_pa,
        driving.oil_temperature_c,
        driving.speed_rpm,
    ]
    columns = [(False, fitted_error, inputs)]
    if statistics.z is not statistics.unsmoothed:
        unsmoothed = statistics.unsmoothed @ -np.concatenate([coefficients, (1.0, -1.0)])
        columns = [(False, unsmoothed, inputs)]
        columns.append((True, fitted_error, _smoothed(inputs, statistics, smoothing)))
    memory = correlation_time_s * 1e6 / samples.period_us
    rounding = ROUNDING * float(np.abs(samples.leakage_l_per_min).max())
    found = []
    for smoothed, error, seen in columns:
        for part in (TRAINING, VALIDATION):
            rows = chosen_rows(statistics.rows_of(part))
            chosen, index = error[rows], samples.index[rows]
            by_name = {name: one[rows] for name, one in zip(INPUTS, seen, strict=True)}
            analysis = analyse_residuals(chosen, by_name, index, memory, rounding)
            lag_one = lag_one_autocorrelation(chosen, np.diff(index) == 1)
            found.append(PartResiduals(part, smoothed, analysis, lag_one))
    return tuple(found)


def _smoothed(
    inputs: list[Array], statistics: NightStatistics, smoothing: Smoothing
) -> list[Array]:
    """Inputs averaged with the rest, or as they are where only the flow was."""
    if smoothing.apply_to == "leakage":
        return inputs
    samples = statistics.samples
    averaged = smooth(
        np.column_stack(inputs),
        samples.index,
        statistics.short_block,
        samples.period_us,
        smoothing.window_s,
    )
    return list(averaged.T)
