"""Levels with hysteresis, by nights counted by hand."""

from __future__ import annotations

import numpy as np
import pytest

from leakage.course.alarms import (
    Levels,
    Limits,
    above_level,
    level_severity,
    limit_severity,
    nights_since_good,
)
from leakage.errors import ParameterError

NAN = np.nan


def on(values: list[float], **rule: float) -> list[int]:
    return above_level(np.array(values), 0.15, 0.05, Levels(**rule)).astype(int).tolist()


def test_three_of_five_nights_switch_on() -> None:
    assert on([0.2, 0.0, 0.2, 0.0, 0.2]) == [0, 0, 0, 0, 1]
    assert on([0.2, 0.0, 0.0, 0.2, 0.0, 0.2]) == [0] * 6
    assert on([0.2, 0.2, 0.2]) == [0, 0, 1]


def test_the_deadband_holds_until_five_nights_in_a_row_are_below() -> None:
    start = [0.2, 0.2, 0.2]
    assert on([*start, *[0.12] * 20])[2:] == [1] * 21
    assert on([*start, 0.09, 0.09, 0.09, 0.09, 0.12, *[0.09] * 5])[2:] == [1] * 10 + [0]
    assert on([*start, *[0.09] * 5, 0.2, 0.2, 0.2])[7:] == [0, 0, 0, 1]


def test_nights_without_a_value_hold_and_do_not_count() -> None:
    assert on([0.2, NAN, 0.2, NAN, NAN, 0.2, NAN]) == [0, 0, 0, 0, 0, 1, 1]
    assert on([0.2, 0.2, 0.2, NAN, 0.0, NAN, 0.0, 0.0, 0.0, NAN, 0.0])[-2:] == [1, 0]
    assert on([NAN, NAN]) == [0, 0]
    assert on([]) == []


def test_other_counts_of_nights() -> None:
    assert on([0.2, 0.0, 0.2], on_nights=1, of_nights=1, off_nights=1) == [1, 0, 1]
    assert on([0.2] * 4, on_nights=4, of_nights=4) == [0, 0, 0, 1]


def test_warning_and_alarm_over_the_baseline_and_over_absolute_limits() -> None:
    deviation = np.repeat([0.0, 0.2, 0.4, 0.27, 0.0], 6)
    by_level = level_severity(deviation, 0.01, Levels())
    by_limit = limit_severity(10 * (1 + deviation), Limits(warning=11.5, alarm=13.0), Levels())
    nights = by_level.reshape(5, 6)[:, -1]
    assert nights.tolist() == [0, 1, 2, 2, 0]
    assert by_limit.reshape(5, 6)[:, -1].tolist() == [0, 1, 2, 1, 0]
    nothing = limit_severity(deviation, Limits(), Levels())
    assert not nothing.any()


def test_a_level_within_the_scatter_of_the_nights_counts_only_beyond_it() -> None:
    """15 % of nights that scatter by 12 % is nothing; 4.5 standard deviations are 54 %."""
    deviation = np.array([0.2] * 10 + [0.6] * 3)
    by_level = level_severity(deviation, 0.12, Levels())
    assert by_level.tolist() == [0] * 12 + [2]


def test_nights_since_the_last_good_one() -> None:
    good = np.array([False, True, False, False, True])
    nights = np.array([1, 3, 4, 9, 10])
    found = nights_since_good(nights, good)
    assert found[1:].tolist() == [0, 1, 6, 0]
    assert found[0] > 10**6
    assert len(nights_since_good(np.empty(0, dtype=np.int64), np.empty(0, dtype=bool))) == 0


@pytest.mark.parametrize(
    "wrong",
    [
        {"warning": 0.4, "alarm": 0.3},
        {"warning": 0.0},
        {"deadband": 0.2},
        {"deadband": -0.1},
        {"on_nights": 6},
        {"on_nights": 0},
        {"off_nights": 0},
        {"least_sd": -1.0},
    ],
)
def test_levels_that_contradict_each_other_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ParameterError) as caught:
        Levels(**wrong)
    assert caught.value.code == "alarm_levels"
