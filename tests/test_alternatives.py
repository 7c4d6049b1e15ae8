"""The comparison of methods, and sizes of a record's noise: a small cell from end to end."""

from __future__ import annotations

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from benchmarks.alternatives import first_alarms, made_nights, share_interval
from benchmarks.charts import BOOSTING, chart, charts
from benchmarks.grey_box_nights import standing, watched
from benchmarks.machine_nights import OTHERWISE, SLEEVE, State
from benchmarks.noise import by_scale

BASELINE, CHANGE, NIGHTS = 15, 17, 21


def state(place: int) -> State:
    return State(paths={SLEEVE: 3.0}) if place >= CHANGE else State()


def test_a_break_is_told_by_every_method_and_named_by_the_grey_box(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(BOOSTING, "max_iter", 20)
    with threadpool_limits(1):
        nights, rows = made_nights(OTHERWISE, state, (1, 2), range(NIGHTS))
        told, distances = watched(standing(nights, rows), CHANGE), charts(nights, BASELINE)
    assert not told.raised[:CHANGE].any()
    assert told.raised[CHANGE + 2]
    assert "balance_piston" in told.named or SLEEVE in told.named
    for method, distance in distances.items():
        assert distance[CHANGE:].max() > max(distance[:CHANGE].max(), 3.0), method


def test_nights_before_a_change_are_those_without_it() -> None:
    (changed, _), (same, _) = (
        made_nights(OTHERWISE, course, (1, 3), range(CHANGE - 1, CHANGE + 1))
        for course in (state, lambda _: State())
    )
    assert np.array_equal(changed[0].factors, same[0].factors)
    assert not np.array_equal(changed[1].flow_l_per_min, same[1].flow_l_per_min)
    # The duty and the errors are drawn alike.
    assert np.array_equal(changed[1].means, same[1].means)


def test_a_chart_counts_in_the_scatter_of_its_baseline() -> None:
    change = np.array([0.9, 1.0, 1.1, 1.4, 1.0]) - 1.0
    assert chart(change, 3) == pytest.approx([-1.0, 0.0, 1.0, 4.0, 0.0])
    # A moving mean of weight w scatters by √(w / (2 − w)); 0.5: by 0.577.
    assert chart(change, 3, 0.5)[3:] == pytest.approx(np.array([2.0, 1.0]) * np.sqrt(3.0))


def test_rates_count_the_time_until_a_first_alarm() -> None:
    assert first_alarms([None, 73, None], 365) == (1, pytest.approx(2.2))
    # 0 of 30 excludes more than 11.6 % (two-sided 95 %), after Clopper and Pearson.
    assert share_interval(0, 30) == (0.0, pytest.approx(0.1157, abs=1e-4))


def test_sizes_by_time_scale_find_the_scale_of_an_error() -> None:
    index = np.arange(7200)
    slow = np.where(index // 600 % 2, 0.01, -0.01)
    quick = np.where(index % 2, 0.02, -0.02)
    whole, to_10_s, to_1_min, to_10_min, to_1_h, longer = by_scale(slow + quick, index)
    assert whole == pytest.approx(np.hypot(0.01, 0.02))
    assert (to_10_s, to_1_h) == pytest.approx((0.02, 0.01))
    assert (to_1_min, to_10_min, longer) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)
