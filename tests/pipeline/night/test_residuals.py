"""A night's metrics, predictions, residual analysis and operation, against errors by hand.

Its samples are all kept, so that its errors can be.
"""

from __future__ import annotations

import datetime as dt
import math
from typing import Any, NamedTuple

import numpy as np
import pytest

from leakage import OperatingConditions, regressors
from pipeline.config import MotorSpec
from pipeline.ingest import RawChannel
from pipeline.night.fit_night import NightOutcome
from pipeline.night.sample_rows import coarse_histograms, data_columns
from pipeline.night.time_base import Samples
from pipeline.report.explain import explain_residuals
from pipeline.schema import PRESSURE_EDGES_BAR
from tests.pipeline.night.noise_free import configured_flow, fit_of, fitted, white
from tests.pipeline.simulated import NIGHT, SECOND_US, Array, night_of, operate, with_file

LONG = operate(minutes=120.0)
N = len(LONG.time_us)
CHANNELS = {
    "pressure_difference": LONG.pressure_bar,
    "oil_temperature": LONG.temperature_c,
    "speed": LONG.speed_rpm,
}


@pytest.fixture(autouse=True)
def every_sample_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """Errors can be computed by hand."""
    monkeypatch.setattr("pipeline.night.cleaning.CHANNEL_RULES", {})


class ByHand(NamedTuple):
    """A night, the errors of least squares on its training samples, and which these are."""

    flow: Array
    outcome: NightOutcome
    error: Array
    parts: dict[str, slice]


@pytest.fixture
def hand(spec: MotorSpec) -> ByHand:
    # More flow towards the end, which the training samples do not show.
    flow = configured_flow(spec, LONG) + white(N) + np.where(np.arange(N) > 6000, 0.05, 0.0)
    outcome = fitted(spec, LONG, flow)
    row = fit_of(outcome.rows)
    assert row["n_training"] + row["n_validation"] == N - 120  # a block of guard between them
    parts = {
        "training": slice(0, row["n_training"]),
        "validation": slice(N - row["n_validation"], N),
    }
    at = OperatingConditions.from_bar(LONG.pressure_bar, LONG.temperature_c, LONG.speed_rpm)
    columns = regressors(spec.motor(NIGHT, "none"), at)
    free, known = columns[:, :-2], columns[:, -1]  # without flushing C_f is 0
    scale, training = np.linalg.norm(free, axis=0), parts["training"]
    theta = np.linalg.lstsq((free / scale)[training], (flow - known)[training])[0] / scale
    return ByHand(flow, outcome, flow - known - free @ theta, parts)


def row_of(outcome: NightOutcome, part: str, test: str) -> dict[str, Any]:
    """Row of a test, whiteness or independence of an input."""
    (row,) = [
        row
        for row in outcome.rows["residual_tests"]
        if row["part"] == part and test in (row["input"], row["test"])
    ]
    return row


def test_rows_are_the_correlations_of_the_errors_with_a_verdict(hand: ByHand) -> None:
    assert len(hand.outcome.rows["residual_tests"]) == 2 * (1 + 3)
    for part, rows in hand.parts.items():
        error, n = hand.error[rows] - hand.error[rows].mean(), len(hand.error[rows])
        for test, highest in (("whiteness", 25), *((name, 25) for name in CHANNELS)):
            row = row_of(hand.outcome, part, test)
            lowest = 0 if test == "whiteness" else -highest
            # One sample a second.
            assert row["lags_s"] == list(range(lowest, highest + 1))
            assert row["n"] == n
            values, bounds = (dict(zip(row["lags_s"], row[name], strict=True)) for name in PAIRED)
            judged = {lag: value for lag, value in values.items() if bounds[lag] is not None}
            assert judged.keys() == values.keys() - ({0} if test == "whiteness" else set())
            largest = max(judged, key=lambda lag: abs(judged[lag]))
            assert (row["largest_lag_s"], row["largest_correlation"]) == (largest, judged[largest])
            assert row["verdict"] == ("failed" if row["p_value"] < 0.01 else "passed")
            if test == "whiteness":
                for lag in (1, 7, 25):
                    expected = np.mean(error[lag:] * error[:-lag]) / np.mean(error**2)
                    assert values[lag] == pytest.approx(expected, rel=1e-8)
                    assert bounds[lag] == pytest.approx(2.576 / math.sqrt(n - lag))
            else:
                expected = np.corrcoef(error, CHANNELS[test][rows])[0, 1]
                assert values[0] == pytest.approx(expected, abs=1e-9), test


PAIRED = ("correlations", "bounds")


