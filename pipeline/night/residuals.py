"""What a night's samples say beside its fit: of its errors, cold oil, and the drain flow's lag."""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Iterator, Mapping
from statistics import fmean, stdev

import numpy as np

from leakage.estimation.blocks import ROUNDING, TRAINING, VALIDATION
from leakage.estimation.residual_analysis import LagTest, ResidualAnalysis, analyse_residuals
from leakage.estimation.transport_lag import transport_lag
from pipeline.arrays import Array, chosen_rows
from pipeline.night.statistics import NightStatistics
from pipeline.schema import LAG_COLUMNS, Row

INPUTS = ("pressure_difference", "oil_temperature", "speed")

WHITENESS, INDEPENDENCE = "whiteness", "independence"
NO_INPUT = "none"
# A motor that rested so long starts cold, and is warm after as long: the first of these after which
# there are pieces enough. Errors of the time between differ from later ones by this share of the
# flow, and by their scatter over pieces.
MINUTE = dt.timedelta(minutes=1)
WARM_UPS, PIECE = (30 * MINUTE, 20 * MINUTE, 10 * MINUTE), 10 * MINUTE
COLD_SHARE, COLD_SCATTERS, FEWEST_PIECES = 0.03, 3.0, 3


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
