"""Parameters of the search and the coefficients that they mean."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given

from leakage.estimation.multi_start import Parametrisation
from leakage.physics.motor import Motor
from leakage.physics.paths import Laminar, Parameter
from tests.leakage.estimation.motors_to_search import (
    EVERYTHING_FREE,
    FLUSHED,
    MOTORS,
    PLAIN,
    SEEDS,
    with_piston,
)
from tests.leakage.made_samples import true_coefficients
from tests.leakage.placeholders import eccentricity, gap, placeholder_motor


@MOTORS
def test_configured_parameters_give_the_configured_coefficients(motor: Motor) -> None:
    parametrisation = Parametrisation.of(motor)
    configured = np.array([parameter.value for parameter in parametrisation.free])
    theta = parametrisation.coefficients(configured)
    np.testing.assert_array_equal(theta, true_coefficients(motor))


def test_free_parameters_stand_in_the_order_of_the_columns() -> None:
    names = [parameter.name for parameter in Parametrisation.of(EVERYTHING_FREE).free]
    assert names == ["h_o", "h_p", "e_p", "h_s", "e_s", "scale_r", "C_f"]
    fixed = with_piston(FLUSHED, gap("p", 10.0, fixed=True), eccentricity("p", 0.4))
    names = [parameter.name for parameter in Parametrisation.of(fixed).free]
    assert names == ["h_o", "e_p", "h_s", "e_s", "C_f"]


def some_motor(fixed: tuple[bool, bool]) -> Motor:
    motor = with_piston(
        EVERYTHING_FREE, gap("p", 10.0, fixed=fixed[0]), eccentricity("p", 0.4, fixed=fixed[1])
    )
    distributor = Laminar("d", 2, Parameter("C_d", "m3", 1e-15, 0.0, 1e-13))
    return replace(motor, paths=(*motor.paths, distributor))


@given(seed=SEEDS)
def test_coefficients_of_any_point_lie_in_the_box_that_bounds_imply(seed: int) -> None:
    parametrisation = Parametrisation.of(some_motor((False, False)))
    low, high = parametrisation.coefficient_bounds()
    lower, upper = parametrisation.bounds()
    share = np.random.default_rng(seed).choice([0.0, 0.2, 1.0], len(lower))
    theta = parametrisation.coefficients(lower + share * (upper - lower))
    assert ((theta >= low * (1 - 1e-14)) & (theta <= high * (1 + 1e-14))).all()


def test_fixing_gap_or_eccentricity_shrinks_the_box_of_its_loss_factor() -> None:
    def box(height_fixed: bool, offset_fixed: bool) -> tuple[float, float]:
        height, offset = gap("p", 10.0, fixed=height_fixed), eccentricity("p", 0.4, fixed=False)
        offset = replace(offset, fixed=offset_fixed)
        lower, upper = Parametrisation.of(with_piston(PLAIN, height, offset)).coefficient_bounds()
        return float(lower[1]), float(upper[1])

    free, fixed_gap, fixed_offset = box(False, False), box(True, False), box(False, True)
    # h from 1 to 60 µm and e from 0 to 1: a factor 60³ and a factor 2.5.
    assert free[1] / free[0] == pytest.approx(60.0**3 * 2.5, rel=1e-12)
    assert fixed_gap[1] / fixed_gap[0] == pytest.approx(2.5, rel=1e-12)
    assert fixed_offset[1] / fixed_offset[0] == pytest.approx(60.0**3, rel=1e-12)
    for narrow in (fixed_gap, fixed_offset):
        assert free[0] <= narrow[0] < 1.558230e-14 < narrow[1] <= free[1]


def test_no_constant_path_is_a_constant_flow_of_zero() -> None:
    parametrisation = Parametrisation.of(PLAIN)
    lower, upper = parametrisation.coefficient_bounds()
    assert (lower[3], upper[3]) == (0.0, 0.0)
    assert parametrisation.coefficients(np.array([8.0, 10.0, 0.4, 12.0, 0.3]))[3] == 0.0


def test_fixed_flushing_is_its_value() -> None:
    motor = placeholder_motor(flushing="fixed", flushing_l_per_min=4.0)
    lower, upper = Parametrisation.of(motor).coefficient_bounds()
    assert (lower[3], upper[3]) == (4.0, 4.0)
    theta = Parametrisation.of(motor).coefficients(np.array([8.0, 10, 0.4, 12, 0.3]))
    assert theta[3] == 4.0
