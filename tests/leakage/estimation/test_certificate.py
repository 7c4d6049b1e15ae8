"""The certificate: the global minimum over a box, against solvers and proofs of other kinds."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear, minimize

from leakage.estimation.block_statistics import Array, criterion, factor, factors, merge
from leakage.estimation.certificate import Certificate, certify
from tests.leakage.estimation.box_problems import LOWER, MOTOR, UPPER, WIDE, column_norms
from tests.leakage.made_samples import made_conditions, made_samples, true_coefficients

SEEDS = st.integers(0, 10_000)


def unbounded_minimum(z: Array) -> Array:
    """numpy's least squares over the samples, columns scaled."""
    norms = column_norms(z)
    return np.linalg.lstsq(z[:, :-2] / norms, z[:, -1] - z[:, -2], rcond=None)[0] / norms


def minimum_by_enumeration(z: Array, lower: Array, upper: Array) -> float:
    """Least criterion over all 3^p choices of coefficients at bounds: slow and certain."""
    norms = column_norms(z)
    matrix, target = z[:, :-2] / norms, z[:, -1] - z[:, -2]
    low, high = lower * norms, upper * norms
    best = math.inf
    for choice in itertools.product((-1, 0, 1), repeat=len(lower)):
        side = np.array(choice)
        inside = side == 0
        x = np.where(side < 0, low, high)
        rest = target - matrix[:, ~inside] @ x[~inside]
        x[inside] = np.linalg.lstsq(matrix[:, inside], rest, rcond=1e-13)[0]
        slack = 1e-9 * (high - low)
        if ((x >= low - slack) & (x <= high + slack)).all():
            residual = matrix @ np.clip(x, low, high) - target
            best = min(best, float(residual @ residual) / len(z))
    return best


def largest_violation(z: Array, found: Certificate, lower: Array, upper: Array) -> float:
    """Karush-Kuhn-Tucker over the samples, in extended precision, scaled columns."""
    norms = column_norms(z)
    matrix = (z[:, :-2] / norms).astype(np.longdouble)
    target = (z[:, -1] - z[:, -2]).astype(np.longdouble)
    gradient = matrix.T @ (matrix @ (found.coefficients * norms) - target)
    theta = found.coefficients
    may_fall, may_rise = theta > lower, theta < upper
    violation = np.maximum(np.where(may_fall, gradient, 0), np.where(may_rise, -gradient, 0))
    return float(violation.max() / np.linalg.norm(target))


def random_problem(seed: int) -> tuple[Array, Array, Array]:
    """Samples with columns of any size, nearly dependent ones, and a box that often binds."""
    generator = np.random.default_rng(seed)
    p = int(generator.integers(1, 5))
    n = int(generator.integers(p + 1, 60))
    columns = generator.standard_normal((n, p))
    if generator.random() < 0.5:
        columns = columns[:, :1] + 10.0 ** generator.uniform(-6, 0) * columns
    columns = np.column_stack([columns * 10.0 ** generator.uniform(0, 13, p), np.ones(n)])
    size = np.linalg.norm(columns, axis=0)
    known = generator.standard_normal(n)
    flow = columns @ (3.0 * generator.standard_normal(p + 1) / size) + known
    flow += 10.0 ** generator.uniform(-3, 1) * generator.standard_normal(n)
    lower = (generator.standard_normal(p + 1) - 1.0) / size
    width = np.abs(generator.standard_normal(p + 1)) * 10.0 ** generator.uniform(-12, 1) / size
    upper = np.where(generator.random(p + 1) < 0.15, lower, lower + width)
    return np.column_stack([columns, known, flow]), lower, upper


# against other solvers


@given(seed=SEEDS)
def test_equals_numpy_least_squares_where_no_bound_binds(seed: int) -> None:
    z = made_samples(MOTOR, 300, seed)
    found = certify(factor(z), -WIDE, WIDE)
    np.testing.assert_allclose(found.coefficients, unbounded_minimum(z), rtol=1e-9)
    assert not (found.at_lower | found.at_upper | found.fixed).any()
    assert found.off_bounds.sum() == 4
    assert found.rank == found.n_estimated == 4