def test_a_night_without_validation_says_so(spec: MotorSpec) -> None:
    begin = dt.datetime(2026, 3, 1, 22, tzinfo=dt.UTC)
    whole = {"training": ((begin, begin + dt.timedelta(hours=2)),)}
    spec = with_file(spec, periods=spec.file.periods.model_copy(update=whole))
    outcome = fitted(spec, LONG, configured_flow(spec, LONG) + white(N))
    row = fit_of(outcome.rows)
    assert row["n_validation"] == 0
    for column in ("fit_percent", "rmse_l_per_min", "mean_error_l_per_min"):
        assert row[f"validation_{column}"] is None
    assert row["n_validation_effective"] is None
    assert row_of(outcome, "validation", "whiteness")["n"] == 0
    words = list(explain_residuals(row, outcome.rows["residual_tests"]))
    assert "validation errors: no samples" in words


def test_mean_errors_and_sizes_are_those_of_the_errors(hand: ByHand) -> None:
    row = fit_of(hand.outcome.rows)
    for part, rows in hand.parts.items():
        error, y = hand.error[rows], hand.flow[rows]
        assert row[f"{part}_mean_error_l_per_min"] == pytest.approx(error.mean(), abs=1e-10)
        assert row[f"{part}_rmse_l_per_min"] == pytest.approx(np.sqrt(np.mean(error**2)))
        fit = 100 * (1 - np.linalg.norm(error) / np.linalg.norm(y - y.mean()))
        assert row[f"{part}_fit_percent"] == pytest.approx(fit, rel=1e-9)
    assert row["validation_mean_error_l_per_min"] > 0.03


def test_predictions_are_samples_of_the_night_and_the_fit_at_them(hand: ByHand) -> None:
    rows = hand.outcome.rows["predictions"]
    # Thinned for plots, extremes kept.
    assert 400 <= len(rows) <= 720
    places = np.searchsorted(LONG.time_us, [row["time"].timestamp() * SECOND_US for row in rows])
    # From the first sample to the last, without a stretch left out: lowest and highest of four
    # figures in each of 90 bins, so that no two bins go without a sample.
    assert (places[0], places[-1]) == (0, N - 1)
    assert np.diff(places).max() < 2 * N / 90
    for column, values in (
        ("measured_l_per_min", hand.flow),
        ("pressure_difference_bar", LONG.pressure_bar),
        ("oil_temperature_c", LONG.temperature_c),
        ("speed_rpm", LONG.speed_rpm),
    ):
        assert [row[column] for row in rows] == values[places].tolist()
    predicted = [row["predicted_l_per_min"] for row in rows]
    assert predicted == pytest.approx((hand.flow - hand.error)[places], rel=1e-9)
    part = np.full(N, "guard", dtype="U10")
    for name, of_part in hand.parts.items():
        part[of_part] = name
    assert [row["part"] for row in rows] == part[places].tolist()


def samples() -> Samples:
    """A quarter of the logged samples turned."""
    generator, index = np.random.default_rng(1), np.arange(400, dtype=np.int64)
    return Samples(
        index=index,
        time_us=index * SECOND_US,
        pressure_difference_bar=-generator.uniform(10.0, 300.0, 400),
        oil_temperature_c=generator.uniform(40.0, 60.0, 400),
        speed_rpm=np.where(index % 4 == 0, -20.0, 20.0),
        leakage_l_per_min=generator.uniform(1.0, 2.0, 400),
        low_pressures_bar={},
        period_us=SECOND_US,
        n_running=400,
        n_logged=800,
        n_turning=200,
    )


@pytest.mark.parametrize(
    ("counter", "running_hours"),
    [
        # A quarter of what is logged, of 24 hours, however little is logged.
        (None, 6.0),
        ((812.0, 815.5, 820.25), 8.25),
        # A counter that cannot tell does not.
        *(((*hours,), 6.0) for hours in ((812.0,), (812.0, 3.0, 5.0), (np.nan, np.nan), ())),
    ],
)
def test_operation_is_counted_and_its_conditions_are_magnitudes(
    counter: tuple[float, ...] | None, running_hours: float
) -> None:
    seen, channel = samples(), None
    if counter is not None:
        time_us, hours = np.arange(len(counter), dtype=np.int64), np.array(counter)
        channel = RawChannel(time_us, hours, np.zeros(len(counter), dtype=np.bool_), 0)
    row = data_columns(night_of(), seen, channel)
    assert row["running_hours"] == pytest.approx(running_hours)
    assert row["logged_hours"] == pytest.approx(800 / 3600)
    pressure = np.abs(seen.pressure_difference_bar)
    assert row["mean_pressure_bar"] == pytest.approx(pressure.mean())
    assert (row["mean_speed_rpm"], row["reversed_percent"]) == (20.0, 25.0)
    expected, _ = np.histogram(pressure, PRESSURE_EDGES_BAR)
    (counts,) = coarse_histograms(pressure, PRESSURE_EDGES_BAR, [slice(None)])
    assert counts == expected.tolist()
