"""Viscosity, density and drive, against the model's worked values, limits and monotonicity."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from leakage.errors import ParameterError, ValidityError
from leakage.physics.oil import (
    FilmPressure,
    Oil,
    density_kg_per_m3,
    dynamic_viscosity_pa_s,
    flow_drive_per_s,
)
from leakage.physics.walther import kinematic_viscosity_mm2_per_s, walther_coefficients
from tests.leakage.placeholders import placeholder_oil


def viscosity(grade: str, temperature_c: float) -> float:
    oil = placeholder_oil(grade)
    return float(kinematic_viscosity_mm2_per_s(temperature_c, oil.walther_a, oil.walther_b))


def test_walther_constants_themselves_are_those_of_decimal_logarithms() -> None:
    # A consistent natural logarithm would give the same viscosities and other constants.
    a, b = walther_coefficients(40.0, 46.0, 100.0, 6.8)
    assert a == pytest.approx(9.4180, abs=5e-5)
    assert b == pytest.approx(3.6844, abs=5e-5)


@pytest.mark.parametrize(
    ("grade", "temperature_c", "expected", "digit"),
    [
        ("VG 46", 0.0, 577.3, 0.05),
        ("VG 46", 50.0, 29.973, 5e-4),
        ("VG 46", 60.0, 20.623, 5e-4),
        ("VG 32", 0.0, 336.0, 0.05),
        ("VG 68", 50.0, 42.867, 5e-4),
        ("VG 68", 0.0, 1033.2, 0.05),
    ],
)
def test_kinematic_viscosity_worked_values(
    grade: str, temperature_c: float, expected: float, digit: float
) -> None:
    assert viscosity(grade, temperature_c) == pytest.approx(expected, abs=digit)


@given(thick=st.floats(1.2, 4.0), thin=st.floats(0.35, 1.1))
def test_thin_oils_follow_the_full_form(thick: float, thin: float) -> None:
    # The standard's two expressions of the full form invert each other to a fraction of a per cent.
    a, b = walther_coefficients(40.0, thick, 100.0, thin)
    again = kinematic_viscosity_mm2_per_s(np.array([40.0, 100.0]), a, b)
    np.testing.assert_allclose(again, [thick, thin], rtol=4e-3)


def test_full_form_worked_by_hand() -> None:
    # ν = 1: Z = 1.7 + exp(-1.47 - 1.84 - 0.51) = 1.7 + exp(-3.82) = 1.721928
    # ν = 4: Z = 4.7
    a, b = walther_coefficients(40.0, 4.0, 100.0, 1.0)
    double_logs = [a - b * math.log10(273.15 + t) for t in (40.0, 100.0)]
    assert [10.0**10.0**x for x in double_logs] == pytest.approx([4.7, 1.721928], rel=1e-6)


@pytest.mark.parametrize("temperature_c", [-70.1, 370.1, -273.15, -500.0])
def test_temperature_outside_d341_is_refused(temperature_c: float) -> None:
    with pytest.raises(ValidityError, match="outside ASTM D341") as caught:
        viscosity("VG 46", temperature_c)
    assert caught.value.code == "oil_temperature_range"
    assert viscosity("VG 46", -70.0) > viscosity("VG 46", -69.0)


def test_viscosity_below_the_full_form_is_refused_even_beside_nan() -> None:
    a, b = walther_coefficients(40.0, 1.2, 100.0, 0.4)
    with pytest.raises(ValidityError, match=r"below the 0\.21") as caught:
        kinematic_viscosity_mm2_per_s(np.array([math.nan, 300.0]), a, b)
    assert caught.value.code == "oil_viscosity_range"


@pytest.mark.parametrize(
    ("points", "error"),
    [
        ((40.0, 46.0, 40.0, 6.8), ParameterError),
        ((40.0, 6.8, 100.0, 46.0), ParameterError),
        ((40.0, 46.0, 100.0, 46.0), ParameterError),
        ((40.0, 46.0, 100.0, 0.2), ValidityError),
        ((40.0, math.inf, 100.0, 6.8), ValidityError),
        ((40.0, math.nan, 100.0, 6.8), ValidityError),
        ((-300.0, 46.0, 100.0, 6.8), ValidityError),
    ],
)
def test_nonsensical_reference_points_are_refused(
    points: tuple[float, float, float, float], error: type[Exception]
) -> None:
    with pytest.raises(error):
        walther_coefficients(*points)


def test_density_is_the_data_sheets_at_15_c_and_expands_linearly() -> None:
    oil = placeholder_oil()
    assert density_kg_per_m3(15.0, oil) == 882.0
    assert density_kg_per_m3(50.0, oil) == pytest.approx(882.0 / 1.0245, rel=1e-14)


def test_dynamic_viscosity_worked_values() -> None:
    found = dynamic_viscosity_pa_s([40.0, 50.0, 60.0], [40e5, 200e5, 300e5], placeholder_oil())
    assert found == pytest.approx([0.063854, 0.055055, 0.044651], abs=5e-7)


@pytest.mark.parametrize("pressure_bar", [1.0, 50.0, 200.0, 350.0])
def test_slot_is_the_integral_of_the_fluidity_over_the_pressure_drop(pressure_bar: float) -> None:
    # Laminar flow through a slot: the flow is the same at every place, so ΔP/η becomes ∫ dp/η(p).
    oil = placeholder_oil()
    integral, _ = quad(
        lambda pressure: 1.0 / float(dynamic_viscosity_pa_s(50.0, pressure, oil)),
        0.0,
        pressure_bar * 1e5,
        epsrel=1e-12,
    )
    slot = flow_drive_per_s(pressure_bar * 1e5, 50.0, oil, FilmPressure("slot"))
    assert float(slot) == pytest.approx(integral, rel=1e-10)


@pytest.mark.parametrize("density", [0.0, -1.0, math.nan, math.inf])
def test_oil_without_a_physical_constant_is_refused(density: float) -> None:
    with pytest.raises(ParameterError, match="density_15_c_kg_per_m3"):
        Oil("none", 9.4, 3.7, density, 7e-4, 2e-8)


def test_a_film_pressure_is_one_of_two_models_and_its_share_one_of_the_whole() -> None:
    assert [FilmPressure(share=share).share for share in (0.0, 1.0)] == [0.0, 1.0]
    for nonsense in ({"share": -0.01}, {"share": 1.01}, {"model": "gap"}):
        with pytest.raises(ParameterError, match="film pressure"):
            FilmPressure(**nonsense)  # type: ignore[arg-type]
