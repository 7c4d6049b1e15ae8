"""The thesis's search: where it starts, where it ends, and that it agrees with the certificate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leakage.estimation.block_statistics import factor
from leakage.estimation.multi_start import (
    ECCENTRICITY_NUDGE,
    coefficients_at,
    free_parameters,
    points_of,
    search,
)
from leakage.physics.motor import Motor
from leakage.physics.paths import AnnularGap, Laminar, Parameter
from tests.leakage.made_samples import made_samples
from tests.leakage.placeholders import (
    balance_piston,
    eccentricity,
    gap,
    placeholder_motor,
    placeholder_oil,
)

PLAIN = placeholder_motor()
FLUSHED = placeholder_motor(flushing="estimated", flushing_l_per_min=4.0)
EVERYTHING_FREE = placeholder_motor(
    flushing="estimated", flushing_l_per_min=4.0, roller_is_free=True
)
MOTORS = pytest.mark.parametrize(
    "motor", [PLAIN, FLUSHED, EVERYTHING_FREE], ids=["plain", "flushed", "everything free"]
)
SEEDS = st.integers(0, 10_000)


def with_piston(motor: Motor, height: Parameter, offset: Parameter) -> Motor:
    """The motor with other parameters of the balance piston."""
    piston = replace(balance_piston(), gap=height, eccentricity=offset)
    return replace(motor, paths=(motor.paths[0], piston, *motor.paths[2:]))


def generator() -> np.random.Generator:
    return np.random.default_rng(20)


# starting points


@given(
    count=st.integers(1, 60),
    seed=SEEDS,
    limits=st.lists(st.tuples(st.floats(-5.0, 5.0), st.floats(0.1, 60.0)), min_size=1, max_size=6),
)
def test_first_is_the_configured_point_the_rest_a_latin_hypercube(
    count: int, seed: int, limits: list[tuple[float, float]]
) -> None:
    parameters = [
        Parameter(f"x_{index}", "um", low + 0.3 * width, low, low + width)
        for index, (low, width) in enumerate(limits)
    ]
    points = points_of(parameters, count, np.random.default_rng(seed))
    assert points.shape == (count, len(parameters))
    assert points[0].tolist() == [parameter.value for parameter in parameters]
    for drawn, (low, width) in zip(points[1:].T, limits, strict=True):
        assert ((drawn >= low) & (drawn <= low + width)).all()
        strata = np.floor((drawn - low) / width * (count - 1) * (1.0 - 1e-12))
        assert sorted(strata) == list(range(count - 1))


# the search


@MOTORS
def test_all_starts_reach_the_certificate_and_none_goes_below(motor: Motor) -> None:
    r = factor(made_samples(motor))
    found = search(r, motor, generator(), starting_points=5)
    assert found.at_minimum == found.starts
    assert len(found.starts) == 5
    assert found.gap == pytest.approx(0.0, abs=1e-7)
    for start in found.starts:
        assert start.cost >= found.certificate.cost * (1.0 - 1e-10)


def test_starts_at_the_minimum_share_loss_factors_while_gap_and_eccentricity_spread() -> None:
    r = factor(made_samples(PLAIN))
    made = search(r, PLAIN, generator(), starting_points=12)
    assert len(made.at_minimum) == 12
    finals = np.array([start.final for start in made.starts])
    found = coefficients_at(PLAIN, finals)[:, :3]
    assert (np.ptp(found, axis=0) / found.mean(axis=0)).max() < 1e-6
    ring_gap, piston_gap, piston_e, sleeve_gap, sleeve_e = finals.T
    assert np.ptp(ring_gap) < 1e-5
    assert np.ptp(piston_e) > 0.3
    assert np.ptp(sleeve_e) > 0.3
    assert np.ptp(piston_gap) > 0.5
    assert np.ptp(sleeve_gap) > 0.5
    piston = PLAIN.paths[1]
    assert isinstance(piston, AnnularGap)
    smallest, largest = piston.feasible_gap_um(float(found[0, 1]))
    assert largest / smallest == pytest.approx(2.5 ** (1 / 3))
    assert ((piston_gap > smallest * (1 - 1e-6)) & (piston_gap < largest * (1 + 1e-6))).all()


def test_a_start_at_no_eccentricity_with_the_gap_at_its_maximum_moves() -> None:
    # K_p needs h 10 µm and e 0.4; h can be no more than 10 µm, and at e = 0 nothing pulls on e.
    motor = with_piston(PLAIN, Parameter("h_p", "um", 10.0, 1.0, 10.0), eccentricity("p", 0.0))
    r = factor(made_samples(PLAIN))
    found = search(r, motor, generator(), starting_points=1)
    (start,) = found.starts
    assert start.initial.tolist() == [8.0, 10.0, ECCENTRICITY_NUDGE, 12.0, 0.3]
    assert start.final[2] > 0.39
    assert start.cost == pytest.approx(found.certificate.cost, rel=1e-9)


def test_same_seed_same_starts_to_the_bit() -> None:
    r = factor(made_samples(FLUSHED))
    first, second = (search(r, FLUSHED, generator(), starting_points=3).starts for _ in range(2))
    for one, other in zip(first, second, strict=True):
        assert (one.cost, one.final.tobytes()) == (other.cost, other.final.tobytes())


@pytest.mark.parametrize("wanted", [0, 10])
def test_nothing_to_search_gives_no_starts(wanted: int) -> None:
    motor = with_piston(PLAIN, gap("p", 10.0), eccentricity("p", 0.4))
    if wanted:
        only = replace(balance_piston(), gap=gap("p", 10.0, fixed=True), eccentricity=None)
        motor = Motor("fixed", (only,), placeholder_oil())
    r = factor(made_samples(motor))
    assert search(r, motor, generator(), starting_points=wanted).starts == ()


# parameters and the coefficients that they mean


def some_motor(fixed: tuple[bool, bool]) -> Motor:
    motor = with_piston(
        EVERYTHING_FREE, gap("p", 10.0, fixed=fixed[0]), eccentricity("p", 0.4, fixed=fixed[1])
    )
    distributor = Laminar("d", 2, Parameter("C_d", "m3", 1e-15, 0.0, 1e-13))
    return replace(motor, paths=(*motor.paths, distributor))


@given(seed=SEEDS)
def test_coefficients_of_any_point_lie_in_the_box_that_bounds_imply(seed: int) -> None:
    motor = some_motor((False, False))
    low, high = motor.coefficient_bounds()
    lower, upper = np.array([(one.minimum, one.maximum) for one in free_parameters(motor)]).T
    share = np.random.default_rng(seed).choice([0.0, 0.2, 1.0], len(lower))
    theta = coefficients_at(motor, lower + share * (upper - lower))
    assert ((theta >= low * (1 - 1e-14)) & (theta <= high * (1 + 1e-14))).all()


def test_fixing_gap_or_eccentricity_shrinks_the_box_of_its_loss_factor() -> None:
    def box(height_fixed: bool, offset_fixed: bool) -> tuple[float, float]:
        height, offset = gap("p", 10.0, fixed=height_fixed), eccentricity("p", 0.4, fixed=False)
        offset = replace(offset, fixed=offset_fixed)
        lower, upper = with_piston(PLAIN, height, offset).coefficient_bounds()
        return float(lower[1]), float(upper[1])

    free, fixed_gap, fixed_offset = box(False, False), box(True, False), box(False, True)
    # h from 1 to 60 µm and e from 0 to 1: a factor 60³ and a factor 2.5.
    assert free[1] / free[0] == pytest.approx(60.0**3 * 2.5, rel=1e-12)
    assert fixed_gap[1] / fixed_gap[0] == pytest.approx(2.5, rel=1e-12)
    assert fixed_offset[1] / fixed_offset[0] == pytest.approx(60.0**3, rel=1e-12)
    for narrow in (fixed_gap, fixed_offset):
        assert free[0] <= narrow[0] < 1.558230e-14 < narrow[1] <= free[1]
