"""A night's metrics, predictions and residual analysis against errors by hand; its `operation`.

Its samples are all kept, so that its errors can be.
"""

from __future__ import annotations

import datetime as dt
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from leakage import OperatingConditions, regressors
from pipeline.config import MotorSpec
from pipeline.ingest import RawChannel
from pipeline.night.fit_night import NightOutcome
from pipeline.night.sample_rows import coarse_histogram, data_columns, hours_counted
from pipeline.night.time_base import Samples
from pipeline.report.explain import explain_residuals
from pipeline.schema import PRESSURE_EDGES_BAR
from tests.pipeline.night.noise_free import configured_flow, fit_of, fitted, white
from tests.pipeline.simulated import (
    NIGHT,
    SECOND_US,
    Array,
    load_motor,
    motor_toml,
    night_of,
    operate,
    with_file,
)

Row = dict[str, Any]
LONG = operate(minutes=120.0)
N = len(LONG.time_us)
AT = OperatingConditions.from_bar(LONG.pressure_bar, LONG.temperature_c, LONG.speed_rpm)


@pytest.fixture(autouse=True)
def every_sample_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """Errors can be computed by hand."""
    monkeypatch.setattr("pipeline.night.cleaning.CHANNEL_RULES", {})


CHANNELS = {
    "pressure_difference": LONG.pressure_bar,
    "oil_temperature": LONG.temperature_c,
    "speed": LONG.speed_rpm,
}


def motor(folder: Path, more: str = "") -> MotorSpec:
    return load_motor(folder, motor_toml("M1", more=more))


def row_of(outcome: NightOutcome, part: str, test: str) -> Row:
    """Row of a test, whiteness or independence of an input."""
    (row,) = [
        row
        for row in outcome.rows["residual_tests"]
        if row["part"] == part and test in (row["input"], row["test"])
    ]
    return row


def lags(outcome: NightOutcome, part: str, test: str) -> dict[int, Row]:
    row = row_of(outcome, part, test)
    names = ("lags_s", "correlations", "bounds")
    every = zip(*(row[name] for name in names), strict=True)
    # One sample a second.
    return {round(lag): {"value": value, "bound": bound} for lag, value, bound in every}


class ByHand(NamedTuple):
    """Errors of a fit, and which samples train and validate."""

    error: Array
    training: slice
    validation: slice


def by_hand(spec: MotorSpec, flow: Array, outcome: NightOutcome) -> ByHand:
    """Errors of least squares on the training samples; none may be missing."""
    row = fit_of(outcome.rows)
    assert row["n_training"] + row["n_validation"] == N - 120  # a block of guard between them
    training = slice(0, row["n_training"])
    columns = regressors(spec.motor(NIGHT, "none"), AT)
    free, known = columns[:, :-2], columns[:, -1]  # without flushing C_f is 0
    scale = np.linalg.norm(free, axis=0)
    theta = np.linalg.lstsq((free / scale)[training], (flow - known)[training])[0] / scale
    return ByHand(flow - known - free @ theta, training, slice(N - row["n_validation"], N))


@pytest.fixture
def spec(tmp_path: Path) -> MotorSpec:
    return motor(tmp_path)


def test_rows_are_the_correlations_of_the_errors(spec: MotorSpec) -> None:
    flow = configured_flow(spec, LONG) + white(N)
    outcome = fitted(spec, LONG, flow)
    hand = by_hand(spec, flow, outcome)
    for part in ("training", "validation"):
        rows = getattr(hand, part)
        error = hand.error[rows]
        e, n = error - error.mean(), len(error)
        found = lags(outcome, part, "whiteness")
        assert sorted(found) == list(range(26))
        assert found[0]["value"] == pytest.approx(1.0)
        assert found[0]["bound"] is None
        for lag in (1, 7, 25):
            expected = np.mean(e[lag:] * e[:-lag]) / np.mean(e**2)
            assert found[lag]["value"] == pytest.approx(expected, rel=1e-8)
            assert found[lag]["bound"] == pytest.approx(2.576 / math.sqrt(n - lag))
        for name, values in CHANNELS.items():
            found = lags(outcome, part, name)
            assert sorted(found) == list(range(-25, 26))
            # At a positive lag the input is the past one.
            expected = np.corrcoef(error, values[rows])[0, 1]
            assert found[0]["value"] == pytest.approx(expected, abs=1e-9), name
        assert row_of(outcome, part, "whiteness")["n"] == n


def test_every_test_has_its_rows_and_its_verdict(tmp_path: Path) -> None:
    more = '[flushing]\nmode = "none"\nalso = ["estimated"]\n'
    spec = motor(tmp_path, more + "[override.smoothing]\nwindow_s = 5.0\n")
    outcome = fitted(spec, LONG, configured_flow(spec, LONG) + white(N))
    tests = outcome.rows["residual_tests"]
    # Two modes, two parts.
    assert len(tests) == 2 * 2 * (1 + 3)
    for row in tests:
        is_white = row["test"] == "whiteness"
        assert len(row["lags_s"]) == len(row["correlations"]) == (26 if is_white else 51)
        every = zip(row["lags_s"], row["correlations"], row["bounds"], strict=True)
        judged = [(lag, value) for lag, value, bound in every if bound is not None]
        assert len(judged) == (25 if is_white else 51)
        largest = max(judged, key=lambda one: abs(one[1]))
        assert (row["largest_lag_s"], row["largest_correlation"]) == largest
        assert (row["input"] == "none") == (row["test"] == "whiteness")
        assert row["verdict"] == ("failed" if row["p_value"] < 0.01 else "passed")
        assert row["reason"] is None


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
    found = row_of(outcome, "validation", "whiteness")
    assert found["n"] == 0
    assert found["reason"] == "0 samples, 1000 are needed"
    told = list(explain_residuals(row, outcome.rows["residual_tests"]))
    assert "validation errors: no samples" in told


