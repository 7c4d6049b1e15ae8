"""The cleaning rules, each against its definition in the design, and what they leave alone."""

from __future__ import annotations

import itertools
import statistics
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from pipeline.config import Channel, Cleaning
from pipeline.ingest import RawChannel
from pipeline.night import masks
from pipeline.night.channel_rules import ChannelRules
from pipeline.night.cleaning import CleanChannel, clean_channel
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
from tests.pipeline.night.channels import SECOND, Floats, lively, refused_by, stamps

RULES = ChannelRules(
    valid_range=(0.0, 100.0),
    sensor_maximum=None,
    resolution=0.1,
    hampel_window=11,
    hampel_threshold=5.0,
    frozen_after_s=60.0,
    gap_sample_periods=5.0,
    longest_gap_s=None,
)


def raw(time_us: NDArray[np.int64], value: Floats, missing: object = None) -> RawChannel:
    """Channel as a reader leaves it: arrays that cannot be written to."""
    blank = np.zeros(len(value), np.bool_) if missing is None else np.asarray(missing, np.bool_)
    arrays = time_us.copy(), np.where(blank, np.nan, value), blank
    for array in arrays:
        array.flags.writeable = False
    return RawChannel(*arrays, 0)


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


class TestValues:
    """Not finite, out of range, at the sensor's maximum."""

    def test_reading_that_is_not_finite_is_not_missing(self) -> None:
        value = lively(100)
        value[[10, 20, 30]] = np.nan, np.inf, -np.inf
        cleaned = clean_channel(raw(stamps(100), value), RULES)
        assert cleaned.counts["not_finite"] == cleaned.counts["any"] == 3
        assert cleaned.counts["missing"] == cleaned.counts["spike"] == 0
        np.testing.assert_array_equal(np.flatnonzero(cleaned.refused), [10, 20, 30])

    def test_range_includes_its_ends(self) -> None:
        value = np.array([-1.1, -1.0, 0.0, 450.0, 450.1, np.nan])
        assert out_of_range(value, (-1.0, 450.0)).tolist() == [True, *[False] * 3, True, False]

    def test_maximum_to_half_of_the_resolution(self) -> None:
        value = np.array([19.98, 19.9899, 19.9901, 20.0 - 1e-12, 20.0, 20.02, np.nan])
        found = at_maximum(value, 20.0, 0.02).tolist()
        assert found == [False, False, True, True, True, True, False]
        assert at_maximum(value, 20.0, 0.0).tolist() == [*[False] * 3, True, True, True, False]
        assert not at_maximum(value, None, 0.02).any()

    def test_several_rules_count_each_and_once_under_any(self) -> None:
        """At its maximum the sensor is out of range here, too."""
        value = lively(200)
        value[100:104] = 120.0
        rules = replace(RULES, sensor_maximum=120.0)
        cleaned = clean_channel(raw(stamps(200), value), rules)
        assert refused_by(cleaned) == {"out_of_range": 4, "at_maximum": 4, "any": 4}
        np.testing.assert_array_equal(np.flatnonzero(cleaned.at_maximum), range(100, 104))

    def test_one_bad_value_costs_its_neighbours_nothing(self) -> None:
        for bad in (np.nan, np.inf, 1e30, -5.0, 70.0):
            value = lively(100)
            value[50] = bad
            cleaned = clean_channel(raw(stamps(100), value), RULES)
            assert np.flatnonzero(cleaned.refused).tolist() == [50]


def slow_hampel(value: Floats, window: int, threshold: float, resolution: float) -> list[bool]:
    """The definition, sample by sample; beyond its ends the signal is mirrored."""
    half = window // 2
    mirrored = np.pad(value, half, mode="reflect")
    flags = []
    for centre in range(len(value)):
        around = [float(one) for one in mirrored[centre : centre + window]]
        middle = statistics.median(around)
        scaled_mad = statistics.median(abs(one - middle) for one in around) * 1.4826022185056018
        # A distance in steps of the sensor is not exceeded by a hundredth of one.
        limit = max(threshold * scaled_mad, (threshold + 0.01) * resolution)
        flags.append(abs(value[centre] - middle) > limit)
    return flags


