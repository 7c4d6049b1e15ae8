"""A baseline at another duty: weights against other solvers, and rises that are none."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import logsumexp

from leakage.course.balanced_baseline import RIDGE, DutyBlocks, Rises, balance, compare, told_rises
from leakage.estimation.block_statistics import factors

Array = NDArray[np.float64]

BOUNDS = np.zeros(2), np.array([10.0, 0.0])


def blocks(
    nights: int, low: float, high: float, *, bend: float = 0.0, wear: float = 1.0, seed: int = 1
) -> DutyBlocks:
    """Nights of 30 blocks whose flow bends with pressure, which the model (K P) does not know."""
    generator = np.random.default_rng(seed)
    n, size = 30 * nights, 20
    level = generator.uniform(low, high, n)
    pressure = level[:, None] + generator.uniform(-5.0, 5.0, (n, size))
    flow = wear * pressure * (1.0 + bend * pressure)
    flow += generator.standard_normal((n, size))
    one = np.ones(n * size)
    z = np.column_stack([pressure.ravel(), one, 0.0 * one, flow.ravel()])
    channels = (generator.uniform(45.0, 55.0, n), pressure.mean(axis=1), np.full(n, 40.0))
    return DutyBlocks(
        factors(z, np.arange(0, n * size + 1, size)),
        np.column_stack(channels),
        np.repeat(np.arange(nights), 30),
    )


def test_weights_are_those_of_a_general_solver_on_the_dual() -> None:
    generator = np.random.default_rng(3)
    features = generator.standard_normal((200, 4)) @ generator.uniform(0.2, 2.0, (4, 4))
    samples = generator.uniform(50.0, 150.0, 200)
    n = samples / samples.sum()
    target = n @ features + 0.4 * features.std(axis=0)
    sd = np.sqrt(n @ (features - n @ features) ** 2)
    scaled = (features - target) / sd

    def dual(slope: Array) -> float:
        return float(logsumexp(scaled @ slope, b=n) + RIDGE / 2.0 * slope @ slope)

    slope = minimize(dual, np.zeros(4), method="BFGS", options={"gtol": 1e-9}).x
    weights = n * np.exp(scaled @ slope)
    found = balance(features, samples, target)
    np.testing.assert_allclose(found.weights, weights / weights.sum(), rtol=1e-4)
    # At the minimum the gradient is 0: what is left of a mean is the ridge's.
    assert found.imbalance == pytest.approx(RIDGE * np.abs(slope).max(), rel=1e-4)


def test_a_normal_feature_is_tilted_as_theory_says() -> None:
    # exp(λ x) moves a standard normal by λ, and leaves exp(−λ²) of its blocks.
    x = np.random.default_rng(4).standard_normal(200_000)
    found = balance(x[:, None], np.ones(len(x)), np.array([0.5]))
    assert found.weights @ x == pytest.approx(0.5, abs=0.01)
    assert found.effective / len(x) == pytest.approx(np.exp(-0.25), abs=0.02)


def test_the_same_conditions_keep_equal_weights() -> None:
    features = np.random.default_rng(5).standard_normal((50, 3))
    found = balance(features, np.ones(50), features.mean(axis=0))
    assert found.effective == pytest.approx(50.0)


def test_a_wrong_model_rises_with_duty_and_not_against_the_balanced_baseline() -> None:
    before, now = blocks(15, 10.0, 300.0, bend=0.002), blocks(1, 10.0, 150.0, bend=0.002, seed=2)
    found = compare(before, now, *BOUNDS)
    same = compare(before, blocks(1, 10.0, 300.0, bend=0.002, seed=3), *BOUNDS)
    assert found is not None
    assert same is not None
    # K itself is that of the mean bend, which has fallen with the load.
    assert found.now[0] / same.now[0] < 0.9
    assert found.now[0] / found.then[0] == pytest.approx(1.0, abs=0.02)
    assert found.log_ratio == pytest.approx(0.0, abs=0.01)
    assert 0.0 < found.effective_share < same.effective_share


def test_wear_at_another_duty_is_found() -> None:
    worn = blocks(1, 10.0, 150.0, bend=0.002, wear=1.3, seed=2)
    found = compare(blocks(15, 10.0, 300.0, bend=0.002), worn, *BOUNDS)
    assert found is not None
    assert found.now[0] / found.then[0] == pytest.approx(1.3, abs=0.03)
    assert np.exp(found.log_ratio) == pytest.approx(1.3, abs=0.01)


def test_the_error_is_that_of_baselines_drawn_anew() -> None:
    now = blocks(1, 10.0, 150.0, seed=2)
    found = [compare(blocks(15, 10.0, 300.0, seed=seed), now, *BOUNDS) for seed in range(40)]
    then = [one.then[0] for one in found if one is not None]
    errors = [np.linalg.norm(one.root[:, 0]) for one in found if one is not None]
    assert len(then) == 40
    assert np.mean(errors) == pytest.approx(np.std(then, ddof=1), rel=0.35)


@pytest.mark.parametrize(("low", "high"), [(350.0, 400.0), (240.0, 299.0)])
def test_a_duty_that_the_baseline_has_not_seen_is_not_compared(low: float, high: float) -> None:
    before = blocks(15, 10.0, 200.0)
    if low < 300.0:
        before = blocks(2, 10.0, 300.0)
    assert compare(before, blocks(1, low, high, seed=2), *BOUNDS) is None


def rises(rise: float, error: float, flow: float, share: float, n: int = 10) -> Array:
    made = (rise, error, 0.4, flow, share)
    return told_rises(Rises(*(np.full(n, one) for one in made)), 15)


def test_a_rise_is_told_once_it_is_certain() -> None:
    # 1 + 15/10 nights: 2.5 · 1.58 · 0.03 = 0.12, so 0.2 is 0.08 above.
    assert rises(0.2, 0.03, 0.1, 0.8)[-1] == pytest.approx(0.2)
    # After one night alone the error is 2.5 · 4 · 0.03 = 0.3.
    assert not rises(0.2, 0.03, 0.1, 0.8)[0] > 0.0
    assert np.isnan(rises(0.15, 0.04, 0.1, 0.8)[-1])
    assert rises(0.04, 0.01, 0.1, 0.8)[-1] == 0.0
    assert rises(-0.1, 0.01, 0.1, 0.8)[-1] == pytest.approx(-0.1)


def test_few_blocks_ask_for_a_flow_that_closes() -> None:
    # A rise of 50 % of 40 % of the flow means 20 % of it.
    assert rises(0.5, 0.03, 0.11, 0.3)[-1] == pytest.approx(0.5)
    assert np.isnan(rises(0.5, 0.03, 0.09, 0.3)[-1])
    assert rises(0.5, 0.03, 0.09, 0.6)[-1] == pytest.approx(0.5)


def test_nights_without_a_figure_are_passed_over() -> None:
    rise = np.array([0.3, np.nan, 0.3])
    full = np.full(3, 0.5)
    found = told_rises(Rises(rise, 0.01 * full, full, full, full), 15)
    assert np.isnan(found[1])
    assert found[2] == pytest.approx(0.3)
