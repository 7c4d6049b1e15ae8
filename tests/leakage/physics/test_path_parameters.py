"""Parameters of the paths: bounds, feasible gaps, and what is refused."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from leakage.errors import ParameterError
from leakage.physics.law import Parameter
from tests.leakage.placeholders import (
    balance_piston,
    balance_sleeve,
    cam_roller,
    eccentricity,
    gap,
    piston_ring,
)


@pytest.mark.parametrize(
    ("fixed_gap", "fixed_e", "lowest", "highest"),
    [
        (False, False, (1.0, 0.0), (60.0, 1.0)),
        (False, True, (1.0, 0.4), (60.0, 0.4)),
        (True, False, (10.0, 0.0), (10.0, 1.0)),
        (True, True, (10.0, 0.4), (10.0, 0.4)),
    ],
)
def test_a_fixed_parameter_shrinks_the_box_of_the_loss_factor(
    fixed_gap: bool, fixed_e: bool, lowest: tuple[float, float], highest: tuple[float, float]
) -> None:
    path = replace(
        balance_piston(),
        gap=gap("p", 10.0, fixed=fixed_gap),
        eccentricity=eccentricity("p", 0.4, fixed=fixed_e),
    )
    # By hand, as multiples of K at h = 10 µm and e = 0.4, 1.558230e-14 m³.
    expected = [
        1.558230e-14 * (h / 10.0) ** 3 * (1 + 1.5 * e * e) / 1.24 for h, e in (lowest, highest)
    ]
    assert path.coefficient_bounds() == pytest.approx(expected, rel=1e-6)
    assert path.is_free == (not (fixed_gap and fixed_e))


@pytest.mark.parametrize("coefficient_m3", [1e-18, 4.373874e-14, 1e-10])
def test_feasible_gaps_lie_a_factor_1_357_apart(coefficient_m3: float) -> None:
    lowest, highest = balance_sleeve().feasible_gap_um(coefficient_m3)
    assert highest / lowest == pytest.approx(2.5 ** (1.0 / 3.0), rel=1e-12)


def test_bounds_of_the_gap_narrow_what_is_feasible() -> None:
    """K of h = 10 µm and e = 0.4: at h it asks for 1 + 1.5 e² = 1.24 (10/h)³, by hand."""
    path = replace(balance_piston(), gap=Parameter("h_p", "um", 10.0, 9.0, 10.5))
    height, e, film = path.derived_figures(1.558230e-14, (1.4e-14, 1.7e-14), (2e-7, 2e-7))
    assert (height.name, height.lowest, height.highest) == ("h_p", 9.0, 10.5)
    # √(0.07116/1.5) and √(0.70096/1.5).
    assert (e.name, e.lowest, e.highest) == ("e_p", *map(near, (0.21781, 0.68361)))
    # h (1 − e) / √(0.2² + 0.2²), widest where the gap is.
    assert (film.lowest, film.highest) == (
        near(9.0 * 0.31639 / 0.28284),
        near(10.5 * 0.78219 / 0.28284),
    )
    assert [one.limits for one in (height, e, film)] == [None] * 3
    assert {one.combination for one in (height, e, film)} == {"K_p ∝ h³(1 + 1.5e²)"}


def test_a_gap_alone_in_its_loss_factor_has_its_interval() -> None:
    height, film = piston_ring().derived_figures(
        7.506312e-14, (-1e-15, 8 * 7.506312e-14), (2e-7, 2e-7)
    )
    assert (height.lowest, height.highest, height.combination) == (near(8.0), near(8.0), "")
    assert height.limits == (0.0, near(16.0))
    assert film.lowest == film.highest == near(8.0 / 0.28284)


def near(value: float) -> Any:
    return pytest.approx(value, rel=1e-4)


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
    ("path", "change", "message"),
    [
        (piston_ring(), {"count": 0}, "'o'.*count"),
        (piston_ring(), {"radius_m": -0.035}, "'o'.*radius_m"),
        (piston_ring(), {"length_m": math.nan}, "'o'.*length_m"),
        (piston_ring(), {"height_factor": 0.0}, "'o'.*height_factor"),
        (piston_ring(), {"deformation_pressure_pa": 0.0}, "'o'.*deformation_pressure_pa"),
        (piston_ring(), {"gap": Parameter("h", "mm", 0.008, 0.001, 0.06)}, "'o'.*expects 'um'"),
        (piston_ring(), {"gap": Parameter("h", "um", 8.0, -1.0, 60.0)}, "'o'.*within 0"),
        (piston_ring(), {"eccentricity": Parameter("e", "1", 0.5, 0.0, 1.5)}, "'o'.*0 to 1"),
        (cam_roller(), {"coefficients": ()}, "'r'.*at least one"),
        (cam_roller(), {"coefficients": (math.nan, 1.0)}, "'r'.*finite"),
        (cam_roller(), {"speed_minimum_rpm": 125.0}, "'r'.*range"),
        (cam_roller(), {"speed_minimum_rpm": -1.0}, "'r'.*range"),
        (cam_roller(), {"speed_maximum_rpm": math.inf}, "'r'.*range"),
        (cam_roller(), {"reference_pressure_pa": 0.0}, "'r'.*reference_pressure_pa"),
        (cam_roller(), {"reference_viscosity_pa_s": -0.035}, "'r'.*reference_viscosity"),
        (cam_roller(), {"scale": Parameter("s", "um", 1.0, 0.0, 5.0)}, "'r'.*expects '1'"),
    ],
)
def test_a_path_with_nonsense_is_refused(path: Any, change: dict[str, Any], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        replace(path, **change)
