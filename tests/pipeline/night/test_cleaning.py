"""The cleaning rules, each against its definition in the design, and what they leave alone."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from pipeline.config import Channel, Cleaning
from pipeline.ingest import RawChannel
from pipeline.night import cleaning
from pipeline.night.channel_rules import ChannelRules
from pipeline.night.cleaning import Course, clean_channel
from pipeline.night.masks import (
    near,
    transient,
)
from pipeline.night.time_order import backward_time, typical_period_us
from tests.pipeline.night.channels import RULES, SECOND, lively, raw, refused_by, stamps


def in_wide_log(rows: NDArray[np.int64], n: int, rate_hz: float = 10.0) -> RawChannel:
    """Channel with samples in some rows of a log whose rows are another, faster channel's."""
    blank = np.ones(n, np.bool_)
    blank[rows] = False
    value = np.full(n, np.nan)
    value[rows] = lively(len(rows))
    return raw(stamps(n, rate_hz), value, blank)


@given(st.lists(st.tuples(st.sampled_from([1, 2, 5, 6, 20]), st.booleans()), max_size=60))
def test_rules_see_a_gap_wherever_credible_samples_are_far_apart(
    steps_and_good: list[tuple[int, bool]],
) -> None:
    """By silence, by samples that are out of range, or by both: more than half a second."""
    seen: list[Course] = []

    def rule(course: Course) -> NDArray[np.bool_]:
        seen.append(course)
        return np.zeros(len(course.value), np.bool_)

    steps, good = [step for step, _ in steps_and_good], [one for _, one in steps_and_good]
    time_us = stamps(10)[0] + np.cumsum(np.array(steps, np.int64)) * SECOND // 10
    value = np.where(good, lively(len(good)), 500.0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cleaning, "CHANNEL_RULES", {"probe": rule})
        clean_channel(raw(time_us, value), replace(RULES, longest_gap_s=0.5))
    (course,) = seen
    credible = time_us[good]
    np.testing.assert_array_equal(course.time_us, credible)
    assert course.borders.tolist() == [
        place
        for place in range(1, len(credible))
        if credible[place] - credible[place - 1] > SECOND // 2
    ]


@pytest.mark.parametrize("n", [0, 1, 2])
def test_channel_of_few_samples(n: int) -> None:
    cleaned = clean_channel(raw(stamps(n), lively(n)), RULES)
    assert cleaned.n_samples == len(cleaned.time_us) == n
    assert refused_by(cleaned) == {}
    assert (cleaned.period_us is None) == (n < 2)
    # A constant of the config has no gap, however far apart its samples are.
    constant = clean_channel(raw(stamps(n), lively(n)), replace(RULES, longest_gap_s=np.inf))
    assert refused_by(constant) == {}


def test_typical_period_is_a_median() -> None:
    assert typical_period_us(np.array([0, 10, 20, 5000, 5010])) == 10.0
    assert typical_period_us(np.array([0, 1, 3, 6, 10])) == 2.5  # of 1, 2, 3, 4: none is of most
    assert typical_period_us(np.array([0, 4, 8, 11, 14])) == 3.5  # two of four are not most
    assert typical_period_us(np.array([7])) is None


