"""What a night's samples say beside its fit: of its errors, and of the drain flow's lag."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from leakage.estimation.blocks import ROUNDING, TRAINING, VALIDATION
from leakage.estimation.residual_analysis import LagTest, ResidualAnalysis, analyse_residuals
from leakage.estimation.transport_lag import transport_lag
from pipeline.arrays import Array, chosen_rows
from pipeline.night.statistics import NightStatistics
from pipeline.schema import Row
from pipeline.schema.fits import LAG_COLUMNS

INPUTS = ("pressure_difference", "oil_temperature", "speed")

WHITENESS, INDEPENDENCE = "whiteness", "independence"
NO_INPUT = "none"


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
    """Return rows of `residual_tests`: a test with its correlations and bounds at each lag."""
    for part, analysis in residuals.items():
        for (name, of), test in _tests(analysis):
            key = {"part": part, "test": name, "input": of, "n": analysis.n}
            yield key | _columns_of(test, period_s)


def residual_columns(residuals: Mapping[str, ResidualAnalysis], period_s: float) -> Row:
    """Return columns of `fits`: how many independent samples there are, and the errors' memory."""
    memory = residuals[TRAINING].memory
    return {
        "correlation_time_s": None if memory is None else memory * period_s,
        **{f"n_{part}_effective": residuals[part].n_effective for part in (TRAINING, VALIDATION)},
    }


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


def lag_columns(statistics: NightStatistics) -> dict[str, float | None]:
    """Return columns of `fits` on the drain flow's lag in a night; null where it has none.

    A drain line that is not full, and a meter that averages, delay the flow. It follows the model's
    own columns, and of machines that the model lacks something of, speed and the root of the
    pressure. Where a motor's first nights agree on a lag, all its nights are paired so.
    """
    samples = statistics.samples
    drivers = np.column_stack(
        [
            statistics.unsmoothed[:, :-1],
            np.abs(samples.speed_rpm),
            np.sqrt(np.abs(samples.pressure_difference_bar)),
        ]
    )
    lag = transport_lag(
        samples.leakage_l_per_min, drivers, samples.index, samples.period_us / 1e6, samples.delay_s
    )
    found = (None, None) if lag is None else (lag.seconds, 100.0 * lag.gain)
    return dict(zip(LAG_COLUMNS, found, strict=True))