@given(seed=SEEDS)
def test_equals_the_best_of_all_active_sets(seed: int) -> None:
    z, lower, upper = random_problem(seed)
    found = certify(factor(z), lower, upper)
    expected = minimum_by_enumeration(z, lower, upper)
    assert ((lower <= found.coefficients) & (found.coefficients <= upper)).all()
    assert found.cost == pytest.approx(expected, rel=1e-8)
    assert found.cost == pytest.approx(criterion(factor(z), found.coefficients), rel=1e-14)


@given(seed=SEEDS)
def test_karush_kuhn_tucker_hold_over_the_samples(seed: int) -> None:
    z, lower, upper = random_problem(seed)
    found = certify(factor(z), lower, upper)
    assert found.dual_residual < 1e-12
    assert largest_violation(z, found, lower, upper) < 1e-12


@pytest.mark.parametrize("method", ["trf", "bvls"])
@pytest.mark.parametrize("share", [0.5, 0.9, 1.1, 2.0])
def test_equals_scipy_over_the_samples_with_a_bound_that_binds(method: str, share: float) -> None:
    # An upper bound on K_p below what the data want, or a lower bound above it.
    z = made_samples(MOTOR, 3000)
    lower, upper = LOWER.copy(), UPPER.copy()
    (upper if share < 1 else lower)[1] = share * true_coefficients(MOTOR)[1]
    norms = column_norms(z)
    expected = lsq_linear(
        z[:, :-2] / norms,
        z[:, -1] - z[:, -2],
        (lower * norms, upper * norms),
        method=method,
        tol=1e-14,
    )
    found = certify(factor(z), lower, upper)
    assert found.cost == pytest.approx(2.0 * expected.cost / len(z), rel=1e-9)
    np.testing.assert_allclose(found.coefficients, expected.x / norms, rtol=1e-4)
    assert found.at_upper.tolist() == [False, share < 1, False, False]
    assert found.at_lower.tolist() == [False, share > 1, False, False]
    assert found.off_bounds.sum() == found.n_estimated == 3
    assert found.rank == 4


def test_no_other_point_of_the_box_is_lower() -> None:
    z, lower, upper = made_samples(MOTOR, 500), LOWER, UPPER.copy()
    upper[2] = 0.7 * true_coefficients(MOTOR)[2]
    r = factor(z)
    found = certify(r, lower, upper)
    generator = np.random.default_rng(1)
    for _ in range(300):
        step = 10.0 ** generator.uniform(-6, 0) * generator.standard_normal(4)
        other = np.clip(found.coefficients * (1.0 + step), lower, upper)
        assert criterion(r, other) >= found.cost * (1.0 - 1e-13)
    # A solver that knows nothing of least squares does not get lower either.
    scale = true_coefficients(MOTOR)
    result = minimize(
        lambda x: criterion(r, x * scale),
        0.5 * (lower + np.minimum(upper, 2.0 * scale)) / scale,
        bounds=list(zip(lower / scale, upper / scale, strict=True)),
        method="L-BFGS-B",
        options={"ftol": 1e-15, "gtol": 1e-12, "maxiter": 5000},
    )
    assert found.cost <= result.fun * (1.0 + 1e-13)
    assert result.fun == pytest.approx(found.cost, rel=1e-3)


@given(seed=SEEDS, shrink=st.floats(0.0, 1.0))
def test_a_smaller_box_never_has_a_lower_minimum(seed: int, shrink: float) -> None:
    z, lower, upper = random_problem(seed)
    r = factor(z)
    inner = lower + shrink * 0.5 * (upper - lower), upper - (1.0 - shrink) * 0.5 * (upper - lower)
    assert certify(r, *inner).cost >= certify(r, lower, upper).cost * (1.0 - 1e-10)


