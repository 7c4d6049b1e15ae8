"""Parameters of the paths: bounds, feasible gaps, and what is refused."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import Any

import pytest
from hypothesis import given

from leakage.errors import ParameterError
from leakage.physics.annular_gap import VISIBLE_BELOW
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
    figures = {one.name: one for one in path.derived_figures(coefficient, limits, (3e-7, 4e-7))}
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
    assert roller.path.coefficients == pytest.approx(raised)  # type: ignore[attr-defined]
    stiff = replace(balance_piston(), deformation_tolerance=0.2)
    assert not any(path.tolerances() for path in (stiff, piston_ring(), cam_roller()))


def test_a_path_shows_below_a_pressure_that_goes_with_its_deformation() -> None:
    assert balance_piston().visible_below_pa == math.inf
    assert piston_ring().visible_below_pa == VISIBLE_BELOW * 120e5


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
