"""Residual analysis of a night's fit, unsmoothed and smoothed, and what tables say of it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from leakage.estimation.choices import ROUNDING
from leakage.estimation.compression import smooth
from leakage.estimation.correlation import memory_s
from leakage.estimation.residual_analysis import LagTest, ResidualAnalysis, analyse_residuals
from leakage.estimation.sample_blocks import TRAINING, VALIDATION, numbers_of
from pipeline.arrays import Array, chosen_rows
from pipeline.config import Smoothing
from pipeline.night.statistics import NightStatistics

Row = dict[str, Any]

INPUTS = ("pressure_difference", "oil_temperature", "speed")

WHITENESS, INDEPENDENCE = "whiteness", "independence"
NO_INPUT = "none"


@dataclass(frozen=True, slots=True, eq=False)
class PartResiduals:
    """Residual analysis of one part of a night."""

    part: str  # training or validation
    smoothed: bool  # whether columns and inputs were smoothed as for the fit
    analysis: ResidualAnalysis  # what was found


def night_residuals(
    statistics: NightStatistics, coefficients: Array, fitted_error: Array, smoothing: Smoothing
) -> tuple[float, tuple[PartResiduals, ...]]:
    """Memory of the training errors [s], and residual analyses of training and validation.

    `fitted_error` has the errors of the fit's columns. The analyses are of unsmoothed columns and,
    if the fit's were smoothed, of those after them.
    """
    samples = statistics.samples
    parts = {part: chosen_rows(statistics.rows_of(part)) for part in (TRAINING, VALIDATION)}
    flow = samples.leakage_l_per_min
    rounding = ROUNDING * float(max(flow.max(), -flow.min()))
    period_s, training = samples.period_us / 1e6, parts[TRAINING]
    memory = memory_s(fitted_error[training], samples.index[training], period_s, rounding)
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
        averaged = smooth(
            np.column_stack(inputs),
            samples.index,
            numbers_of(statistics.short),
            samples.period_us,
            smoothing.window_s,
        )
        columns.append((True, fitted_error, list(averaged.T)))
    found = []
    for smoothed, error, seen in columns:
        for part, rows in parts.items():
            by_name = {name: one[rows] for name, one in zip(INPUTS, seen, strict=True)}
            analysis = analyse_residuals(
                error[rows], by_name, samples.index[rows], memory / period_s, rounding
            )
            found.append(PartResiduals(part, smoothed, analysis))
    return memory, tuple(found)


def residual_test_rows(residuals: Sequence[PartResiduals], period_s: float) -> Iterator[Row]:
    """Rows of `residual_tests`: a test with its correlations and their bounds at each lag."""
    for residual in residuals:
        for (name, of), test in _tests(residual.analysis):
            yield {
                "part": residual.part,
                "is_smoothed": residual.smoothed,
                "test": name,
                "input": of,
                "n": residual.analysis.n,
                **_columns_of(test, period_s),
            }


def residual_columns(residuals: Sequence[PartResiduals]) -> Row:
    """Columns of `fits`: effective numbers of what was fitted."""
    # The analysis of what was fitted comes last.
    fitted = {residual.part: residual.analysis.n_effective for residual in residuals}
    return {f"n_{part}_effective": fitted[part] for part in (TRAINING, VALIDATION)}


def _tests(analysis: ResidualAnalysis) -> Iterator[tuple[tuple[str, str], LagTest]]:
    yield (WHITENESS, NO_INPUT), analysis.whiteness
    for name, test in analysis.independence.items():
        yield (INDEPENDENCE, name), test


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
