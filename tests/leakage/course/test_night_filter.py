"""The random walk on loss factors, against the statements of model.md, section 7, "Poor nights"."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from leakage import OperatingConditions, regressors
from leakage.course.night_filter import FilterState, first_state, follow, night_information
from leakage.errors import ShapeError
from leakage.estimation.block_statistics import factors
from leakage.estimation.multi_start import Parametrisation
from tests.leakage.placeholders import placeholder_motor

Array = NDArray[np.float64]

MOTOR = placeholder_motor("CB560")
THETA = np.array(
    [path.configured_coefficient if path else 0.0 for path in Parametrisation.of(MOTOR).paths]
)
SCALE, FREE = THETA[:3], np.array([True, True, True, False])
REFERENCE = regressors(MOTOR, OperatingConditions.from_bar(200.0, 50.0, 30.0))[0]
PISTON, SLEEVE = np.eye(3)[1:]
SD, ROWS = 0.1, 120


def night(
    generator: np.random.Generator,
    theta: Array = THETA,
    *,
    blocks: int = 10,
    gain: float = 1.0,
    pressure_bar: tuple[float, float] = (20.0, 300.0),
    shared: bool = False,
) -> Array:
    """Block factors of a night at 1 Hz; errors white, or one and the same through each block."""
    n = blocks * ROWS
    columns = regressors(
        MOTOR,
        OperatingConditions.from_bar(
            generator.uniform(*pressure_bar, n),
            np.full(n, 50.0),
            np.repeat(generator.uniform(5.0, 100.0, blocks), ROWS),
        ),
    )
    error = SD * (
        np.repeat(generator.standard_normal(blocks), ROWS)
        if shared
        else generator.standard_normal(n)
    )
    flow = gain * (columns[:, :4] @ theta + columns[:, 4]) + error
    return factors(np.column_stack([columns, flow]), np.arange(0, n + 1, ROWS))


def after(state: FilterState, blocks: Array, nights_since: int = 1) -> FilterState:
    return follow(state, night_information(blocks, THETA, FREE), nights_since, SCALE)


def steady(nights: int, generator: np.random.Generator, blocks: int = 10) -> FilterState:
    state = first_state(SCALE)
    for _ in range(nights):
        state = after(state, night(generator, blocks=blocks))
    return state


def test_a_first_night_is_known_to_its_noise_and_the_common_gain_error() -> None:
    """J = S/λ − vv'τ²/(1 + τ²θ'v) is the inverse of λ/S + τ² dd', d how a gain moves θ."""
    blocks = night(np.random.default_rng(1), blocks=60)
    told = night_information(blocks, THETA, FREE)
    state = after(first_state(SCALE), blocks)
    # In units of the scale: the Gram of K spans 26 orders of magnitude.
    gram = told.gram * np.outer(SCALE, SCALE)
    moved = np.linalg.solve(gram, SCALE * (told.explained + told.known))
    expected = SD**2 * np.linalg.inv(gram) + 0.015**2 * np.outer(moved, moved)
    found = state.covariance / np.outer(SCALE, SCALE)
    assert np.diag(found) == pytest.approx(np.diag(expected), rel=0.35)
    assert state.informed
    assert not state.opened


def test_the_walk_grows_by_two_percent_a_night_over_nights_without_data() -> None:
    state = steady(5, np.random.default_rng(2))
    nothing = np.zeros((0, 6, 6))
    gap = after(state, nothing, nights_since=9)
    by_night = state
    for _ in range(9):
        by_night = after(by_night, nothing)
    assert gap.covariance == pytest.approx(by_night.covariance, rel=1e-12)
    grown = np.diag(gap.covariance - state.covariance)
    assert grown == pytest.approx(9 * (0.02 * SCALE) ** 2, rel=1e-9)
    assert np.array_equal(gap.mean, state.mean)


def test_no_number_of_samples_makes_leakage_better_known_than_the_gain() -> None:
    leakage = float(REFERENCE[:3] @ SCALE) + REFERENCE[4]
    state = after(first_state(SCALE), night(np.random.default_rng(3), blocks=720))
    assert state.half_width(REFERENCE[:3]) / leakage > 1.96 * 0.015


