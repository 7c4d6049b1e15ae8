"""Parameters of the paths: bounds, feasible gaps, and what is refused."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given

from leakage.errors import ParameterError
from leakage.physics.paths import Parameter
from tests.leakage.physics.declared_paths import COEFFICIENTS_M3
from tests.leakage.placeholders import (
    balance_piston,
    balance_sleeve,
    cam_roller,
    eccentricity,
    gap,
    piston_ring,
)


def test_bounds_are_reached_and_a_fixed_parameter_shrinks_them() -> None:
    free = balance_piston()
    assert free.coefficient_bounds() == (
        free.coefficient([1.0, 0.0]),
        free.coefficient([60.0, 1.0]),
    )
    half = replace(free, eccentricity=eccentricity("p", 0.4, fixed=True))
    assert half.coefficient_bounds() == (
        free.coefficient([1.0, 0.4]),
        free.coefficient([60.0, 0.4]),
    )
    assert half.is_free
    whole = replace(half, gap=gap("p", 10.0, fixed=True))
    assert not whole.is_free
    assert whole.coefficient_bounds() == (whole.configured_coefficient,) * 2


@given(coefficient_m3=COEFFICIENTS_M3)
def test_feasible_gaps_lie_a_factor_1_357_apart(coefficient_m3: float) -> None:
    lowest, highest = balance_sleeve().feasible_gap_um(coefficient_m3)
    assert highest / lowest == pytest.approx(2.5 ** (1.0 / 3.0), rel=1e-12)
    assert round(highest / lowest, 3) == 1.357


def test_inverse_map_takes_arrays_and_refuses_what_has_no_gap() -> None:
    piston = balance_piston()
    assert piston.gap_um_from_coefficient([0.0, 1.558230e-14], 0.4) == pytest.approx(
        [0.0, 10.0], rel=1e-7
    )
    for coefficient, e in ((-1e-15, 0.0), (1e-15, 1.5), (1e-15, math.nan)):
        with pytest.raises(ParameterError, match="no gap height"):
            piston.gap_um_from_coefficient(coefficient, e)


@pytest.mark.parametrize(
    ("value", "minimum", "maximum"),
    [
        (0.5, 1.0, 60.0),
        (61.0, 1.0, 60.0),
        (8.0, 60.0, 1.0),
        (math.nan, 1.0, 60.0),
        (8, 1, math.inf),
    ],
)
def test_parameter_outside_its_bounds_is_refused(
    value: float, minimum: float, maximum: float
) -> None:
    with pytest.raises(ParameterError, match="h_o"):
        Parameter("h_o", "um", value, minimum, maximum)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"count": 0}, "count"),
        ({"radius_m": -0.035}, "radius_m"),
        ({"length_m": math.nan}, "length_m"),
        ({"height_factor": 0.0}, "height_factor"),
        ({"deformation_pressure_pa": 0.0}, "deformation_pressure_pa"),
        ({"gap": Parameter("h_o", "mm", 0.008, 0.001, 0.06)}, "expects 'um'"),
        ({"gap": Parameter("h_o", "um", 8.0, -1.0, 60.0)}, "within 0"),
        ({"eccentricity": Parameter("e_o", "1", 0.5, 0.0, 1.5)}, "within 0 to 1"),
    ],
)
def test_annular_gap_with_nonsense_is_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(ParameterError, match=message) as caught:
        replace(piston_ring(), **change)  # type: ignore[arg-type]
    assert "'o'" in str(caught.value)


@pytest.mark.parametrize(
    "change",
    [
        {"coefficients": ()},
        {"coefficients": (math.nan, 1.0)},
        {"speed_minimum_rpm": 125.0},
        {"speed_minimum_rpm": -1.0},
        {"speed_maximum_rpm": math.inf},
        {"reference_pressure_pa": 0.0},
        {"reference_viscosity_pa_s": -0.035},
        {"scale": Parameter("scale_r", "um", 1.0, 0.0, 5.0)},
    ],
)
def test_speed_curve_with_nonsense_is_refused(change: dict[str, object]) -> None:
    with pytest.raises(ParameterError, match="'r'"):
        replace(cam_roller(), **change)  # type: ignore[arg-type]
