"""The small pictures: in their box, broken where nothing is known, flat for noise alone."""

from __future__ import annotations

import re

import numpy as np
import pytest

from pipeline.report.history import Course
from pipeline.report.sparkline import HEIGHT, MARGIN, POINTS, WIDTH, sparkline, strip


def course(values: list[float] | np.ndarray, half: float = np.nan) -> Course:
    value = np.asarray(values, dtype=float)
    return Course(value, value - half, value + half)


def points(path: str) -> np.ndarray:
    return np.array(re.findall(r"(-?[\d.]+) (-?[\d.]+)", path), dtype=float).reshape(-1, 2)


@pytest.mark.parametrize("n", [1, 2, 30, 365, 4000])
def test_the_line_stays_in_its_box_and_small(n: int) -> None:
    values = np.cumsum(np.random.default_rng(n).standard_normal(n)) + 50
    made = sparkline(np.arange(n), course(values, 500.0), (0, n - 1))
    for path in (made.line, made.band):
        drawn = points(path)
        assert len(drawn) <= 2 * POINTS
        assert (drawn >= MARGIN - 0.06).all()
        assert (drawn <= [WIDTH - MARGIN + 0.06, HEIGHT - MARGIN + 0.06]).all()
    assert (made.smallest, made.largest) == (values.min(), values.max())
    assert made.last == pytest.approx(points(made.line)[-1], abs=0.06)


def test_noise_of_one_percent_looks_flat_and_a_third_more_does_not() -> None:
    noise = 1.4 * (1 + 0.01 * np.random.default_rng(1).standard_normal(60))
    flat = sparkline(np.arange(60), course(noise), (0, 59))
    noise[40:] *= 1.33
    risen = sparkline(np.arange(60), course(noise), (0, 59))
    assert np.ptp(points(flat.line)[:, 1]) < 0.25 * HEIGHT
    assert np.ptp(points(risen.line)[:, 1]) > 0.4 * HEIGHT
    # Up is more.
    assert points(risen.line)[-1, 1] < points(risen.line)[0, 1]


def test_the_line_is_broken_over_weeks_without_a_value() -> None:
    days = np.array([0, 1, 2, 30, 31, 32])
    made = sparkline(days, course([1.0, 1.0, 1.0, 1.1, np.nan, 1.1], 0.1), (0, 32))
    assert made.line.count("M") == 2
    assert made.band.count("Z") == 2


def test_all_motors_of_a_fleet_share_one_time() -> None:
    """Ten nights in the middle of a hundred are drawn in the middle."""
    made = sparkline(np.arange(45, 55), course(np.ones(10)), (0, 99))
    x = points(made.line)[:, 0]
    assert x.min() == pytest.approx(MARGIN + 45 / 99 * (WIDTH - 2 * MARGIN), abs=0.06)
    assert x.max() == pytest.approx(MARGIN + 54 / 99 * (WIDTH - 2 * MARGIN), abs=0.06)


def test_the_baseline_is_drawn_at_its_level_if_there_is_one() -> None:
    made = sparkline(np.arange(9), course(np.linspace(1.0, 2.0, 9)), (0, 8), baseline=1.5)
    bare = sparkline(np.arange(9), course(np.ones(9)), (0, 8))
    assert made.baseline == f"M{MARGIN:g} {HEIGHT / 2:.1f}H{WIDTH - MARGIN:g}"
    assert bare.baseline == ""
    # Without a value there is no picture.
    assert sparkline(np.arange(3), course([np.nan] * 3), (0, 2)) is None
    assert sparkline(np.arange(0), course([]), (0, 2)) is None


def test_a_bar_a_night_whatever_it_came_to() -> None:
    bars = strip(["ok", "failed", None, "ok", "a_new_status"])
    assert bars["ok"].count("z") == 2
    assert bars["failed"].startswith("M4 ")
    assert set(bars) == {"ok", "failed", "a_new_status"}