class TestMissing:
    """Design 3: `missing`, in a log whose rows are those of the fastest channel."""

    @pytest.mark.parametrize("first", range(10))
    def test_each_sample_left_out_is_missing_once(self, first: int) -> None:
        rows = np.delete(np.arange(first, 6000, 10), [5, 100, 101, 102])
        cleaned = clean_channel(in_wide_log(rows, 6000), RULES)
        assert refused_by(cleaned) == {"missing": 4, "any": 4}
        assert cleaned.n_samples == 600
        lost = cleaned.time_us[cleaned.refused]
        np.testing.assert_array_equal(lost, (np.array([5, 100, 101, 102]) * 10 + first) * 100_000)

    @pytest.mark.parametrize("seed", range(5))
    def test_slow_channel_that_comes_a_row_early_or_late_misses_none(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        steps = rng.choice([9, 10, 11], p=[0.2, 0.6, 0.2], size=500)
        rows = np.cumsum(steps)
        assert refused_by(clean_channel(in_wide_log(rows, rows[-1] + 1), RULES)) == {}

    @pytest.mark.parametrize("phase", [0.0, 0.2, 0.5, 0.7])
    @pytest.mark.parametrize("ratio", [2.0, 2.5, 3.3, 4.0, 6.7])
    def test_rate_that_is_no_whole_part_of_the_rows_misses_none(
        self, ratio: float, phase: float
    ) -> None:
        rows = np.ceil(np.arange(400) * ratio + phase).astype(np.int64)
        assert refused_by(clean_channel(in_wide_log(rows, rows[-1] + 1), RULES)) == {}

    @given(st.sets(st.integers(1, 198), max_size=60))
    def test_fast_channel_misses_every_blank(self, lost: set[int]) -> None:
        rows = np.array(sorted(set(range(200)) - lost))
        cleaned = clean_channel(in_wide_log(rows, 200), RULES)
        assert cleaned.counts["missing"] == len(lost)
        assert cleaned.n_samples == 200

    def test_channel_that_begins_late(self) -> None:
        slow = clean_channel(in_wide_log(np.arange(55, 6000, 10), 6000), RULES)
        assert slow.counts["missing"] == 0
        fast = clean_channel(in_wide_log(np.arange(55, 6000), 6000), RULES)
        assert fast.counts["missing"] == 55

    def test_blank_cells_of_a_repeated_row_are_no_samples_of_a_slow_channel(self) -> None:
        """Row 3 stands four times; the slow channel has its samples in rows 0, 10, 20…"""
        once = in_wide_log(np.arange(0, 600, 10), 600)
        again = [*range(4), 3, 3, 3, *range(4, 600)]
        cleaned = clean_channel(
            raw(once.time_us[again], once.value[again], once.missing[again]), RULES
        )
        assert cleaned.n_samples == 60
        assert refused_by(cleaned) == {}


class TestTime:
    """Backward and duplicate time."""

    @given(st.lists(st.integers(0, 8), max_size=9))
    def test_as_few_as_possible_are_named(self, times: list[int]) -> None:
        kept = ~backward_time(np.array(times, dtype=np.int64))
        left = [time for time, good in zip(times, kept, strict=True) if good]
        assert left == sorted(left)
        longest = max(
            len(some)
            for size in range(len(times) + 1)
            for some in itertools.combinations(times, size)
            if list(some) == sorted(some)
        )
        assert len(left) == longest

    @pytest.mark.parametrize("at", [0, 1, 50, 198, 199])
    @pytest.mark.parametrize("years", [-30, 30])
    def test_one_stamp_far_off_costs_one_sample(self, at: int, years: int) -> None:
        """Only at the log's very end can a stamp in the future not be told from a real one."""
        time = stamps(200) + 56 * 365 * 86400 * SECOND
        time[at] += years * 365 * 86400 * SECOND
        cleaned = clean_channel(raw(time, lively(200)), RULES)
        in_order = (at == 0 and years < 0) or (at == 199 and years > 0)
        assert refused_by(cleaned) == ({} if in_order else {"backward_time": 1, "any": 1})
        assert cleaned.n_samples == 200
        assert len(cleaned.time_us) == 200 - (not in_order)

    @given(st.lists(st.integers(0, 10**6), max_size=60), st.integers(0, 2**32 - 1))
    def test_what_is_left_is_strictly_increasing_and_all_are_counted(
        self, times: list[int], seed: int
    ) -> None:
        time = np.array(times, dtype=np.int64)
        value = np.random.default_rng(seed).uniform(40, 60, len(time))
        cleaned = clean_channel(raw(time, value), RULES)
        assert (np.diff(cleaned.time_us) > 0).all()
        assert cleaned.n_samples == len(time)
        refused = cleaned.counts["backward_time"] + cleaned.counts["duplicate_time"]
        assert len(cleaned.time_us) + refused == len(time)
        assert cleaned.counts["any"] == refused + int(cleaned.refused.sum())


class TestNear:
    """Guard times."""

    @given(
        st.lists(st.integers(0, 100), max_size=5),
        st.lists(st.integers(-20, 120), max_size=20).map(sorted),
        st.integers(0, 15),
        st.integers(0, 15),
    )
    def test_as_the_slow_definition(
        self, events: list[int], times: list[int], before: int, after: int
    ) -> None:
        event, time = np.array(sorted(events), np.int64), np.array(times, np.int64)
        expected = [any(-before <= t - e <= after for e in events) for t in times]
        assert near(event, time, before, after).tolist() == expected


class TestTransient:
    """|dω/dt| or |dΔP/dt| above a limit."""

    def test_both_ends_of_each_fast_change(self) -> None:
        value = np.array([10.0, 10.4, 10.4, 11.0, 11.0, 10.0, 10.0])
        found = transient(value, np.ones(7, np.bool_), 0.1, 5.0)
        assert np.flatnonzero(found).tolist() == [2, 3, 4, 5]

    def test_a_change_of_just_the_limit_is_none(self) -> None:
        value = np.array([10.0, 10.5, 10.0])
        assert not transient(value, np.ones(3, np.bool_), 0.125, 4.0).any()


class TestRules:
    """Precedence of the settings: the channel's own keys, else the fleet's, else the channel's."""

    def test_temperature_has_limits_of_its_own(self) -> None:
        rules = ChannelRules.of("oil_temperature", Channel(source="T", unit="degC"), Cleaning())
        assert rules.frozen_after_s == 900.0
        assert rules.longest_gap_s == 5.0

    def test_what_a_channel_states_wins(self) -> None:
        stated = {"valid_range": (5.0, 80.0), "resolution": 0.5, "frozen_after_s": 120.0}
        channel = Channel(source="T", unit="degC", **stated)
        rules = ChannelRules.of("oil_temperature", channel, Cleaning())
        assert {name: getattr(rules, name) for name in stated} == stated
