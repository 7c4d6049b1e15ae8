"""The recursive statistic against the likelihood ratio of all blocks at once, and what it tells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from leakage.course.step_detection import (
    LEAST_LIMIT,
    LEAST_RISE,
    BlockErrors,
    Evidence,
    StepWatch,
    advance,
    block_errors,
    limit_of_maxima,
)

Array = NDArray[np.float64]

ERRORS = BlockErrors(correlation=0.9, slow_sd=0.02, white_sd=0.03)


def drawn(
    rng: np.random.Generator,
    days: int,
    number: NDArray[np.int64],
    flow: Array,
    errors: BlockErrors = ERRORS,
) -> Array:
    """Errors of the blocks of some days by their covariance, shape (days, n)."""
    root = np.linalg.cholesky(covariance(number, flow, errors) + 1e-12 * np.eye(len(flow)))
    return np.asarray(rng.standard_normal((days, len(flow))) @ root.T)


def covariance(number: NDArray[np.int64], flow: Array, errors: BlockErrors = ERRORS) -> Array:
    """σ_s² ρ^|i−j| ŷŷ' + σ_w² I, as the model has it."""
    apart = np.abs(number[:, None] - number)
    slow = errors.slow_sd**2 * errors.correlation**apart * np.outer(flow, flow)
    return np.asarray(slow + errors.white_sd**2 * np.eye(len(flow)))


def followed(
    number: NDArray[np.int64], flow: Array, error: Array, errors: BlockErrors = ERRORS
) -> list[Evidence]:
    watch, found = StepWatch.begin(errors), []
    for one in zip(number, flow, error, strict=True):
        watch, evidence = advance(watch, errors, *map(np.asarray, one))
        found.append(evidence)
    return found


def test_the_statistic_is_the_likelihood_ratio_of_all_blocks_at_once() -> None:
    rng = np.random.default_rng(1)
    number = np.array([3, 4, 5, 7, 8, 9, 20, 21, 22, 24, 25, 26])
    flow = rng.uniform(1.0, 3.0, len(number))
    inverse = np.linalg.inv(covariance(number, flow))
    seen = 0
    for _ in range(20):
        error = drawn(rng, 1, number, flow)[0] + 0.1 * flow * (number >= 9)
        found = followed(number, flow, error)[-1]
        best = 0.0
        began, rise = -1, 0.0
        pulses = [max(inverse[at] @ error, 0.0) ** 2 / inverse[at, at] for at in range(len(flow))]
        for start in range(len(flow) - 1):
            signature = np.where(np.arange(len(flow)) >= start, flow, 0.0)
            score, information = signature @ inverse @ error, signature @ inverse @ signature
            step = max(score / information, LEAST_RISE)
            ratio = 2.0 * step * score - step**2 * information
            is_step = (
                ratio > max(pulses[start:]) and error[-1] / flow[-1] >= score / information / 2
            )
            if is_step and ratio > best:
                best, began, rise = ratio, number[start], score / information
        assert found.statistic == pytest.approx(np.sqrt(best), rel=1e-9)
        if best > 0.0:
            seen += 1
            assert found.began == began
            assert found.rise == pytest.approx(rise, rel=1e-9)
    assert seen > 10


def test_series_side_by_side_are_as_each_alone_and_a_missing_block_is_as_none() -> None:
    rng = np.random.default_rng(2)
    number, flow = np.arange(12), np.full((3, 12), 2.0)
    error = 0.1 * rng.standard_normal((3, 12))
    error[1, 5] = np.nan
    watch, largest = StepWatch.begin(ERRORS, (3,)), np.zeros(3)
    for at in number:
        watch, found = advance(watch, ERRORS, np.full(3, at), flow[:, at], error[:, at])
        largest = np.maximum(largest, found.statistic)
    for place in range(3):
        there = np.isfinite(error[place])
        alone = followed(number[there], flow[place][there], error[place][there])
        assert largest[place] == pytest.approx(max(float(one.statistic) for one in alone))


