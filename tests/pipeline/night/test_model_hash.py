"""The hash of what shapes the statistics, and the seeds of a night."""

from __future__ import annotations

import datetime as dt
from pathlib import Path
from typing import Any

import pytest

from pipeline.config import MotorSpec
from pipeline.config.hashes import model_hash
from tests.pipeline.simulated import (
    NIGHT,
    load_motor,
    motor_toml,
    with_channel,
    with_settings,
)


def same_hash(one: MotorSpec, other: MotorSpec) -> bool:
    first, second = (model_hash(spec, spec.motor(NIGHT, "none"), NIGHT) for spec in (one, other))
    return first == second


# What shapes the statistics, and what does not


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