class TestHampel:
    """Window of 11, 5 scaled MAD, never below the sensor's resolution."""

    @given(
        st.integers(0, 2**32 - 1),
        st.sampled_from([3, 5, 11, 21]),
        st.sampled_from([2.0, 3.0, 5.0]),
        st.sampled_from([0.0, 0.1, 1.0]),
        st.booleans(),
    )
    def test_as_the_slow_definition(
        self, seed: int, window: int, threshold: float, resolution: float, in_steps: bool
    ) -> None:
        rng = np.random.default_rng(seed)
        value = np.cumsum(rng.standard_t(2, 120))
        if in_steps and resolution:
            value = np.round(value / resolution) * resolution
        expected = slow_hampel(value, window, threshold, resolution)
        assert spike(value, window, threshold, resolution).tolist() == expected

    def test_mad_is_scaled_to_a_standard_deviation(self) -> None:
        """Median 0 and MAD 1, so the limit is 5 · 1.4826 = 7.413."""
        around = np.array([-1.0, 1.0, 0.0, 1.5, -1.0, -1.5, 1.0, 0.0, -1.0, 1.0])
        for centre, is_spike in ((7.40, False), (7.42, True)):
            value = np.insert(around, 5, centre)
            assert spike(value, 11, 5.0, 0.0)[5] == is_spike

    def test_coarse_signal_keeps_its_steps(self) -> None:
        """MAD 0 without the floor: each lone step of the sensor would be a spike."""
        value = np.full(50, 20.0)
        value[[10, 30]] = 20.1, 20.5
        assert not spike(value, 11, 5.0, 0.1).any()
        value[30] = 20.6
        assert np.flatnonzero(spike(value, 11, 5.0, 0.1)).tolist() == [30]

    @given(st.floats(-50, 50), st.floats(-20, 20))
    def test_ramp_has_no_spike(self, offset: float, slope: float) -> None:
        assert not spike(offset + slope * np.arange(60.0), 11, 5.0, 0.1).any()

    @given(st.floats(-1000, 1000), st.integers(8, 52))
    def test_lasting_step_has_no_spike(self, height: float, at: int) -> None:
        value = lively(60)
        value[at:] += height
        assert not spike(value, 11, 5.0, 0.1).any()

    @pytest.mark.parametrize("at", [0, 1, 4, 5, 30, 58, 59])
    def test_lone_spike_is_found_wherever_it_stands(self, at: int) -> None:
        value = lively(60)
        value[at] += 40.0
        assert np.flatnonzero(spike(value, 11, 5.0, 0.1)).tolist() == [at]

    def test_five_in_a_row_are_found_and_six_are_a_level(self) -> None:
        for count in (5, 6):
            value = lively(60)
            value[30 : 30 + count] += 40.0
            found = spike(value, 11, 5.0, 0.1)
            assert found[30 : 30 + count].all() == (count == 5)

    def test_fewer_samples_than_a_window_are_not_judged(self) -> None:
        value = lively(10)
        value[5] = 1e6
        assert not spike(value, 11, 5.0, 0.1).any()

    def test_parts_between_borders_are_judged_by_themselves(self) -> None:
        value = np.random.default_rng(5).standard_t(2, 300)
        borders = np.array([10, 21, 90, 291])
        alone = [spike(part, 11, 5.0, 0.1) for part in np.split(value, borders)]
        found = spike(value, 11, 5.0, 0.1, borders)
        np.testing.assert_array_equal(found, np.concatenate(alone))
        assert found[:21].any()
        assert not found[:10].any()

    def test_chunks_change_nothing(self, monkeypatch: pytest.MonkeyPatch) -> None:
        value = np.random.default_rng(3).standard_t(2, 1000)
        whole = spike(value, 11, 5.0, 0.1)
        monkeypatch.setattr(masks, "WINDOWS", 7)
        monkeypatch.setattr(masks, "CACHED", 7)
        np.testing.assert_array_equal(spike(value, 11, 5.0, 0.1), whole)
        assert whole.any()

    @given(st.floats(0.1, 10), st.floats(-100, 100))
    def test_scale_and_offset_change_nothing(self, scale: float, offset: float) -> None:
        value = np.random.default_rng(4).standard_t(2, 300)
        scaled = spike(value * scale + offset, 11, 5.0, 0.1 * scale)
        np.testing.assert_array_equal(spike(value, 11, 5.0, 0.1), scaled)


class TestAcrossAGap:
    """Samples before a gap change nothing after it."""

    @given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 40.0, -45.0]))
    def test_samples_before_a_gap_do_not_judge_those_after_it(
        self, seed: int, level: float
    ) -> None:
        after = 50.0 + np.random.default_rng(seed).standard_t(2, 60)
        time = np.append(stamps(60), stamps(60) + 60 * SECOND)
        alone = clean_channel(raw(time[60:], after), RULES)
        both = clean_channel(raw(time, np.append(lively(60) + level, after)), RULES)
        np.testing.assert_array_equal(both.refused[60:], alone.refused)

    def test_a_spike_beside_a_gap_is_found(self) -> None:
        time = np.append(stamps(60), stamps(60) + 60 * SECOND)
        value = lively(120)
        value[[59, 60]] += 40.0
        found = clean_channel(raw(time, value), RULES)
        assert np.flatnonzero(found.refused).tolist() == [59, 60]