def quiet(n: int) -> tuple[NDArray[np.int64], Array, Array]:
    return np.arange(n), np.full(n, 2.0), 0.002 * (-1.0) ** np.arange(n)


def test_a_step_is_told_by_its_second_block_with_its_begin_and_size() -> None:
    number, flow, error = quiet(42)
    found = followed(number, flow, error + 0.8 * flow * (number >= 40))
    assert found[40].statistic == 0.0
    assert found[41].statistic > 10.0
    assert found[41].began == 40
    assert found[41].rise == pytest.approx(0.8, abs=0.02)
    assert pytest.approx(found[41].rise, abs=2.0 * found[41].rise_sd) == 0.8


@pytest.mark.parametrize("size", [0.5, 5.0, -0.9])
def test_neither_a_spike_nor_a_hole_is_a_step(size: float) -> None:
    number, flow, error = quiet(100)
    found = followed(number, flow, error + size * flow * (number == 40))
    assert max(float(one.statistic) for one in found) < LEAST_LIMIT


def test_neither_a_fall_nor_its_end_is_a_rise() -> None:
    number, flow, error = quiet(120)
    found = followed(number, flow, error - 0.4 * flow * ((number >= 40) & (number < 70)))
    assert max(float(one.statistic) for one in found) < LEAST_LIMIT


def test_the_errors_of_blocks_are_found_across_gaps_and_faults() -> None:
    rng = np.random.default_rng(3)
    number = np.concatenate([1000 * day + np.arange(200) for day in range(40)])
    flow = rng.uniform(1.5, 2.5, len(number))
    slow = drawn(rng, 40, np.arange(200), np.ones(200), replace(ERRORS, white_sd=0.0)).ravel()
    error = flow * slow + 0.03 * rng.standard_normal(len(number))
    error[::500] += 20.0
    found = block_errors(number, flow, error)
    assert found.correlation == pytest.approx(0.9, abs=0.02)
    assert found.slow_sd == pytest.approx(0.02, rel=0.1)
    assert found.white_sd == pytest.approx(0.03, rel=0.15)


def test_white_errors_have_no_slow_part_to_speak_of() -> None:
    rng = np.random.default_rng(4)
    found = block_errors(np.arange(20_000), np.full(20_000, 2.0), rng.standard_normal(20_000))
    assert found.slow_sd < 0.05
    assert found.white_sd == pytest.approx(1.0, rel=0.02)


def test_the_limit_is_the_gumbel_quantile_and_never_below_its_floor() -> None:
    rng = np.random.default_rng(5)
    drawn_maxima = rng.gumbel(3.0, 0.5, 200_000)
    expected = 3.0 - 0.5 * np.log(-np.log(1.0 - 1.0 / 3650.0))
    assert limit_of_maxima(drawn_maxima) == pytest.approx(expected, rel=0.01)
    assert limit_of_maxima(np.array([1.0, 1.1, 0.9])) == LEAST_LIMIT


def test_a_healthy_motor_is_left_alone_and_a_broken_ring_is_told_in_minutes() -> None:
    """30 days calibrate; 60 other days are watched, and 60 with a rise of 20 % at block 100."""
    rng = np.random.default_rng(6)
    number, flow = np.arange(200), np.full(200, 2.0)

    def days(n: int) -> Array:
        return drawn(rng, n, number, flow)

    def largest(error: Array) -> Array:
        watch, found = StepWatch.begin(ERRORS, (len(error),)), []
        for at in number:
            blocks = (np.full(len(error), one) for one in (at, 2.0))
            watch, evidence = advance(watch, ERRORS, *blocks, error[:, at])  # type: ignore[arg-type]
            found.append(evidence.statistic)
        return np.array(found).T

    limit = limit_of_maxima(largest(days(30)).max(axis=1))
    assert not (largest(days(60)) > limit).any()
    told = largest(days(60) + 0.2 * flow * (number >= 100)) > limit
    assert told[:, 100:].any(axis=1).all()
    assert np.median(told[:, 100:].argmax(axis=1)) <= 3
