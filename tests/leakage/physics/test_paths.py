"""The laws of the leakage paths, against the model's worked values, limits and dimensions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from leakage.physics.oil import THESIS_FILM_PRESSURE, FilmPressure, Oil, flow_drive_per_s
from leakage.physics.paths import AnnularGap, Constant, LeakagePath
from tests.leakage.physics.declared_paths import COEFFICIENTS_M3, DISTRIBUTOR, EACH_LAW, vector
from tests.leakage.placeholders import (
    balance_piston,
    balance_sleeve,
    cam_roller,
    eccentricity,
    piston_ring,
    placeholder_oil,
)

GAPS_UM = st.floats(1.0, 60.0)
ECCENTRICITIES = st.floats(0.0, 1.0)
PRESSURES_BAR = st.floats(1.0, 350.0)
SPEEDS_RPM = st.floats(-300.0, 300.0)


def flow_l_per_min(
    path: LeakagePath,
    pressure_bar: float,
    temperature_c: float = 50.0,
    speed_rpm: float = 30.0,
    oil: Oil | None = None,
    film_pressure: FilmPressure = THESIS_FILM_PRESSURE,
) -> float:
    pressure = vector(pressure_bar * 1e5)
    drive = flow_drive_per_s(
        pressure, vector(temperature_c), oil or placeholder_oil(), film_pressure
    )
    return path.configured_coefficient * path.regressor(drive, pressure, vector(speed_rpm)).item()


@pytest.mark.parametrize(
    ("pressure_bar", "temperature_c", "speed_rpm", "ring", "piston", "sleeve", "roller"),
    [
        (40.0, 40.0, 10.0, 3.243447e-3, 1.830232e-3, 4.496090e-3, 1.735590e-3),
        (200.0, 50.0, 30.0, 3.445024e-4, 1.061377e-2, 1.529589e-2, 1.660281e-2),
        (300.0, 60.0, 80.0, 5.230070e-5, 1.963003e-2, 2.027035e-2, 6.068909e-2),
    ],
)
def test_flow_of_one_interface_worked_values(
    pressure_bar: float,
    temperature_c: float,
    speed_rpm: float,
    ring: float,
    piston: float,
    sleeve: float,
    roller: float,
) -> None:
    flows = [
        flow_l_per_min(path, pressure_bar, temperature_c, speed_rpm)
        for path in (piston_ring(1), balance_piston(1), balance_sleeve(1), cam_roller(1))
    ]
    assert flows == pytest.approx([ring, piston, sleeve, roller], rel=3e-7)


@pytest.mark.parametrize(
    ("path", "expected_m3"),
    [
        (piston_ring(), 7.506312e-14),
        (balance_piston(), 1.558230e-14),
        (balance_sleeve(), 4.373874e-14),
    ],
    ids=["o", "p", "s"],
)
def test_loss_factors_of_the_cb560(path: AnnularGap, expected_m3: float) -> None:
    assert path.configured_coefficient == pytest.approx(expected_m3, rel=1e-7)


@given(gap_um=GAPS_UM, e=ECCENTRICITIES)
def test_inverse_map_both_ways(gap_um: float, e: float) -> None:
    for path, values in (
        (piston_ring(), [gap_um]),
        (balance_piston(), [gap_um, e]),
        (balance_sleeve(), [gap_um, e]),
    ):
        at = e if path.eccentricity else 0.0
        coefficient = path.coefficient(values)
        again = float(path.gap_um_from_coefficient(coefficient, at))
        assert again == pytest.approx(gap_um, rel=1e-12)


@given(coefficient_m3=COEFFICIENTS_M3, e=ECCENTRICITIES)
def test_inverse_map_the_other_way(coefficient_m3: float, e: float) -> None:
    sleeve = balance_sleeve()
    gap_um = float(sleeve.gap_um_from_coefficient(coefficient_m3, e))
    assert sleeve.coefficient([gap_um, e]) == pytest.approx(coefficient_m3, rel=1e-12)


@given(pressure_bar=PRESSURES_BAR)
def test_sleeve_without_deformation_leaks_1_331_times_the_piston(pressure_bar: float) -> None:
    # X → ∞ on the geometry of the balance piston; 1.331 = 1.1³.
    piston = balance_piston()
    stiff = replace(piston, name="s", deformation_pressure_pa=1e18, height_factor=1.1)
    ratio = flow_l_per_min(stiff, pressure_bar) / flow_l_per_min(piston, pressure_bar)
    assert ratio == pytest.approx(1.331, rel=1e-9)
    none = replace(stiff, deformation_pressure_pa=None)
    assert flow_l_per_min(stiff, pressure_bar) == pytest.approx(
        flow_l_per_min(none, pressure_bar), rel=1e-9
    )


@pytest.mark.parametrize("build", [balance_piston, balance_sleeve])
@given(gap_um=GAPS_UM)
def test_full_eccentricity_leaks_2_5_times_as_much(
    build: Callable[[], AnnularGap], gap_um: float
) -> None:
    path = build()
    ratio = path.coefficient([gap_um, 1.0]) / path.coefficient([gap_um, 0.0])
    assert ratio == pytest.approx(2.5, rel=1e-14)


@given(gap_um=st.floats(1.0, 30.0), e=ECCENTRICITIES)
def test_twice_the_gap_leaks_8_times_as_much(gap_um: float, e: float) -> None:
    for path, values in ((piston_ring(), [gap_um]), (balance_sleeve(), [gap_um, e])):
        double = [2.0 * values[0], *values[1:]]
        assert path.coefficient(double) / path.coefficient(values) == pytest.approx(8.0, rel=1e-14)


@EACH_LAW
@given(pressure_bar=PRESSURES_BAR, speed_rpm=SPEEDS_RPM)
def test_direction_has_no_effect(path: LeakagePath, pressure_bar: float, speed_rpm: float) -> None:
    forward = flow_l_per_min(path, pressure_bar, speed_rpm=speed_rpm)
    assert flow_l_per_min(path, -pressure_bar, speed_rpm=-speed_rpm) == forward
    assert flow_l_per_min(path, -pressure_bar, speed_rpm=speed_rpm) == forward


def pressure_of_largest_leakage_bar(
    oil: Oil, film_pressure: FilmPressure = THESIS_FILM_PRESSURE
) -> float:
    search = minimize_scalar(
        lambda bar: -flow_l_per_min(piston_ring(), bar, oil=oil, film_pressure=film_pressure),
        bounds=(1.0, 200.0),
        method="bounded",
        options={"xatol": 1e-8},
    )
    return float(search.x)


def test_ring_leaks_most_at_a_third_of_its_deformation_pressure() -> None:
    oil = placeholder_oil(pressure_viscosity_per_pa=0.0)
    assert pressure_of_largest_leakage_bar(oil) == pytest.approx(40.0, abs=1e-3)


@pytest.mark.parametrize(("share", "expected_bar"), [(1.0, 37.04), (0.5, 38.46)])
def test_ring_leaks_most_at_lower_pressure_with_barus(share: float, expected_bar: float) -> None:
    found = pressure_of_largest_leakage_bar(placeholder_oil(), FilmPressure("thesis", share))
    assert found == pytest.approx(expected_bar, abs=0.005)


def test_roller_holds_the_end_value_of_its_curve() -> None:
    at = cam_roller().curve_l_per_min(vector(200.0, 125.0, -200.0))
    assert at.round(7).tolist() == [0.0819297, 0.0819297, 0.0819297]


def test_roller_holds_the_first_value_below_its_points() -> None:
    roller = replace(cam_roller(), speed_minimum_rpm=10.0)
    first, held = roller.curve_l_per_min(vector(10.0, 0.0))
    assert held == first
    assert roller.is_beyond(vector(9.0, -10.0, 125.0, -126.0)).tolist() == [
        True,
        False,
        False,
        True,
    ]


def test_roller_curve_is_the_polynomial_highest_power_first() -> None:
    # f(0) is the constant term; f(10) summed by hand: 0.004 + 0.016 - 0.005 + 0.0009 - 0.00007
    # + 0.000002 l/min.
    at = cam_roller().curve_l_per_min(vector(0.0, 10.0))
    assert at == pytest.approx([0.004, 0.015832], rel=1e-12)


def test_roller_leaks_its_curve_at_the_simulations_pressure_and_viscosity() -> None:
    roller = cam_roller(1)
    drive = vector(roller.reference_pressure_pa / roller.reference_viscosity_pa_s)
    flow = roller.regressor(drive, vector(roller.reference_pressure_pa), vector(10.0))
    assert flow.item() == pytest.approx(0.015832, rel=1e-12)


def test_ring_can_have_an_eccentricity_and_piston_none() -> None:
    ring = replace(piston_ring(), eccentricity=eccentricity("o", 1.0))
    assert ring.configured_coefficient == pytest.approx(2.5 * 7.506312e-14, rel=1e-7)
    piston = replace(balance_piston(), eccentricity=None)
    assert piston.configured_coefficient == pytest.approx(1.558230e-14 / 1.24, rel=1e-7)


@given(scale=st.floats(0.1, 10.0), gap_um=st.floats(1.0, 6.0), e=ECCENTRICITIES)
def test_loss_factor_is_a_volume(scale: float, gap_um: float, e: float) -> None:
    # Dimensions: all lengths scaled by s, K scales by s³.
    sleeve = balance_sleeve()
    larger = replace(sleeve, radius_m=sleeve.radius_m * scale, length_m=sleeve.length_m * scale)
    ratio = larger.coefficient([gap_um * scale, e]) / sleeve.coefficient([gap_um, e])
    assert ratio == pytest.approx(scale**3, rel=1e-12)


@given(factor=st.floats(0.1, 10.0))
def test_loss_factor_grows_with_radius_and_falls_with_length(factor: float) -> None:
    ring = piston_ring()
    wider = replace(ring, radius_m=ring.radius_m * factor)
    longer = replace(ring, length_m=ring.length_m * factor)
    assert wider.coefficient([8.0]) / ring.coefficient([8.0]) == pytest.approx(factor, rel=1e-12)
    assert ring.coefficient([8.0]) / longer.coefficient([8.0]) == pytest.approx(factor, rel=1e-12)


@EACH_LAW
@given(factor=st.floats(0.01, 100.0))
def test_flow_is_proportional_to_the_drive(path: LeakagePath, factor: float) -> None:
    # Dimensions: viscosity enters only as 1/η, and a constant not at all.
    drive, pressure, speed = vector(3.6e8, 1.0e8), vector(200e5, 40e5), vector(30.0, 80.0)
    ratio = path.regressor(factor * drive, pressure, speed) / path.regressor(drive, pressure, speed)
    expected = 1.0 if isinstance(path, Constant) else factor
    assert ratio == pytest.approx([expected, expected], rel=1e-12)


def test_one_cubic_metre_a_second_is_60_000_litres_a_minute() -> None:
    assert DISTRIBUTOR.regressor(vector(1.0), vector(1.0), vector(0.0)).item() == 60_000.0


@EACH_LAW
def test_no_drive_no_leakage(path: LeakagePath) -> None:
    flow = path.regressor(vector(0.0), vector(0.0), vector(50.0)).item()
    assert flow == (1.0 if isinstance(path, Constant) else 0.0)


@EACH_LAW
def test_regressor_changes_no_argument_and_returns_its_own_array(path: LeakagePath) -> None:
    drive, pressure, speed = vector(3.6e8, 1e8), vector(-200e5, 4e6), vector(-30.0, 200.0)
    copies = [channel.copy() for channel in (drive, pressure, speed)]
    result = path.regressor(drive, pressure, speed)
    result[:] = -1.0
    for channel, copy in zip((drive, pressure, speed), copies, strict=True):
        np.testing.assert_array_equal(channel, copy)
