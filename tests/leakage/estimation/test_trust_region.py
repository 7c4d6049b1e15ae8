"""The search from many points at once: against SciPy's, one point at a time."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

from leakage.estimation.trust_region import (
    FAILED,
    FUNCTION,
    FUNCTION_AND_STEP,
    GRADIENT,
    ITERATION_LIMIT,
    STEP,
    Tolerances,
    minimise,
)

Array = NDArray[np.float64]
STOP = Tolerances(step=1e-10, function=1e-10, gradient=1e-15, evaluations=200)
ENDED = {GRADIENT, FUNCTION, STEP, FUNCTION_AND_STEP}


class Gaps:
    """A linear problem in h³ and h³(1 + 1.5e²): ridges, and bounds that bind or not."""

    lower = np.array([0.1, 0.1, 0.0, 0.1, 0.0])
    upper = np.array([3.0, 3.0, 1.0, 3.0, 1.0])

    def __init__(self, seed: int) -> None:
        generator = np.random.default_rng(seed)
        self.a = generator.normal(size=(6, 3)) * 10.0 ** generator.uniform(-2, 2, 3)
        self.b = self.a @ generator.uniform(0.5, 3.0, 3) + 3.0 * generator.normal(size=6)
        share = generator.random((8, 5))
        self.starts = self.lower + (self.upper - self.lower) * share

    def residual(self, x: Array) -> Array:
        products = (
            x[:, 0] ** 3,
            x[:, 1] ** 3 * (1 + 1.5 * x[:, 2] ** 2),
            x[:, 3] ** 3 * (1 + 1.5 * x[:, 4] ** 2),
        )
        flow: Array = np.stack(products, axis=1) @ self.a.T - self.b
        return flow

    def jacobian(self, x: Array) -> Array:
        slope = np.zeros((len(x), 3, 5))
        slope[:, 0, 0] = 3 * x[:, 0] ** 2
        for row, (h, e) in enumerate(((1, 2), (3, 4)), start=1):
            slope[:, row, h] = 3 * x[:, h] ** 2 * (1 + 1.5 * x[:, e] ** 2)
            slope[:, row, e] = 3 * x[:, h] ** 3 * x[:, e]
        product: Array = self.a @ slope
        return product


@pytest.mark.parametrize("seed", range(40))
def test_it_ends_as_low_as_scipy_from_every_point(seed: int) -> None:
    problem = Gaps(seed)
    ends = minimise(
        problem.residual, problem.jacobian, problem.starts, problem.lower, problem.upper, STOP
    )
    ours = np.sum(problem.residual(ends.x) ** 2, axis=1)
    for point, cost in zip(problem.starts, ours, strict=True):
        scipy = least_squares(
            lambda x: problem.residual(x[None])[0],
            point,
            jac=lambda x: problem.jacobian(x[None])[0],
            bounds=(problem.lower, problem.upper),
            x_scale="jac",
            xtol=1e-10,
            ftol=1e-10,
            gtol=1e-15,
            max_nfev=200,
        )
        assert cost <= 2 * scipy.cost * (1 + 1e-4) + 1e-12
    assert set(ends.status.tolist()) <= ENDED
    assert ((ends.x >= problem.lower) & (ends.x <= problem.upper)).all()


def rosenbrock(x: Array) -> Array:
    return np.stack([10 * (x[:, 1] - x[:, 0] ** 2), 1 - x[:, 0]], axis=1)


def rosenbrock_slope(x: Array) -> Array:
    ones, zeros = np.ones(len(x)), np.zeros(len(x))
    rows = [np.stack([-20 * x[:, 0], 10 * ones], axis=1), np.stack([-ones, zeros], axis=1)]
    return np.stack(rows, axis=1)


def test_a_curved_valley_is_followed_to_its_end() -> None:
    starts = np.array([[-1.2, 1.0], [2.0, -2.0], [0.0, 0.0]])
    box = np.array([-3.0, -3.0]), np.array([3.0, 3.0])
    ends = minimise(rosenbrock, rosenbrock_slope, starts, *box, STOP)
    assert ends.x == pytest.approx(np.ones((3, 2)), abs=1e-6)


def test_a_minimum_outside_is_met_on_the_bound() -> None:
    """Within x ≤ 0.5 the valley's lowest point is (0.5, 0.25)."""
    starts = np.array([[-1.2, 1.0], [0.4, -2.0]])
    box = np.array([-3.0, -3.0]), np.array([0.5, 3.0])
    ends = minimise(rosenbrock, rosenbrock_slope, starts, *box, STOP)
    assert ends.x == pytest.approx(np.array([[0.5, 0.25]] * 2), abs=1e-5)
    assert (ends.x[:, 0] <= 0.5).all()


def test_a_search_alone_is_the_search_among_others() -> None:
    problem = Gaps(3)
    box = problem.lower, problem.upper
    together = minimise(problem.residual, problem.jacobian, problem.starts, *box, STOP)
    for number, point in enumerate(problem.starts):
        alone = minimise(problem.residual, problem.jacobian, point[None], *box, STOP)
        assert alone.x[0] == pytest.approx(together.x[number], rel=1e-6, abs=1e-9)
        assert alone.evaluations[0] == together.evaluations[number]


def test_the_limit_of_evaluations_holds() -> None:
    starts = np.array([[-1.2, 1.0], [1.0, 1.0]])
    box = np.array([-3.0, -3.0]), np.array([3.0, 3.0])
    few = Tolerances(step=1e-10, function=1e-10, gradient=1e-15, evaluations=3)
    ends = minimise(rosenbrock, rosenbrock_slope, starts, *box, few)
    assert ends.status.tolist() == [ITERATION_LIMIT, GRADIENT]
    assert ends.evaluations.tolist() == [3, 1]


def test_a_point_without_finite_residuals_fails_alone() -> None:
    def broken(x: Array) -> Array:
        values = rosenbrock(x)
        values[x[:, 0] < -1.0] = np.nan
        return values

    starts = np.array([[-1.2, 1.0], [0.5, 0.5]])
    box = np.array([-3.0, -3.0]), np.array([3.0, 3.0])
    ends = minimise(broken, rosenbrock_slope, starts, *box, STOP)
    assert ends.status[0] == FAILED
    assert ends.x[0] == pytest.approx(starts[0])
    assert ends.x[1] == pytest.approx([1.0, 1.0], abs=1e-6)


def test_a_step_into_what_is_not_finite_is_taken_back() -> None:
    """√(2 − x) − 0.1 is not finite beyond 2; its zero at 1.99 is close to that edge."""

    def residual(x: Array) -> Array:
        with np.errstate(invalid="ignore"):
            values: Array = np.sqrt(2.0 - x) - 0.1
        return values

    def jacobian(x: Array) -> Array:
        slope: Array = -0.5 / np.sqrt(2.0 - x)
        return slope[:, :, None]

    box = np.array([0.0]), np.array([5.0])
    ends = minimise(residual, jacobian, np.array([[0.1]]), *box, STOP)
    assert ends.x[0, 0] == pytest.approx(1.99, abs=1e-8)


def test_a_start_on_a_bound_moves() -> None:
    box = np.array([-3.0, -3.0]), np.array([3.0, 3.0])
    ends = minimise(rosenbrock, rosenbrock_slope, np.array([[-3.0, 3.0]]), *box, STOP)
    assert ends.x[0] == pytest.approx([1.0, 1.0], abs=1e-6)
