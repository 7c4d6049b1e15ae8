"""Slow errors: the whitening against its covariance written out, and intervals that hold."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from leakage.estimation.block_fit import SampleBlocks, fit_blocks
from leakage.estimation.blocks import factors, merge
from leakage.estimation.identifiability import Excitation, judge_leakage
from leakage.estimation.proven_minimum import certify
from leakage.estimation.slow_errors import SlowErrors, slow_errors, whiten, with_level
from leakage.estimation.uncertainty import cluster_robust
from leakage.physics.conditions import OperatingConditions
from leakage.physics.motor import regressors
from tests.leakage.made_samples import Array, autoregression
from tests.leakage.placeholders import placeholder_motor

PER_BLOCK = 120
# model.md, section 5: the grid of ρ and λ, and what makes up for both being estimates.
MEMORIES = (0.0, 0.5, 0.8, 0.9, 0.95, 0.98, 0.995)
RATIOS = [10.0 ** (0.5 * half) for half in range(-2, 10)]
WIDENING = 1.25
BOUNDS = np.full(3, 1e9)
FREE = np.zeros(3, dtype=bool)
THETA = np.array([2.0, 3.0, 0.5])
# Columns of which a slow error is a multiple: the ones, or the leakage that is estimated.
ONES = np.array([0.0, 0.0, 1.0, 0.0, 0.0])
FLOW = np.array([2.0, 3.0, 0.0, 0.0, 0.0]) / 2.0
ADDS = SlowErrors(0.9, 10.0, 3.0, 99.0, scales=False, direction=ONES)
SCALES = SlowErrors(0.9, 10.0, 3.0, 99.0, scales=True, direction=FLOW)


def made_night(blocks: int, error: Array, seed: int = 0, hold: int = 300) -> Array:
    """Columns (two paths, one, known, measured): a load in steps, θ = (2, 3, 0.5)."""
    generator = np.random.default_rng(seed)
    n = blocks * PER_BLOCK
    load = np.repeat(generator.uniform(0.1, 1.0, n // hold + 1), hold)[:n]
    load = load + 0.01 * generator.standard_normal(n)
    paths = np.column_stack([load, load * np.exp(-3 * load)])
    known = 0.1 * load
    measured = paths @ THETA[:2] + THETA[2] + known + error[:n]
    return np.column_stack([paths, np.ones(n), known, measured])


def blocks_of(z: Array) -> Array:
    return factors(z, np.arange(0, len(z) + 1, PER_BLOCK))


def slow(n: int, memory_s: float, generator: np.random.Generator) -> Array:
    """An autoregression of unit variance, one sample a second."""
    return autoregression(math.exp(-1.0 / memory_s), n, generator)


def covariance_of_means(n: Array, number: Array, memory: float, ratio: float) -> Array:
    """Over σ²κ: diag(1/n) + λ/n̄ R, R the powers of ρ by distance on the clock."""
    distance = np.abs(number[:, None] - number)
    powers = np.where(distance == 0, 1.0, memory**distance)
    covariance: Array = np.diag(1.0 / n) + ratio / np.median(n) * powers
    return covariance


def means_by_definition(z: Array, direction: Array) -> tuple[Array, Array, Array]:
    """Squared norm of d, the means Z'd/d'd of each block, and the Gram of what is left beside d."""
    blocks = z.reshape(-1, PER_BLOCK, z.shape[1])
    along = blocks @ direction
    n = np.sum(along**2, axis=1)
    means = np.einsum("bi,bij->bj", along, blocks) / n[:, None]
    rest = blocks - along[:, :, None] * means[:, None]
    return n, means, np.einsum("bij,bik->jk", rest, rest)


@pytest.mark.parametrize("errors", [ADDS, SCALES], ids=["adds", "scales"])
def test_whitened_factors_are_those_of_the_covariance_written_out(errors: SlowErrors) -> None:
    z = made_night(12, np.random.default_rng(1).standard_normal(5000))
    number = np.array([0, 1, 2, 3, 7, 8, 9, 10, 11, 30, 31, 32])
    n, means, rest = means_by_definition(z, errors.direction)
    expected = rest + means.T @ np.linalg.solve(covariance_of_means(n, number, 0.9, 10.0), means)
    made = merge(whiten(blocks_of(z), number, errors))
    scale = len(z) / expected[-3, -3]
    np.testing.assert_allclose(made.T @ made, scale * expected, rtol=1e-9)


def test_the_level_keeps_its_weight_and_what_differs_from_it_is_whitened() -> None:
    z = made_night(12, np.random.default_rng(1).standard_normal(5000))
    number = np.arange(12)
    n, means, rest = means_by_definition(z, FLOW)
    level = n @ means / n.sum()
    apart = means - level
    covariance = covariance_of_means(n, number, 0.9, 10.0)
    expected = (
        rest + apart.T @ np.linalg.solve(covariance, apart) + n.sum() * np.outer(level, level)
    )
    made = with_level(blocks_of(z), number, SCALES)
    np.testing.assert_allclose(made.T @ made, expected, rtol=1e-9)


def test_memory_and_size_maximise_the_restricted_likelihood_written_out() -> None:
    """Harville's (1977): log|V| + log|X'V⁻¹X| + y'Py, on means and on the samples about them."""
    generator = np.random.default_rng(3)
    error = generator.standard_normal(2400) + 2 * slow(2400, 600.0, generator)
    z = made_night(20, 0.02 * error)
    blocks, number = blocks_of(z), np.arange(20)
    found = slow_errors(blocks, number, FREE, np.zeros(3))
    # However small the errors are, as long as they are no rounding.
    small = slow_errors(blocks_of(made_night(20, 1e-6 * error)), number, FREE, np.zeros(3))
    assert small.memory == found.memory > 0.0
    combine = np.eye(5)[:, [0, 1, 2, 4]]
    combine[3, 3] = -1.0
    theta = certify(merge(blocks), -BOUNDS, BOUNDS).coefficients
    expected = np.array([*theta[:2], 0.0, 0.0, 0.0])
    expected /= (z @ expected).mean()
    least = {False: math.inf, True: math.inf}
    sizes, parts = {}, {}
    for scales, direction in ((False, ONES), (True, expected)):
        n, means, rest = means_by_definition(z, direction)
        about = combine.T @ rest @ combine
        size, vectors = np.linalg.eigh(about[:3, :3])
        moving = vectors[:, size > 1e-9 * size.max()]
        fitted = np.linalg.solve(moving.T @ about[:3, :3] @ moving, moving.T @ about[:3, 3])
        left = about[3, 3] - fitted @ moving.T @ about[:3, 3]
        sizes[scales] = left / (len(z) - 20 - moving.shape[1])
        parts[scales] = (n, means @ combine, about)
    # Both are held against the errors about the direction whose scores scatter less.
    scale = found.within * sizes[True]

    def deviance(scales: bool, memory: float, ratio: float) -> float:
        n, means, about = parts[scales]
        covariance = covariance_of_means(n, number, memory, ratio)
        gram = about + means.T @ np.linalg.solve(covariance, means)
        x, y = gram[:3, :3], gram[:3, 3]
        left = gram[3, 3] - y @ np.linalg.solve(x, y)
        weights = np.log(n).sum()
        return float(
            np.linalg.slogdet(covariance)[1] + weights + np.linalg.slogdet(x)[1] + left / scale
        )

    for scales, (n, means, _) in parts.items():
        left = means[:, 3] - means[:, :3] @ theta
        largest = 4.0 * np.average(left**2, weights=n) * np.median(n) / scale
        ratios = [ratio for ratio in RATIOS if ratio <= largest]
        assert 0 < len(ratios) < len(RATIOS)
        least[scales] = min(
            deviance(scales, *point) for point in itertools.product(MEMORIES, ratios)
        )
    assert least[found.scales] == min(least.values())
    best = deviance(found.scales, found.memory, found.variance_ratio)
    assert best == pytest.approx(least[found.scales], abs=1e-6)
    assert found.evidence == pytest.approx(deviance(found.scales, 0.0, 0.0) - best, abs=1e-6)