@given(seed=SEEDS, exponent=st.integers(-13, 13))
def test_units_of_a_column_do_not_matter(seed: int, exponent: int) -> None:
    z, lower, upper = random_problem(seed)
    found = certify(factor(z), lower, upper)
    unit = np.ones(z.shape[1])
    unit[0] = 2.0**exponent
    other = certify(factor(z * unit), lower / unit[:-2], upper / unit[:-2])
    assert other.cost == pytest.approx(found.cost, rel=1e-9)
    np.testing.assert_array_equal(other.at_lower, found.at_lower)
    np.testing.assert_array_equal(other.at_upper, found.at_upper)


# the motor


@given(
    gaps_um=st.tuples(st.floats(4.0, 20.0), st.floats(4.0, 20.0), st.floats(4.0, 20.0)),
    flow=st.floats(0.5, 15.0),
)
def test_known_loss_factors_are_recovered_without_noise(
    gaps_um: tuple[float, float, float], flow: float
) -> None:
    truth = true_coefficients(MOTOR) * (np.array([*gaps_um, 1.0]) / [8.0, 10.0, 12.0, 1.0]) ** 3
    truth[3] = flow
    z = made_samples(MOTOR, 400, noise_l_per_min=0.0)
    z[:, -1] = z[:, :4] @ truth + z[:, 4]
    parts = factors(z, np.array([0, 1, 1, 4, 400]))
    found = certify(merge(parts), LOWER, UPPER)
    np.testing.assert_allclose(found.coefficients, truth, rtol=1e-10)
    assert found.cost < 1e-26


def test_fixed_coefficients_keep_their_value_to_the_bit() -> None:
    z = made_samples(MOTOR, 1000)
    lower, upper = LOWER.copy(), UPPER.copy()
    lower[0] = upper[0] = 7.1e-14
    lower[3] = upper[3] = 1.9
    found = certify(factor(z), lower, upper)
    assert found.coefficients[0] == 7.1e-14
    assert found.coefficients[3] == 1.9
    assert found.fixed.tolist() == [True, False, False, True]
    assert not (found.at_lower | found.at_upper).any()
    assert found.off_bounds.sum() == found.rank == len(found.singular_values) == 2
    assert found.n_estimated == 2
    # The rest is the least squares of what the fixed ones leave.
    rest = z[:, -1] - z[:, -2] - z[:, [0, 3]] @ [7.1e-14, 1.9]
    norms = column_norms(z)[1:3]
    expected = np.linalg.lstsq(z[:, 1:3] / norms, rest, rcond=None)[0] / norms
    np.testing.assert_allclose(found.coefficients[1:3], expected, rtol=1e-9)


def test_everything_fixed_is_a_prediction() -> None:
    z = made_samples(MOTOR, 100)
    theta = true_coefficients(MOTOR)
    found = certify(factor(z), theta, theta)
    np.testing.assert_array_equal(found.coefficients, theta)
    assert found.cost == pytest.approx(np.mean((z[:, :4] @ theta + z[:, 4] - z[:, 5]) ** 2))
    assert (found.rank, found.off_bounds.sum(), found.dual_residual) == (0, 0, 0.0)
    assert found.n_estimated == 0
    assert math.isnan(found.condition_number)


@pytest.mark.parametrize("upper_side", [False, True])
@pytest.mark.parametrize("relative_width", [0.5, 1e-4, 1e-6, 1e-9])
def test_a_narrow_box_far_from_zero_binds_and_says_so(
    relative_width: float, upper_side: bool
) -> None:
    # Scaling a bound and back is off by rounding, which is not small beside such a width.
    z = made_samples(MOTOR, 500)
    for index, truth in enumerate(true_coefficients(MOTOR)):
        for share in np.linspace(0.3, 0.6, 20) * (1.0 if upper_side else 5.0):
            lower, upper = LOWER.copy(), UPPER.copy()
            lower[index] = share * truth
            upper[index] = share * truth * (1.0 + relative_width)
            if not upper_side and upper[index] > UPPER[index]:
                continue
            found = certify(factor(z), lower, upper)
            assert found.at_upper[index] == upper_side
            assert found.at_lower[index] != upper_side
            assert found.dual_residual < 1e-12


