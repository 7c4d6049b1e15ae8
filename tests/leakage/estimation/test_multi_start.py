"""The thesis's search: where it starts, where it ends, and that it agrees with the certificate."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from leakage.estimation.block_statistics import Array, criterion, factor
from leakage.estimation.certificate import certify
from leakage.estimation.multi_start import (
    ECCENTRICITY_NUDGE,
    Parametrisation,
    SearchSettings,
    Start,
    at_minimum,
    search,
    starting_points,
)
from leakage.physics.motor import Motor
from leakage.physics.paths import AnnularGap, Parameter
from tests.leakage.estimation.motors_to_search import (
    EVERYTHING_FREE,
    FLUSHED,
    MOTORS,
    PLAIN,
    SEEDS,
    with_piston,
)
from tests.leakage.made_samples import made_conditions, made_samples, true_coefficients
from tests.leakage.placeholders import balance_piston, eccentricity, gap, placeholder_oil


def generator() -> np.random.Generator:
    return np.random.default_rng(20)


def minimum_of(motor: Motor, r: Array) -> float:
    return certify(r, *Parametrisation.of(motor).coefficient_bounds()).cost


def coefficients_at_the_end(motor: Motor, starts: tuple[Start, ...]) -> Array:
    parametrisation = Parametrisation.of(motor)
    return np.array([parametrisation.coefficients(start.final) for start in starts])


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
    points = starting_points(parameters, count, np.random.default_rng(seed))
    assert points.shape == (count, len(parameters))
    assert points[0].tolist() == [parameter.value for parameter in parameters]
    for drawn, (low, width) in zip(points[1:].T, limits, strict=True):
        assert ((drawn >= low) & (drawn <= low + width)).all()
        strata = np.floor((drawn - low) / width * (count - 1) * (1.0 - 1e-12))
        assert sorted(strata) == list(range(count - 1))


def test_the_strata_of_parameters_are_not_in_step() -> None:
    parameters = Parametrisation.of(FLUSHED).free
    drawn = starting_points(parameters, 201, generator())[1:]
    correlation = np.corrcoef(drawn.T) - np.eye(len(parameters))
    assert np.abs(correlation).max() < 0.3


def test_one_starting_point_is_the_configured_one_alone() -> None:
    points = starting_points(Parametrisation.of(PLAIN).free, 1, generator())
    np.testing.assert_array_equal(points, [[8.0, 10.0, 0.4, 12.0, 0.3]])


def test_same_seed_same_points_and_another_seed_others() -> None:
    free = Parametrisation.of(PLAIN).free
    first = starting_points(free, 10, np.random.default_rng(7))
    np.testing.assert_array_equal(first, starting_points(free, 10, np.random.default_rng(7)))
    other = starting_points(free, 10, np.random.default_rng(8))
    np.testing.assert_array_equal(first[0], other[0])
    assert (first[1:] != other[1:]).all()


@pytest.mark.parametrize(("maximum", "expected"), [(1.0, ECCENTRICITY_NUDGE), (1e-4, 1e-4)])
def test_an_eccentricity_of_zero_is_nudged_within_its_bounds(
    maximum: float, expected: float
) -> None:
    free = [gap("p", 10.0), Parameter("e_p", "1", 0.0, 0.0, maximum)]
    assert starting_points(free, 1, generator()).tolist() == [[10.0, expected]]


def test_a_zero_that_is_no_eccentricity_stays() -> None:
    free = [Parameter("C_f", "l_per_min", 0.0, 0.0, 20.0)]
    assert starting_points(free, 1, generator()).tolist() == [[0.0]]


# the search


@MOTORS
def test_all_starts_reach_the_certificate_and_none_goes_below(motor: Motor) -> None:
    r = factor(made_samples(motor))
    starts = search(r, motor, SearchSettings(5), generator())
    minimum = minimum_of(motor, r)
    assert [start.number for start in starts] == list(range(5))
    assert at_minimum(starts, minimum).all()
    for start in starts:
        assert start.status.endswith("tolerance")
        assert start.cost >= minimum * (1.0 - 1e-10)
        assert start.cost == pytest.approx(minimum, rel=1e-7)


@settings(deadline=None, max_examples=15)
@given(seed=SEEDS)
def test_no_start_ends_below_the_certificate_wherever_bounds_bind(seed: int) -> None:
    draw = np.random.default_rng(seed)
    height = Parameter("h_p", "um", 5.0, 1.0, float(draw.uniform(6.0, 14.0)))
    offset = Parameter("e_p", "1", 0.5, 0.0, float(draw.uniform(0.5, 1.0)), bool(draw.integers(2)))
    motor = with_piston(FLUSHED, height, offset)
    r = factor(made_samples(FLUSHED, 300, seed, noise_l_per_min=0.05))
    starts = search(r, motor, SearchSettings(3), draw)
    minimum = minimum_of(motor, r)
    lower, upper = Parametrisation.of(motor).bounds()
    for start in starts:
        assert start.cost >= minimum * (1.0 - 1e-10)
        assert ((lower <= start.final) & (start.final <= upper)).all()
    assert at_minimum(starts, minimum).any()


def test_known_loss_factors_are_recovered_without_noise() -> None:
    r = factor(made_samples(EVERYTHING_FREE, noise_l_per_min=0.0))
    starts = search(r, EVERYTHING_FREE, SearchSettings(10), generator())
    found = coefficients_at_the_end(EVERYTHING_FREE, starts)
    np.testing.assert_allclose(found, [true_coefficients(EVERYTHING_FREE)] * 10, rtol=1e-8)


def test_starts_at_the_minimum_share_loss_factors_while_gap_and_eccentricity_spread() -> None:
    r = factor(made_samples(PLAIN))
    starts = search(r, PLAIN, SearchSettings(12), generator())
    assert at_minimum(starts, minimum_of(PLAIN, r)).all()
    found = coefficients_at_the_end(PLAIN, starts)[:, :3]
    assert (np.ptp(found, axis=0) / found.mean(axis=0)).max() < 1e-6
    ring_gap, piston_gap, piston_e, sleeve_gap, sleeve_e = np.array(
        [start.final for start in starts]
    ).T
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
    (start,) = search(r, motor, SearchSettings(1), generator())
    assert start.initial.tolist() == [8.0, 10.0, ECCENTRICITY_NUDGE, 12.0, 0.3]
    assert start.final[2] > 0.39
    assert start.cost == pytest.approx(minimum_of(motor, r), rel=1e-9)
    assert minimum_of(motor, r) == pytest.approx(minimum_of(PLAIN, r), rel=1e-12)


def test_a_gap_that_is_fixed_too_small_ends_at_the_bound_of_its_loss_factor() -> None:
    motor = with_piston(PLAIN, gap("p", 7.0, fixed=True), eccentricity("p", 0.2))
    r = factor(made_samples(PLAIN))
    certificate = certify(r, *Parametrisation.of(motor).coefficient_bounds())
    assert certificate.at_upper.tolist() == [False, True, False, False]
    starts = search(r, motor, SearchSettings(5), generator())
    for start in starts:
        assert start.final[1] == pytest.approx(1.0, abs=1e-6)
        assert start.cost == pytest.approx(certificate.cost, rel=1e-6)
        assert start.cost >= certificate.cost * (1.0 - 1e-10)


def test_a_fixed_eccentricity_identifies_the_gap() -> None:
    motor = with_piston(PLAIN, gap("p", 20.0), eccentricity("p", 0.4, fixed=True))
    r = factor(made_samples(PLAIN, noise_l_per_min=0.0))
    starts = search(r, motor, SearchSettings(6), generator())
    for start in starts:
        assert start.final[1] == pytest.approx(10.0, rel=1e-8)


def test_search_over_the_samples_reaches_the_same_minimum_in_nine_digits() -> None:
    # The oracle: the thesis's way, residuals of all samples and nothing of this package's factor.
    z = made_samples(FLUSHED, 3000)
    starts = search(factor(z), FLUSHED, SearchSettings(4), generator())
    ring, piston, sleeve = true_coefficients(FLUSHED)[:3] / [8**3, 10**3 * 1.24, 12**3 * 1.135]

    def residual(x: Array) -> Array:
        h_o, h_p, e_p, h_s, e_s, c_f = x
        flow = (
            ring * h_o**3 * z[:, 0]
            + piston * h_p**3 * (1 + 1.5 * e_p**2) * z[:, 1]
            + sleeve * h_s**3 * (1 + 1.5 * e_s**2) * z[:, 2]
        )
        error: Array = flow + c_f + z[:, -2] - z[:, -1]
        return error

    for start in starts:
        result = least_squares(
            residual,
            start.initial,
            bounds=([1, 1, 0, 1, 0, 0], [60, 60, 1, 60, 1, 20]),
            method="trf",
            x_scale="jac",
            xtol=1e-12,
            ftol=1e-12,
            gtol=None,
        )
        assert start.cost == pytest.approx(2.0 * result.cost / len(z), rel=1e-9)


def test_a_start_that_runs_out_of_iterations_is_a_row() -> None:
    r = factor(made_samples(PLAIN))
    starts = search(r, PLAIN, SearchSettings(6, maximum_iterations=2), generator())
    assert len(starts) == 6
    limited = [start for start in starts if start.status == "iteration_limit"]
    assert len(limited) >= 5
    for start in limited:
        assert start.iterations == 2
        assert start.reason
        assert math.isfinite(start.cost)
    # The configured point is the truth and is there at once; the others were on their way.
    assert at_minimum(starts, minimum_of(PLAIN, r)).tolist() == [True, *[False] * 5]


def test_a_start_that_fails_is_a_row_with_its_reason() -> None:
    # The certificate refuses such a factor; the search by itself must not fall over it.
    r = factor(made_samples(PLAIN))
    r[0, -1] = np.inf
    starts = search(r, PLAIN, SearchSettings(3), generator())
    assert [start.number for start in starts] == [0, 1, 2]
    for start in starts:
        assert start.status == "failed"
        assert "not finite" in start.reason
        assert math.isnan(start.cost)
        np.testing.assert_array_equal(start.initial, start.final)
    assert not at_minimum(starts, 1.0).any()


def test_same_seed_same_starts_to_the_bit() -> None:
    r = factor(made_samples(FLUSHED))
    first, second = (
        search(r, FLUSHED, SearchSettings(5), np.random.default_rng(3)) for _ in range(2)
    )
    for one, other in zip(first, second, strict=True):
        assert one.final.tobytes() == other.final.tobytes()
        assert (one.cost, one.status, one.iterations) == (
            other.cost,
            other.status,
            other.iterations,
        )


def test_cost_of_a_start_is_the_criterion_at_its_end() -> None:
    r = factor(made_samples(FLUSHED))
    starts = search(r, FLUSHED, SearchSettings(3), generator())
    for start, theta in zip(starts, coefficients_at_the_end(FLUSHED, starts), strict=True):
        assert start.cost == criterion(r, theta)


@pytest.mark.parametrize("wanted", [0, 10])
def test_nothing_to_search_gives_no_starts(wanted: int) -> None:
    motor = with_piston(PLAIN, gap("p", 10.0), eccentricity("p", 0.4))
    if wanted:
        only = replace(balance_piston(), gap=gap("p", 10.0, fixed=True), eccentricity=None)
        motor = Motor("fixed", (only,), placeholder_oil())
    r = factor(made_samples(motor))
    assert search(r, motor, SearchSettings(wanted), generator()) == ()


def test_bounds_that_are_equal_fix_a_parameter() -> None:
    pinned = with_piston(PLAIN, gap("p", 10.0), Parameter("e_p", "1", 0.4, 0.4, 0.4))
    fixed = with_piston(PLAIN, gap("p", 10.0), eccentricity("p", 0.4, fixed=True))
    r = factor(made_samples(PLAIN))
    for one, other in zip(
        search(r, pinned, SearchSettings(3), generator()),
        search(r, fixed, SearchSettings(3), generator()),
        strict=True,
    ):
        assert one.status != "failed"
        np.testing.assert_array_equal(one.final, other.final)


@pytest.mark.parametrize("pressure_bar", [(180.0, 180.0), (0.0, 0.0)])
@MOTORS
def test_dependent_columns_stop_no_start(motor: Motor, pressure_bar: tuple[float, float]) -> None:
    conditions = made_conditions(500, pressure_bar=pressure_bar)
    r = factor(made_samples(motor, conditions=conditions))
    starts = search(r, motor, SearchSettings(5), generator())
    assert at_minimum(starts, minimum_of(motor, r)).all()


@settings(deadline=None, max_examples=15)
@given(flow=st.sampled_from([0.0, -1.0, 1e-6, 1e4]), seed=SEEDS)
def test_flows_that_no_gap_explains_stop_no_start(flow: float, seed: int) -> None:
    z = made_samples(FLUSHED, 200, seed)
    z[:, -1] = flow
    r = factor(z)
    starts = search(r, FLUSHED, SearchSettings(2), np.random.default_rng(seed))
    minimum = minimum_of(FLUSHED, r)
    assert at_minimum(starts, minimum).all()
    assert all(start.cost >= minimum * (1.0 - 1e-10) for start in starts)


@pytest.mark.parametrize(
    ("cost", "reached"), [(1.0, True), (1.00009, True), (1.00011, False), (math.nan, False)]
)
def test_at_the_minimum_means_within_a_ten_thousandth(cost: float, reached: bool) -> None:
    nowhere = np.empty(0)
    start = Start(0, "step_tolerance", "", cost, 1, nowhere, nowhere)
    assert at_minimum([start], 1.0).tolist() == [reached]
    assert at_minimum([], 1.0).shape == (0,)
