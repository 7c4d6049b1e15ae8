"""One motor, one night: noise-free nights give back what they were made of."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from leakage import OperatingConditions, total_flow_l_per_min
from pipeline.config import MotorSpec
from pipeline.night.rows import Rows
from pipeline.schema import NIGHT_TABLES, frame
from pipeline.schema.fits import OK
from tests.pipeline.night.noise_free import (
    TRUTH,
    fit,
    fit_of,
    simulate,
    true_coefficients,
    values_of,
    white,
)
from tests.pipeline.simulated import (
    CANONICAL,
    NIGHT,
    load_motor,
    motor_toml,
    operate,
    with_settings,
)

ALL_MODES = '[flushing]\nmode = "estimated"\nalso = ["none", "fixed"]\n'


def with_flushing(spec: MotorSpec, **keys: Any) -> MotorSpec:
    flushing = spec.file.flushing.model_copy(update=keys)
    return replace(spec, file=spec.file.model_copy(update={"flushing": flushing}))


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
    for mode in ("none", "fixed", "estimated"):
        assert max(errors_of_k(spec, outcome.rows, mode)) < 1e-6
        assert values_of(outcome.rows, mode)["C_f"] == pytest.approx(0.0, abs=1e-9)
        row = fit_of(outcome.rows, mode)
        for part in ("training", "validation"):
            assert row[f"{part}_fit_percent"] == pytest.approx(100.0, abs=1e-6)


def test_four_litres_more_move_the_flushing_alone(spec: MotorSpec) -> None:
    spec = with_flushing(spec, mode="estimated", flow_l_per_min=1.0)
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
    leakage = "reference_leakage_l_per_min"
    assert fit_of(after)[leakage] == pytest.approx(fit_of(before)[leakage], rel=1e-6)
    assert fit_of(after)["mean_flow_l_per_min"] == pytest.approx(
        fit_of(before)["mean_flow_l_per_min"] + 4.0, abs=1e-9
    )


def test_matched_smoothing_leaves_k_as_it_is_and_the_thesis_s_does_not(spec: MotorSpec) -> None:
    # model.md, section 4: on the columns of z no error, on y alone a few per cent.
    operation = operate()
    values = simulate(spec, operation)
    largest = {}
    for apply_to in ("all", "leakage"):
        own = with_settings(spec, "smoothing", window_s=30.0, apply_to=apply_to)
        largest[apply_to] = max(errors_of_k(spec, fit(own, operation, values).rows, "none"))
    assert largest["all"] < 1e-6
    assert largest["leakage"] > 1e-2


def with_ports(folder: Path, more: str = "") -> MotorSpec:
    ports_of = {"high_port_pressure": "bar", "low_port_pressure": "bar"}
    units = ports_of | {name: unit for name, unit in CANONICAL.items() if "pressure" not in name}
    return load_motor(folder, motor_toml("M1", units=units, more=more))


def test_the_low_side_changes_its_port_under_back_drive(tmp_path: Path, spec: MotorSpec) -> None:
    ports, operation = with_ports(tmp_path / "ports"), operate()
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


def test_rows_fit_their_tables_and_no_key_stands_twice(tmp_path: Path) -> None:
    spec = load_motor(tmp_path, motor_toml("M1", more=ALL_MODES))
    operation = operate()
    values = simulate(spec, operation)
    # Without any error there are no residuals to test.
    values["leakage_flow"] += white(2400)
    outcome = fit(spec, operation, values)
    for table in NIGHT_TABLES:
        rows = frame(table, outcome.rows.get(table.name, []))
        key = [name for name in table.key if name in rows.columns]
        assert rows.select(key).is_unique().all(), table.name
        if table.name not in ("input_files", "starts"):
            assert rows.height, table.name
