"""The certificate where columns depend on one another, and what it refuses."""

from __future__ import annotations

import math

import numpy as np
import pytest

from leakage.errors import EstimationError
from leakage.estimation.block_statistics import Array, factor, factors, merge
from leakage.estimation.certificate import certify
from leakage.estimation.multi_start import Parametrisation
from tests.leakage.estimation.box_problems import LOWER, MOTOR, UPPER, WIDE, column_norms
from tests.leakage.made_samples import made_conditions, made_samples, true_coefficients
from tests.leakage.placeholders import placeholder_motor


def constant_pressure(n: int = 2000) -> Array:
    """180 bar throughout: the three gaps' columns are multiples of one another."""
    conditions = made_conditions(n, pressure_bar=(180.0, 180.0))
    return made_samples(placeholder_motor(), conditions=conditions)


# dependent columns


def test_constant_pressure_has_the_solution_of_least_norm() -> None:
    z = constant_pressure()
    lower, upper = Parametrisation.of(placeholder_motor()).coefficient_bounds()
    found = certify(factor(z), lower, upper)
    # Three gaps off their bounds, and one figure that the samples determine.
    assert found.off_bounds.sum() == 3
    assert found.rank == found.n_estimated == 1
    assert found.condition_number > 1e11
    # By hand: parallel columns carry equal shares, of the one factor that fits the sum.
    flow = z[:, -1] - z[:, -2]
    norms = column_norms(z)[:3]
    direction = z[:, 0] / norms[0]
    np.testing.assert_allclose(found.coefficients[:3] * norms, direction @ flow / 3.0, rtol=1e-9)
    assert found.coefficients[3] == 0.0
    # What is known is the leakage, not its split.
    truth = true_coefficients(placeholder_motor())
    np.testing.assert_allclose(
        (z[:, :4] @ found.coefficients).mean(), (z[:, :4] @ truth).mean(), rtol=2e-3
    )
    assert found.dual_residual < 1e-12


def test_constant_pressure_is_deterministic_and_forgets_the_blocks() -> None:
    z = constant_pressure()
    lower, upper = Parametrisation.of(placeholder_motor()).coefficient_bounds()
    whole = certify(factor(z), lower, upper)
    assert whole.coefficients.tobytes() == certify(factor(z), lower, upper).coefficients.tobytes()
    for step in (1, 7, 500):
        borders = np.append(np.arange(0, len(z), step), len(z))
        blocks = certify(merge(factors(z, borders)), lower, upper)
        np.testing.assert_allclose(blocks.coefficients, whole.coefficients, rtol=1e-9)
        assert blocks.rank == 1


# what is refused


@pytest.mark.parametrize("n", [0, 1, 3])
def test_fewer_samples_than_free_coefficients_are_refused(n: int) -> None:
    with pytest.raises(EstimationError, match=f"{n} samples are too few for 4 free") as caught:
        certify(factor(made_samples(MOTOR, n)), LOWER, UPPER)
    assert caught.value.code == "too_few_samples"


def test_as_many_samples_as_free_coefficients_are_met_exactly() -> None:
    found = certify(factor(made_samples(MOTOR, 4)), -WIDE, WIDE)
    assert found.cost < 1e-20
    only_two = certify(factor(made_samples(MOTOR, 2)), *(np.array([0, 0, 1, 1.0]),) * 2)
    assert only_two.fixed.all()


def test_no_samples_are_refused_even_with_nothing_free() -> None:
    with pytest.raises(EstimationError, match="0 samples"):
        certify(np.zeros((6, 6)), LOWER, LOWER)


@pytest.mark.parametrize(
    ("lower", "upper"),
    [
        ([1.0, 0, 0, 0], [0.5, 1, 1, 1]),
        ([math.nan, 0, 0, 0], [1.0, 1, 1, 1]),
        ([0.0, 0, 0, 0], [1.0, 1, 1, math.nan]),
        ([0.0, 0, 0, 0], [1.0, 1, 1, math.inf]),
        ([-math.inf, 0, 0, 0], [1.0, 1, 1, 1]),
        ([0.0, 0, 0], [1.0, 1, 1]),
        ([0.0], [1.0, 1, 1, 1]),
        ([[0.0, 0, 0, 0]], [[1.0, 1, 1, 1]]),
    ],
)
def test_nonsense_bounds_are_refused(lower: list[float], upper: list[float]) -> None:
    with pytest.raises(EstimationError, match="bounds must be") as caught:
        certify(factor(made_samples(MOTOR, 50)), np.array(lower), np.array(upper))
    assert caught.value.code == "bounds"


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_factor_that_is_not_finite_is_refused(value: float) -> None:
    r = factor(made_samples(MOTOR, 50))
    r[1, 2] = value
    with pytest.raises(EstimationError, match="not finite") as caught:
        certify(r, LOWER, UPPER)
    assert caught.value.code == "not_finite"


def test_arguments_stay_as_they_are() -> None:
    r, lower, upper = factor(made_samples(MOTOR, 50)), LOWER.copy(), UPPER.copy()
    before = r.copy()
    certify(r, lower, upper)
    np.testing.assert_array_equal(r, before)
    np.testing.assert_array_equal(lower, LOWER)
    np.testing.assert_array_equal(upper, UPPER)
