"""Trend, step, or both: which model wins, and what it says."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from leakage.course.change_points import find_changes
from leakage.errors import ShapeError
from tests.leakage.made_nights import autoregression

NIGHTS = np.arange(200)
HALF = NIGHTS >= 100


def winners(shape: np.ndarray, phi: float, n: int = 8) -> Counter[tuple[str, int]]:
    found: Counter[tuple[str, int]] = Counter()
    for seed in range(n):
        noise = autoregression(len(shape), phi, np.random.default_rng(seed))
        changes = find_changes(np.arange(len(shape)), shape + noise)
        found[changes.model, len(changes.steps)] += 1
    return found


@pytest.mark.parametrize("phi", [0.0, 0.5])
def test_each_shape_is_called_by_its_name(phi: float) -> None:
    for shape, name, steps, least in (
        (0.0 * NIGHTS, "none", 0, 7),
        (0.04 * NIGHTS, "trend", 0, 6),
        (4.0 * HALF, "step", 1, 6),
        (4.0 * HALF + 4.0 * (NIGHTS >= 150), "step", 2, 6),
        (5.0 * HALF - 0.03 * NIGHTS, "trend_and_step", 1, 5),
    ):
        assert winners(shape, phi)[name, steps] >= least, (name, phi)


def test_a_ramp_that_a_partition_alone_reads_as_steps_is_a_trend_from_its_night() -> None:
    ramp = 0.08 * np.maximum(NIGHTS - 100, 0)
    from ruptures import KernelCPD

    noise = autoregression(200, 0.3, np.random.default_rng(1))
    signal = (ramp + noise)[:, None]
    penalty = 3 * np.log(200) * 1.3 / 0.7
    assert len(KernelCPD("linear", min_size=7).fit(signal).predict(pen=penalty)) > 2
    found = find_changes(NIGHTS, ramp + noise)
    assert found.model == "trend"
    assert abs(found.trend_from_night - 100) <= 12
    assert found.bic["trend"] < found.bic["step"] - 10


def test_a_step_has_its_night_and_its_size() -> None:
    held = 0
    for seed in range(30):
        noise = autoregression(200, 0.4, np.random.default_rng(seed))
        found = find_changes(1000 + NIGHTS, 5.0 * HALF + noise)
        step = min(found.steps, key=lambda one: abs(one.night - 1100))
        assert abs(step.night - 1100) <= 3
        held += abs(step.size - 5.0) <= 0.5
    assert held >= 25


def test_odd_nights_are_no_steps() -> None:
    values = np.random.default_rng(2).standard_normal(200)
    values[[20, 21, 90, 140]] += 60.0
    assert find_changes(NIGHTS, values).model == "none"


def test_gaps_of_weeks_and_missing_nights() -> None:
    values = 4.0 * HALF + np.random.default_rng(3).standard_normal(200)
    values[60:95] = np.nan
    values[::9] = np.nan
    found = find_changes(NIGHTS, values)
    assert (found.model, len(found.steps)) == ("step", 1)
    assert 95 <= found.steps[0].night <= 103


def test_a_sudden_jump_is_proposed_as_one_step() -> None:
    """A motor exchanged under the same name."""
    values = np.where(HALF, 7.0, 1.37) + 0.003 * np.random.default_rng(4).standard_normal(200)
    found = find_changes(NIGHTS, values)
    assert [step.night for step in found.steps] == [100]
    assert found.steps[0].size == pytest.approx(7.0 - 1.37, abs=0.01)


def test_series_without_scatter() -> None:
    assert find_changes(NIGHTS, np.full(200, 1.37)).model == "none"
    found = find_changes(NIGHTS, np.where(HALF, 2.0, 1.0))
    assert [(step.night, step.size) for step in found.steps] == [(100, 1.0)]


def test_too_few_nights() -> None:
    for n in (0, 3, 19):
        found = find_changes(np.arange(n), np.ones(n))
        assert (found.model, found.steps, found.bic) == ("too_few_nights", (), {})
    with pytest.raises(ShapeError):
        find_changes(np.arange(30), np.ones(29))


def test_long_histories_are_looked_at_from_their_end() -> None:
    values = np.random.default_rng(5).standard_normal(3000) + 9.0 * (np.arange(3000) < 500)
    assert find_changes(np.arange(3000), values).model == "none"