class TestFrozen:
    """60 s without a change beyond the resolution; temperature 900 s."""

    def judged(self, value: Floats, rate_hz: float = 10.0, **rules: float) -> CleanChannel:
        return clean_channel(
            raw(stamps(len(value), rate_hz), value),
            replace(RULES, **rules),  # type: ignore[arg-type]
        )

    def test_all_samples_of_a_stretch_longer_than_the_limit(self) -> None:
        value = lively(2000)
        value[500:1102] = 42.0
        refused = np.flatnonzero(self.judged(value).refused)
        np.testing.assert_array_equal(refused, range(500, 1102))

    def test_a_stretch_of_just_the_limit_is_credible(self) -> None:
        value = lively(2000)
        value[500:1101] = 42.0  # first to last: 60.0 s
        assert self.judged(value).counts["frozen"] == 0

    @given(st.floats(10.0, 90.0), st.integers(0, 2**32 - 1))
    def test_noise_below_the_resolution_is_no_change_wherever_it_lies(
        self, level: float, seed: int
    ) -> None:
        noise = np.random.default_rng(seed).uniform(-0.24, 0.24, 900) * RULES.resolution
        cleaned = self.judged(level + noise)
        assert cleaned.counts["frozen"] == 900

    @given(st.integers(100, 900))
    def test_one_step_of_the_sensor_is_a_change(self, step: int) -> None:
        value = np.resize([step, step + 1.0], 900) * RULES.resolution
        assert self.judged(value).counts["frozen"] == 0

    @given(st.floats(0.0, 5.0), st.sampled_from([0.1, 0.02, 1.0]))
    def test_never_where_the_value_moves_beyond_the_resolution(
        self, start: float, resolution: float
    ) -> None:
        """A ramp of just over a step in the limit's time."""
        value = start + np.arange(900) * resolution / 600 * 1.01
        assert self.judged(value, resolution=resolution).counts["frozen"] == 0

    def test_without_a_resolution_values_must_be_equal(self) -> None:
        still = np.full(900, 42.0)
        assert frozen(stamps(900), still, 0.0, 60 * SECOND).all()
        still[::100] += 1e-9
        assert not frozen(stamps(900), still, 0.0, 60 * SECOND).any()

    @given(st.data())
    def test_as_looked_at_pair_by_pair(self, data: st.DataObject) -> None:
        """Few samples tell where no stretch can be: what is found is what all of them tell."""
        n = data.draw(st.integers(1, 1500))
        rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
        time = np.cumsum(rng.choice([1, 1, 1, 1, 40], n)) * SECOND
        resolution = data.draw(st.sampled_from([0.0, 0.1]))
        value = rng.integers(0, data.draw(st.integers(1, 4)), n).astype(np.float64)
        value *= 0.1
        for _ in range(data.draw(st.integers(0, 4))):
            first = data.draw(st.integers(0, n - 1))
            value[first : first + data.draw(st.integers(1, 400))] = value[first]
        if resolution:
            value += rng.uniform(-0.02, 0.02, n)
        limit = data.draw(st.sampled_from([0.5, 5.0, 20.0, 100.0, 2000.0])) * SECOND
        borders = np.flatnonzero(rng.random(n - 1) < data.draw(st.sampled_from([0.0, 0.1]))) + 1
        gaps = np.zeros(n, dtype=np.int64)
        gaps[borders] = time[borders] - time[borders - 1]
        seen = time - np.cumsum(gaps)
        expected = np.zeros(n, dtype=bool)
        grids = [np.floor(value / 0.1 + at) for at in (0.25, 0.75)] if resolution else [value]
        for step in grids:
            first = 0
            for row in range(1, n + 1):
                if row == n or step[row] != step[first]:
                    expected[first:row] |= seen[row - 1] - seen[first] > limit
                    first = row
        np.testing.assert_array_equal(frozen(time, value, resolution, limit, borders), expected)

    def test_time_counts_and_not_samples(self) -> None:
        assert self.judged(np.full(62, 42.0), rate_hz=1.0).counts["frozen"] == 62
        assert self.judged(np.full(600, 42.0), rate_hz=100.0).counts["frozen"] == 0

    def test_a_gap_adds_no_time(self) -> None:
        """The same reading before and after a night in the garage: nobody saw it frozen."""
        value = lively(400)
        value[195:205] = 50.1
        time = stamps(400)
        time[200:] += 3600 * SECOND
        assert refused_by(clean_channel(raw(time, value), RULES)) == {}

    def test_sensor_frozen_on_both_sides_of_a_gap(self) -> None:
        time = stamps(1400)
        time[700:] += 3600 * SECOND
        cleaned = clean_channel(raw(time, np.full(1400, 42.0)), RULES)
        assert cleaned.counts["frozen"] == 1400

    def test_speed_of_a_halted_motor_is_not_frozen(self) -> None:
        """An encoder at rest says 0 for hours; that is a standstill, not a fault."""
        rules = ChannelRules.of(
            "speed", Channel(source="n", unit="rpm", resolution=0.1), Cleaning()
        )
        value = lively(3000)
        value[1000:2000] = 0.0
        assert refused_by(clean_channel(raw(stamps(3000), value), rules)) == {}
        value[1000:2000] = 30.0
        stuck = clean_channel(raw(stamps(3000), value), rules)
        assert refused_by(stuck) == {"frozen": 1000, "any": 1000}

    def test_pressure_of_zero_is_frozen(self) -> None:
        rules = ChannelRules.of(
            "pressure_difference", Channel(source="p", unit="bar", resolution=0.1), Cleaning()
        )
        cleaned = clean_channel(raw(stamps(1000), np.zeros(1000)), rules)
        assert cleaned.counts["frozen"] == 1000


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
