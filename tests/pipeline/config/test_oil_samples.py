"""Analyses of the oil: which curve holds in a night."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from leakage import OperatingConditions
from leakage.physics.motor import path_flows_l_per_min
from leakage.physics.oil import kinematic_viscosity_mm2_per_s
from pipeline.config import MotorSpec
from pipeline.config.hashes import SettingsHashes, config_hash
from pipeline.config.motor_types import OilSample
from tests.pipeline.config.conftest import TYPE, Configs
from tests.pipeline.trends.nights import FIRST, event, motor, named, night_of


def sample(place: int, at_40: float) -> OilSample:
    return OilSample(date=night_of(place), viscosity_40_c_mm2_per_s=at_40)


def with_samples(spec: MotorSpec, *samples: OilSample) -> MotorSpec:
    return replace(spec, file=spec.file.model_copy(update={"oil_samples": samples}))


def at_40(spec: MotorSpec, place: int) -> float | None:
    curve = spec.measured_curve(night_of(place))
    return None if curve is None else float(kinematic_viscosity_mm2_per_s(40.0, *curve))


def test_a_curve_holds_from_its_first_analysis_on() -> None:
    spec = with_samples(motor(), sample(10, 60.0), sample(20, 50.0))
    assert (at_40(spec, 0), at_40(spec, 9)) == (None, None)
    assert at_40(spec, 10) == pytest.approx(60.0)
    assert 54.0 < (at_40(spec, 15) or 0.0) < 55.5
    assert at_40(spec, 20) == at_40(spec, 400) == pytest.approx(50.0)


@pytest.mark.parametrize("celsius", [0.0, 40.0, 100.0])
def test_log_log_of_the_viscosity_is_linear_in_time(celsius: float) -> None:
    """ASTM D341, a quarter of the way between two analyses."""
    spec = with_samples(motor(), sample(10, 68.0), sample(30, 50.0))
    first, between, last = (
        math.log10(math.log10(float(kinematic_viscosity_mm2_per_s(celsius, *curve)) + 0.7))
        for place in (10, 15, 30)
        if (curve := spec.measured_curve(night_of(place))) is not None
    )
    assert between == pytest.approx(first + 0.25 * (last - first), abs=1e-12)


def test_a_dated_filling_begins_as_its_data_sheet_has_it() -> None:
    """VG 68 from the 10th night on, analysed in the 20th; from the 30th on fresh oil again."""
    changes = [event(place, "oil_change", oil="vg68") for place in (10, 30)]
    spec = with_samples(named(motor(), "M1", events=changes), sample(20, 60.0))
    assert at_40(spec, 9) is None
    assert at_40(spec, 10) == pytest.approx(68.0)
    assert 63.5 < (at_40(spec, 15) or 0.0) < 64.5
    assert at_40(spec, 29) == pytest.approx(60.0)
    assert at_40(spec, 30) is None


def test_one_viscosity_keeps_the_slope_of_the_data_sheet() -> None:
    sheet = motor().oil_on(FIRST)
    a, b = sheet.oil().walther_a, sheet.oil().walther_b
    assert sample(1, 54.4).curve(sheet) == (pytest.approx(a, abs=0.1), b)


def test_only_the_figures_of_nights_with_another_curve_are_made_anew() -> None:
    before, after = motor(), with_samples(motor(), sample(10, 60.0))
    old, new = SettingsHashes(before), SettingsHashes(after)
    for place, is_same in ((9, True), (10, False)):
        label = night_of(place)
        assert (old.figures(label) == new.figures(label)) == is_same
        assert old.statistics(label) == new.statistics(label)
    assert config_hash(before) != config_hash(after)


# Constants of a path may be points of a simulation


def test_points_of_a_simulation_stand_for_constants(configs: Configs) -> None:
    """Of a gap the flow at constant viscosity [bar, µm, l/min], of a roller that by speed."""
    quintic, speeds = (
        [2.0e-11, -7.0e-9, 9.0e-7, -5.0e-5, 1.6e-3, 4.0e-3],
        (0, 20, 45, 70, 90, 110, 125),
    )
    bars = (10.0, 40.0, 90.0, 160.0, 250.0, 320.0)
    gap = [[bar, 8.0, 8.0**3 * bar * math.exp(-3.0 * bar / 120.0)] for bar in bars]
    curve = [[rpm, float(np.polyval(quintic, rpm))] for rpm in map(float, speeds)]
    at = OperatingConditions.from_bar(
        np.array([20.0, 200.0, 310.0]), np.array([30.0, 50.0, 70.0]), np.array([10.0, 60.0, 120.0])
    )
    constants = path_flows_l_per_min(configs.motor().motor(FIRST, "none"), at)
    text = (configs / TYPE).read_text("utf-8")
    for key, points in (("deformation_pressure_bar = 120.0", gap), ("coefficients = [", curve)):
        (line,) = [line for line in text.splitlines() if line.startswith(key)]
        name = "points" if points is curve else "deformation_points"
        configs.change(TYPE, line, f"{name} = {points}")
    configs.change(TYPE, "speed_range_rpm = [0.0, 125.0]\n", "")
    by_points = path_flows_l_per_min(configs.motor().motor(FIRST, "none"), at)
    assert by_points.keys() == constants.keys()
    for path, flow in by_points.items():
        np.testing.assert_allclose(flow, constants[path], rtol=1e-6)
