"""The cleaning rules, each against its definition in the design, and what they leave alone."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from pipeline.config import Channel, Cleaning
from pipeline.ingest import RawChannel
from pipeline.night import cleaning, masks
from pipeline.night.channel_rules import ChannelRules
from pipeline.night.cleaning import Course, clean_channel
from pipeline.night.clocks import backward_time, typical_period_us
from pipeline.night.masks import (
    at_maximum,
    frozen,
    missing_sample,
    near,
    out_of_range,
    spike,
    transient,
)
from tests.pipeline.night.channels import SECOND, lively, refused_by, stamps
from tests.pipeline.night.cleaned import RULES, raw


def in_wide_log(rows: NDArray[np.int64], n: int, rate_hz: float = 10.0) -> RawChannel:
    """Channel with samples in some rows of a log whose rows are another, faster channel's."""
    blank = np.ones(n, np.bool_)
    blank[rows] = False
    value = np.full(n, np.nan)
    value[rows] = lively(len(rows))
    return raw(stamps(n, rate_hz), value, blank)


def test_good_samples_pass_unchanged() -> None:
    value = lively(600)
    cleaned = clean_channel(raw(stamps(600), value), RULES)
    assert refused_by(cleaned) == {}
    assert cleaned.n_samples == 600
    assert not cleaned.refused.any()
    np.testing.assert_array_equal(cleaned.value, value)
    np.testing.assert_array_equal(cleaned.time_us, stamps(600))
    assert cleaned.period_us == SECOND / 10


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


def test_typical_period_is_a_median() -> None:
    assert typical_period_us(np.array([0, 10, 20, 5000, 5010])) == 10.0
    assert typical_period_us(np.array([7])) is None


@given(
    st.lists(st.integers(-3, 8), min_size=1, max_size=40),
    st.integers(1, 2500),
    st.integers(0, 2**32 - 1),
    st.sampled_from([0, 1, 30]),
)
def test_typical_period_is_the_median_of_any_steps(
    steps: list[int], repeats: int, seed: int, jitter: int
) -> None:
    rng = np.random.default_rng(seed)
    all_steps = 10 * np.repeat(steps, repeats) + rng.integers(0, jitter + 1, len(steps) * repeats)
    rng.shuffle(all_steps)
    time = np.concatenate([[0], np.cumsum(all_steps)])
    assert typical_period_us(time) == np.median(all_steps)
    left_out = rng.random(len(time)) < rng.choice([0.001, 0.02, 0.4])
    if np.count_nonzero(~left_out) > 1:
        assert typical_period_us(time, left_out) == np.median(np.diff(time[~left_out]))


