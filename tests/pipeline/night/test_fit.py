"""One motor, one night: its fit, its verdicts and rows, and nights that have none."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from leakage import OperatingConditions, regressors, total_flow_l_per_min
from leakage.estimation.blocks import merge
from leakage.estimation.misfit import model_errors
from pipeline.config import MotorSpec
from pipeline.night.fit import ErrorParts, assumed_sensors, by_squares, of_extrapolation, tolerances
from pipeline.night.fit_night import NightOutcome
from pipeline.night.rows import Rows
from pipeline.schema import FAILED, INSUFFICIENT_DATA, OK, QUALITY_REASONS, STOOD_STILL
from tests.pipeline.night.noise_free import (
    TRUTH,
    configured_flow,
    fit,
    fit_of,
    fitted,
    parameters,
    refused_of,
    simulate,
    true_coefficients,
    values_of,
    white,
)
from tests.pipeline.simulated import (
    CANONICAL,
    NIGHT,
    Array,
    load_motor,
    motor_toml,
    operate,
    with_channel,
    with_file,
    with_settings,
)

LONG = operate(minutes=120.0)
N = len(LONG.time_us)
GAIN = "gain_tolerance_percent"


def outcome(spec: MotorSpec, flow_of: MotorSpec | None = None) -> NightOutcome:
    """Two hours with noise of the motor as configured, or of another."""
    return fitted(spec, LONG, configured_flow(flow_of or spec, LONG) + white(N))


def true_k(spec: MotorSpec) -> dict[str, float]:
    paths = spec.motor(NIGHT, "none").column_paths
    return {path.coefficient_name: path.configured_coefficient for path in paths}


def test_a_good_night_has_verdicts_intervals_and_shares(spec: MotorSpec) -> None:
    found = outcome(spec)
    rows, row = parameters(found), fit_of(found.rows)
    for name, true in true_k(spec).items():
        found = rows[name]
        assert found["verdict"] == "identified"
        assert found["lower"] < found["value"] < found["upper"]
        # Three half-widths: a fixed seed must not sit on the edge of one night in twenty.
        assert abs(found["value"] - true) < 3 * (found["upper"] - found["lower"]) / 2
    assert (row["fitted_leakage_verdict"], row["interval_status"]) == ("identified", "ok")
    assert row["fitted_leakage_l_per_min"] == pytest.approx(1.371423, rel=0.01)
    # Equation (25), and AIC and BIC as Burnham and Anderson have them.
    n, cost = row["n_training"], row["training_rmse_l_per_min"] ** 2
    assert row["fpe"] == pytest.approx(cost * (n + 3) / (n - 3))
    assert row["aic"] == pytest.approx(n * (math.log(2 * math.pi * cost) + 1) + 6)
    assert row["aicc"] == pytest.approx(row["aic"] + 24 / (n - 4))
    assert row["bic"] == pytest.approx(row["aic"] + 3 * (math.log(n) - 2))
    # h and e of a balance piston never get a ±.
    for name in ("h_balance_piston", "e_balance_piston", "h_balance_sleeve", "e_balance_sleeve"):
        assert rows[name]["verdict"] == "only_in_combination"
        assert "lower" not in rows[name]
    # model.md, section 3: 0.0110, 0.3396, 0.4895, 0.5313 of 1.371423 l/min, 32 interfaces each.
    worked = {
        "share_piston_ring": 3.445024e-4,
        "share_balance_piston": 1.061377e-2,
        "share_balance_sleeve": 1.529589e-2,
        "share_cam_roller": 1.660281e-2,
    }
    assert {name for name in rows if name.startswith("share_")} == worked.keys()
    assert sum(rows[name]["value"] for name in worked) == pytest.approx(1.0)
    for name, flow_l_per_min in worked.items():
        assert rows[name]["verdict"] == "identified"
        assert rows[name]["value"] == pytest.approx(32 * flow_l_per_min / 1.371423, rel=0.02)
        assert rows[name]["lower"] < rows[name]["value"] < rows[name]["upper"]


def test_slow_errors_are_estimated_reported_and_allowed_for(spec: MotorSpec) -> None:
    drift = lfilter([1.0], [1.0, -np.exp(-0.1 / 900.0)], white(N, 1.0, seed=3))
    truth = configured_flow(spec, LONG) + white(N)
    flows = (truth + 0.05 * drift / drift.std(), truth)
    slow, quiet = (fit_of(fitted(spec, LONG, flow).rows) for flow in flows)
    assert slow["interval_status"].startswith("ok: the errors remember for ")
    assert quiet["interval_status"] == "ok"
    lower, upper = "fitted_leakage_lower", "fitted_leakage_upper"
    assert slow[upper] - slow[lower] > 3 * (quiet[upper] - quiet[lower])


def test_stated_tolerances_become_a_budget_whose_squares_add(tmp_path: Path) -> None:
    text = motor_toml("M1")
    for name, key in (("oil_temperature", "offset_tolerance"), ("leakage_flow", GAIN)):
        text = text.replace(f"[channels.{name}]\n", f"[channels.{name}]\n{key} = 1.0\n")
    spec = load_motor(tmp_path, text)
    rows = outcome(spec).rows
    reference = {
        row["source"]: row for row in rows["error_budget"] if row["indicator"] == "fitted_leakage"
    }
    wanted = {"oil_temperature offset", "leakage_flow gain"}
    assert wanted <= reference.keys()
    ring = [row for row in rows["error_budget"] if row["indicator"] == "K_piston_ring"]
    stated = [row["effect"] for row in ring if not row["is_assumed"]]
    assert 0 < len(stated) < len(ring)
    (row,) = [row for row in rows["parameters"] if row["parameter"] == "K_piston_ring"]
    assert row["systematic"] == pytest.approx(np.linalg.norm(stated))
    # model.md, section 5: 1 °C moves the reference leakage by −4.8 %.
    leakage = fit_of(rows)["fitted_leakage_l_per_min"]
    share = reference["oil_temperature offset"]["effect"] / leakage
    assert share == pytest.approx(-0.048, abs=0.004)


@pytest.mark.parametrize("logged", [True, False])
def test_two_sided_leakage_is_found_again(tmp_path: Path, logged: bool) -> None:
    """Charge pressure from a channel or as a constant; one-sided, the ring is far off."""
    place = 'source = "charge_pressure"' if logged else "constant = 16.0"
    more = f'[channels.charge_pressure]\n{place}\nunit = "bar"\n'
    more += '[channels.case_pressure]\nconstant = 1.0\nunit = "bar"\n'
    spec = load_motor(tmp_path, motor_toml("M1", more=more))
    charge_bar = 16.0 + logged * np.sin(np.arange(N) / 40.0)
    conditions = OperatingConditions.from_bar(
        LONG.pressure_bar, LONG.temperature_c, LONG.speed_rpm, charge_bar - 1.0
    )
    flow = total_flow_l_per_min(spec.motor(NIGHT, "none"), conditions)
    charge = {"charge_pressure": np.broadcast_to(charge_bar, N), "case_pressure": np.ones(N)}
    outcome = fitted(spec, LONG, flow, charge)
    for name, true in true_k(spec).items():
        assert parameters(outcome)[name]["value"] == pytest.approx(true, rel=1e-6)
    charges = [row["mean_charge_over_case_bar"] for row in outcome.rows["blocks"]]
    assert charges == pytest.approx([15.0] * len(charges), abs=1.0)
    one_sided = fitted(with_settings(spec, "model", two_sided=False), LONG, flow, charge)
    ring = parameters(one_sided)["K_piston_ring"]["value"]
    assert ring > 1.3 * true_k(spec)["K_piston_ring"]


ALL_MODES = '[flushing]\nmode = "estimated"\nalso = ["none", "fixed"]\n'


def errors_of_k(spec: MotorSpec, rows: Rows, mode: str) -> list[float]:
    """Relative errors of the loss factors."""
    found, true = values_of(rows, mode), true_coefficients(spec)
    return [abs(found[f"K_{name}"] / true[name] - 1.0) for name in TRUTH]


def test_noise_free_night_gives_back_k_in_all_modes_side_by_side(tmp_path: Path) -> None:
    spec = load_motor(tmp_path, motor_toml("M1", more=ALL_MODES))
    operation = operate()
    outcome = fit(spec, operation, simulate(spec, operation))
    assert outcome.status == OK, outcome.reason
    assert [row["flushing_mode"] for row in outcome.rows["fits"]] == ["estimated", "none", "fixed"]
    assert [row["is_primary"] for row in outcome.rows["fits"]] == [True, False, False]
    # On y alone smoothing would move K by a few per cent (model.md, section 4).
    smoothed = with_settings(spec, "smoothing", window_s=30.0)
    rows = fit(smoothed, operation, simulate(spec, operation)).rows
    assert max(errors_of_k(spec, rows, "none")) < 1e-6
    for mode in ("none", "fixed", "estimated"):
        assert max(errors_of_k(spec, outcome.rows, mode)) < 1e-6
        assert values_of(outcome.rows, mode)["C_f"] == pytest.approx(0.0, abs=1e-9)
        row = fit_of(outcome.rows, mode)
        for part in ("training", "validation"):
            assert row[f"{part}_fit_percent"] == pytest.approx(100.0, abs=1e-6)


def test_four_litres_more_move_the_flushing_alone(spec: MotorSpec) -> None:
    keys = {"mode": "estimated", "flow_l_per_min": 1.0}
    spec = with_file(spec, flushing=spec.file.flushing.model_copy(update=keys))
    operation = operate()
    # Noise, so that the night is like any other and the comparison means something.
    values = simulate(spec, operation, flushing=2.0)
    values["leakage_flow"] += white(2400, 0.02)
    before = fit(spec, operation, values).rows
    values["leakage_flow"] = values["leakage_flow"] + 4.0
    after = fit(spec, operation, values).rows
    old, new = values_of(before, "estimated"), values_of(after, "estimated")
    assert new["C_f"] - old["C_f"] == pytest.approx(4.0, abs=1e-6)
    for name in TRUTH:
        assert new[f"K_{name}"] == pytest.approx(old[f"K_{name}"], rel=1e-6)
    leakage = "fitted_leakage_l_per_min"
    assert fit_of(after)[leakage] == pytest.approx(fit_of(before)[leakage], rel=1e-6)
    assert fit_of(after)["mean_drain_flow_l_per_min"] == pytest.approx(
        fit_of(before)["mean_drain_flow_l_per_min"] + 4.0, abs=1e-9
    )


def test_the_low_side_changes_its_port_under_back_drive(tmp_path: Path, spec: MotorSpec) -> None:
    ports_of = dict.fromkeys(("high_port_pressure", "low_port_pressure"), "bar")
    units = ports_of | {name: unit for name, unit in CANONICAL.items() if "pressure" not in name}
    ports, operation = load_motor(tmp_path / "ports", motor_toml("M1", units=units)), operate()
    sign = np.where(np.arange(len(operation.time_us)) < 1200, 1.0, -1.0)
    charge = 15.0 + np.sin(np.arange(len(sign)) / 50.0)
    conditions = OperatingConditions.from_bar(
        operation.pressure_bar, operation.temperature_c, operation.speed_rpm, charge
    )
    difference = sign * operation.pressure_bar
    values = {
        "high_port_pressure": charge + np.maximum(difference, 0.0),
        "low_port_pressure": charge + np.maximum(-difference, 0.0),
        "oil_temperature": operation.temperature_c,
        "speed": sign * operation.speed_rpm,
        "leakage_flow": total_flow_l_per_min(
            spec.motor(NIGHT, "estimated"), conditions, true_coefficients(spec)
        ),
    }
    assert max(errors_of_k(spec, fit(ports, operation, values).rows, "none")) < 1e-6


MOVING = operate()
PLACE = np.arange(len(MOVING.time_us))
STILL = 0.1 + 1e-3 * np.sin(MOVING.pressure_bar)
LIMITS: dict[str, dict[str, Any]] = {
    "leakage_flow": {"sensor_maximum": 0.5},
    "oil_temperature": {"valid_range": (0.0, 1000.0)},
}


@pytest.mark.parametrize(
    ("limited", "changed", "outcome", "words"),
    [
        pytest.param(
            "", {"speed": STILL, "pressure_difference": 60.0 + 1e-3 * np.sin(PLACE)},
            STOOD_STILL, ["the motor stood still all night"], id="stood still",
        ),
        pytest.param(
            "", {"speed": STILL}, INSUFFICIENT_DATA, ["a dead speed sensor?"], id="dead speed",
        ),
        pytest.param(
            "leakage_flow", {"speed": np.where(PLACE < 60, 0.0, MOVING.speed_rpm)},
            INSUFFICIENT_DATA, ["leakage_flow at_maximum"], id="a sensor at its maximum",
        ),
        pytest.param(
            "", {"oil_temperature": np.empty(0)},
            INSUFFICIENT_DATA, ["no samples of oil_temperature"], id="a sensor without a sample",
        ),
        pytest.param(
            "", {"oil_temperature": np.where(PLACE % 1000 < 500, 850.0, MOVING.temperature_c)},
            INSUFFICIENT_DATA, ["oil_temperature out_of_range", "60 % are needed"],
            id="too much refused",
        ),
        pytest.param(
            "oil_temperature", {"oil_temperature": MOVING.temperature_c + 600.0},
            FAILED, ["outside ASTM D341"], id="beyond Walther",
        ),
    ],
)  # fmt: skip
def test_a_night_without_a_fit_has_one_row_that_says_why(
    spec: MotorSpec, limited: str, changed: dict[str, Array], outcome: str, words: list[str]
) -> None:
    spec = with_channel(spec, limited, **LIMITS[limited]) if limited else spec
    found = fit(spec, MOVING, simulate(spec, MOVING) | changed)
    row = fit_of(found.rows)
    assert row["status"] == found.status == outcome
    assert row["reason"] == found.reason
    assert all(word in row["reason"] for word in words), row["reason"]
    assert row["error_code"] == found.error_code
    assert (found.error_code is None) == (outcome != FAILED)
    # Neither a window nor any figure.
    assert not row.keys() & {"window_start", "fitted_leakage_l_per_min"}
    assert not found.rows.keys() & {"parameters", "predictions"}
    assert ("quality" in found.rows) == all(len(values) for values in changed.values())


COUNTED = "volume_per_count_cm3 = 1.0\n"
ALL_RULES = """
[override.cleaning]
refuse_transients = true
warm_up_minutes = 1.0
[override.transport_delay]
fixed_s = 2.0
"""
BY_HAND = """
[periods]
training = [[2026-03-01T22:00:00Z, 2026-03-01T22:20:00Z]]
"""


def reasons_of(folder: Path, text: str) -> set[str]:
    spec = load_motor(folder, text)
    operation = operate()
    values = operation.channels(configured_flow(spec, operation))
    if spec.file.channels["leakage_flow"].is_counted:
        values["leakage_flow"] = np.floor(np.cumsum(values["leakage_flow"]) * 1000.0 / 60.0)
    return {reason for _, reason in refused_of(fit(spec, operation, values))}


def test_every_reason_is_documented_and_no_other(tmp_path: Path) -> None:
    counted = motor_toml("M1", units=CANONICAL | {"leakage_flow": "count"}) + COUNTED + ALL_RULES
    found = reasons_of(tmp_path / "all", counted)
    found |= reasons_of(tmp_path / "by_hand", motor_toml("M1", more=BY_HAND))
    assert found <= QUALITY_REASONS.keys()
    # Only where a channel's config names a column of qualities.
    assert QUALITY_REASONS.keys() - found <= {"bad_quality"}


BUDGET = [
    {"indicator": name, "source": source, "effect": effect, "is_assumed": assumed}
    for name, source, effect, assumed in (
        ("fitted_leakage", "oil_temperature offset", -3.0, True),
        ("fitted_leakage", "leakage_flow gain", 4.0, False),
        ("fitted_leakage", "density", 2.0, False),
        ("own_conditions_leakage", "density", 1.5, False),
        ("fitted_leakage", "piston_ring deformation constant", 1.0, False),
    )
]


def test_parts_add_by_squares_each_where_it_belongs() -> None:
    """Unknown ones add nothing; in an extrapolation constants count as far as they differ."""
    assert ErrorParts(3.0, 4.0, 12.0).total == pytest.approx(13.0)
    assert ErrorParts(3.0, 4.0, None).total == pytest.approx(5.0)
    assert ErrorParts(None, 4.0, 12.0).total is None
    assert ErrorParts(3.0, 4.0, 12.0, 84.0).total == pytest.approx(85.0)
    own, reference = 1.5, math.sqrt(9 + 16 + 4 + 1)
    assert by_squares(BUDGET) == pytest.approx(
        {"fitted_leakage": reference, "own_conditions_leakage": own}
    )
    found = of_extrapolation(BUDGET, 1.2)
    assert found == pytest.approx(math.hypot(2.0 - 1.2 * 1.5, 1.0))


def test_sensors_have_the_tolerance_stated_or_that_of_their_kind(tmp_path: Path) -> None:
    """EN 837-1 class 1, IEC 60751 class B at 50 °C, and a gear meter's 1 %."""
    pressure = "[channels.pressure_difference]\n"
    text = motor_toml("M1").replace(pressure, f"{pressure}sensor_maximum = 250\n")
    found = tolerances(load_motor(tmp_path / "kind", text), NIGHT)
    assert found.pressure_bar.offset == pytest.approx(2.5)
    assert found.temperature_c.offset == pytest.approx(0.3 + 0.005 * 50.0)
    assert found.flow_l_per_min.gain == pytest.approx(0.01)
    assert found.speed_rpm.offset == found.speed_rpm.gain == 0.0
    oil = "[channels.oil_temperature]\n"
    spec = load_motor(tmp_path / "own", text.replace(oil, f"{oil}offset_tolerance = 0.2\n"))
    assert tolerances(spec, NIGHT).temperature_c.offset == pytest.approx(0.2)
    assert set(assumed_sensors(spec)) == {"pressure_difference", "leakage_flow"}