def test_mean_errors_and_sizes_are_those_of_the_errors(spec: MotorSpec) -> None:
    # More flow towards the end, which the training samples do not show.
    flow = configured_flow(spec, LONG) + white(N) + np.where(np.arange(N) > 6000, 0.05, 0.0)
    outcome = fitted(spec, LONG, flow)
    hand, row = by_hand(spec, flow, outcome), fit_of(outcome.rows)
    for part in ("training", "validation"):
        error, y = hand.error[getattr(hand, part)], flow[getattr(hand, part)]
        assert row[f"{part}_mean_error_l_per_min"] == pytest.approx(error.mean(), abs=1e-10)
        assert row[f"{part}_rmse_l_per_min"] == pytest.approx(np.sqrt(np.mean(error**2)))
        fit = 100 * (1 - np.linalg.norm(error) / np.linalg.norm(y - y.mean()))
        assert row[f"{part}_fit_percent"] == pytest.approx(fit, rel=1e-9)
    assert row["validation_mean_error_l_per_min"] > 0.03


def test_predictions_are_samples_of_the_night_and_the_fit_at_them(spec: MotorSpec) -> None:
    flow = configured_flow(spec, LONG) + white(N)
    outcome = fitted(spec, LONG, flow)
    hand, rows = by_hand(spec, flow, outcome), outcome.rows["predictions"]
    # Thinned for plots, extremes kept.
    assert 400 <= len(rows) <= 720
    epoch, microsecond = dt.datetime(1970, 1, 1, tzinfo=dt.UTC), dt.timedelta(microseconds=1)
    stamps = [(row["time"] - epoch) // microsecond for row in rows]
    places = np.searchsorted(LONG.time_us, stamps)
    # From the first sample to the last, without a stretch left out: lowest and highest of four
    # figures in each of 90 bins, so that no two bins go without a sample.
    assert (places[0], places[-1]) == (0, N - 1)
    assert np.diff(places).max() < 2 * N / 90
    for column, values in (
        ("measured_l_per_min", flow),
        ("pressure_difference_bar", LONG.pressure_bar),
        ("oil_temperature_c", LONG.temperature_c),
        ("speed_rpm", LONG.speed_rpm),
    ):
        assert [row[column] for row in rows] == values[places].tolist()
    predicted = [row["predicted_l_per_min"] for row in rows]
    assert predicted == pytest.approx((flow - hand.error)[places], rel=1e-9)
    part = np.full(N, "guard", dtype="U10")
    part[hand.training], part[hand.validation] = "training", "validation"
    assert [row["part"] for row in rows] == part[places].tolist()
    shares = [np.mean(part[places] == name) for name in ("training", "validation")]
    assert shares == pytest.approx([0.80, 0.18], abs=0.02)


KEPT = 400


def samples(n: int = KEPT, **more: object) -> Samples:
    generator = np.random.default_rng(1)
    index = np.arange(n, dtype=np.int64)
    return Samples(
        index,
        index * SECOND_US,
        -generator.uniform(10.0, 300.0, n),
        generator.uniform(40.0, 60.0, n),
        np.where(index % 4 == 0, -20.0, 20.0),
        generator.uniform(1.0, 2.0, n),
        {},
        SECOND_US,
        KEPT,
        **more,  # type: ignore[arg-type]
    )


def counter(*hours: float) -> RawChannel:
    n = len(hours)
    return RawChannel(np.arange(n, dtype=np.int64), np.array(hours), np.zeros(n, dtype=np.bool_), 0)


def test_running_hours_are_the_share_of_the_logged_time_over_the_night() -> None:
    """A quarter of what is logged, of 24 hours, however little is logged."""
    row = data_columns(night_of(), samples(n_logged=800, n_turning=200), None)
    assert row["running_hours"] == pytest.approx(6.0)
    assert row["logged_hours"] == pytest.approx(800 / 3600)


def test_a_counter_in_the_log_wins() -> None:
    seen = samples(n_logged=800, n_turning=200)
    row = data_columns(night_of(), seen, counter(812.0, 815.5, 820.25))
    assert row["running_hours"] == 8.25


@pytest.mark.parametrize("hours", [(812.0,), (812.0, 3.0, 5.0), (np.nan, np.nan), ()])
def test_a_counter_that_cannot_tell_does_not(hours: tuple[float, ...]) -> None:
    assert hours_counted(counter(*hours)) is None
    seen = samples(n_logged=800, n_turning=200)
    row = data_columns(night_of(), seen, counter(*hours))
    assert row["running_hours"] == pytest.approx(6.0)


def test_conditions_are_magnitudes() -> None:
    seen = samples()
    row = data_columns(night_of(), seen, None)
    assert row["mean_pressure_bar"] == pytest.approx(np.abs(seen.pressure_difference_bar).mean())
    assert row["mean_speed_rpm"] == 20.0
    assert row["reversed_percent"] == 25.0
    histogram = coarse_histogram(np.abs(seen.pressure_difference_bar), PRESSURE_EDGES_BAR)
    expected, _ = np.histogram(np.abs(seen.pressure_difference_bar), PRESSURE_EDGES_BAR)
    assert histogram == expected.tolist()