def test_white_errors_act_as_themselves_and_steady_ones_as_many() -> None:
    generator = np.random.default_rng(4)
    white, steady = [], []
    for seed in range(10):
        for kept, error in (
            (white, generator.standard_normal(5400)),
            (steady, slow(5400, 10.0, generator)),
        ):
            blocks = blocks_of(made_night(45, 0.02 * error, seed))
            kept.append(slow_errors(blocks, np.arange(45), FREE, np.zeros(3)))
    assert np.median([errors.within for errors in white]) < 1.5
    # A first-order autoregression acts as (1 + φ)/(1 − φ) = 20 times its variance.
    assert 10 < np.median([errors.within for errors in steady]) < 25
    assert sum(errors.are_slow for errors in white) <= 2


@pytest.mark.parametrize("scale", [0.0, 1e-12])
def test_without_noise_nothing_is_slow(scale: float) -> None:
    blocks = blocks_of(made_night(20, scale * np.random.default_rng(5).standard_normal(3000)))
    assert not slow_errors(blocks, np.arange(20), FREE, np.zeros(3)).are_slow


def test_too_few_blocks_and_fixed_coefficients_tell_nothing() -> None:
    blocks = blocks_of(made_night(20, np.random.default_rng(6).standard_normal(3000)))
    for n, fixed, tells in ((4, FREE, False), (5, FREE, True), (20, ~FREE, False)):
        found = slow_errors(blocks[:n], np.arange(n), fixed, np.zeros(3))
        assert bool(len(found.direction)) == tells


