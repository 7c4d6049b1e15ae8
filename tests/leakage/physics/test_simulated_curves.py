"""Constants fitted to points of a simulated curve: recovery, nonsense."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leakage.errors import CurveError
from leakage.physics.simulated_curves import fit_deformation_pressure, fit_speed_curve
from tests.leakage.placeholders import ROLLER_QUINTIC, cam_roller

PRESSURE_PA = np.tile(np.array([5.0, 20.0, 40.0, 80.0, 160.0, 320.0]) * 1e5, 3)
GAP_M = np.repeat(np.array([6e-6, 9e-6, 14e-6]), 6)


def gap_points(deformation_pressure_pa: float, amplitude: float = 1e7) -> np.ndarray:
    """The law itself: Q = a h³ ΔP exp(-3ΔP/X)."""
    decay = np.exp(-3.0 * PRESSURE_PA / deformation_pressure_pa)
    return np.column_stack([PRESSURE_PA, GAP_M, amplitude * GAP_M**3 * PRESSURE_PA * decay])


@given(deformation_bar=st.floats(60.0, 3000.0), amplitude=st.floats(1e3, 1e12))
def test_deformation_pressure_is_recovered(deformation_bar: float, amplitude: float) -> None:
    # 120 bar, the ring, and 900 bar, the sleeve, lie in this range.
    found = fit_deformation_pressure(gap_points(deformation_bar * 1e5, amplitude))
    assert found == pytest.approx(deformation_bar * 1e5, rel=1e-6)


def test_deformation_pressure_from_read_off_points_peaks_where_they_do() -> None:
    # Points of one gap, read off with an error of 1 % of the peak at 40 bar: X ≈ 3·40 bar.
    generator = np.random.default_rng(3)
    pressure = np.linspace(5e5, 200e5, 40)
    exact = pressure / 40e5 * np.exp(1.0 - pressure / 40e5)
    read = np.maximum(exact + 0.01 * generator.standard_normal(40), 1e-4)
    points = np.column_stack([pressure, np.full(40, 8e-6), read])
    assert fit_deformation_pressure(points) == pytest.approx(120e5, rel=0.02)


def test_quintic_is_recovered_from_its_points_and_lower_degrees_are_quintics() -> None:
    speed = np.linspace(0.0, 125.0, 26)
    found = fit_speed_curve(np.column_stack([speed, cam_roller().curve_l_per_min(speed)]))
    assert found == pytest.approx(ROLLER_QUINTIC, rel=1e-8)
    straight = fit_speed_curve(np.column_stack([speed[:6], 1.0 + 0.02 * speed[:6]]))
    assert straight == pytest.approx([0, 0, 0, 0, 0.02, 1.0], abs=1e-9)


SPEEDS = (0.0, 25.0, 50.0, 75.0, 100.0, 125.0)


TWO_POINTS = [(2e6, 8e-6, 1.2), (4e6, 8e-6, 1.3)]
UNDERSHOOT = [(0, 0.0), (5, 0.08), (10, 0.0), (60, 0.0), (120, 0.0), (125, 0.08)]
POINTS = "curve_points"


@pytest.mark.parametrize(
    ("fit", "points", "code"),
    [
        (fit_deformation_pressure, (), POINTS),
        (fit_deformation_pressure, TWO_POINTS, POINTS),
        (fit_deformation_pressure, [(2e6, 8e-6, 1)] * 3, POINTS),
        (fit_deformation_pressure, [(0.0, 8e-6, 1.0), *TWO_POINTS], POINTS),
        (fit_deformation_pressure, [(1e6, -8e-6, 1.0), *TWO_POINTS], POINTS),
        (fit_deformation_pressure, [(1e6, 8e-6, math.nan), *TWO_POINTS], POINTS),
        (fit_deformation_pressure, gap_points(-500e5), "curve_without_deformation"),
        (fit_speed_curve, (), POINTS),
        (fit_speed_curve, [(rpm, 1.0) for rpm in SPEEDS[:5]], POINTS),
        (fit_speed_curve, [(min(rpm, 100.0), 1.0) for rpm in SPEEDS], POINTS),
        (fit_speed_curve, [(rpm - 5.0, 1.0) for rpm in SPEEDS], POINTS),
        (fit_speed_curve, [(rpm, -1.0) for rpm in SPEEDS], POINTS),
        (fit_speed_curve, UNDERSHOOT, "curve_undershoot"),
    ],
)
def test_points_that_determine_no_curve_are_refused(fit: Any, points: object, code: str) -> None:
    with pytest.raises(CurveError) as caught:
        fit(points)
    assert caught.value.code == code


@pytest.mark.parametrize(("dip", "refused"), [(-0.0099, False), (-0.0101, True)])
def test_an_undershoot_of_one_per_cent_is_the_accuracy_of_a_plot(dip: float, refused: bool) -> None:
    """A parabola whose lowest place, between two points, is that share of its largest flow."""
    speed = np.linspace(0.0, 120.0, 8)
    low = (speed[3] + speed[4]) / 2
    flow = (1.0 - dip) * ((speed - low) / low) ** 2 + dip
    assert flow.min() > 0.0
    points = np.column_stack([speed, flow])
    if refused:
        with pytest.raises(CurveError):
            fit_speed_curve(points)
    else:
        assert fit_speed_curve(points)[-1] == pytest.approx(1.0)
