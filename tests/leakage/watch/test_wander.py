"""What a motor does from night to night, from nights whose shifts are known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import null_space

from leakage.watch.wander import (
    PHI,
    SHARE,
    USUAL_MEMORY,
    Wander,
    WanderPrior,
    effective,
    estimate_wander,
)
from tests.leakage.watch.made_machine import autoregression

Array = NDArray[np.float64]

ALL_PATHS = np.array([0.7, 0.3])


def precise_nights(shifts: Array, weight: float = 1e9) -> tuple[Array, Array]:
    """Information and scores of nights that tell their paths' shifts, shape (n, p), exactly."""
    n, p = shifts.shape
    return np.tile(weight * np.eye(p), (n, 1, 1)), weight * shifts


def one_path(
    shifts: Array, days: NDArray[np.int64] | None = None, prior: WanderPrior | None = None
) -> Wander:
    """Wander of a machine of one path, of which nothing else is known."""
    when = np.arange(len(shifts)) if days is None else days
    information, score = precise_nights(shifts[:, None])
    wide = np.array([[1e-9]])
    prior = prior or WanderPrior()
    return estimate_wander(information, score, when, np.ones(1), wide, prior)


def test_a_night_with_its_own_shift_says_what_its_blocks_say_with_it_in_their_errors() -> None:
    generator = np.random.default_rng(1)
    design, residuals = generator.normal(size=(9, 4)), generator.normal(size=9)
    spread = np.array([[2.0, 0.5], [0.5, 1.0]])
    (told,) = effective((design.T @ design)[None], (design.T @ residuals)[None], spread)
    precise = np.linalg.inv(np.eye(9) + design[:, :2] @ spread @ design[:, :2].T)
    assert told[:, :-1] == pytest.approx(design.T @ precise @ design, rel=1e-8)
    assert told[:, -1] == pytest.approx(design.T @ precise @ residuals, rel=1e-8)


def test_spread_and_memory_are_found_again() -> None:
    n, phi = 600, 0.6
    spread = 1e-4 * np.array([[1.5, 0.6], [0.6, 0.8]])
    series = np.column_stack([autoregression(n, phi, np.random.default_rng(k)) for k in (1, 2)])
    shifts = series @ np.linalg.cholesky(spread).T
    # Blocks tell each night's paths well, and a third unknown, which does not wander.
    generator = np.random.default_rng(3)
    information = np.empty((n, 3, 3))
    score = np.empty((n, 3))
    for night in range(n):
        design = generator.normal(size=(6, 3)) / 0.001
        told = np.array([*(np.array([0.02, -0.01]) + shifts[night]), 0.05])
        information[night] = design.T @ design
        score[night] = design.T @ (design @ told + generator.standard_normal(6))
    days = np.arange(n)
    wander = estimate_wander(
        information, score, days, ALL_PATHS, np.diag([1.0, 1.0, 1.0]), WanderPrior()
    )
    assert wander.spread == pytest.approx(spread, rel=0.25)
    assert wander.serial == pytest.approx(phi, abs=0.08)


def correlations(memory: Array, days: Array | NDArray[np.int64]) -> Array:
    """Of nights' shifts: a share of the variance remembers, what is left does not."""
    apart = np.abs(np.subtract.outer(days, days)).astype(float)
    alike = SHARE[:, None, None] * PHI[:, None, None] ** apart
    alike += (1.0 - SHARE)[:, None, None] * np.eye(len(days))
    return np.asarray(np.einsum("g,gij->ij", memory, alike))


def test_spread_of_few_nights_is_by_hand() -> None:
    """Of precise nights and a line that is estimated too, EM gives Q = (Σ(s − ŝ)² + 6 Q₀)/(n + 4).

    Correlated nights scatter less about their own line: what is not prior is scaled up by that.
    """
    shifts = 0.02 * np.array([0.3, -1.2, 0.8, 1.9, -0.6, -0.1, 1.1, -1.5])
    days, prior = np.arange(8), 0.012**2
    line = np.column_stack([np.ones(8), days])
    left = np.eye(8) - line @ np.linalg.pinv(line)
    wander = one_path(shifts)
    correlated = float(np.trace(left @ correlations(wander.memory, days)))
    assert correlated > 0.4 * 8
    of_nights = (8 + 6) * (shifts @ left @ shifts + 6 * prior) / (8 + 4) - 6 * prior
    wanted = (6 / correlated * of_nights + 6 * prior) / (8 + 6)
    assert wander.spread.item() == pytest.approx(wanted, rel=0.03)


