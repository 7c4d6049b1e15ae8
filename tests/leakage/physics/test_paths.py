"""The laws of the leakage paths, against the model's worked values, limits and dimensions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from leakage.physics.annular_gap import AnnularGap
from leakage.physics.law import Parameter
from leakage.physics.oil import THESIS_FILM_PRESSURE, FilmPressure, flow_drive_per_s
from leakage.physics.paths import Laminar, LeakagePath
from tests.leakage.placeholders import (
    balance_piston,
    balance_sleeve,
    cam_roller,
    piston_ring,
    placeholder_oil,
)

GAPS_UM = st.floats(1.0, 60.0)
ECCENTRICITIES = st.floats(0.0, 1.0)
PRESSURES_BAR = st.floats(1.0, 350.0)


def vector(*values: float) -> NDArray[np.float64]:
    return np.array(values)


def flow_l_per_min(
    path: LeakagePath,
    pressure_bar: float,
    temperature_c: float = 50.0,
    speed_rpm: float = 30.0,
    film_pressure: FilmPressure = THESIS_FILM_PRESSURE,
) -> float:
    pressure = vector(pressure_bar * 1e5)
    drive = flow_drive_per_s(pressure, vector(temperature_c), placeholder_oil(), film_pressure)
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


@pytest.mark.parametrize(("share", "expected_bar"), [(1.0, 37.04), (0.5, 38.46)])
def test_ring_leaks_most_at_lower_pressure_with_barus(share: float, expected_bar: float) -> None:
    film = FilmPressure("thesis", share)
    search = minimize_scalar(
        lambda bar: -flow_l_per_min(piston_ring(), bar, film_pressure=film),
        bounds=(1.0, 200.0),
        method="bounded",
        options={"xatol": 1e-8},
    )
    assert float(search.x) == pytest.approx(expected_bar, abs=0.005)


def test_a_laminar_path_leaks_as_a_gap_that_pressure_does_not_close() -> None:
    piston = balance_piston()
    of_one = Parameter("C_d", "m3", piston.configured_coefficient / 2, 0.0, 1e-13)
    assert flow_l_per_min(Laminar("d", 2, of_one), 200.0) == pytest.approx(32 * 1.061377e-2)
    assert Laminar("d", 2, of_one).coefficient_bounds() == (0.0, 2e-13)


def test_roller_holds_the_end_value_of_its_curve() -> None:
    at = cam_roller().curve_l_per_min(vector(200.0, 125.0, -200.0))
    assert at.round(7).tolist() == [0.0819297, 0.0819297, 0.0819297]


def test_roller_leaks_its_curve_at_the_simulations_pressure_and_viscosity() -> None:
    roller = cam_roller(1)
    drive = vector(roller.reference_pressure_pa / roller.reference_viscosity_pa_s)
    flow = roller.regressor(drive, vector(roller.reference_pressure_pa), vector(10.0))
    assert flow.item() == pytest.approx(0.015832, rel=1e-12)
