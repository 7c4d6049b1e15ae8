"""What corrects a night's samples: the transport delay (equation 14), the oil as measured."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from leakage.physics.oil import density_kg_per_m3
from leakage.physics.walther import kinematic_viscosity_mm2_per_s, walther_coefficients
from pipeline.config import Channel, ConfigError, MotorSpec, TransportDelay
from pipeline.config.oil_samples import OilSample
from pipeline.night import transport_delay
from pipeline.night.fit_night import NightOutcome
from pipeline.night.refit import PublishedNight, refit
from pipeline.night.transport_delay import (
    delay_inputs,
    delay_on_grid_s,
    drain_line_delay_s,
    shifted,
)
from pipeline.schema import BLOCKS, frame
from tests.pipeline.night.noise_free import configured_flow, fit, fit_of, fitted, refused_of
from tests.pipeline.simulated import NIGHT, load_motor, motor_toml, operate, with_file

LINE: dict[str, Any] = {"line_length_m": 2.0, "line_inner_diameter_mm": 12.0}


def test_worked_value_of_the_line_s_volume() -> None:
    """π/4 · (12 mm)² · 2 m = 0.22619 l: 13.572 s at 1 l/min, 6.786 s at 2 l/min."""
    found = drain_line_delay_s(np.array([1.0, 2.0, 0.0, -1.0, np.nan]), 2.0, 12.0)
    np.testing.assert_allclose(found[:2], [13.5717, 6.7858], rtol=1e-5)
    assert found[2] == found[3] == np.inf
    assert np.isnan(found[4])


def test_flow_is_averaged_so_that_a_pulse_meter_has_a_delay() -> None:
    flow = np.tile([0.0, 0.6], 300)
    settings = TransportDelay(**LINE)
    tau = delay_on_grid_s(flow, np.ones(600, np.bool_), 0.1, settings)
    np.testing.assert_allclose(tau, drain_line_delay_s(np.array([0.3]), 2.0, 12.0)[0], rtol=0.03)


@given(st.integers(0, 2**32 - 1))
def test_as_the_slow_definition(seed: int) -> None:
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


def test_above_its_limit_or_without_flow_a_sample_is_refused() -> None:
    flow = np.array([1.0, 0.5, 0.1, 0.0, np.nan])
    values = {"speed": np.arange(5.0), "leakage_flow": flow}
    present = {"speed": np.ones(5, np.bool_), "leakage_flow": np.isfinite(flow)}
    # At 0.5 l/min half the length is a delay of 14 s: a tenth of that flow is beyond the limit.
    settings = TransportDelay(lagging=("speed",), **LINE)
    _, there, refused, _ = delay_inputs(values, present, 60.0, settings)
    assert refused.tolist() == [False, False, True, True, True]
    assert not there["speed"][refused].any()


OPERATION = operate(minutes=60.0)


def with_delay(folder: Path, keys: str) -> MotorSpec:
    return load_motor(folder, motor_toml("M1", more=f"[override.transport_delay]\n{keys}\n"))


def test_a_temperature_measured_in_the_line_lags_and_pressure_does_not(tmp_path: Path) -> None:
    errors = []
    for keys in ('fixed_s = 30.0\nlagging = ["oil_temperature"]', ""):
        spec = with_delay(tmp_path / str(len(keys)), keys)
        celsius = OPERATION.temperature_c
        late = {"oil_temperature": np.append(np.full(30, celsius[0]), celsius[:-30])}
        outcome = fitted(spec, OPERATION, configured_flow(spec, OPERATION), late)
        errors.append(fit_of(outcome.rows)["training_rmse_l_per_min"])
    assert errors[0] < 0.02 * errors[1]


def test_a_delay_by_the_flow_varies_and_its_refusals_are_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(transport_delay, "FLOW_AVERAGE_S", 0.0)
    monkeypatch.setattr(transport_delay, "MAXIMUM_DELAY_S", 15.0)
    line = "line_length_m = 2.0\nline_inner_diameter_mm = 12.0\n"
    spec = with_delay(tmp_path, f'{line}lagging = ["oil_temperature"]')
    flow = configured_flow(spec, OPERATION)
    tau = drain_line_delay_s(flow, 2.0, 12.0)
    # Oil that leaves the motor at t passes the sensor at t + τ(t).
    seconds = np.arange(len(flow), dtype=np.float64)
    arrives = np.maximum.accumulate(seconds + tau)
    late = {"oil_temperature": np.interp(seconds, arrives, OPERATION.temperature_c)}
    outcome = fitted(spec, OPERATION, flow, late)
    assert refused_of(outcome)["time_base", "transport_delay"] == int((tau > 15.0).sum()) > 0
    assert fit_of(outcome.rows)["training_fit_percent"] > 99.5


@pytest.mark.parametrize(
    "keys",
    [
        "line_length_m = 1.0",
        'lagging = ["speed"]',
        "fixed_s = 61.0",
        "fixed_s = 1.0\nline_length_m = 1.0\nline_inner_diameter_mm = 9.0",
        'fixed_s = 1.0\nlagging = ["leakage_flow"]',
    ],
)
def test_what_does_not_go_together_is_a_fault(tmp_path: Path, keys: str) -> None:
    with pytest.raises(ConfigError, match="transport_delay"):
        with_delay(tmp_path, keys)


# 20 % thinner than VG 68 (68 and 8.7 mm²/s), 15 % at 100 °C.
THIN = walther_coefficients(40.0, 54.4, 100.0, 7.4)
SAMPLE = OilSample(date=NIGHT, viscosity_40_c_mm2_per_s=54.4, viscosity_100_c_mm2_per_s=7.4)
UNITS = {"kinematic_viscosity": "cSt", "dynamic_viscosity": "mPa.s"}
Array = NDArray[np.float64]


def thin_flow(spec: MotorSpec) -> Array:
    motor = spec.motor(NIGHT, "none")
    oil = replace(motor.oil, walther_a=THIN[0], walther_b=THIN[1])
    return OPERATION.flow(replace(motor, oil=oil))


def with_sample(spec: MotorSpec) -> MotorSpec:
    return with_file(spec, oil_samples=(SAMPLE,))


def with_sensor(spec: MotorSpec, name: str) -> MotorSpec:
    sensor = {name: Channel(source=name, unit=UNITS[name])}
    return with_file(spec, channels=spec.file.channels | sensor)


def readings(spec: MotorSpec, name: str) -> Array:
    """What a sensor without error reads."""
    value = kinematic_viscosity_mm2_per_s(OPERATION.temperature_c, *THIN)
    if name == "dynamic_viscosity":
        value = value * density_kg_per_m3(OPERATION.temperature_c, spec.oil_on(NIGHT).oil()) / 1e3
    return value


def night(spec: MotorSpec, **more: Array) -> NightOutcome:
    return fit(spec, OPERATION, OPERATION.channels(thin_flow(spec)) | more)


def off(spec: MotorSpec, found: NightOutcome) -> Array:
    """Relative errors of the loss factors."""
    (row,) = found.rows["fits"]
    paths = spec.motor(NIGHT, "none").column_paths
    true = np.array([path.configured_coefficient for path in paths])
    estimates: Array = np.array(row["coefficients"][: len(true)])
    return np.abs(estimates / true - 1.0)


def test_with_an_analysis_the_loss_factors_are_the_true_ones(spec: MotorSpec) -> None:
    found = night(with_sample(spec))
    assert off(spec, found).max() < 1e-3
    (row,) = found.rows["fits"]
    # One factor a block, in which the temperature moves by up to 5 K here.
    assert row["training_fit_percent"] > 99.5
    # At the reference conditions, with the data sheet's oil: model.md, section 3.
    assert row["fitted_leakage_l_per_min"] == pytest.approx(1.371423, rel=1e-3)


@pytest.mark.parametrize("name", UNITS)
def test_a_viscosity_in_the_log_does_the_same(spec: MotorSpec, name: str) -> None:
    found = night(with_sensor(spec, name), **{name: readings(spec, name)})
    assert off(spec, found).max() < 0.02
    assert found.rows["blocks"][0]["viscosity_ratio"] == pytest.approx(0.81, abs=0.01)


def test_an_analysis_that_comes_late_needs_no_log(spec: MotorSpec) -> None:
    before, after = night(spec), night(with_sample(spec))
    blocks = frame(BLOCKS, before.rows["blocks"])
    published = PublishedNight(NIGHT, before.rows, blocks)
    anew = refit(with_sample(spec), published)
    for column in ("coefficients", "cost", "training_fit_percent"):
        (made,), (read,) = anew.rows["fits"], after.rows["fits"]
        assert made[column] == pytest.approx(read[column], rel=1e-9, abs=1e-12)
    # Blocks are those of the data sheet, whatever was measured.
    assert after.rows["blocks"] == before.rows["blocks"]


@pytest.mark.parametrize(
    ("factor", "constant", "words"),
    [
        (0.0, np.nan, "is credible in only 0 % of the kept samples"),
        (0.0, 31.0, "is credible in only"),  # frozen
        (0.0, 0.3, "is credible in only 0 %"),  # below any oil
        (3.8, 0.0, "times that of ISO VG 68 hydraulic oil: another unit, oil or place"),
    ],
)
def test_a_sensor_that_tells_nothing_makes_no_figure(
    spec: MotorSpec, factor: float, constant: float, words: str
) -> None:
    name = "kinematic_viscosity"
    value = factor * readings(spec, name) + constant
    found = night(with_sensor(spec, name), **{name: value})
    assert found.status == "insufficient_data"
    for one in (name, words, "the data sheet holds"):
        assert one in (found.reason or "")


@pytest.mark.parametrize(
    ("factor", "share", "is_enough"),
    # Within a factor of three of the data sheet, in a tenth of the samples.
    [(3.6, 1.0, True), (1.0, 0.11, True), (1.0, 0.09, False)],
)
def test_what_a_sensor_has_to_tell(
    spec: MotorSpec, factor: float, share: float, is_enough: bool
) -> None:
    name = "kinematic_viscosity"
    told = np.arange(len(OPERATION.time_us)) < share * len(OPERATION.time_us)
    value = np.where(told, factor * readings(spec, name), np.nan)
    found = night(with_sensor(spec, name), **{name: value})
    assert (found.status == "ok") == is_enough
    if is_enough:
        ratio = found.rows["blocks"][0]["viscosity_ratio"]
        assert ratio == pytest.approx(0.81 * factor, rel=0.02)
