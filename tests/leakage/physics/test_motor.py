"""A motor as a list of paths: totals, columns, flushing, and a type by declaration alone."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leakage.errors import ParameterError, ShapeError
from leakage.physics.conditions import OperatingConditions
from leakage.physics.law import Parameter
from leakage.physics.motor import Motor, regressors, speed_beyond_curve, total_flow_l_per_min
from leakage.physics.oil import FilmPressure, dynamic_viscosity_pa_s
from leakage.physics.paths import Constant
from tests.leakage.placeholders import (
    piston_ring,
    placeholder_motor,
    placeholder_oil,
)

WORKED = OperatingConditions.from_bar([40.0, 200.0, 300.0], [40.0, 50.0, 60.0], [10.0, 30.0, 80.0])
WORKED_CB560_L_PER_MIN = [0.361771, 1.371423, 3.220537]


def random_conditions(n: int, seed: int = 1) -> OperatingConditions:
    generator = np.random.default_rng(seed)
    return OperatingConditions.from_bar(
        generator.uniform(-350.0, 350.0, n),
        generator.uniform(0.0, 90.0, n),
        generator.uniform(-150.0, 150.0, n),
    )


def test_total_of_the_cb560_worked_values() -> None:
    total = total_flow_l_per_min(placeholder_motor("CB560"), WORKED)
    assert total == pytest.approx(WORKED_CB560_L_PER_MIN, abs=5e-7)


@given(pressure_bar=st.floats(0.0, 350.0), speed_rpm=st.floats(0.0, 300.0))
def test_direction_has_no_effect(pressure_bar: float, speed_rpm: float) -> None:
    forward, *others = (
        total_flow_l_per_min(
            placeholder_motor(),
            OperatingConditions.from_bar(p * pressure_bar, 50.0, w * speed_rpm),
        )
        for p, w in ((1, 1), (-1, -1), (-1, 1), (1, -1))
    )
    for other in others:
        np.testing.assert_array_equal(other, forward)


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


def test_columns_follow_the_models_regressors() -> None:
    # φ_o = exp(-3ΔP/X_o)·ΔP/η, φ_p = ΔP/η, φ_s = exp(-3ΔP/X_s)·ΔP/η, each times 60 000.
    z = regressors(placeholder_motor(), WORKED)
    pressure = np.array([40e5, 200e5, 300e5])
    phi_p = 60_000.0 * pressure / dynamic_viscosity_pa_s([40, 50, 60], pressure, placeholder_oil())
    np.testing.assert_allclose(z[:, 1], phi_p, rtol=1e-12)
    np.testing.assert_allclose(z[:, 0], phi_p * np.exp(-3 * pressure / 120e5), rtol=1e-12)
    np.testing.assert_allclose(z[:, 2], phi_p * np.exp(-3 * pressure / 900e5), rtol=1e-12)
    np.testing.assert_array_equal(z[:, 3], 1.0)
    np.testing.assert_allclose(z[:, 4] / 32, [1.735590e-3, 1.660281e-2, 6.068909e-2], rtol=3e-7)


def test_long_series_equal_their_samples_one_by_one() -> None:
    # Longer than the chunks in which the columns are computed.
    motor, conditions = placeholder_motor(), random_conditions(40_000)
    z = regressors(motor, conditions)
    total = total_flow_l_per_min(motor, conditions)
    for index in (0, 16_383, 16_384, 16_385, 32_768, 39_999):
        sample = conditions.part(slice(index, index + 1))
        np.testing.assert_allclose(regressors(motor, sample)[0], z[index], rtol=1e-14)
        np.testing.assert_allclose(total_flow_l_per_min(motor, sample)[0], total[index], rtol=1e-14)


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


def test_samples_beyond_the_curve_are_counted_on_both_sides() -> None:
    speed = np.array([0.0, 125.0, -125.0, 125.1, -130.0])
    assert speed_beyond_curve(placeholder_motor(), speed).tolist() == [
        *(False, False, False),
        *(True, True),
    ]
    without_roller = Motor("ring", (piston_ring(),), placeholder_oil())
    assert not speed_beyond_curve(without_roller, speed).any()


def test_coefficient_of_an_unknown_path_is_refused() -> None:
    with pytest.raises(ParameterError, match="has no path") as caught:
        total_flow_l_per_min(placeholder_motor(), WORKED, {"K_o": 1e-14})
    assert caught.value.code == "coefficient_unknown"


def test_motor_without_paths_or_with_doubled_ones_is_refused() -> None:
    oil, ring = placeholder_oil(), piston_ring()
    flushing = Constant("f", Parameter("C_f", "l_per_min", 4.0, 0.0, 20.0))
    other = replace(flushing, name="g", flow=replace(flushing.flow, name="C_g"))
    for paths, message in (
        ((), "no leakage path"),
        ((ring, ring), "more than once"),
        ((ring, replace(ring, name="q")), "parameter"),
        ((replace(ring, name="known"),), "known"),
        ((flushing, other), "more than one constant"),
    ):
        with pytest.raises(ParameterError, match=message) as caught:
            Motor("CB0", paths, oil)
        assert "CB0" in str(caught.value)


@pytest.mark.parametrize("shapes", [(2, 3, 2), (2, 2, 2, 3), ((2, 2),) * 3])
def test_conditions_of_unequal_length_are_refused(shapes: tuple[int, ...]) -> None:
    with pytest.raises(ShapeError):
        OperatingConditions(*map(np.zeros, shapes))
    if len(set(shapes)) > 1:
        with pytest.raises(ShapeError):
            OperatingConditions.from_bar(*map(np.zeros, shapes))
