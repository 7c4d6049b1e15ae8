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
    kinematic_viscosity_mm2_per_s,
    walther_coefficients,
)
from tests.leakage.placeholders import REFERENCE_VISCOSITIES, placeholder_oil

TEMPERATURES_C = st.floats(-20.0, 120.0)
PRESSURES_PA = st.floats(0.0, 350e5)
GRADES = st.sampled_from(sorted(REFERENCE_VISCOSITIES))


def viscosity(grade: str, temperature_c: float) -> float:
    oil = placeholder_oil(grade)
    return float(kinematic_viscosity_mm2_per_s(temperature_c, oil.walther_a, oil.walther_b))


def test_walther_constants_themselves_are_those_of_decimal_logarithms() -> None:
    # A consistent natural logarithm would give the same viscosities and other constants.
    a, b = walther_coefficients(40.0, 46.0, 100.0, 6.8)
    assert a == pytest.approx(9.4180, abs=5e-5)
    assert b == pytest.approx(3.6844, abs=5e-5)


def test_walther_constants_do_not_depend_on_the_order_of_the_points() -> None:
    assert walther_coefficients(100.0, 6.8, 40.0, 46.0) == pytest.approx(
        walther_coefficients(40.0, 46.0, 100.0, 6.8), rel=1e-14
    )


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


@pytest.mark.parametrize(("grade", "data_sheet"), [("VG 46", 580.0), ("VG 32", 338.0)])
def test_kinematic_viscosity_at_0_c_is_near_the_data_sheets(grade: str, data_sheet: float) -> None:
    assert viscosity(grade, 0.0) == pytest.approx(data_sheet, rel=0.01)


@pytest.mark.parametrize("grade", sorted(REFERENCE_VISCOSITIES))
def test_kinematic_viscosity_at_both_reference_points(grade: str) -> None:
    at_40_c, at_100_c = REFERENCE_VISCOSITIES[grade]
    assert viscosity(grade, 40.0) == pytest.approx(at_40_c, rel=1e-12)
    assert viscosity(grade, 100.0) == pytest.approx(at_100_c, rel=1e-12)


@given(thick=st.floats(2.5, 5000.0), ratio=st.floats(1.05, 50.0))
def test_reference_viscosities_come_back(thick: float, ratio: float) -> None:
    thin = max(2.0 + 1e-9, thick / ratio)
    a, b = walther_coefficients(40.0, thick, 100.0, thin)
    again = kinematic_viscosity_mm2_per_s(np.array([40.0, 100.0]), a, b)
    np.testing.assert_allclose(again, [thick, thin], rtol=1e-9)


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


def test_step_to_the_full_form_is_small_and_downward() -> None:
    a, b = walther_coefficients(40.0, 4.0, 100.0, 1.0)
    temperature = np.linspace(40.0, 100.0, 20_001)
    values = kinematic_viscosity_mm2_per_s(temperature, a, b)
    below = int(np.argmax(values < 2.0))
    assert values[below - 1] >= 2.0 > values[below] > 2.0 * (1.0 - 6e-4)
    assert (np.diff(values) < 0.0).all()


@given(grade=GRADES, low=TEMPERATURES_C, step=st.floats(0.01, 100.0))
def test_viscosity_and_density_fall_with_temperature(grade: str, low: float, step: float) -> None:
    oil = placeholder_oil(grade)
    assert viscosity(grade, low + step) < viscosity(grade, low)
    assert density_kg_per_m3(low + step, oil) < density_kg_per_m3(low, oil)


@pytest.mark.parametrize("temperature_c", [-71.0, 371.0, -273.15, -500.0])
def test_temperature_outside_d341_is_refused(temperature_c: float) -> None:
    with pytest.raises(ValidityError, match="outside ASTM D341") as caught:
        viscosity("VG 46", temperature_c)
    assert caught.value.code == "oil_temperature_range"


def test_viscosity_below_the_full_form_is_refused_even_beside_nan() -> None:
    a, b = walther_coefficients(40.0, 1.2, 100.0, 0.4)
    with pytest.raises(ValidityError, match=r"below the 0\.21") as caught:
        kinematic_viscosity_mm2_per_s(np.array([math.nan, 300.0]), a, b)
    assert caught.value.code == "oil_viscosity_range"


def test_nan_stays_nan_and_nothing_else_changes() -> None:
    oil = placeholder_oil()
    temperature = np.array([math.nan, 50.0])
    before = temperature.copy()
    values = dynamic_viscosity_pa_s(temperature, 200e5, oil)
    assert math.isnan(values[0])
    assert values[1] == pytest.approx(0.055055, abs=5e-7)
    np.testing.assert_array_equal(temperature, before)


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


