"""The demo's truth, physics, noise and faults."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from pipeline.config import MotorSpec
from pipeline.demo.fleet import (
    DemoNight,
    coefficients_of,
    reference_leakage,
)
from pipeline.demo.recording import (
    autoregression,
    correlated_noise,
    phi_of,
    record_night,
    simulate_operation,
)
from tests.pipeline.demo.conftest import MOTORS, PLAN, night_of


def test_reference_leakage_of_an_unworn_motor_as_built_is_the_published_one(
    specs: dict[str, MotorSpec],
) -> None:
    # model.md, section 3: the whole CB560 at 200 bar, 50 °C, 30 rpm: 1.371423 l/min.
    as_drawn = replace(MOTORS["CB560-01"], gap_factors={})
    nights = [DemoNight(as_drawn, specs["CB560-01"], PLAN, number) for number in range(1, 31)]
    mean = np.mean([reference_leakage(night, coefficients_of(night)) for night in nights])
    assert mean == pytest.approx(1.371423, rel=2e-3)


def test_halts_stop_the_motor_and_back_flow_follows_at_once() -> None:
    time_s = np.arange(27_000) / 5.0
    operation = simulate_operation(MOTORS["CB560-01"], time_s, np.random.default_rng(1))
    halted = operation.speed_rpm == 0.0
    assert 120.0 <= halted.sum() / 5.0 <= 480.0
    assert np.all(operation.pressure_difference_bar[halted] == 0.0)
    assert np.all(halted[operation.back_flow])
    starts = np.flatnonzero(np.diff(operation.back_flow.astype(int)) == 1)
    assert np.array_equal(starts, np.flatnonzero(np.diff(halted.astype(int)) == 1))
    backward = operation.speed_rpm < 0.0
    assert backward.any()
    assert np.all(operation.pressure_difference_bar[backward] < 0.0)


def test_every_kind_of_fault_is_there(specs: dict[str, MotorSpec]) -> None:
    recordings = [record_night(night_of(specs, "CB400-02", number)) for number in range(1, 7)]
    flow = np.concatenate([recording.values["leakage_flow"] for recording in recordings])
    speed = np.concatenate([recording.values["speed"] for recording in recordings])
    steps = np.concatenate([np.diff(recording.time_us) for recording in recordings])
    assert np.sum(flow == 16.0) > 50  # back-flow, for seconds
    assert np.isinf(flow).any()
    assert np.isnan(flow).any()
    assert (flow == -1.0).any()
    assert (speed == 9999.0).any()
    assert (steps == 0).any()
    assert (steps < 0).any()
    assert (steps > 20_000_000).any()
    assert np.mean(np.isfinite(flow) & (np.abs(speed) > 0.5)) > 0.8


def test_a_sensor_freezes_on_one_night_alone(specs: dict[str, MotorSpec]) -> None:
    def longest_standstill(number: int) -> int:
        flow = record_night(night_of(specs, "CB400-01", number)).values["leakage_flow"]
        changes = np.flatnonzero((np.diff(flow) != 0.0) & (flow[:-1] > 0.3))
        return int(np.diff(changes).max())

    assert longest_standstill(12) > 5 * 120
    assert longest_standstill(11) < 5 * 360  # a halt and no more


SERIES = 20_000


@pytest.mark.parametrize("phi", [0.0, 0.5, 0.95, 0.999])
def test_autoregression_has_variance_one_from_the_start_and_forgets_by_phi_a_step(
    phi: float,
) -> None:
    noise = autoregression(np.random.default_rng(1).standard_normal((41, SERIES)), phi)
    covariance = noise @ noise.T / SERIES
    lags = np.abs(np.subtract.outer(np.arange(41), np.arange(41)))
    # Standard error of a covariance of unit normals: at most √(2 / SERIES).
    assert covariance == pytest.approx(phi**lags, abs=5 * math.sqrt(2 / SERIES))
    assert phi_of(0.1, -0.1 / math.log(0.95)) == pytest.approx(0.95)


def test_correlated_noise_falls_to_1_over_e_in_its_time_constant() -> None:
    noise = correlated_noise(np.random.default_rng(3), 400_000, 0.5, 5.0)
    assert np.mean(noise[10:] * noise[:-10]) == pytest.approx(1 / math.e, abs=0.03)
