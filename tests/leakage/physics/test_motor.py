"""A motor as a list of paths, and its oil: worked values, limits, and what is refused."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from leakage.errors import ParameterError, ShapeError, ValidityError
from leakage.physics.conditions import OperatingConditions
from leakage.physics.motor import Motor, regressors, total_flow_l_per_min
from leakage.physics.oil import (
    FilmPressure,
    Oil,
    dynamic_viscosity_pa_s,
    flow_drive_per_s,
    kinematic_viscosity_mm2_per_s,
    walther_coefficients,
)
from leakage.physics.paths import Constant, Parameter
from tests.leakage.placeholders import piston_ring, placeholder_motor, placeholder_oil


def random_conditions(n: int, seed: int = 1) -> OperatingConditions:
    generator = np.random.default_rng(seed)
    return OperatingConditions.from_bar(
        generator.uniform(-350.0, 350.0, n),
        generator.uniform(0.0, 90.0, n),
        generator.uniform(-150.0, 150.0, n),
    )


@pytest.mark.parametrize(("forward", "turning"), [(1, 1), (-1, -1), (-1, 1), (1, -1)])
def test_total_of_the_cb560_worked_values_in_either_direction(forward: int, turning: int) -> None:
    at = OperatingConditions.from_bar(
        forward * np.array([40.0, 200.0, 300.0]),
        [40.0, 50.0, 60.0],
        turning * np.array([10.0, 30.0, 80.0]),
    )
    total = total_flow_l_per_min(placeholder_motor("CB560"), at)
    assert total == pytest.approx([0.361771, 1.371423, 3.220537], abs=5e-7)


@pytest.mark.parametrize("roller_is_free", [False, True])
@pytest.mark.parametrize("flushing", ["none", "fixed", "estimated"])
@pytest.mark.parametrize("film_pressure", [FilmPressure(share=0.5), FilmPressure("slot")])
def test_flow_is_linear_in_the_columns(
    roller_is_free: bool, flushing: str, film_pressure: FilmPressure
) -> None:
    # y = known + Σ K φ + C_f: the columns rebuild the flow at any coefficients.
    motor = placeholder_motor(
        flushing=flushing,  # type: ignore[arg-type]
        flushing_l_per_min=3.0,
        roller_is_free=roller_is_free,
        film_pressure=film_pressure,
    )
    conditions = random_conditions(500)
    coefficients = {path.name: 1.7 * path.configured_coefficient for path in motor.column_paths}
    constant = 0.0 if motor.constant is None else motor.constant.configured_coefficient
    z = regressors(motor, conditions)
    assert z.shape == (500, len(motor.columns) - 1)
    rebuilt = z @ np.array([*coefficients.values(), constant, 1.0])
    np.testing.assert_allclose(
        rebuilt, total_flow_l_per_min(motor, conditions, coefficients), rtol=1e-12
    )


def test_long_series_equal_their_samples_one_by_one() -> None:
    # Longer than the chunks in which the columns are computed.
    motor, conditions = placeholder_motor(), random_conditions(40_000)
    z = regressors(motor, conditions)
    total = total_flow_l_per_min(motor, conditions)
    for index in (0, 16_383, 16_384, 16_385, 32_768, 39_999):
        sample = conditions.part(slice(index, index + 1))
        np.testing.assert_allclose(regressors(motor, sample)[0], z[index], rtol=1e-14)
        np.testing.assert_allclose(total_flow_l_per_min(motor, sample)[0], total[index], rtol=1e-14)


def test_with_a_charge_pressure_both_sides_leak() -> None:
    """The high one at ΔP and the charge, whatever the direction; the low one at the charge."""
    both = OperatingConditions.from_bar([200.0, -200.0], 50.0, 30.0, 15.0)
    sides = (OperatingConditions.from_bar([bar, bar], 50.0, 30.0) for bar in (215.0, 15.0))
    motor = placeholder_motor()
    apart = sum(total_flow_l_per_min(motor, side) for side in sides)
    np.testing.assert_allclose(total_flow_l_per_min(motor, both), apart, rtol=1e-12)


def test_nan_stays_in_its_row_and_in_what_depends_on_it() -> None:
    conditions = OperatingConditions.from_bar(
        [200.0, math.nan, 200.0, 200.0], [50.0, 50.0, math.nan, 50.0], [30.0, 30.0, 30.0, math.nan]
    )
    z = regressors(placeholder_motor(), conditions)
    assert np.isnan(z).tolist() == [
        [False] * 5,
        [True, True, True, False, True],
        [True, True, True, False, True],
        [False, False, False, False, True],
    ]


def test_a_standard_can_be_freed() -> None:
    motor = placeholder_motor()
    assert motor.with_free_standard() == placeholder_motor(roller_is_free=True)
    # A known gap is none: its loss factor is a constant of the drawing.
    known = replace(piston_ring(), gap=replace(piston_ring().gap, fixed=True))
    assert replace(motor, paths=(known,)).standard is None


def test_coefficient_of_an_unknown_path_is_refused() -> None:
    with pytest.raises(ParameterError) as caught:
        total_flow_l_per_min(placeholder_motor(), random_conditions(3), {"K_o": 1e-14})
    assert caught.value.code == "coefficient_unknown"


def test_motor_without_paths_or_with_doubled_ones_is_refused() -> None:
    oil, ring = placeholder_oil(), piston_ring()
    flushing = Constant("f", Parameter("C_f", "l_per_min", 4.0, 0.0, 20.0))
    other = replace(flushing, name="g", flow=replace(flushing.flow, name="C_g"))
    for paths in (
        (),
        (ring, ring),
        (ring, replace(ring, name="q")),
        (replace(ring, name="known"),),
        (flushing, other),
    ):
        with pytest.raises(ParameterError, match="CB0"):
            Motor("CB0", paths, oil)


@pytest.mark.parametrize("shapes", [(2, 3, 2), (2, 2, 2, 3), ((2, 2),) * 3])
def test_conditions_of_unequal_length_are_refused(shapes: tuple[int, ...]) -> None:
    with pytest.raises(ShapeError):
        OperatingConditions(*map(np.zeros, shapes))
    if len(set(shapes)) > 1:
        with pytest.raises(ShapeError):
            OperatingConditions.from_bar(*map(np.zeros, shapes))


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
    oil = placeholder_oil(grade)
    viscosity = kinematic_viscosity_mm2_per_s(temperature_c, oil.walther_a, oil.walther_b)
    assert float(viscosity) == pytest.approx(expected, abs=digit)


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


THIN = walther_coefficients(40.0, 1.2, 100.0, 0.4)
VG_46 = walther_coefficients(40.0, 46.0, 100.0, 6.8)


@pytest.mark.parametrize(
    ("temperatures_c", "oil", "code"),
    [
        ([-70.1], VG_46, "oil_temperature_range"),
        ([370.1], VG_46, "oil_temperature_range"),
        ([-273.15], VG_46, "oil_temperature_range"),
        ([-500.0], VG_46, "oil_temperature_range"),
        ([math.nan, 300.0], THIN, "oil_viscosity_range"),
    ],
)
def test_temperatures_at_which_d341_does_not_hold_are_refused(
    temperatures_c: list[float], oil: tuple[float, float], code: str
) -> None:
    with pytest.raises(ValidityError) as caught:
        kinematic_viscosity_mm2_per_s(temperatures_c, *oil)
    assert caught.value.code == code
    for ends in ([-70.0, -69.0], [369.0, 370.0]):
        assert np.diff(kinematic_viscosity_mm2_per_s(ends, *VG_46)) < 0.0


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


def test_an_oil_and_a_film_pressure_without_physics_are_refused() -> None:
    assert [FilmPressure(share=share).share for share in (0.0, 1.0)] == [0.0, 1.0]
    for nonsense in ({"share": -0.01}, {"share": 1.01}, {"model": "gap"}):
        with pytest.raises(ParameterError):
            FilmPressure(**nonsense)  # type: ignore[arg-type]
    for density in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(ParameterError):
            Oil("none", 9.4, 3.7, density, 7e-4, 2e-8)
