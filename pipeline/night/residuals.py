"""Residual analysis of a night's fit, unsmoothed and smoothed, and what tables say of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from leakage.estimation.choices import LEVEL, ROUNDING
from leakage.estimation.compression import smooth
from leakage.estimation.correlation import memory_s
from leakage.estimation.residual_analysis import (
    FAILED,
    NOT_TESTED,
    PASSED,
    LagTest,
    ResidualAnalysis,
    analyse_residuals,
)
from leakage.estimation.sample_blocks import TRAINING, VALIDATION, numbers_of
from leakage.estimation.validation import effective_sample_count
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
        columns.append((True, fitted_error, _smoothed(inputs, statistics, smoothing)))
    found = []
    for smoothed, error, seen in columns:
        for part, rows in parts.items():
            by_name = {name: one[rows] for name, one in zip(INPUTS, seen, strict=True)}
            analysis = analyse_residuals(
                error[rows], by_name, samples.index[rows], memory / period_s, rounding
            )
            found.append(PartResiduals(part, smoothed, analysis))
    return memory, tuple(found)


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
        numbers_of(statistics.short),
        samples.period_us,
        smoothing.window_s,
    )
    return list(averaged.T)


def residual_test_rows(residuals: Sequence[PartResiduals], period_s: float) -> list[Row]:
    """Rows of `residual_tests`: a correlation with its band at each lag."""
    return [key | row for key, test in _tests(residuals) for row in _lag_rows(test, period_s)]


def residual_verdict_rows(residuals: Sequence[PartResiduals], period_s: float) -> list[Row]:
    """Rows of `residual_verdicts`: one a test."""
    means = {
        (one.part, one.smoothed): {
            "n": one.analysis.n,
            "mean_error_l_per_min": one.analysis.mean_l_per_min if one.analysis.n else None,
        }
        for one in residuals
    }
    return [
        key | means[key["part"], key["smoothed"]] | _verdict_columns(test, period_s)
        for key, test in _tests(residuals)
    ]


def residual_columns(residuals: Sequence[PartResiduals]) -> Row:
    """Columns of `fits`: verdicts on unsmoothed errors, effective numbers of what was fitted."""
    columns: Row = {}
    for one in residuals:
        if not one.smoothed:
            tests = list(one.analysis.independence.values())
            columns[f"{one.part}_whiteness"] = one.analysis.whiteness.verdict
            columns[f"{one.part}_independence"] = _together(tests)
    # The analysis of what was fitted comes last.
    fitted = {one.part: one for one in residuals}
    for part, prefix in ((TRAINING, ""), (VALIDATION, "validation_")):
        one = fitted[part]
        columns[f"{prefix}n_effective"] = effective_sample_count(
            one.analysis.n, one.analysis.lag_one_autocorrelation
        )
        columns[f"{prefix}n_effective_summed"] = one.analysis.n_effective
    training = fitted[TRAINING].analysis
    return columns | {"lag_one_autocorrelation": training.lag_one_autocorrelation}


def _tests(residuals: Sequence[PartResiduals]) -> Iterator[tuple[Row, LagTest]]:
    for one in residuals:
        key: Row = {"part": one.part, "smoothed": one.smoothed}
        yield key | {"test": WHITENESS, "input": NO_INPUT}, one.analysis.whiteness
        for name, test in one.analysis.independence.items():
            yield key | {"test": INDEPENDENCE, "input": name}, test


def _lag_rows(test: LagTest, period_s: float) -> Iterator[Row]:
    judged = np.isfinite(test.bounds).tolist()
    for lag, value, bound, outside, is_judged in zip(
        test.lags.tolist(),
        test.values.tolist(),
        test.bounds.tolist(),
        test.outside.tolist(),
        judged,
        strict=True,
    ):
        yield {
            "lag": lag,
            "lag_s": lag * period_s,
            "value": value if np.isfinite(value) else None,
            "bound": bound if is_judged else None,
            "outside": outside if is_judged else None,
        }


def _verdict_columns(test: LagTest, period_s: float) -> Row:
    lag, value = test.largest or (None, None)
    return {
        "verdict": test.verdict,
        "reason": test.reason,
        "statistic": test.statistic,
        "degrees_of_freedom": test.degrees_of_freedom,
        "p_value": test.p_value,
        "n_lags": test.n_judged,
        "n_outside": int(test.outside.sum()),
        "n_expected_outside": LEVEL * test.n_judged,
        "largest_value": value,
        "largest_lag": lag,
        "largest_lag_s": None if lag is None else lag * period_s,
    }


def _together(tests: Sequence[LagTest]) -> str:
    """Failed if one of them is, passed if the others are that were tested."""
    verdicts = {test.verdict for test in tests}
    return next((one for one in (FAILED, PASSED) if one in verdicts), NOT_TESTED)