def test_a_motor_at_one_pressure_knows_its_leakage_and_no_path() -> None:
    generator = np.random.default_rng(4)
    state = first_state(SCALE)
    for _ in range(6):
        state = after(state, night(generator, pressure_bar=(179.9, 180.1)))
    here = regressors(MOTOR, OperatingConditions.from_bar(180.0, 50.0, 30.0))[0, :3]
    assert state.half_width(here) < 0.06 * float(here @ SCALE)
    assert abs(float(here @ (state.mean - THETA[:3]))) < state.half_width(here)
    assert all(state.half_width(path) > path @ SCALE for path in (PISTON, SLEEVE))


def test_a_step_is_followed_within_nights_and_its_split_is_not_claimed() -> None:
    """Right after a step the split of piston and sleeve is noise: intervals must show that."""
    generator = np.random.default_rng(5)
    before = steady(60, generator)
    stepped = THETA * (1.0, 1.0, 1.4, 1.0)
    first = after(before, night(generator, stepped))
    assert first.opened
    for path in (PISTON, SLEEVE):
        assert first.half_width(path) > 1.5 * before.half_width(path)
        assert abs(path @ (first.mean - stepped[:3])) < first.half_width(path)
    state = first
    for _ in range(2):
        state = after(state, night(generator, stepped))
    leakage = float(REFERENCE[:3] @ (state.mean - stepped[:3]))
    assert abs(leakage) < state.half_width(REFERENCE[:3])
    assert SLEEVE @ (state.mean - SCALE) > 0.2 * SLEEVE @ SCALE


@pytest.mark.parametrize("blocks", [5, 15])
def test_intervals_of_short_nights_hold_while_the_motor_walks_and_sensors_wander(
    blocks: int,
) -> None:
    """95 % at a walk of 2 % and a gain of 1.5 % a night; no night is taken for a step."""
    generator = np.random.default_rng(blocks)
    held, opened = [], 0
    for _ in range(12):
        theta, state = THETA.copy(), first_state(SCALE)
        for _ in range(25):
            theta[:3] += 0.02 * SCALE * generator.standard_normal(3)
            gain = 1.0 + 0.015 * generator.standard_normal()
            state = after(state, night(generator, theta, blocks=blocks, gain=gain))
            opened += state.opened
            held += [
                abs(c @ (state.mean - theta[:3])) <= state.half_width(c)
                for c in (*np.eye(3), REFERENCE[:3])
            ]
    assert 0.92 < np.mean(held) <= 1.0
    assert opened <= 3


def pooled_noise(shared: bool) -> Array:
    generator = np.random.default_rng(6)
    told = [
        night_information(night(generator, blocks=5, shared=shared), THETA, FREE)
        for _ in range(300)
    ]
    pooled: Array = np.sum([one.noise for one in told], axis=0) / np.sum(
        [one.freedom for one in told], axis=0
    )
    return pooled


def test_the_noise_of_nights_of_five_blocks_is_pooled_without_bias() -> None:
    assert pooled_noise(shared=False) == pytest.approx(np.full(3, SD**2), rel=0.15)


def test_errors_that_last_through_a_block_count_its_samples_nearly_once() -> None:
    """Not fully, as the regressors vary within a block and average some of them out."""
    found = pooled_noise(shared=True)
    assert np.all(found > 0.2 * ROWS * SD**2)
    assert np.all(found < 1.1 * ROWS * SD**2)


def test_a_night_of_one_block_does_not_tell_its_noise() -> None:
    state = after(first_state(SCALE), night(np.random.default_rng(7), blocks=1))
    assert not state.informed
    assert np.isfinite(state.covariance).all()


def test_coefficients_and_blocks_are_of_one_model() -> None:
    with pytest.raises(ShapeError, match=r"expected \(b, c, c\)"):
        night_information(np.zeros((2, 6, 6)), np.zeros(3), FREE)