@pytest.mark.parametrize("n", [0, 1, 2, 7, 8, 9, 15, 40])
def test_steps_in_blocks_are_those_of_all_stamps(n: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(masks, "CACHED", 7)
    time = np.cumsum(np.random.default_rng(n).integers(0, 3, n))
    found = masks.steps_where(lambda steps: steps > 0, time)
    np.testing.assert_array_equal(found, np.flatnonzero(np.diff(time) > 0))


class TestMissing:
    """Design 3: `missing`, in a log whose rows are those of the fastest channel."""

    def test_slow_channel_between_its_samples_misses_none(self) -> None:
        cleaned = clean_channel(in_wide_log(np.arange(0, 6000, 10), 6000), RULES)
        assert cleaned.n_samples == len(cleaned.time_us) == 600
        assert refused_by(cleaned) == {}
        assert cleaned.period_us == SECOND

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

    def test_channel_that_ends_early(self) -> None:
        slow = clean_channel(in_wide_log(np.arange(0, 5000, 10), 6000), RULES)
        assert slow.counts["missing"] == 100

    def test_channel_without_any_sample_misses_all(self) -> None:
        cleaned = clean_channel(in_wide_log(np.zeros(0, np.int64), 50), RULES)
        assert refused_by(cleaned) == {"missing": 50, "any": 50}
        assert cleaned.period_us is None

    def test_blank_cells_of_a_repeated_row_are_no_samples_of_a_slow_channel(self) -> None:
        """Row 3 stands four times; the slow channel has its samples in rows 0, 10, 20…"""
        once = in_wide_log(np.arange(0, 600, 10), 600)
        again = [*range(4), 3, 3, 3, *range(4, 600)]
        cleaned = clean_channel(
            raw(once.time_us[again], once.value[again], once.missing[again]), RULES
        )
        assert cleaned.n_samples == 60
        assert refused_by(cleaned) == {}

    def test_nor_are_those_of_a_row_whose_clock_was_set_back(self) -> None:
        once = in_wide_log(np.arange(0, 600, 10), 600)
        time = once.time_us.copy()
        time[[33, 77]] -= SECOND
        cleaned = clean_channel(raw(time, once.value, once.missing), RULES)
        assert cleaned.n_samples == 60
        assert refused_by(cleaned) == {}

    @given(st.integers(0, 2**32 - 1))
    def test_jitter_of_the_rows_hides_and_makes_none(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        regular = in_wide_log(np.delete(np.arange(0, 2000, 10), [50, 51, 120]), 2000)
        time = regular.time_us + rng.integers(-12_000, 12_001, 2000)
        cleaned = clean_channel(raw(time, regular.value, regular.missing), RULES)
        assert refused_by(cleaned) == {"missing": 3, "any": 3}

    def test_blank_is_missing_and_nothing_else(self) -> None:
        cleaned = clean_channel(in_wide_log(np.delete(np.arange(100), 40), 100), RULES)
        assert refused_by(cleaned) == {"missing": 1, "any": 1}


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

    def test_clock_that_is_set_back_loses_the_shorter_side(self) -> None:
        time = stamps(200)
        time[100:] -= 30 * 100_000
        cleaned = clean_channel(raw(time, lively(200)), RULES)
        assert cleaned.counts["backward_time"] + cleaned.counts["duplicate_time"] == 30
        assert (np.diff(cleaned.time_us) > 0).all()

    def test_repeated_stamp_keeps_the_first_sample(self) -> None:
        time, value = stamps(100), lively(100)
        time[41] = time[42] = time[40]
        cleaned = clean_channel(raw(time, value), RULES)
        assert refused_by(cleaned) == {"duplicate_time": 2, "any": 2}
        assert cleaned.n_samples == 100
        assert cleaned.value[40] == value[40]
        assert len(cleaned.time_us) == 98

    def test_a_log_copied_behind_itself_is_read_once(self) -> None:
        """Two files that overlap: the second brings nothing new."""
        time, value = stamps(300), lively(300)
        twice = raw(np.concatenate([time, time]), np.concatenate([value, value]))
        cleaned = clean_channel(twice, RULES)
        np.testing.assert_array_equal(cleaned.time_us, time)
        assert cleaned.counts["any"] == 300

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

    def test_before_and_after_are_not_the_same(self) -> None:
        time = np.arange(0, 100) * SECOND
        found = near(np.array([50 * SECOND]), time, 10.0 * SECOND, 30.0 * SECOND)
        np.testing.assert_array_equal(np.flatnonzero(found), range(40, 81))

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

    def test_no_change_is_seen_across_an_absent_sample(self) -> None:
        for absent in (np.nan, 1e9):
            value = np.array([10.0, absent, 90.0])
            assert not transient(value, np.array([True, False, True]), 0.1, 5.0).any()

    @pytest.mark.parametrize("n", [0, 1])
    def test_few_samples(self, n: int) -> None:
        assert len(transient(np.zeros(n), np.ones(n, np.bool_), 0.1, 5.0)) == n


class TestRules:
    """Precedence of the settings: the channel's own keys, else the fleet's, else the channel's."""

    def test_defaults_of_the_design(self) -> None:
        rules = ChannelRules.of("leakage_flow", Channel(source="q", unit="l/min"), Cleaning())
        assert rules.hampel_window == 11
        assert rules.hampel_threshold == 5.0
        assert rules.frozen_after_s == 60.0
        assert rules.gap_sample_periods == 5.0
        assert rules.longest_gap_s is None
        assert rules.sensor_maximum is None

    def test_temperature_has_limits_of_its_own(self) -> None:
        rules = ChannelRules.of("oil_temperature", Channel(source="T", unit="degC"), Cleaning())
        assert rules.frozen_after_s == 900.0
        assert rules.longest_gap_s == 5.0

    def test_what_a_channel_states_wins(self) -> None:
        stated = Channel(
            source="T", unit="degC", valid_range=(5.0, 80.0), resolution=0.5, frozen_after_s=120.0
        )
        rules = ChannelRules.of("oil_temperature", stated, Cleaning())
        assert rules.valid_range == (5.0, 80.0)
        assert rules.resolution == 0.5
        assert rules.frozen_after_s == 120.0

    def test_gap_is_stated_in_sample_periods(self) -> None:
        fast = clean_channel(raw(stamps(100), lively(100)), RULES)
        assert fast.longest_gap_us == 5 * SECOND / 10
        slow = replace(RULES, longest_gap_s=5.0)
        assert clean_channel(raw(stamps(100, 1.0), lively(100)), slow).longest_gap_us == 5 * SECOND


TIME, VALUE, FLAGS = stamps(50), lively(50), np.arange(50) % 7 == 0


@pytest.mark.parametrize(
    "call",
    [
        lambda: clean_channel(RawChannel(TIME[::-1], VALUE, FLAGS, 0), RULES),
        lambda: missing_sample(TIME, FLAGS, 200_000.0, 100_000.0),
        lambda: backward_time(TIME[::-1]),
        lambda: out_of_range(VALUE, (0.0, 1.0)),
        lambda: at_maximum(VALUE, 50.0, 0.1),
        lambda: spike(VALUE, 11, 5.0, 0.1),
        lambda: frozen(TIME, VALUE, 0.1, 1.0),
        lambda: near(TIME[:5], TIME, 1.0, 1.0),
        lambda: transient(VALUE, FLAGS, 0.1, 1.0),
    ],
)
def test_a_rule_changes_nothing_in_its_arguments(call: Callable[[], object]) -> None:
    before = TIME.copy(), VALUE.copy(), FLAGS.copy()
    for array in (TIME, VALUE, FLAGS):
        array.flags.writeable = False
    call()
    for array, kept in zip((TIME, VALUE, FLAGS), before, strict=True):
        np.testing.assert_array_equal(array, kept)


def test_a_mask_is_the_caller_s_own() -> None:
    """Writing to a mask that came back must not reach the raw channel."""
    channel = in_wide_log(np.delete(np.arange(50), 7), 50)
    blank = channel.missing.copy()
    missing_sample(channel.time_us, blank, None, None)[:] = True
    np.testing.assert_array_equal(blank, channel.missing)
