"""Nights that have no fit, and what they say instead."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.config import MotorSpec
from pipeline.ingest import RawChannel
from pipeline.night.fit_night import NightOutcome, fit_night
from pipeline.schema.fits import FAILED, INSUFFICIENT_DATA, STOOD_STILL
from tests.pipeline.night.noise_free import fit, simulate
from tests.pipeline.simulated import night_of, operate, raw, with_channel


def check_unfitted(outcome: NightOutcome, status: str) -> dict[str, Any]:
    """One primary row in `fits`, with a reason and neither a window nor any figure."""
    assert (outcome.status, outcome.model) == (status, {})
    (row,) = outcome.rows["fits"]
    assert row["is_primary"]
    assert row["status"] == status
    assert row["reason"] == outcome.reason
    assert row["reason"]
    assert row.get("window_start") is None
    assert row.get("reference_leakage_l_per_min") is None
    assert not outcome.rows.keys() & {"parameters", "starts", "predictions"}
    return row


def test_a_motor_that_stood_still(spec: MotorSpec) -> None:
    operation = operate()
    values = simulate(spec, operation) | {
        "speed": np.full(len(operation.time_us), 0.1) + 1e-3 * np.sin(operation.pressure_bar)
    }
    outcome = fit(spec, operation, values)
    check_unfitted(outcome, STOOD_STILL)
    assert outcome.rows["quality"]


def test_a_sensor_at_its_maximum_all_night_is_no_standstill(spec: MotorSpec) -> None:
    low = with_channel(spec, "leakage_flow", sensor_maximum=0.5)
    operation = operate()
    values = simulate(low, operation)
    values["speed"] = np.where(np.arange(len(values["speed"])) < 60, 0.0, values["speed"])
    outcome = fit(low, operation, values)
    assert outcome.status == INSUFFICIENT_DATA
    assert "leakage_flow at_maximum" in (outcome.reason or "")


def test_a_sensor_without_a_sample(spec: MotorSpec) -> None:
    operation = operate()
    channels = raw(operation.time_us, simulate(spec, operation))
    nothing = np.empty(0)
    channels["oil_temperature"] = RawChannel(
        nothing.astype(np.int64), nothing, nothing.astype(np.bool_), 0
    )
    row = check_unfitted(fit_night(spec, night_of(), channels, {}), INSUFFICIENT_DATA)
    assert "oil_temperature" in row["reason"]


def test_too_little_training(spec: MotorSpec) -> None:
    operation = operate(minutes=5.0)
    row = check_unfitted(fit(spec, operation, simulate(spec, operation)), INSUFFICIENT_DATA)
    assert "5 are needed" in row["reason"]


def test_too_much_refused_names_the_causes(spec: MotorSpec) -> None:
    operation = operate()
    values = simulate(spec, operation)
    values["oil_temperature"] = np.where(
        np.arange(len(operation.time_us)) % 1000 < 500, 850.0, values["oil_temperature"]
    )
    row = check_unfitted(fit(spec, operation, values), INSUFFICIENT_DATA)
    assert "oil_temperature out_of_range" in row["reason"]
    assert "60 % are needed" in row["reason"]


def test_temperatures_beyond_walther_are_a_failed_night_with_its_code(spec: MotorSpec) -> None:
    spec = with_channel(spec, "oil_temperature", valid_range=(0.0, 1000.0))
    operation = operate()
    values = simulate(spec, operation)
    values["oil_temperature"] = values["oil_temperature"] + 600.0
    outcome = fit(spec, operation, values)
    row = check_unfitted(outcome, FAILED)
    assert outcome.error_code
    assert row["error_code"] == outcome.error_code
