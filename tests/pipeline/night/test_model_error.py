"""Parts of the ± of a figure in the rows of a night."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from leakage import OperatingConditions, regressors, total_flow_l_per_min
from pipeline.config import MotorSpec
from pipeline.night.block_fit import ErrorParts, of_extrapolation, of_sensors, of_stated
from pipeline.night.fit import assumed_sensors, tolerances
from pipeline.night.fit_night import NightOutcome
from tests.pipeline.night.noise_free import configured_flow, fitted, white
from tests.pipeline.simulated import NIGHT, load_motor, motor_toml, operate

OPERATION = operate(minutes=90.0)
BUDGET = [
    {"indicator": name, "source": source, "effect": effect, "assumed_sensor": assumed}
    for name, source, effect, assumed in (
        ("reference_leakage", "oil_temperature offset", -3.0, "Pt100 class B"),
        ("reference_leakage", "leakage_flow gain", 4.0, None),
        ("reference_leakage", "density", 2.0, None),
        ("own_conditions_leakage", "density", 1.5, None),
        ("reference_leakage", "piston_ring deformation constant", 1.0, None),
    )
]


def outcome(spec: MotorSpec, flow_of: MotorSpec | None = None) -> NightOutcome:
    flow = configured_flow(flow_of or spec, OPERATION)
    return fitted(spec, OPERATION, flow + white(len(flow)))


def test_parts_add_by_squares_and_an_unknown_model_adds_nothing() -> None:
    assert ErrorParts(3.0, 4.0, 12.0).total == pytest.approx(13.0)
    assert ErrorParts(3.0, 4.0, None).total == pytest.approx(5.0)
    assert ErrorParts(None, 4.0, 12.0).total is None
    assert ErrorParts(3.0, 4.0, 12.0, 84.0).total == pytest.approx(85.0)


def test_assumed_sensors_are_in_no_stated_error_and_constants_in_no_sensor_error() -> None:
    assert of_stated(BUDGET)["reference_leakage"] == pytest.approx(math.sqrt(16 + 4 + 1))
    assert of_sensors(BUDGET) == {"reference_leakage": pytest.approx(5.0)}


def test_constants_count_in_an_extrapolation_as_far_as_they_differ() -> None:
    found = of_extrapolation(BUDGET, "reference_leakage", "own_conditions_leakage", 1.2)
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


def test_a_right_model_leaves_little_and_its_figures_have_all_parts(spec: MotorSpec) -> None:
    rows = outcome(spec).rows
    (fit,) = rows["fits"]
    assert fit["model_misfit_percent"] < 0.5
    figures = {
        "reference_leakage_": fit,
        "own_conditions_leakage_": fit,
        "": next(row for row in rows["parameters"] if row["parameter"] == "K_balance_piston"),
    }
    for stem, row in figures.items():
        statistical, sensor, model, total = (
            row[f"{stem}{part}_half_width"] for part in ("statistical", "sensor", "model", "total")
        )
        width = (row[f"{stem}upper"] - row[f"{stem}lower"]) / 2
        assert statistical == pytest.approx(width)
        assert sensor > 0.0
        assert total == pytest.approx(math.hypot(statistical, sensor, model))
    # No sensor has a stated tolerance: the constants alone are systematic.
    assert fit["reference_leakage_systematic"] < fit["reference_leakage_sensor_half_width"]
    assert fit["reference_verdict"] == "identified"


def test_another_film_law_is_told_and_widens_the_total(spec: MotorSpec) -> None:
    settings = spec.settings
    slot = settings.model.model_copy(update={"film_pressure": "slot"})
    truth = replace(spec, settings=settings.model_copy(update={"model": slot}))
    (fit,) = outcome(spec, truth).rows["fits"]
    assert fit["model_misfit_percent"] > 2.0
    assert fit["reference_leakage_model_half_width"] > fit["reference_leakage_sensor_half_width"]
    there = OperatingConditions.from_bar(200.0, 50.0, 30.0)
    (true,) = total_flow_l_per_min(truth.motor(NIGHT, "none"), there)
    error = abs(fit["reference_leakage_l_per_min"] - true)
    assert fit["reference_leakage_statistical_half_width"] < error
    assert error < fit["reference_leakage_total_half_width"]


def test_a_misfit_widens_leakages_twice_and_loss_factors_two_and_a_half_times(
    spec: MotorSpec,
) -> None:
    """κ τ √(c'(X'X/N)⁻¹c), model.md, section 8, from the night's own factor."""
    rows = outcome(spec).rows
    (fit,) = rows["fits"]
    factor = np.zeros((6, 6))
    factor[np.triu_indices(6)] = fit["night_factor"]
    inverse = np.linalg.inv(factor[:3, :3] / np.linalg.norm(factor[:3, :3], axis=0))
    scale = np.linalg.norm(factor[:3, :3], axis=0)
    n = float(factor[:, 3] @ factor[:, 3])
    tau = fit["model_misfit_percent"] / 100.0 * fit["mean_flow_l_per_min"]
    at = OperatingConditions.from_bar(200.0, 50.0, 30.0)
    reference = regressors(spec.motor(NIGHT, "none"), at)[0, :3]
    ring = next(row for row in rows["parameters"] if row["parameter"] == "K_piston_ring")
    for found, contrast, kappa in (
        (fit["reference_leakage_model_half_width"], reference, 2.0),
        (ring["model_half_width"], np.array([1.0, 0.0, 0.0]), 2.5),
    ):
        reach = np.linalg.norm((contrast / scale) @ inverse) * np.sqrt(n)
        assert found == pytest.approx(kappa * tau * reach, rel=0.01)