def test_slow_wear_is_no_wander() -> None:
    shifts = 0.01 * np.random.default_rng(5).standard_normal(30)
    still, worn = (one_path(shifts + rise * np.arange(30)) for rise in (0.0, 0.004))
    assert worn.spread.item() == pytest.approx(still.spread.item(), rel=0.1)
    assert worn.serial == pytest.approx(still.serial, abs=0.02)


def test_only_what_moves_all_paths_remembers_for_long() -> None:
    """The part of Q that is common to two paths by halves; a difference between them has none."""
    spread, common = np.diag([1.0, 1.0]), np.full((2, 2), 0.5)
    wander = Wander(spread, USUAL_MEMORY, common)
    long = wander.long_inflation
    assert long > 4.0
    both, apart = np.array([1.0, 1.0]), np.array([1.0, -1.0])
    assert both @ wander.long_spread @ both == pytest.approx(long * 2.0)
    assert apart @ wander.long_spread @ apart == pytest.approx(4.0 * 2.0)


def test_long_changes_are_judged_by_fewer_degrees_of_freedom() -> None:
    """n (1 − φ²)/(1 + φ²) nights, or 1.2 n over the inflation of a stretch's mean, and 6."""
    memory = np.where((PHI == 0.6) & (SHARE == 1.0), 1.0, 0.0)
    wander = Wander(np.eye(1), memory, np.eye(1))
    inflation = 1.0 + 2.0 * sum((1 - lag / 20) * 0.6**lag for lag in range(1, 20))
    found = wander.degrees_of_freedom(100, np.array([1.0, 20.0]))
    assert found == pytest.approx([100 * 0.64 / 1.36 + 6, 120 / inflation + 6])


@pytest.mark.parametrize("is_even", [True, False])
def test_memory_is_by_the_likelihood_of_what_a_line_leaves(is_even: bool) -> None:
    """Contrasts free of level and slope are Gaussian; their scale is profiled out."""
    days = np.arange(12) if is_even else np.array([0, 1, 3, 6, 7, 8, 12, 13, 14, 25, 26, 40])
    shifts = 0.01 * np.sin(days / 2.0) + 0.004 * np.cos(3 * days)
    free = null_space(np.column_stack([np.ones(12), days]).T)
    log_likelihood = []
    for memory in np.eye(len(PHI)):
        covariance = free.T @ correlations(memory, days) @ free
        left = free.T @ shifts
        squares = left @ np.linalg.solve(covariance, left)
        log_likelihood.append(-0.5 * np.linalg.slogdet(covariance)[1] - 5 * np.log(squares))
    wanted = USUAL_MEMORY * np.exp(np.array(log_likelihood))
    assert one_path(shifts, days).memory == pytest.approx(wanted / wanted.sum(), rel=1e-3)


def test_what_forgets_does_not_hide_a_long_memory() -> None:
    """The mean of forty nights varies by as much as half of them remembering makes it."""
    generator = np.random.default_rng(8)
    shifts = 0.01 * autoregression(500, 0.9, generator) + 0.01 * generator.standard_normal(500)
    wanted = 40 * (0.5 * 0.9 ** np.abs(np.subtract.outer(np.arange(40), np.arange(40)))).mean()
    found = one_path(shifts).inflation(np.array([40.0])).item()
    assert found == pytest.approx(wanted + 0.5, rel=0.25)


def test_mean_of_correlated_nights_varies_by_more() -> None:
    wander = Wander(np.eye(1), USUAL_MEMORY, np.eye(1))
    for n in (1, 2, 7, 40):
        wanted = n * correlations(USUAL_MEMORY, np.arange(n)).mean()
        assert wander.inflation(np.array([float(n)])).item() == pytest.approx(wanted)
    assert wander.inflation(np.array([1e6])).item() == pytest.approx(
        wander.long_inflation, rel=1e-3
    )