def test_zero_flow_leaves_every_coefficient_at_its_lower_bound() -> None:
    z = made_samples(MOTOR, 500)
    z[:, -1] = z[:, -2] = 0.0
    found = certify(factor(z), LOWER, UPPER)
    np.testing.assert_array_equal(found.coefficients, LOWER)
    assert found.at_lower.all()
    assert found.off_bounds.sum() == found.n_estimated == 0
    nothing = certify(factor(z), np.zeros(4), UPPER)
    np.testing.assert_array_equal(nothing.coefficients, np.zeros(4))
    assert (nothing.cost, nothing.dual_residual) == (0.0, 0.0)


def test_a_flow_beyond_the_box_leaves_every_coefficient_at_its_upper_bound() -> None:
    z = made_samples(MOTOR, 500)
    z[:, -1] = 1e7
    found = certify(factor(z), LOWER, UPPER)
    np.testing.assert_array_equal(found.coefficients, UPPER)
    assert found.at_upper.all()


# Here SciPy's BVLS stops above the minimum, by up to 0.2 %, on a small change of cost.


# Here SciPy's BVLS stops above the minimum, by up to 0.2 %, on a small change of cost.
@example(seed=617)
@example(seed=761)
@example(seed=1533)
@given(seed=SEEDS)
def test_dependent_columns_in_a_box_still_have_their_minimum(seed: int) -> None:
    z, lower, upper = random_problem(seed)
    z[:, 0] = 2.5 * z[:, -3]  # parallel to the constant flow
    found = certify(factor(z), lower, upper)
    assert found.dual_residual < 1e-12
    assert found.cost == pytest.approx(minimum_by_enumeration(z, lower, upper), rel=1e-8)
    again = certify(factor(z), lower, upper)
    assert found.coefficients.tobytes() == again.coefficients.tobytes()


def test_a_constant_regressor_shares_the_flow_with_the_flushing() -> None:
    # One pressure and one temperature: K_p φ_p and C_f are one constant.
    z = made_samples(MOTOR, 300)[:, [1, 3, 4, 5]]
    z[:, 0] = 2e13
    z[:, 2] = 0.0
    z[:, 3] = 3.0
    found = certify(factor(z), np.array([0.0, 0.0]), np.array([1e-12, 20.0]))
    assert found.rank == 1
    np.testing.assert_allclose(found.coefficients, [1.5 / 2e13, 1.5], rtol=1e-9)
    fixed = certify(factor(z), np.array([0.0, 2.0]), np.array([1e-12, 2.0]))
    np.testing.assert_allclose(fixed.coefficients, [1.0 / 2e13, 2.0], rtol=1e-9)
    assert fixed.rank == 1


def test_a_motor_at_rest_excites_nothing() -> None:
    z = made_samples(MOTOR, conditions=made_conditions(200, pressure_bar=(0.0, 0.0)))
    found = certify(factor(z), LOWER, UPPER)
    assert found.rank == 1
    assert found.coefficients[3] == pytest.approx(z[:, -1].mean(), rel=1e-12)
    np.testing.assert_array_equal(found.coefficients[:3], LOWER[:3])
    assert math.isinf(found.condition_number)


def test_singular_values_are_those_of_scaled_columns() -> None:
    z = made_samples(MOTOR, 1000)
    found = certify(factor(z), LOWER, UPPER)
    scaled = z[:, :4] / column_norms(z)
    expected = np.linalg.svd(scaled, compute_uv=False)
    np.testing.assert_allclose(found.singular_values, expected, rtol=1e-10)
    assert found.condition_number == pytest.approx(expected[0] / expected[-1], rel=1e-10)
