"""A night's metrics and predictions, against the errors as computed by hand."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import numpy as np
import pytest

from leakage import regressors
from pipeline.config import MotorSpec
from tests.pipeline.night.noise_free import configured_flow, fit_of, fitted, white
from tests.pipeline.night.residuals_by_hand import AT, LONG, N, by_hand, motor
from tests.pipeline.simulated import NIGHT


@pytest.fixture
def spec(tmp_path: Path) -> MotorSpec:
    return motor(tmp_path)


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


def test_the_model_before_has_its_error_on_all_of_tonight(spec: MotorSpec) -> None:
    flow = configured_flow(spec, LONG) + white(N)
    first = fitted(spec, LONG, flow)
    assert fit_of(first.rows)["previous_model_rmse_l_per_min"] is None
    assert fit_of(first.rows)["previous_model_mean_error_l_per_min"] is None
    worn = {mode: tuple(1.1 * k for k in theta) for mode, theta in first.model.items()}
    row = fit_of(fitted(spec, LONG, flow, previous=worn).rows)
    error = flow - regressors(spec.motor(NIGHT, "none"), AT) @ np.append(worn["none"], 1.0)
    assert row["previous_model_mean_error_l_per_min"] == pytest.approx(error.mean(), rel=1e-9)
    assert row["previous_model_rmse_l_per_min"] == pytest.approx(np.sqrt(np.mean(error**2)))
    assert row["previous_model_mean_error_l_per_min"] < 0  # it predicts too much


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