def test_samples_of_a_block_act_at_least_as_one_in_three() -> None:
    error = slow(45 * PER_BLOCK, 60.0, np.random.default_rng(9))
    blocks = blocks_of(made_night(45, error, hold=60))
    found = slow_errors(blocks, np.arange(45), FREE, np.zeros(3))
    assert found.within == pytest.approx(PER_BLOCK / 3, rel=1e-3)


def test_errors_are_slow_from_an_evidence_of_four_on() -> None:
    for memory, evidence, slow_s in (
        (0.5, 4.0, 120.0 / math.log(2.0)),
        (0.5, 3.99, 0.0),
        (0.0, 9.0, 0.0),
    ):
        found = replace(ADDS, memory=memory, evidence=evidence)
        assert found.are_slow == bool(slow_s)
        assert found.memory_s(120.0) == pytest.approx(slow_s)


def error_of(kind: str, n: int, generator: np.random.Generator) -> Array:
    fast = slow(n, 10.0, generator)
    if kind == "random walk":
        return fast + np.cumsum(generator.standard_normal(n)) * 5 / math.sqrt(n)
    if kind == "5 minutes":
        return fast + 2 * slow(n, 300.0, generator)
    return slow(n, -1.0 / math.log(float(kind)), generator)


NIGHTS = 120


def test_an_error_that_turns_too_seldom_hides_the_level() -> None:
    """T / 2τ stretches, of which a leakage needs two; an error that adds hides none."""
    for memory, hides in ((0.5, False), (0.9, False), (0.95, True), (0.98, True)):
        scaling = replace(SCALES, memory=memory)
        assert scaling.hides_level(np.arange(45)) == hides
        assert not replace(ADDS, memory=memory).hides_level(np.arange(45))
    assert not replace(SCALES, memory=0.98, evidence=3.9).hides_level(np.arange(45))
    # With gaps between them, blocks last longer.
    assert not replace(SCALES, memory=0.95).hides_level(10 * np.arange(45))


