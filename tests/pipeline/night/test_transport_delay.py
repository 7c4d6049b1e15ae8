"""Equation (14): the delay itself, the pairing of flow and inputs, and its estimate."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.config import ConfigError, MotorSpec, TransportDelay
from pipeline.night.transport_delay import (
    delay_inputs,
    delay_on_grid_s,
    drain_line_delay_s,
    shifted,
)
from tests.pipeline.night.noise_free import configured_flow, fit_of, fitted, refused_of
from tests.pipeline.simulated import load_motor, motor_toml, operate

LINE: dict[str, Any] = {"line_length_m": 2.0, "line_inner_diameter_mm": 12.0}


def test_worked_value_of_the_line_s_volume() -> None:
    """π/4 · (12 mm)² · 2 m = 0.22619 l: 13.572 s at 1 l/min, 6.786 s at 2 l/min."""
    found = drain_line_delay_s(np.array([1.0, 2.0, 0.0, -1.0, np.nan]), 2.0, 12.0)
    np.testing.assert_allclose(found[:2], [13.5717, 6.7858], rtol=1e-5)
    assert found[2] == found[3] == np.inf
    assert np.isnan(found[4])


def test_flow_is_averaged_so_that_a_pulse_meter_has_a_delay() -> None:
    flow = np.tile([0.0, 0.6], 300)
    settings = TransportDelay(mode="flow", leading=("speed",), flow_average_s=10.0, **LINE)
    tau = delay_on_grid_s(flow, np.ones(600, np.bool_), 0.1, settings)
    np.testing.assert_allclose(tau, drain_line_delay_s(np.array([0.3]), 2.0, 12.0)[0], rtol=0.03)


class TestShifted:
    @given(st.integers(0, 2**32 - 1))
    def test_as_the_slow_definition(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        value, present = rng.normal(size=30), rng.random(30) < 0.8
        steps = rng.choice([-3.0, -2.5, -0.25, 0.0, 1.75, 4.0, np.nan, np.inf], 30)
        found, there = shifted(value, present, steps)
        for i, step in enumerate(steps):
            place = i + step
            ends = {int(np.floor(place)), int(np.ceil(place))} if np.isfinite(place) else {-1}
            good = all(0 <= end < 30 and present[end] for end in ends)
            assert there[i] == good
            if good:
                expected = np.interp(place, sorted(ends), value[sorted(ends)])
                assert found[i] == pytest.approx(expected, rel=1e-12, abs=1e-12)
            else:
                assert np.isnan(found[i])

    def test_above_its_limit_or_without_flow_a_sample_is_refused(self) -> None:
        flow = np.array([1.0, 0.5, 0.1, 0.0, np.nan])
        values = {"speed": np.arange(5.0), "leakage_flow": flow}
        present = {"speed": np.ones(5, np.bool_), "leakage_flow": np.isfinite(flow)}
        settings = TransportDelay(
            mode="flow", leading=("speed",), maximum_s=30.0, flow_average_s=0.0, **LINE
        )
        _, there, refused, _ = delay_inputs(values, present, 60.0, settings)
        assert refused.tolist() == [False, False, True, True, True]
        assert not there["speed"][refused].any()


OPERATION = operate(minutes=60.0)


def with_delay(folder: Path, keys: str) -> MotorSpec:
    return load_motor(folder, motor_toml("M1", more=f"[override.transport_delay]\n{keys}\n"))


def test_a_temperature_measured_in_the_line_lags_and_pressure_does_not(tmp_path: Path) -> None:
    errors = []
    for seconds in (30.0, 0.0):
        keys = f'mode = "fixed"\nfixed_s = {seconds}\nlagging = ["oil_temperature"]'
        spec = with_delay(tmp_path / str(seconds), keys)
        celsius = OPERATION.temperature_c
        late = {"oil_temperature": np.append(np.full(30, celsius[0]), celsius[:-30])}
        outcome = fitted(spec, OPERATION, configured_flow(spec, OPERATION), late)
        errors.append(fit_of(outcome.rows)["training_rmse_l_per_min"])
    assert errors[0] < 0.02 * errors[1]


def test_a_delay_by_the_flow_varies_and_its_refusals_are_counted(tmp_path: Path) -> None:
    mode = (
        'mode = "flow"\nline_length_m = 2.0\nline_inner_diameter_mm = 12.0\nmaximum_s = 15.0\n'
        'flow_average_s = 0.0\nlagging = ["oil_temperature"]'
    )
    spec = with_delay(tmp_path, mode)
    flow = configured_flow(spec, OPERATION)
    tau = drain_line_delay_s(flow, 2.0, 12.0)
    # Oil that leaves the motor at t passes the sensor at t + τ(t).
    seconds = np.arange(len(flow), dtype=np.float64)
    arrives = np.maximum.accumulate(seconds + tau)
    late = {"oil_temperature": np.interp(seconds, arrives, OPERATION.temperature_c)}
    outcome = fitted(spec, OPERATION, flow, late)
    row = fit_of(outcome.rows)
    assert refused_of(outcome)["time_base", "transport_delay"] == int((tau > 15.0).sum()) > 0
    assert row["transport_delay_s"] == pytest.approx(tau[tau <= 15.0].mean(), rel=0.02)
    assert row["training_fit_percent"] > 99.5


@pytest.mark.parametrize(
    "keys",
    [
        'mode = "fixed"',
        'mode = "flow"\nleading = ["speed"]\nline_length_m = 1.0',
        'leading = ["speed"]\nlagging = ["speed"]',
        'mode = "fixed"\nfixed_s = 61.0\nleading = ["speed"]',
        'leading = ["leakage_flow"]',
    ],
)
def test_what_does_not_go_together_is_a_fault(tmp_path: Path, keys: str) -> None:
    with pytest.raises(ConfigError, match="transport_delay"):
        with_delay(tmp_path, keys)
