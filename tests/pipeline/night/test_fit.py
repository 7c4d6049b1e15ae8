"""A night's fit: verdicts, intervals, budgets, and the choices beyond the thesis."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from leakage import OperatingConditions, total_flow_l_per_min
from pipeline.config import MotorSpec
from pipeline.demo import shipped_configs
from pipeline.night.fit_night import NightOutcome, fit_night
from pipeline.schema.fits import OK
from tests.pipeline.simulated import (
    NIGHT,
    Operation,
    load_motor,
    motor_toml,
    night_of,
    operate,
    raw,
    with_settings,
)

Array = NDArray[np.float64]
TWO_HOURS = 120.0


def noise(n: int, seed: int = 1, sd: float = 0.01) -> Array:
    return sd * np.random.default_rng(seed).standard_normal(n)


def configured_flow(spec: MotorSpec, operation: Operation) -> Array:
    return operation.flow(spec.motor(NIGHT, "none"))


def fitted(
    spec: MotorSpec, operation: Operation, flow: Array, more: Mapping[str, Array] | None = None
) -> NightOutcome:
    values = operation.channels(flow) | dict(more or {})
    outcome = fit_night(spec, night_of(), raw(operation.time_us, values), {})
    assert outcome.status == OK, outcome.reason
    return outcome


def parameters(outcome: NightOutcome) -> dict[str, dict[str, Any]]:
    return {row["parameter"]: row for row in outcome.rows["parameters"]}


def primary(outcome: NightOutcome) -> dict[str, Any]:
    return next(row for row in outcome.rows["fits"] if row["is_primary"])


def true_k(spec: MotorSpec) -> dict[str, float]:
    paths = spec.motor(NIGHT, "none").column_paths
    return {path.coefficient_name: path.configured_coefficient for path in paths}


def test_a_good_night_has_verdicts_and_intervals(spec: MotorSpec) -> None:
    operation = operate(minutes=TWO_HOURS)
    flow = configured_flow(spec, operation) + noise(len(operation.time_us))
    outcome = fitted(spec, operation, flow)
    rows, row = parameters(outcome), primary(outcome)
    for name, true in true_k(spec).items():
        found = rows[name]
        assert found["verdict"] == "identified"
        assert found["lower"] < found["value"] < found["upper"]
        # Three half-widths: a fixed seed must not sit on the edge of one night in twenty.
        half = (found["upper"] - found["lower"]) / 2
        assert abs(found["value"] - true) < 3 * half
    assert row["reference_verdict"] == "identified"
    assert row["reference_leakage_l_per_min"] == pytest.approx(1.371423, rel=0.01)
    assert row["n_parameters"] == 3
    assert row["interval_status"] == "ok"
    # The ring has no eccentricity: its gap is known as well as its K, by the cube root.
    ring, k = rows["h_piston_ring"], rows["K_piston_ring"]
    assert (ring["upper"] / ring["value"]) ** 3 == pytest.approx(k["upper"] / k["value"])
    # h and e of a balance piston never get a ±.
    for name in ("h_balance_piston", "e_balance_piston", "h_balance_sleeve", "e_balance_sleeve"):
        assert rows[name]["verdict"] == "only_in_combination"
        assert "lower" not in rows[name]
    low, high = (rows["h_balance_piston"][f"feasible_{end}"] for end in ("min", "max"))
    assert high / low == pytest.approx(2.5 ** (1 / 3))
    # To the last digit, as a root of what rounding leaves would be 1e-8.
    ends = [rows["e_balance_piston"][f"feasible_{end}"] for end in ("min", "max")]
    assert ends == [0.0, 1.0]
    assert rows["film_thickness_ratio_balance_piston"]["feasible_min"] == 0.0


def test_shares_sum_to_one_and_have_intervals(spec: MotorSpec) -> None:
    operation = operate(minutes=TWO_HOURS)
    flow = configured_flow(spec, operation) + noise(len(operation.time_us))
    rows = parameters(fitted(spec, operation, flow))
    shares = {name: row for name, row in rows.items() if name.startswith("share_")}
    assert len(shares) == 4
    assert sum(row["value"] for row in shares.values()) == pytest.approx(1.0)
    # model.md, section 3: 0.0110, 0.3396, 0.4895, 0.5313 of 1.371423 l/min, 32 interfaces each.
    worked = {
        "piston_ring": 3.445024e-4,
        "balance_piston": 1.061377e-2,
        "balance_sleeve": 1.529589e-2,
        "cam_roller": 1.660281e-2,
    }
    for path, flow_l_per_min in worked.items():
        row = shares[f"share_{path}"]
        assert row["verdict"] == "identified"
        assert row["value"] == pytest.approx(32 * flow_l_per_min / 1.371423, rel=0.02)
        assert row["lower"] < row["value"] < row["upper"]


def test_slow_errors_are_found_told_and_allowed_for(spec: MotorSpec) -> None:
    operation = operate(minutes=90.0)
    n = len(operation.time_us)
    drift = lfilter([1.0], [1.0, -np.exp(-0.1 / 900.0)], np.random.default_rng(3).normal(size=n))
    truth = configured_flow(spec, operation)
    flow = truth + noise(n) + 0.05 * drift / drift.std()
    row = primary(fitted(spec, operation, flow))
    assert row["slow_error_evidence"] >= 4
    assert row["slow_error_memory"] >= 0.8
    assert row["slow_error_ratio"] > 0
    assert row["interval_status"].startswith("ok: the errors remember for ")
    quiet = primary(fitted(spec, operation, truth + noise(n)))
    assert quiet["interval_status"] == "ok"
    widths = [
        one["reference_leakage_upper"] - one["reference_leakage_lower"] for one in (row, quiet)
    ]
    assert widths[0] > 3 * widths[1]


def test_one_pressure_all_night_leaves_the_leakage_at_own_conditions(spec: MotorSpec) -> None:
    operation = operate(minutes=TWO_HOURS)
    pressure = 180.0 + 0.1 * np.sin(np.arange(len(operation.time_us)) / 17.0)
    operation = replace(operation, pressure_bar=pressure)
    truth = configured_flow(spec, operation)
    outcome = fitted(spec, operation, truth + noise(len(truth)))
    row = primary(outcome)
    assert row["reference_leakage_l_per_min"] is None
    assert row["outside_fitted_range"]
    assert "180" in row["reference_reason"]
    assert not any(parameters(outcome)[name]["verdict"] == "identified" for name in true_k(spec))
    own = spec.motor(NIGHT, "none")
    conditions = OperatingConditions.from_bar(
        row["own_pressure_bar"], row["own_temperature_c"], row["own_speed_rpm"]
    )
    expected = float(total_flow_l_per_min(own, conditions)[0])
    assert row["own_conditions_leakage_l_per_min"] == pytest.approx(expected, rel=0.01)
    half = row["own_conditions_leakage_upper"] - row["own_conditions_leakage_l_per_min"]
    assert 0 < half < 0.01 * expected


def test_stated_tolerances_become_a_budget_whose_squares_add(tmp_path: Path) -> None:
    stated = "[override.model]\nfilm_pressure_share_tolerance = 0.1\n"
    text = motor_toml("M1", more=stated)
    text = text.replace(
        "[channels.oil_temperature]\n", "[channels.oil_temperature]\noffset_tolerance = 1.0\n"
    ).replace(
        "[channels.leakage_flow]\n", "[channels.leakage_flow]\ngain_tolerance_percent = 2.0\n"
    )
    spec = load_motor(tmp_path, text)
    operation = operate(minutes=TWO_HOURS)
    flow = configured_flow(spec, operation) + noise(len(operation.time_us))
    outcome = fitted(spec, operation, flow)
    effects = outcome.rows["sensitivities"]
    sources = {row["source"] for row in effects}
    assert {"oil_temperature offset", "leakage_flow gain", "film pressure share"} <= sources
    reference = [row for row in effects if row["indicator"] == "reference_leakage"]
    stated = [row for row in reference if row["assumed_sensor"] is None]
    total = np.sqrt(sum(row["effect"] ** 2 for row in stated))
    row = primary(outcome)
    assert row["reference_leakage_systematic"] == pytest.approx(total)
    by_source = {one["source"]: one for one in reference}
    leakage = row["reference_leakage_l_per_min"]
    # model.md, section 5: 1 °C moves the reference leakage by −4.8 %.
    assert by_source["oil_temperature offset"]["effect"] / leakage == pytest.approx(
        -0.048, abs=0.004
    )


def test_hubers_loss_withstands_what_the_cleaning_lets_through(spec: MotorSpec) -> None:
    """Bursts of 20 s in 8 % of the time are no spikes: squares follow them, Huber does not."""
    operation = operate(minutes=TWO_HOURS)
    truth = configured_flow(spec, operation)
    n = len(truth)
    burst = (np.arange(n) % 250) < 20
    flow = truth + noise(n) + 0.3 * burst
    off = {}
    for loss in ("squared", "huber"):
        robust = with_settings(spec, "estimation", loss=loss)
        row = primary(fitted(robust, operation, flow))
        assert row["loss"] == loss
        off[loss] = abs(row["own_conditions_leakage_l_per_min"] - _at_own(spec, row))
    assert off["huber"] < 0.25 * off["squared"]


def _at_own(spec: MotorSpec, row: Mapping[str, Any]) -> float:
    conditions = OperatingConditions.from_bar(
        row["own_pressure_bar"], row["own_temperature_c"], row["own_speed_rpm"]
    )
    return float(total_flow_l_per_min(spec.motor(NIGHT, "none"), conditions)[0])


@pytest.mark.parametrize("logged", [True, False])
def test_two_sided_leakage_is_found_again(tmp_path: Path, logged: bool) -> None:
    """Charge pressure from a channel or as a constant; one-sided, the ring is far off."""
    channel = '[channels.charge_pressure]\nsource = "charge_pressure"\nunit = "bar"\n'
    constants = "[override.model]\ncase_pressure_bar = 1.0\n"
    more = (
        (channel if logged else "") + constants + ("" if logged else "charge_pressure_bar = 16.0\n")
    )
    spec = load_motor(tmp_path, motor_toml("M1", more=more))
    operation = operate(minutes=TWO_HOURS)
    n = len(operation.time_us)
    charge_bar = 16.0 + (np.sin(np.arange(n) / 40.0) if logged else np.zeros(n))
    conditions = OperatingConditions.from_bar(
        operation.pressure_bar, operation.temperature_c, operation.speed_rpm, charge_bar - 1.0
    )
    flow = total_flow_l_per_min(spec.motor(NIGHT, "none"), conditions)
    charge = {"charge_pressure": charge_bar} if logged else {}
    outcome = fitted(spec, operation, flow, charge)
    for name, true in true_k(spec).items():
        assert parameters(outcome)[name]["value"] == pytest.approx(true, rel=1e-6)
    assert primary(outcome)["two_sided"]
    one_sided = with_settings(spec, "model", two_sided=False)
    ring = parameters(fitted(one_sided, operation, flow, charge))["K_piston_ring"]["value"]
    assert ring > 1.3 * true_k(spec)["K_piston_ring"]


def test_a_free_roller_scale_is_found(tmp_path: Path) -> None:
    text = (shipped_configs() / "motor_types" / "CB560.toml").read_text("utf-8")
    text = text.replace('motor_type = "CB560"', 'motor_type = "CB560F"')
    text += "scale = { value = 1.0, minimum = 0.1, maximum = 5.0, fixed = false }\n"
    spec = load_motor(tmp_path, motor_toml("M1", "CB560F"), {"CB560F": text})
    motor = spec.motor(NIGHT, "none")
    assert motor.columns[3] == "cam_roller"
    operation = operate(minutes=TWO_HOURS)
    flow = operation.flow(motor, {"cam_roller": 1.6}) + noise(len(operation.time_us))
    found = parameters(fitted(spec, operation, flow))["scale_cam_roller"]
    assert found["verdict"] == "identified"
    assert found["value"] == pytest.approx(1.6, rel=0.02)
    assert found["lower"] < 1.6 < found["upper"]