@pytest.mark.parametrize("is_right", [True, False])
def test_figures_have_all_parts_and_a_misfit_widens_them(spec: MotorSpec, is_right: bool) -> None:
    """κ R(c), model.md, section 8, from the night's own blocks."""
    truth = spec if is_right else with_settings(spec, "model", film_pressure="slot")
    rows = outcome(spec, truth).rows
    fit = fit_of(rows)
    statistical, sensor, model, total = (
        fit[f"fitted_leakage_{part}_l_per_min"]
        for part in ("statistical", "sensor", "model", "total")
    )
    width = (fit["fitted_leakage_upper"] - fit["fitted_leakage_lower"]) / 2
    assert statistical == pytest.approx(width)
    assert sensor > 0.0
    assert total == pytest.approx(math.hypot(statistical, sensor, model))
    assert (fit["model_misfit_percent"] < 0.5) == (model < sensor) == is_right
    at = OperatingConditions.from_bar(200.0, 50.0, 30.0)
    (true,) = total_flow_l_per_min(truth.motor(NIGHT, "none"), at)
    assert abs(fit["fitted_leakage_l_per_min"] - true) < total
    factors = np.zeros((len(rows["blocks"]), 6, 6))
    factors[(slice(None), *np.triu_indices(6))] = [row["factor"] for row in rows["blocks"]]
    tau = fit["model_misfit_percent"] / 100.0 * fit["mean_drain_flow_l_per_min"]
    reference = np.append(regressors(spec.motor(NIGHT, "none"), at)[0, :3], 0.0)
    fixed = np.array([False, False, False, True])
    (leakage,) = model_errors(merge(factors), fixed, reference[None], tau)
    assert model == pytest.approx(2.0 * leakage, rel=0.01)
