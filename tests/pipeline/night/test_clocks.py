"""Clocks: what is put back in order, what is refused, what is only counted."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.config import Channel, Cleaning
from pipeline.night.channel_rules import ChannelRules
from pipeline.night.cleaning import clean_channel
from pipeline.night.time_order import backward_time, n_jittered, written_late
from tests.pipeline.night.channels import SECOND, Floats, Times, as_read, lively, stamps

STEP = 100_000


def cleaned(time_us: Times, value: Floats, cleaning: Cleaning | None = None, **keys: Any) -> Any:
    channel = Channel(source="x", unit="bar", resolution=0.1, **keys)
    rules = ChannelRules.of("pressure_difference", channel, cleaning or Cleaning())
    return clean_channel(as_read(time_us, value), rules)


class TestWrittenLate:
    @given(st.permutations(range(12)), st.integers(20, 60))
    def test_chunks_written_in_any_order_are_all_put_back(
        self, order: list[int], size: int
    ) -> None:
        """Files whose names do not sort as their times do; a logger that flushed late."""
        time, value = stamps(12 * size), lively(12 * size)
        rows = np.concatenate([np.arange(one * size, (one + 1) * size) for one in order])
        found = cleaned(time[rows], value[rows])
        np.testing.assert_array_equal(found.time_us, time)
        np.testing.assert_array_equal(found.value, value)
        assert found.counts["any"] == 0
        assert found.noted["backward_time"] == int(backward_time(time[rows]).sum())

    @pytest.mark.parametrize("at", [1, 50, 150, 199])
    @pytest.mark.parametrize("rows_late", [1, 2, 30])
    def test_a_sample_that_came_late_is_put_back(self, at: int, rows_late: int) -> None:
        place = np.arange(200)
        rows = np.insert(np.delete(place, at), min(at + rows_late, 199), at)
        found = cleaned(stamps(200)[rows], lively(200)[rows])
        np.testing.assert_array_equal(found.value, lively(200))

    def test_a_clock_that_was_set_back_runs_over_times_that_are_taken(self) -> None:
        for back_us in (30 * STEP, 30 * STEP + STEP // 2, 30 * STEP + 7):
            time = stamps(300)
            time[150:] -= back_us
            found = cleaned(time, lively(300))
            assert found.noted["backward_time"] == 0
            assert found.counts["backward_time"] + found.counts["duplicate_time"] in (30, 31)

    def test_a_lone_stamp_far_from_all_others_is_wrong(self) -> None:
        time = np.append(stamps(100), stamps(100) + 3600 * SECOND)
        time[150] -= 1800 * SECOND
        found = cleaned(time, lively(200))
        assert found.counts["backward_time"] == 1
        assert found.noted["backward_time"] == 0

    def test_of_two_rows_that_contradict_each_other_the_stray_one_is_refused(self) -> None:
        time = stamps(100) + 3600 * SECOND
        time[1] = 0
        backward = backward_time(time)
        late, stray = written_late(time, backward, time[~backward])
        assert (late.tolist(), stray.tolist()) == ([0], [1])
        found = cleaned(time, lively(100))
        assert found.counts["backward_time"] == 1
        np.testing.assert_array_equal(found.value, np.delete(lively(100), 1))


class TestJitter:
    def test_is_counted_and_refuses_nothing(self) -> None:
        time = stamps(1000)
        time[[100, 500, 700]] += 40_000
        found = cleaned(time, lively(1000))
        assert found.noted["jitter"] == 6
        assert found.counts["any"] == 0

    def test_samples_left_out_are_none(self) -> None:
        time = np.delete(stamps(1000), [5, 70, 71, 72])
        assert n_jittered(time, float(STEP)) == n_jittered(time, None) == 0


def test_a_clock_known_to_be_off_is_put_right() -> None:
    found = cleaned(stamps(100), lively(100), time_offset_s=-12.3)
    np.testing.assert_array_equal(found.time_us, stamps(100) - 12_300_000)
    np.testing.assert_array_equal(found.value, lively(100))
