"""One motor, one night: noise-free nights give back what they were made of."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from leakage import AnnularGap, OperatingConditions, total_flow_l_per_min
from pipeline.config import MotorSpec
from pipeline.config.hashes import model_hash
from pipeline.ingest import RawChannel, read_log
from pipeline.night.block_fit import night_seed
from pipeline.night.fit_night import NightOutcome, fit_night, unfitted
from pipeline.night.rows import Rows
from pipeline.schema import NIGHT_TABLES, frame
from pipeline.schema.fits import FAILED, INSUFFICIENT_DATA, OK, STOOD_STILL
from tests.pipeline.simulated import (
    CANONICAL,
    NIGHT,
    Array,
    Operation,
    load_motor,
    motor_toml,
    night_of,
    operate,
    raw,
    with_channel,
    with_settings,
    write_log,
)

# Gaps of the worked values (model.md, sections 3 and 4), in µm, each a little off the configured.
TRUTH = {"piston_ring": 1.05**3, "balance_piston": 0.93**3, "balance_sleeve": 1.02**3}
ALL_MODES = '[flushing]\nmode = "estimated"\nalso = ["none", "fixed"]\n'


@pytest.fixture
def spec(tmp_path: Path) -> MotorSpec:
    return load_motor(tmp_path, motor_toml("M1"))


def true_coefficients(spec: MotorSpec, flushing: float = 0.0) -> dict[str, float]:
    motor = spec.motor(NIGHT, "none")
    factors = {
        path.name: path.configured_coefficient * TRUTH[path.name]
        for path in motor.paths
        if isinstance(path, AnnularGap)
    }
    return factors | {"flushing": flushing}


def test_readings_are_given_up_as_they_are_cleaned(spec: MotorSpec) -> None:
    """A day at 100 Hz is not to be in memory twice."""
    operation = operate(NIGHT)
    channels = raw(operation.time_us, operation.channels(operation.flow(spec.motor(NIGHT, "none"))))
    assert fit_night(spec, night_of(), channels, {}).status == OK
    assert channels == {}


def simulate(spec: MotorSpec, operation: Operation, flushing: float = 0.0) -> dict[str, Array]:
    motor = spec.motor(NIGHT, "estimated")
    return operation.channels(operation.flow(motor, true_coefficients(spec, flushing)))


def fit(
    spec: MotorSpec,
    operation: Operation,
    values: Mapping[str, Any],
    previous: Mapping[str, tuple[float, ...]] | None = None,
) -> NightOutcome:
    return fit_night(spec, night_of(), raw(operation.time_us, values), previous or {})


def values_of(rows: Rows, mode: str) -> dict[str, float]:
    return {
        row["parameter"]: row["value"]
        for row in rows["parameters"]
        if row["flushing_mode"] == mode and row["value"] is not None
    }


def fit_of(rows: Rows, mode: str | None = None) -> dict[str, Any]:
    (found,) = (
        row for row in rows["fits"] if (row["flushing_mode"] == mode if mode else row["is_primary"])
    )
    return found


def with_flushing(spec: MotorSpec, **keys: Any) -> MotorSpec:
    flushing = spec.file.flushing.model_copy(update=keys)
    return replace(spec, file=spec.file.model_copy(update={"flushing": flushing}))


def noisy(values: Mapping[str, Array]) -> dict[str, Array]:
    """The same with noise on the drain flow."""
    flow = values["leakage_flow"]
    return {**values, "leakage_flow": flow + np.random.default_rng(3).normal(0.0, 0.02, len(flow))}


def errors_of_k(spec: MotorSpec, rows: Rows, mode: str) -> list[float]:
    """Relative errors of the loss factors."""
    found, true = values_of(rows, mode), true_coefficients(spec)
    return [abs(found[f"K_{name}"] / true[name] - 1.0) for name in TRUTH]


# Recovery


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


@pytest.mark.parametrize("mode", ["fixed", "estimated"])
def test_noise_free_night_with_flushing(spec: MotorSpec, mode: str) -> None:
    spec = with_flushing(spec, mode=mode, flow_l_per_min=4.0 if mode == "fixed" else 1.0)
    operation = operate()
    rows = fit(spec, operation, simulate(spec, operation, flushing=4.0)).rows
    assert values_of(rows, mode)["C_f"] == pytest.approx(4.0, rel=1e-9)
    assert max(errors_of_k(spec, rows, mode)) < 1e-6


def test_flushing_that_the_mode_denies_shows_in_the_fit(spec: MotorSpec) -> None:
    spec = with_flushing(spec, mode="none", also=("estimated",))
    operation = operate()
    rows = fit(spec, operation, simulate(spec, operation, flushing=4.0)).rows
    assert fit_of(rows, "none")["validation_fit_percent"] < 80.0
    assert fit_of(rows, "estimated")["validation_fit_percent"] > 99.999


def test_four_litres_more_move_the_flushing_alone(spec: MotorSpec) -> None:
    spec = with_flushing(spec, mode="estimated", flow_l_per_min=1.0)
    operation = operate()
    # Noise, so that the night is like any other and the comparison means something.
    values = noisy(simulate(spec, operation, flushing=2.0))
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


def test_reverse_running_is_the_same_as_forward(spec: MotorSpec) -> None:
    operation = operate()
    values = simulate(spec, operation)
    backward = values | {name: -values[name] for name in ("pressure_difference", "speed")}
    forth, back = fit(spec, operation, values).rows, fit(spec, operation, backward).rows
    assert [row["share_reversed"] for row in forth["block_statistics"]] == [0.0] * 20
    assert [row["share_reversed"] for row in back["block_statistics"]] == [1.0] * 20
    same = [name for name in forth if name not in ("block_statistics", "operation", "quality")]
    assert {name: forth[name] for name in same} == {name: back[name] for name in same}


def test_half_forward_half_backward_is_one_motor(spec: MotorSpec) -> None:
    operation = operate()
    values = simulate(spec, operation)
    sign = np.where(np.arange(len(operation.time_us)) < 1200, 1.0, -1.0)
    turned = values | {name: sign * values[name] for name in ("pressure_difference", "speed")}
    assert max(errors_of_k(spec, fit(spec, operation, turned).rows, "none")) < 1e-6


def with_ports(folder: Path, more: str = "") -> MotorSpec:
    ports_of = {"high_port_pressure": "bar", "low_port_pressure": "bar"}
    units = ports_of | {name: unit for name, unit in CANONICAL.items() if "pressure" not in name}
    return load_motor(folder, motor_toml("M1", units=units, more=more))


def test_two_ports_are_their_difference(tmp_path: Path, spec: MotorSpec) -> None:
    ports = with_ports(tmp_path / "ports", "[override.model]\ntwo_sided = false\n")
    operation = operate()
    values = simulate(spec, operation)
    # 16ths of a bar: the difference of the ports is then exact.
    low = np.round(15.0 + 2.0 * np.sin(np.arange(len(operation.time_us)) / 50.0), 4)
    difference = values.pop("pressure_difference")
    both = values | {"high_port_pressure": difference + low, "low_port_pressure": low}
    assert max(errors_of_k(spec, fit(ports, operation, both).rows, "none")) < 1e-6


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
    values["leakage_flow"] += 0.01 * np.random.default_rng(1).standard_normal(2400)
    outcome = fit(with_settings(spec, "estimation", search_every_nights=1), operation, values)
    for table in NIGHT_TABLES:
        rows = frame(table, outcome.rows.get(table.name, []))
        key = [name for name in table.key if name in rows.columns]
        assert rows.select(key).is_unique().all(), table.name
        if table.name != "input_files":
            assert rows.height, table.name


def test_arguments_are_not_changed(spec: MotorSpec) -> None:
    operation = operate()
    channels = raw(operation.time_us, simulate(spec, operation))
    before = {name: channel.value.copy() for name, channel in channels.items()}
    for channel in channels.values():
        for array in (channel.time_us, channel.value, channel.missing):
            array.flags.writeable = False
    assert fit_night(spec, night_of(), channels, {}).status == OK
    assert all((channels[name].value == before[name]).all() for name in channels)


# Outcomes that are no fit


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


@pytest.mark.parametrize("n", [1, 2, 3, 10, 100])
def test_a_handful_of_samples(spec: MotorSpec, n: int) -> None:
    operation = operate()
    values = {name: value[:n] for name, value in simulate(spec, operation).items()}
    outcome = fit_night(spec, night_of(), raw(operation.time_us[:n], values), {})
    check_unfitted(outcome, INSUFFICIENT_DATA)


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


def test_every_value_refused(spec: MotorSpec) -> None:
    operation = operate()
    values = {
        name: np.full(len(value), np.nan) for name, value in simulate(spec, operation).items()
    }
    check_unfitted(fit(spec, operation, values), INSUFFICIENT_DATA)


def test_temperatures_beyond_walther_are_a_failed_night_with_its_code(spec: MotorSpec) -> None:
    spec = with_channel(spec, "oil_temperature", valid_range=(0.0, 1000.0))
    operation = operate()
    values = simulate(spec, operation)
    values["oil_temperature"] = values["oil_temperature"] + 600.0
    outcome = fit(spec, operation, values)
    row = check_unfitted(outcome, FAILED)
    assert outcome.error_code
    assert row["error_code"] == outcome.error_code


def test_a_motor_at_rest_pressure_has_no_certainty_but_an_outcome(spec: MotorSpec) -> None:
    # One pressure all night: K cannot be told apart, yet nothing falls over.
    operation = operate()
    still = replace(operation, pressure_bar=180.0 + 0.05 * np.sin(operation.pressure_bar))
    outcome = fit(spec, still, simulate(spec, still))
    assert outcome.status == OK
    row = fit_of(outcome.rows)
    assert row["condition_number"] > 1e3
    assert row["outside_fitted_range"]
    motor = spec.motor(NIGHT, "none")
    assert row["own_conditions_leakage_l_per_min"] == pytest.approx(
        float(still.flow(motor, true_coefficients(spec)).mean()), rel=0.05
    )


def test_unfitted_keeps_what_was_counted_and_nothing_else(spec: MotorSpec) -> None:
    rows: Rows = {"quality": [{}], "block_statistics": [{}], "starts": [{}], "fits": [{}, {}]}
    outcome = unfitted(spec, NIGHT, FAILED, "why", code="log_damaged", rows=rows)
    assert outcome.rows.keys() == {"quality", "block_statistics", "fits"}
    assert outcome.rows["fits"][0]["error_code"] == "log_damaged"
    assert rows["fits"] == [{}, {}]


# The model before


def test_the_model_before_is_judged_on_all_of_tonight(spec: MotorSpec) -> None:
    operation = operate()
    values = simulate(spec, operation)
    first = fit(spec, operation, values)
    assert fit_of(first.rows)["previous_model_fit_percent"] is None
    again = fit(spec, operation, values, first.model)
    assert fit_of(again.rows)["previous_model_fit_percent"] == pytest.approx(100.0, abs=1e-6)
    worn = {mode: tuple(1.3 * k for k in theta) for mode, theta in first.model.items()}
    poor = fit_of(fit(spec, operation, values, worn).rows)["previous_model_fit_percent"]
    assert 0.0 < poor < 90.0
    # By hand (23): the prediction is the truth of the free paths times 1.3.
    motor = spec.motor(NIGHT, "none")
    true = true_coefficients(spec)
    y = values["leakage_flow"]
    off = operation.flow(motor, {name: 1.3 * k for name, k in true.items()}) - y
    by_hand = 100.0 * (1.0 - np.linalg.norm(off) / np.linalg.norm(y - y.mean()))
    assert poor == pytest.approx(by_hand, abs=1e-6)


def test_a_model_before_of_another_shape_is_no_model(spec: MotorSpec) -> None:
    operation = operate()
    outcome = fit(spec, operation, simulate(spec, operation), {"none": (1e-14, 0.0)})
    assert outcome.status == OK
    assert fit_of(outcome.rows)["previous_model_fit_percent"] is None


def test_the_model_is_that_of_each_mode(tmp_path: Path) -> None:
    spec = load_motor(tmp_path, motor_toml("M1", more=ALL_MODES))
    operation = operate()
    outcome = fit(spec, operation, simulate(spec, operation))
    assert outcome.model.keys() == {"none", "fixed", "estimated"}
    found = values_of(outcome.rows, "estimated")
    names = [*(f"K_{path.name}" for path in spec.motor(NIGHT, "none").column_paths), "C_f"]
    assert list(outcome.model["estimated"]) == [found[name] for name in names]


# Seeds


def test_a_seed_for_each_run_motor_night_and_mode() -> None:
    seeds = {
        night_seed(seed, motor, night, mode)
        for seed in (1, 2)
        for motor in ("A", "B")
        for night in (NIGHT, NIGHT + dt.timedelta(days=1))
        for mode in ("none", "estimated")
    }
    assert len(seeds) == 16
    # regression: another value would move every start; Python's own hash moves in every process.
    assert night_seed(1, "M", NIGHT, "none") == 3_302_863_321_456_288_741


def test_the_seed_moves_the_starts_and_not_the_estimate(spec: MotorSpec) -> None:
    operation = operate()
    values = noisy(simulate(spec, operation))
    spec = with_settings(spec, "estimation", search_every_nights=1)
    other = with_settings(spec, "estimation", seed=2)
    one, same, two = (fit(which, operation, values).rows for which in (spec, spec, other))
    assert one == same
    initial = [[row["initial_values"] for row in rows["starts"]] for rows in (one, two)]
    assert initial[0][0] == initial[1][0]
    assert all(a != b for a, b in zip(initial[0][1:], initial[1][1:], strict=True))
    for name in TRUTH:
        key = f"K_{name}"
        assert values_of(one, "none")[key] == values_of(two, "none")[key]


def test_starts_end_at_the_certificate_and_never_below(spec: MotorSpec) -> None:
    operation = operate()
    values = noisy(simulate(spec, operation))
    every = with_settings(spec, "estimation", search_every_nights=1)
    rows = fit(every, operation, values).rows
    row = fit_of(rows)
    assert (row["n_starts"], row["n_starts_at_minimum"]) == (10, 10)
    assert all(start["cost"] >= row["cost"] * (1.0 - 1e-10) for start in rows["starts"])
    # The audit of another night leaves nothing but what the search itself tells.
    other = fit(with_settings(spec, "estimation", search_every_nights=7), operation, values).rows
    assert NIGHT.toordinal() % 7
    assert (fit_of(other)["n_starts"], fit_of(other)["certificate_gap"]) == (0, None)
    assert (other["starts"], values_of(other, "none")) == ([], values_of(rows, "none"))
    # h and e of one gap spread over the starts, K does not (model.md, section 4.1).
    spread = {one["parameter"]: one.get("spread_over_starts") or 0.0 for one in rows["parameters"]}
    assert spread["h_balance_piston"] > 0.5
    assert spread["K_balance_piston"] < 1e-4 * values_of(rows, "none")["K_balance_piston"]


# What shapes the statistics, and what does not


def same_hash(one: MotorSpec, other: MotorSpec) -> bool:
    first, second = (model_hash(spec, spec.motor(NIGHT, "none"), NIGHT) for spec in (one, other))
    return first == second


@pytest.mark.parametrize(
    ("before", "after", "expected"),
    [
        ("deformation_pressure_bar = 120.0", "deformation_pressure_bar = 121.0", "other"),
        ("deformation_pressure_bar = 900.0", "deformation_pressure_bar = 901.0", "other"),
        ("reference_viscosity_mpa_s = 35.0", "reference_viscosity_mpa_s = 36.0", "other"),
        ("4.0e-3]", "4.1e-3]", "other"),
        ("count = 32\ncoefficients", "count = 33\ncoefficients", "other"),
        ("radius_mm = 35.0", "radius_mm = 36.0", "same"),
        ("length_mm = 4.0", "length_mm = 5.0", "same"),
        ("count = 32", "count = 31", "same"),
        ("height_factor = 1.1", "height_factor = 1.2", "same"),
        ("maximum = 60.0", "maximum = 50.0", "same"),
        ('source = "placeholder"', 'source = "drawing 4711"', "same"),
        ("tolerance_percent = 10.0", "tolerance_percent = 5.0", "same"),
    ],
)
def test_model_hash_covers_what_shapes_the_columns(
    tmp_path: Path, before: str, after: str, expected: str
) -> None:
    plain = load_motor(tmp_path / "plain", motor_toml("M1"))
    text = (tmp_path / "plain/configs/motor_types/CB560.toml").read_text(encoding="utf-8")
    assert before in text
    types = {"CB560": text.replace(before, after, 1)}
    changed = load_motor(tmp_path / "changed", motor_toml("M1"), types)
    assert same_hash(plain, changed) == (expected == "same")


@pytest.mark.parametrize(
    ("section", "changes", "expected"),
    [
        ("smoothing", {"window_s": 5.0}, "other"),
        ("windows", {"block_s": 60.0}, "other"),
        ("cleaning", {"standstill_rpm": 0.6}, "other"),
        ("time_base", {"rate_hz": 2.0}, "other"),
        ("model", {"film_pressure": "slot"}, "other"),
        ("model", {"film_pressure_share": 0.5}, "other"),
        ("windows", {"minimum_block_share": 0.5}, "other"),
        ("transport_delay", {"fixed_s": 1.0}, "other"),
        ("windows", {"minimum_kept_share": 0.5}, "same"),
        ("windows", {"minimum_pressure_spread_bar": 5.0}, "same"),
        ("windows", {"minimum_training_minutes": 20.0}, "same"),
        ("estimation", {"seed": 7, "starting_points": 50}, "same"),
        ("reference", {"pressure_bar": 210.0}, "same"),
    ],
)
def test_model_hash_and_the_settings(
    spec: MotorSpec, section: str, changes: dict[str, Any], expected: str
) -> None:
    other = with_settings(spec, section, **changes)
    assert same_hash(spec, other) == (expected == "same")


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"resolution": 0.1}, "other"),
        ({"valid_range": (0.0, 100.0)}, "other"),
        ({"scale": 2.0}, "other"),
        ({"time_offset_s": 1.0}, "other"),
        ({"sampling": "on_change", "longest_silence_s": 60.0}, "other"),
        ({"offset_tolerance": 1.0}, "same"),
        ({"gain_tolerance_percent": 1.0}, "same"),
    ],
)
def test_model_hash_and_a_channel(spec: MotorSpec, changes: dict[str, Any], expected: str) -> None:
    other = with_channel(spec, "speed", **changes)
    assert same_hash(spec, other) == (expected == "same")


def test_model_hash_changes_with_the_oil_and_not_with_the_mode(tmp_path: Path) -> None:
    change = '[[events]]\ndate = 2026-03-02\nkind = "oil_change"\noil = "vg46"\n'
    spec = load_motor(tmp_path, motor_toml("M1", more=change))
    before, after = NIGHT - dt.timedelta(days=1), NIGHT
    hashes = {
        (night, mode): model_hash(spec, spec.motor(night, mode), night)
        for night in (before, after)
        for mode in ("none", "estimated")
    }
    assert hashes[before, "none"] == hashes[before, "estimated"] != hashes[after, "none"]
    assert len({hashes[after, mode] for mode in ("none", "estimated")}) == 1


# The same night in other units


OTHER_UNITS = [
    {"pressure_difference": "kPa", "oil_temperature": "K", "leakage_flow": "m3/h"},
    {"pressure_difference": "MPa", "oil_temperature": "degF", "speed": "1/s"},
    {"pressure_difference": "psi", "speed": "rad/s", "leakage_flow": "us_gal/min"},
]
FROM_CANONICAL: dict[str, Callable[[Array], Array]] = {
    "kPa": lambda bar: bar * 100.0,
    "MPa": lambda bar: bar / 10.0,
    "psi": lambda bar: bar * 1e5 / 6894.757293168361,
    "K": lambda c: c + 273.15,
    "degF": lambda c: c * 1.8 + 32.0,
    "1/s": lambda rpm: rpm / 60.0,
    "rad/s": lambda rpm: rpm * np.pi / 30.0,
    "m3/h": lambda lpm: lpm * 0.06,
    "us_gal/min": lambda lpm: lpm / 3.785411784,
}


@pytest.mark.parametrize("units", OTHER_UNITS, ids=lambda units: "-".join(units.values()))
def test_the_same_night_in_other_units_is_the_same_fit(
    tmp_path: Path, units: dict[str, str]
) -> None:
    operation = operate()
    fits = []
    for name, own in (("plain", {}), ("other", units)):
        spec = load_motor(tmp_path / name, motor_toml("M1", units=CANONICAL | own))
        logged = {
            channel: FROM_CANONICAL[own[channel]](value) if channel in own else value
            for channel, value in noisy(simulate(spec, operation)).items()
        }
        path = tmp_path / name / "logs" / "M1" / "a.parquet"
        write_log(path, operation.time_us, logged)
        channels = read_log(path, spec.file.logs, spec.file.channels).channels
        fits.append(fit_night(spec, night_of(), channels, {}))
    plain, other = fits
    assert plain.status == other.status == OK
    found = values_of(plain.rows, "none"), values_of(other.rows, "none")
    assert found[1] == pytest.approx(found[0], rel=1e-9)
    exempt = {"model_hash", "certificate_gap", "dual_residual"}
    for key, value in fit_of(plain.rows).items():
        if isinstance(value, float) and key not in exempt:
            assert fit_of(other.rows)[key] == pytest.approx(value, rel=1e-9), key
    counted = [
        {(row["channel"], row["reason"]): row["n_refused"] for row in one.rows["quality"]}
        for one in fits
    ]
    assert counted[0] == counted[1]


def test_what_came_before_a_gap_changes_nothing_after_it(spec: MotorSpec) -> None:
    """Half an hour of anything, a gap, then a smoothed night: its samples and columns are alike."""
    smoothed = with_settings(spec, "smoothing", window_s=5.0)
    operation = operate(minutes=70.0)
    values = simulate(spec, operation)
    seen = np.delete(np.arange(4200), np.arange(1800, 1860))
    other = {name: value.copy() for name, value in values.items()}
    rng = np.random.default_rng(3)
    other["leakage_flow"][:1800] += rng.standard_t(2, 1800)
    other["pressure_difference"][:1800] *= 0.7
    found = [
        fit_night(
            smoothed,
            night_of(),
            raw(operation.time_us[seen], {name: value[seen] for name, value in one.items()}),
            {},
        ).rows["block_statistics"]
        for one in (values, other)
    ]
    border = dt.datetime.fromtimestamp(operation.time_us[1860] / 1e6, dt.UTC)
    after = [
        [(row["n"], row["statistics"]) for row in rows if row["block_start"] >= border]
        for rows in found
    ]
    assert len(after[0]) >= 18
    assert after[0] == after[1]