@pytest.mark.parametrize(
    ("pressure_bar", "temperature_c", "expected_pa_s"),
    [(40.0, 40.0, 0.063854), (200.0, 50.0, 0.055055), (300.0, 60.0, 0.044651)],
)
def test_dynamic_viscosity_worked_values(
    pressure_bar: float, temperature_c: float, expected_pa_s: float
) -> None:
    value = dynamic_viscosity_pa_s(temperature_c, pressure_bar * 1e5, placeholder_oil())
    assert float(value) == pytest.approx(expected_pa_s, abs=5e-7)


def test_one_square_millimetre_a_second_is_one_millipascal_second_at_density_1000() -> None:
    # Dimensions: 1 mm²/s · 1000 kg/m³ = 1e-3 Pa·s.
    a, b = walther_coefficients(40.0, 46.0, 100.0, 6.8)
    oil = Oil("heavy", a, b, 1000.0, 0.0, 0.0)
    assert float(dynamic_viscosity_pa_s(40.0, 0.0, oil)) == pytest.approx(46e-3, rel=1e-12)


@given(temperature_c=TEMPERATURES_C, pressure_pa=PRESSURES_PA, step=st.floats(1e3, 1e7))
def test_barus_is_exponential_in_pressure(
    temperature_c: float, pressure_pa: float, step: float
) -> None:
    oil = placeholder_oil()
    low = dynamic_viscosity_pa_s(temperature_c, pressure_pa, oil)
    high = dynamic_viscosity_pa_s(temperature_c, pressure_pa + step, oil)
    assert high > low
    assert float(high / low) == pytest.approx(math.exp(2e-8 * step), rel=1e-9)


@given(pressure_pa=st.floats(1e5, 350e5), temperature_c=TEMPERATURES_C)
def test_slot_equals_the_thesis_at_the_equivalent_share(
    pressure_pa: float, temperature_c: float
) -> None:
    oil = placeholder_oil()
    x = oil.pressure_viscosity_per_pa * pressure_pa
    share = math.log(x / -math.expm1(-x)) / x
    slot = flow_drive_per_s(pressure_pa, temperature_c, oil, FilmPressure("slot"))
    thesis = flow_drive_per_s(pressure_pa, temperature_c, oil, FilmPressure("thesis", share))
    assert float(slot) == pytest.approx(float(thesis), rel=1e-9)


def test_share_1_understates_the_slot_by_19_percent_at_200_bar() -> None:
    oil = placeholder_oil()
    thesis = flow_drive_per_s(200e5, 50.0, oil)
    slot = flow_drive_per_s(200e5, 50.0, oil, FilmPressure("slot"))
    assert round(float(thesis / slot) - 1.0, 2) == -0.19


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


@given(pressure_pa=PRESSURES_PA, temperature_c=TEMPERATURES_C)
def test_without_pressure_viscosity_all_film_pressures_agree(
    pressure_pa: float, temperature_c: float
) -> None:
    oil = placeholder_oil(pressure_viscosity_per_pa=0.0)
    plain = pressure_pa / float(dynamic_viscosity_pa_s(temperature_c, 0.0, oil))
    for film_pressure in (FilmPressure(), FilmPressure(share=0.5), FilmPressure("slot")):
        drive = flow_drive_per_s(pressure_pa, temperature_c, oil, film_pressure)
        assert float(drive) == pytest.approx(plain, rel=1e-12)


@pytest.mark.parametrize("film_pressure", [FilmPressure(), FilmPressure("slot")])
@given(pressure_pa=PRESSURES_PA, temperature_c=TEMPERATURES_C, step=st.floats(1e4, 1e7))
def test_drive_is_even_and_grows_with_pressure(
    film_pressure: FilmPressure, pressure_pa: float, temperature_c: float, step: float
) -> None:
    # ΔP·exp(-αΔP) grows up to 1/α = 500 bar, beyond every motor's pressure.
    oil = placeholder_oil()
    drive, reverse, more = (
        float(flow_drive_per_s(pressure, temperature_c, oil, film_pressure))
        for pressure in (pressure_pa, -pressure_pa, pressure_pa + step)
    )
    assert drive == reverse
    assert 0.0 <= drive < more


def test_no_samples_give_no_values() -> None:
    assert flow_drive_per_s(np.empty(0), np.empty(0), placeholder_oil()).shape == (0,)


@pytest.mark.parametrize("share", [-0.1, 1.1, math.nan])
def test_film_pressure_share_outside_0_to_1_is_refused(share: float) -> None:
    with pytest.raises(ParameterError, match="share"):
        FilmPressure("thesis", share)


def test_unknown_film_pressure_model_is_refused() -> None:
    with pytest.raises(ParameterError, match="use 'thesis' or 'slot'"):
        FilmPressure("mean")  # type: ignore[arg-type]


@pytest.mark.parametrize("density", [0.0, -1.0, math.nan, math.inf])
def test_oil_without_a_physical_constant_is_refused(density: float) -> None:
    with pytest.raises(ParameterError, match="density_15_c_kg_per_m3"):
        Oil("none", 9.4, 3.7, density, 7e-4, 2e-8)
