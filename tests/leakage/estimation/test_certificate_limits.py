"""The certificate where columns depend on one another, and what it refuses."""

from __future__ import annotations

import math

import numpy as np
import pytest

from leakage.errors import EstimationError
from leakage.estimation.block_statistics import Array, factor
from leakage.estimation.certificate import certify
from tests.leakage.estimation.box_problems import LOWER, MOTOR, UPPER, column_norms
from tests.leakage.made_samples import made_conditions, made_samples, true_coefficients
from tests.leakage.placeholders import placeholder_motor


def constant_pressure(n: int = 2000) -> Array:
    """180 bar throughout: the three gaps' columns are multiples of one another."""
    conditions = made_conditions(n, pressure_bar=(180.0, 180.0))
    return made_samples(placeholder_motor(), conditions=conditions)


def test_constant_pressure_has_the_solution_of_least_norm() -> None:
    z = constant_pressure()
    lower, upper = placeholder_motor().coefficient_bounds()
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


@pytest.mark.parametrize(
    ("n", "upper", "words"),
    [
        (0, UPPER, "0 samples are too few for 4 free"),
        (3, UPPER, "3 samples are too few for 4 free"),
        (0, LOWER, "0 samples are too few for 0 free"),
    ],
)
def test_fewer_samples_than_free_coefficients_are_refused(n: int, upper: Array, words: str) -> None:
    with pytest.raises(EstimationError, match=words) as caught:
        certify(factor(made_samples(MOTOR, n)), LOWER, upper)
    assert caught.value.code == "too_few_samples"
    certify(factor(made_samples(MOTOR, 4)), LOWER, upper)


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_factor_that_is_not_finite_is_refused(value: float) -> None:
    r = factor(made_samples(MOTOR, 50))
    r[1, 2] = value
    with pytest.raises(EstimationError, match="not finite") as caught:
        certify(r, LOWER, UPPER)
    assert caught.value.code == "not_finite"
