"""First-order autoregressions on uneven nights, against their covariance written out."""

from __future__ import annotations

import numpy as np
import pytest

from leakage.course.slope import (
    correlation_to_previous,
    estimated_phi,
    variance_of_mean,
    whitened,
)
from tests.leakage.estimation.made_errors import autoregression

UNEVEN = np.array([0, 1, 2, 5, 6, 20, 21, 23])


@pytest.mark.parametrize("phi", [0.0, 0.4, 0.95])
def test_whitening_and_the_variance_of_a_mean_are_those_of_the_covariance(phi: float) -> None:
    whole = phi ** np.abs(np.subtract.outer(UNEVEN, UNEVEN))
    transform = whitened(np.eye(len(UNEVEN)), correlation_to_previous(phi, UNEVEN))
    assert transform @ whole @ transform.T == pytest.approx(np.eye(len(UNEVEN)))
    assert variance_of_mean(phi, UNEVEN) == pytest.approx(whole.mean())


@pytest.mark.parametrize(("n", "phi"), [(30, 0.0), (30, 0.4), (60, 0.6), (200, 0.8)])
def test_phi_is_found_without_the_bias_of_a_fitted_line(n: int, phi: float) -> None:
    """The uncorrected estimate falls short by (2 + 4 φ) / n: 0.12 for n = 30, φ = 0.4."""
    generator = np.random.default_rng(n)
    nights = np.arange(n)
    found = []
    for _ in range(400):
        values = autoregression(phi, n, generator)
        residual = values - np.polyval(np.polyfit(nights, values, 1), nights)
        found.append(estimated_phi(residual, nights))
    # Clipped at 0, which lifts the mean of small ones.
    assert np.mean(found) == pytest.approx(phi, abs=0.04 if phi else 0.1)


def test_phi_is_one_nights_where_the_motor_runs_every_second() -> None:
    generator = np.random.default_rng(3)
    nights = 2 * np.arange(600)
    found = [estimated_phi(autoregression(0.6, 1200, generator)[::2], nights) for _ in range(20)]
    assert np.mean(found) == pytest.approx(0.6, abs=0.03)


def test_series_that_say_nothing_of_their_memory_have_none() -> None:
    assert estimated_phi(np.zeros(50), np.arange(50)) == 0.0
    assert estimated_phi(np.ones(5), np.arange(5)) == 0.0
    assert estimated_phi(np.empty(0), np.empty(0, dtype=np.int64)) == 0.0
    # Every distance between nights but once: no pairs to compare.
    triangular = np.cumsum(np.arange(1, 30))
    assert estimated_phi(np.random.default_rng(1).normal(size=29), triangular) == 0.0


def test_phi_stays_below_one() -> None:
    slow = np.cumsum(np.random.default_rng(5).standard_normal(400))
    assert 0.9 < estimated_phi(slow - slow.mean(), np.arange(400)) <= 0.95
