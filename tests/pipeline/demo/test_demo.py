"""The demo's truth, physics and faults."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from leakage import OperatingConditions, leakage_l_per_min, regressors
from pipeline.config import MotorSpec
from pipeline.demo.fleet import (
    DEMO_FLEET,
    DemoNight,
    coefficients_of,
    reference_leakage,
    truth_document,
)
from pipeline.demo.recording import record_night, simulate_operation
from tests.pipeline.demo.conftest import EXCITED, MOTORS, PLAN, night_of


@pytest.fixture(scope="module")
def truth(specs: dict[str, MotorSpec]) -> dict[str, Any]:
    nights = [
        DemoNight(demo, specs[demo.motor_id], PLAN, number)
        for demo in DEMO_FLEET
        for number in range(1, PLAN.nights + 1)
    ]
    motors: dict[str, Any] = json.loads(json.dumps(truth_document(PLAN, nights)))["motors"]
    return motors


def test_reference_leakage_of_an_unworn_motor_as_built_is_the_published_one(
    specs: dict[str, MotorSpec],
) -> None:
    # model.md, section 3: the whole CB560 at 200 bar, 50 °C, 30 rpm: 1.371423 l/min.
    as_drawn = replace(MOTORS["CB560-01"], gap_factors={})
    nights = [DemoNight(as_drawn, specs["CB560-01"], PLAN, number) for number in range(1, 31)]
    mean = np.mean([reference_leakage(night, coefficients_of(night)) for night in nights])
    assert mean == pytest.approx(1.371423, rel=2e-3)


def test_wear_begins_after_night_30_in_the_stated_paths_alone(truth: dict[str, Any]) -> None:
    for motor in truth.values():
        nights, worn = list(motor["nights"].values()), set(motor["worn_paths"])
        for path in nights[0]["K_m3"]:
            factors = np.array([night["K_m3"][path] for night in nights])
            factors /= factors[:30].mean()
            assert np.all(np.abs(factors[:30] - 1.0) < 0.03)
            assert (factors[69] > 1.3) == (path in worn)
            assert (abs(factors[74] - 1.0) < 0.03) == (path not in worn)
    assert [name for name, motor in truth.items() if not motor["worn_paths"]] == ["CB400-01"]


def test_truth_names_flushing_and_a_step_on_night_45(truth: dict[str, Any]) -> None:
    motor = truth["CB560-01"]
    sleeve = [night["K_m3"]["balance_sleeve"] for night in motor["nights"].values()]
    assert sleeve[44] / sleeve[43] > 1.4
    assert motor["first_night_of_wear"] == list(motor["nights"])[44] == "2026-02-15"
    for name, motor in truth.items():
        flows = [night["C_f_l_per_min"] for night in motor["nights"].values()]
        assert flows == pytest.approx([4.0 if name == "CB1120-01" else 0.0] * 75, rel=0.03)


@pytest.mark.parametrize("motor_id", EXCITED)
def test_least_squares_recovers_the_truth(specs: dict[str, MotorSpec], motor_id: str) -> None:
    errors = np.array([recovery(night_of(specs, motor_id, number)) for number in (1, 40, 75)])
    assert np.all(np.median(np.abs(errors), axis=0) < [0.1] * (errors.shape[1] - 1) + [0.01])


def recovery(night: DemoNight) -> NDArray[np.float64]:
    """Relative errors of K of each path and of the reference leakage, by plain least squares."""
    recording, truth, motor = record_night(night), coefficients_of(night), night.motor
    logged = ~np.isnan(recording.values["leakage_flow"])  # messages come every second
    values = {name: np.asarray(column)[logged] for name, column in recording.values.items()}
    pressure = values.get("pressure_difference")
    if pressure is None:
        pressure = values["high_port_pressure"] - values["low_port_pressure"]
    seconds = np.flatnonzero(np.abs(values["oil_temperature"] - 48.0) < 15.0)
    temperature = np.interp(
        np.arange(pressure.size), seconds, median(values["oil_temperature"][seconds])
    )
    flow, speed = values["leakage_flow"], values["speed"]
    calm = np.abs(flow - median(flow)) < 0.1 * median(flow)
    calm &= np.abs(pressure - median(pressure)) < 10.0
    running = np.abs(median(speed)) > 2.0
    rows = np.flatnonzero(running & calm & (np.abs(speed) < 150.0))
    conditions = OperatingConditions.from_bar(pressure[rows], temperature[rows], speed[rows])
    columns = regressors(motor, conditions)
    names = [path.name for path in motor.column_paths]
    used = columns[:, : len(names) + (night.demo.flushing_l_per_min > 0.0)]
    scale = np.linalg.norm(used, axis=0)
    solution, *_ = np.linalg.lstsq(used / scale, flow[rows] - columns[:, -1])
    found = dict(zip(names, solution / scale, strict=False))
    at_reference = leakage_l_per_min(motor, OperatingConditions.from_bar(200.0, 50.0, 30.0), found)
    pairs = [(found[name], truth[name]) for name in names]
    pairs.append((float(at_reference[0]), reference_leakage(night, truth)))
    return np.array([estimate / true - 1.0 for estimate, true in pairs])


def median(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(median_filter(np.nan_to_num(values, posinf=0.0), 15))


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
