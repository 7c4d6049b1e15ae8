"""A night's metrics and predictions, against the errors as computed by hand."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import numpy as np
import pytest

from leakage import OperatingConditions, regressors
from pipeline.config import MotorSpec
from tests.pipeline.night.residuals_by_hand import (
    MINUTES,
    N,
    by_hand,
    fitted,
    motor,
    primary,
    true_flow,
    white,
)
from tests.pipeline.simulated import NIGHT, operate


@pytest.fixture
def spec(tmp_path: Path) -> MotorSpec:
    return motor(tmp_path)


# metrics


def test_mean_errors_and_sizes_are_those_of_the_errors(spec: MotorSpec) -> None:
    operation = operate(minutes=MINUTES)
    # More flow towards the end, which the training samples do not show.
    flow = true_flow(spec, operation) + white() + np.where(np.arange(N) > 6000, 0.05, 0.0)
    outcome = fitted(spec, operation, flow)
    hand, row = by_hand(spec, operation, flow, outcome), primary(outcome)
    for part in ("training", "validation"):
        error = hand.error[getattr(hand, part)]
        assert row[f"{part}_mean_error_l_per_min"] == pytest.approx(error.mean(), abs=1e-10)
        assert row[f"{part}_rmse_l_per_min"] == pytest.approx(np.sqrt(np.mean(error**2)))
        y = flow[getattr(hand, part)]
        fit = 100 * (1 - np.linalg.norm(error) / np.linalg.norm(y - y.mean()))
        assert row[f"{part}_fit_percent"] == pytest.approx(fit, rel=1e-9)
    assert row["validation_mean_error_l_per_min"] > 0.03


def test_the_model_before_has_its_error_on_all_of_tonight(spec: MotorSpec) -> None:
    operation = operate(minutes=MINUTES)
    flow = true_flow(spec, operation) + white()
    first = fitted(spec, operation, flow)
    assert primary(first)["previous_model_rmse_l_per_min"] is None
    assert primary(first)["previous_model_mean_error_l_per_min"] is None
    worn = {mode: tuple(1.1 * k for k in theta) for mode, theta in first.model.items()}
    row = primary(fitted(spec, operation, flow, worn))
    at = OperatingConditions.from_bar(
        operation.pressure_bar, operation.temperature_c, operation.speed_rpm
    )
    error = flow - regressors(spec.motor(NIGHT, "none"), at) @ np.append(worn["none"], 1.0)
    assert row["previous_model_mean_error_l_per_min"] == pytest.approx(error.mean(), rel=1e-9)
    assert row["previous_model_rmse_l_per_min"] == pytest.approx(np.sqrt(np.mean(error**2)))
    assert row["previous_model_mean_error_l_per_min"] < 0  # it predicts too much


# predictions


def test_predictions_are_samples_of_the_night_and_the_fit_at_them(spec: MotorSpec) -> None:
    operation = operate(minutes=MINUTES)
    flow = true_flow(spec, operation) + white()
    outcome = fitted(spec, operation, flow)
    hand, rows = by_hand(spec, operation, flow, outcome), outcome.rows["predictions"]
    # Thinned for plots, extremes kept.
    assert 400 <= len(rows) <= 720
    microsecond = dt.timedelta(microseconds=1)
    epoch = dt.datetime(1970, 1, 1, tzinfo=dt.UTC)
    places = [
        int(np.searchsorted(operation.time_us, (row["time"] - epoch) // microsecond))
        for row in rows
    ]
    # From the first sample to the last, without a stretch left out.
    assert (places[0], places[-1]) == (0, N - 1)
    # Lowest and highest of four figures in each of 90 bins: no two bins go without a sample.
    assert np.diff(places).max() < 2 * N / 90
    error = hand.error
    for place, row in zip(places, rows, strict=True):
        assert row["measured_l_per_min"] == flow[place]
        assert row["predicted_l_per_min"] == pytest.approx(flow[place] - error[place], rel=1e-9)
        assert row["pressure_difference_bar"] == operation.pressure_bar[place]
        assert row["oil_temperature_c"] == operation.temperature_c[place]
        assert row["speed_rpm"] == operation.speed_rpm[place]
        inside = {
            part: place in range(*getattr(hand, part).indices(N))
            for part in ("training", "validation")
        }
        assert row["part"] == next((part for part, has in inside.items() if has), "guard")
    counts = [sum(row["part"] == part for row in rows) for part in ("training", "validation")]
    assert [count / len(rows) for count in counts] == pytest.approx([0.80, 0.18], abs=0.02)
