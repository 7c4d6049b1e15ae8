"""Constants fitted to points of a simulated curve: recovery, nonsense."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leakage.errors import CurveError
from leakage.physics.simulated_curves import fit_deformation_pressure, fit_speed_curve
from tests.leakage.placeholders import ROLLER_QUINTIC, cam_roller

PRESSURE_PA = np.tile(np.array([5.0, 20.0, 40.0, 80.0, 160.0, 320.0]) * 1e5, 3)
GAP_M = np.repeat(np.array([6e-6, 9e-6, 14e-6]), 6)


def simulated_flow(deformation_pressure_pa: float, amplitude: float = 1e7) -> np.ndarray:
    """The law itself: Q = a h³ ΔP exp(-3ΔP/X)."""
    decay = np.exp(-3.0 * PRESSURE_PA / deformation_pressure_pa)
    return np.asarray(amplitude * GAP_M**3 * PRESSURE_PA * decay)


@given(deformation_bar=st.floats(60.0, 3000.0), amplitude=st.floats(1e3, 1e12))
def test_deformation_pressure_is_recovered(deformation_bar: float, amplitude: float) -> None:
    # 120 bar, the ring, and 900 bar, the sleeve, lie in this range.
    flow = simulated_flow(deformation_bar * 1e5, amplitude)
    found = fit_deformation_pressure(PRESSURE_PA, GAP_M, flow)
    assert found == pytest.approx(deformation_bar * 1e5, rel=1e-6)


def test_deformation_pressure_from_read_off_points_peaks_where_they_do() -> None:
    # Points of one gap, read off with an error of 1 % of the peak at 40 bar: X ≈ 3·40 bar.
    generator = np.random.default_rng(3)
    pressure = np.linspace(5e5, 200e5, 40)
    exact = pressure / 40e5 * np.exp(1.0 - pressure / 40e5)
    read = np.maximum(exact + 0.01 * generator.standard_normal(40), 1e-4)
    assert fit_deformation_pressure(pressure, 8e-6, read) == pytest.approx(120e5, rel=0.02)


@pytest.mark.parametrize("rigid", [math.inf, -500e5])
def test_gap_that_does_not_close_has_no_deformation_pressure(rigid: float) -> None:
    flow = GAP_M**3 * PRESSURE_PA * np.exp(-3.0 * PRESSURE_PA / rigid + 1e-9 * PRESSURE_PA)
    with pytest.raises(CurveError, match="does not close") as caught:
        fit_deformation_pressure(PRESSURE_PA, GAP_M, flow)
    assert caught.value.code == "curve_without_deformation"


@pytest.mark.parametrize(
    ("pressure", "gap_m", "flow", "message"),
    [
        ([20e5, 40e5], 8e-6, [1.0, 1.5], "needs 3 points"),
        ([20e5, 20e5, 20e5], [6e-6, 8e-6, 9e-6], [1.0, 2.0, 3.0], "2 different pressures"),
        ([0.0, 20e5, 40e5], 8e-6, [1.0, 1.2, 1.3], "pressures must be above 0"),
        ([10e5, 20e5, 40e5], 8e-6, [0.0, 1.2, 1.3], "flows must be above 0"),
        ([10e5, 20e5, 40e5], -8e-6, [1.0, 1.2, 1.3], "gap heights must be above 0"),
        ([10e5, 20e5, math.nan], 8e-6, [1.0, 1.2, 1.3], "finite"),
        ([10e5, 20e5, 40e5], 8e-6, [1.0, 1.2], "differ in length"),
        (np.full((3, 3), 1e5), 8e-6, np.ones((3, 3)), "finite"),
    ],
)
def test_nonsensical_points_of_a_gap_are_refused(
    pressure: list[float], gap_m: float, flow: list[float], message: str
) -> None:
    with pytest.raises(CurveError, match=message):
        fit_deformation_pressure(pressure, gap_m, flow)


def test_quintic_is_recovered_from_its_points() -> None:
    speed = np.linspace(0.0, 125.0, 26)
    flow = cam_roller().curve_l_per_min(speed)
    assert fit_speed_curve(speed, flow) == pytest.approx(ROLLER_QUINTIC, rel=1e-8)


@given(seed=st.integers(0, 1000), degree=st.integers(0, 6))
def test_polynomials_of_any_degree_are_recovered(seed: int, degree: int) -> None:
    generator = np.random.default_rng(seed)
    per_range = generator.uniform(0.1, 1.0, degree + 1)  # at ω/125 rpm, so that all terms count
    speed = np.linspace(0.0, 125.0, 30)
    found = fit_speed_curve(speed, np.polyval(per_range, speed / 125.0), degree)
    scaled = np.array(found) * 125.0 ** np.arange(degree, -1, -1)
    np.testing.assert_allclose(scaled, per_range, rtol=1e-7)


def test_curve_that_begins_at_no_leakage_is_taken() -> None:
    assert fit_speed_curve([0.0, 50.0, 100.0], [0.0, 1.0, 2.0], 1) == pytest.approx([0.02, 0.0])


def test_curve_that_turns_negative_between_its_points_is_refused() -> None:
    speed = np.array([0.0, 5.0, 10.0, 60.0, 120.0, 125.0])
    flow = np.array([0.0, 0.08, 0.0, 0.0, 0.0, 0.08])
    with pytest.raises(CurveError, match="falls to") as caught:
        fit_speed_curve(speed, flow)
    assert caught.value.code == "curve_undershoot"


@pytest.mark.parametrize(
    ("speed", "flow", "degree", "message"),
    [
        ([0.0, 25.0, 50.0, 75.0, 100.0], [1.0] * 5, 5, "needs 6 points"),
        ([0.0, 25.0, 50.0, 75.0, 100.0, 100.0], [1.0] * 6, 5, "6 different speeds"),
        ([-5.0, 25.0], [1.0, 1.0], 1, "not be negative"),
        ([5.0, 25.0], [1.0, -1.0], 1, "not be negative"),
        ([5.0, 25.0], [1.0, 1.0], -1, "not be negative"),
        ([5.0, math.inf], [1.0, 1.0], 1, "finite"),
    ],
)
def test_nonsensical_points_of_a_speed_curve_are_refused(
    speed: list[float], flow: list[float], degree: int, message: str
) -> None:
    with pytest.raises(CurveError, match=message):
        fit_speed_curve(speed, flow, degree)