@pytest.mark.parametrize(
    ("kind", "least", "plain_at_most"),
    # Least coverage by model.md, section 5; and by how much the plain sandwich falls short.
    [
        ("0.5", 0.94, 1.0),
        pytest.param("0.9", 0.94, 1.0, marks=pytest.mark.full),
        ("0.99", 0.92, 0.92),
        ("random walk", 0.92, 0.86),
        pytest.param("5 minutes", 0.92, 0.86, marks=pytest.mark.full),
    ],
)
def test_intervals_hold_under_slow_errors(kind: str, least: float, plain_at_most: float) -> None:
    generator = np.random.default_rng(7)
    held = {"plain": 0, "whitened": 0}
    for night in range(NIGHTS):
        error = 0.02 * error_of(kind, 45 * PER_BLOCK, generator)
        blocks = blocks_of(made_night(45, error, night))
        number = np.arange(45)
        errors = slow_errors(blocks, number, FREE, np.zeros(3))
        for name, made, widening in (
            ("plain", blocks, 1.0),
            ("whitened", whiten(blocks, number, errors), WIDENING if errors.are_slow else 1.0),
        ):
            theta = certify(merge(made), -BOUNDS, BOUNDS).coefficients
            distribution = cluster_robust(made, theta, ~FREE, widening)
            interval = distribution.interval(np.array([1.0, 0.0, 0.0]))
            held[name] += abs(theta[0] - 2.0) <= interval.half_width
    slack = 3 * math.sqrt(least * (1 - least) / NIGHTS)
    assert held["whitened"] / NIGHTS >= least - slack
    assert held["plain"] / NIGHTS <= plain_at_most


BLOCK = 120
MODEL = placeholder_motor()
REFERENCE = OperatingConditions.from_bar(200.0, 50.0, 30.0)


def drifting_night(generator: np.random.Generator) -> SampleBlocks:
    """90 minutes in steps of load and speed, in which the flow drifts by 8 % against the model."""
    n = 45 * BLOCK
    bar, rpm = (
        np.repeat(generator.uniform(*span, n // 45 + 1), 45)[:n]
        for span in ((20.0, 300.0), (5.0, 45.0))
    )
    celsius = 50.0 + 5.0 * np.sin(np.arange(n) / 1000.0)
    columns = regressors(MODEL, OperatingConditions.from_bar(bar, celsius, rpm))
    theta = [path.configured_coefficient for path in MODEL.column_paths]
    flow = columns @ [*theta, 0.0, 1.0] * np.linspace(0.96, 1.04, n)
    flow += 0.02 * generator.standard_normal(n)
    made = factors(np.column_stack([columns, flow]), np.arange(0, n + 1, BLOCK))
    spans = [(float(channel.min()), float(channel.max())) for channel in (bar, celsius, rpm)]
    means = np.column_stack([celsius, bar, rpm]).reshape(-1, BLOCK, 3).mean(axis=1)
    number = np.arange(len(made))
    trains = number < 0.8 * len(made)
    return SampleBlocks(made, number, float(BLOCK), trains, means, Excitation(*spans))


def test_an_error_that_hides_the_level_costs_no_leakage() -> None:
    """Whitened, it would leave the level to one block, and one block has no interval."""
    generator, n_hidden = np.random.default_rng(1), 0
    for _ in range(15):
        blocks = drifting_night(generator)
        made = fit_blocks(blocks, MODEL)
        n_hidden += made.slow.hides_level(blocks.number)
        if made.slow.scales:
            level = with_level(blocks.factors, blocks.number, made.slow)
            np.testing.assert_array_equal(made.fitted, level)
        judged = made.identify(blocks.excitation)
        found = judge_leakage(made.fit, judged, blocks.excitation, REFERENCE)
        assert found.has_value, found.reason
        # model.md, section 3.
        assert found.leakage_l_per_min == pytest.approx(1.371423, rel=0.02)
        assert abs(found.leakage_l_per_min - 1.371423) <= found.interval.half_width
    assert n_hidden >= 5
