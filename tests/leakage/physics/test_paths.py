"""The leakage paths: worked values, limits, feasible gaps, and what is refused."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from leakage.errors import ParameterError
from leakage.physics.annular_gap import VISIBLE_BELOW
from leakage.physics.oil import THESIS_FILM_PRESSURE, FilmPressure, flow_drive_per_s
from leakage.physics.paths import Laminar, Law, Parameter, Side
from tests.leakage.placeholders import (
    balance_piston,
    balance_sleeve,
    cam_roller,
    eccentricity,
    gap,
    piston_ring,
    placeholder_oil,
)

GAPS_UM = st.floats(1.0, 60.0)
ECCENTRICITIES = st.floats(0.0, 1.0)


def vector(*values: float) -> NDArray[np.float64]:
    return np.array(values)


def flow_l_per_min(
    path: Law,
    pressure_bar: float,
    temperature_c: float = 50.0,
    speed_rpm: float = 30.0,
    film_pressure: FilmPressure = THESIS_FILM_PRESSURE,
) -> float:
    pressure = vector(pressure_bar * 1e5)
    drive = flow_drive_per_s(pressure, vector(temperature_c), placeholder_oil(), film_pressure)
    return (
        path.configured_coefficient
        * path.regressor(Side(drive, pressure, vector(speed_rpm))).item()
    )


@pytest.mark.parametrize(
    ("at", "expected"),
    [
        ((40.0, 40.0, 10.0), [3.243447e-3, 1.830232e-3, 4.496090e-3, 1.735590e-3]),
        ((200.0, 50.0, 30.0), [3.445024e-4, 1.061377e-2, 1.529589e-2, 1.660281e-2]),
        ((300.0, 60.0, 80.0), [5.230070e-5, 1.963003e-2, 2.027035e-2, 6.068909e-2]),
    ],
)
def test_flow_of_one_interface_worked_values(
    at: tuple[float, float, float], expected: list[float]
) -> None:
    """Of ring, balance piston, balance sleeve and roller at bar, °C and rpm."""
    paths = piston_ring(1), balance_piston(1), balance_sleeve(1), cam_roller(1)
    assert [flow_l_per_min(path, *at) for path in paths] == pytest.approx(expected, rel=3e-7)


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


def test_roller_leaks_its_curve_at_the_simulations_pressure_and_viscosity() -> None:
    roller = cam_roller(1)
    drive = vector(roller.reference_pressure_pa / roller.reference_viscosity_pa_s)
    flow = roller.regressor(Side(drive, vector(roller.reference_pressure_pa), vector(10.0)))
    assert flow.item() == pytest.approx(0.015832, rel=1e-12)


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
    assert path.coefficient_bounds() == pytest.approx(expected, rel=1e-6, abs=0.0)
    assert path.is_free == (not (fixed_gap and fixed_e))


@pytest.mark.parametrize(
    ("change", "h", "e", "h_limits"),
    [
        # K of h = 10 µm at e = 0.4: h³(1 + 1.5e²) = 1240 µm³ for each h and e that are possible.
        ({}, (496 ** (1 / 3), 1240 ** (1 / 3)), (0.0, 1.0), None),
        ({"gap": Parameter("h_p", "um", 9.0, 8.0, 10.0)}, (8.0, 10.0), (0.4, 0.973610), None),
        ({"gap": gap("p", 9.0, fixed=True)}, (9.0, 9.0), (0.683598, 0.683598), None),
        ({"eccentricity": eccentricity("p", 0.4, fixed=True)}, (10, 10), (0.4, 0.4), (9.0, 11.0)),
        ({"eccentricity": None}, (1240 ** (1 / 3),) * 2, None, (9.669034, 11.817708)),
    ],
)
def test_figures_that_a_loss_factor_leaves_possible(
    change: dict[str, Any],
    h: tuple[float, float],
    e: tuple[float, float] | None,
    h_limits: tuple[float, float] | None,
) -> None:
    coefficient = float(balance_piston().coefficient([10.0, 0.4]))
    path, close = replace(balance_piston(), **change), partial(pytest.approx, rel=1e-5, abs=1e-8)
    limits = 0.729 * coefficient, 1.331 * coefficient
    figures = {
        figure.name: figure for figure in path.derived_figures(coefficient, limits, (3e-7, 4e-7))
    }
    assert (figures["h_p"].lowest, figures["h_p"].highest) == close(h)
    assert figures["h_p"].limits == (h_limits and close(h_limits))
    ratio = figures["film_thickness_ratio_p"]
    # The narrowest gap is the most eccentric one; √(0.3² + 0.4²) = 0.5 µm.
    smallest, largest = e or (0.0, 0.0)
    thickness = [h[0] * (1 - largest) / 0.5, h[1] * (1 - smallest) / 0.5]
    assert [ratio.lowest, ratio.highest] == close(thickness)
    assert ("e_p" in figures) == (e is not None)
    if e:
        assert (figures["e_p"].lowest, figures["e_p"].highest) == close(e)
    assert bool(ratio.combination) == (e is not None and path.gap.is_free and h_limits is None)


def test_a_stated_tolerance_gives_the_path_with_the_larger_constant() -> None:
    (ring,) = replace(piston_ring(), deformation_tolerance=0.2).tolerances()
    assert ring.share == 0.2
    assert ring.path.deformation_pressure_pa == pytest.approx(144e5)  # type: ignore[attr-defined]
    (roller,) = replace(cam_roller(), curve_tolerance=0.1).tolerances()
    raised = [1.1 * coefficient for coefficient in cam_roller().coefficients]
    assert roller.path.coefficients == pytest.approx(raised, abs=0.0)  # type: ignore[attr-defined]
    stiff = replace(balance_piston(), deformation_tolerance=0.2)
    assert not any(path.tolerances() for path in (stiff, piston_ring(), cam_roller()))


def test_a_path_shows_below_a_pressure_that_goes_with_its_deformation() -> None:
    assert balance_piston().visible_below_pa == math.inf
    assert piston_ring().visible_below_pa == VISIBLE_BELOW * 120e5


@pytest.mark.parametrize(
    "figures", [(0.5, 1, 60), (61, 1, 60), (8, 60, 1), (math.nan, 1, 60), (8, 1, math.inf)]
)
def test_parameter_outside_its_bounds_is_refused(figures: tuple[float, float, float]) -> None:
    with pytest.raises(ParameterError, match="h_o"):
        Parameter("h_o", "um", *figures)


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
