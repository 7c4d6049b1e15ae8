"""Cleaning: rules of time and of values against their definitions, and what they leave alone."""

from __future__ import annotations

import itertools
import statistics
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from pipeline.config import Channel
from pipeline.ingest import RawChannel
from pipeline.night.cleaning import ChannelRules, clean_channel
from pipeline.night.masks import (
    STEP_ROUNDING,
    at_maximum,
    frozen,
    near,
    spike,
    transient,
)
from pipeline.night.time_order import (
    Steps,
    backward_time,
    order_once,
    written_late,
)
from tests.pipeline.night.channels import (
    RULES,
    SECOND,
    STEP,
    Floats,
    as_read,
    lively,
    raw,
    refused_by,
    stamps,
)


def in_wide_log(rows: NDArray[np.int64], n: int, rate_hz: float = 10.0) -> RawChannel:
    """Channel with samples in some rows of a log whose rows are another, faster channel's."""
    blank = np.ones(n, np.bool_)
    blank[rows] = False
    value = np.full(n, np.nan)
    value[rows] = lively(len(rows))
    return raw(stamps(n, rate_hz), value, blank)


@pytest.mark.parametrize("n", [0, 1, 2])
def test_channel_of_few_samples(n: int) -> None:
    cleaned = clean_channel(raw(stamps(n), lively(n)), RULES)
    assert cleaned.n_samples == len(cleaned.time_us) == n
    assert refused_by(cleaned) == {}
    assert (cleaned.period_us is None) == (n < 2)
    # A constant of the config has no gap, however far apart its samples are.
    constant = clean_channel(raw(stamps(n), lively(n)), replace(RULES, longest_gap_s=np.inf))
    assert refused_by(constant) == {}


@pytest.mark.parametrize(("periods", "n_gaps"), [(5, 0), (6, 1)])
def test_a_silence_of_more_than_five_periods_is_a_gap(periods: int, n_gaps: int) -> None:
    rows = np.r_[:10, 9 + periods : 20 + periods]
    cleaned = clean_channel(raw(stamps(40)[rows], lively(len(rows))), RULES)
    assert len(cleaned.gaps) == n_gaps


@pytest.mark.parametrize(
    ("time_us", "period_us"),
    # Of 1, 2, 3, 4 none is of most; two of four are not most.
    [
        ([0, 10, 20, 5000, 5010], 10.0),
        ([0, 1, 3, 6, 10], 2.5),
        ([0, 4, 8, 11, 14], 3.5),
        ([7], None),
    ],
)
def test_typical_period_is_a_median(time_us: list[int], period_us: float | None) -> None:
    assert Steps.of(np.array(time_us)).period_us == period_us


@given(
    st.lists(st.integers(1, 40), min_size=2, max_size=30),
    st.integers(0, 45),
)
def test_long_steps_are_those_beyond_a_limit_however_regular_the_others(
    lengths: list[int], limit_us: int
) -> None:
    time_us = np.cumsum(lengths)
    expected = [place for place, length in enumerate(lengths[1:]) if length > limit_us]
    assert Steps.of(time_us).longer_than(limit_us, time_us).tolist() == expected


EVERY_TENTH = np.arange(0, 6000, 10)
LEFT_OUT = [5, 100, 101, 102]


@pytest.mark.parametrize(
    ("rows", "n", "n_missing"),
    [
        # Each sample that is left out of a slow channel is missing once.
        *((np.delete(EVERY_TENTH + first, LEFT_OUT), 6000, 4) for first in (0, 7)),
        # A rate that is no whole part of the rows misses none.
        *(
            (np.ceil(np.arange(400) * ratio + phase).astype(np.int64), 0, 0)
            for ratio in (2.0, 2.5, 3.3, 4.0, 6.7)
            for phase in (0.0, 0.2, 0.5, 0.7)
        ),
        # A fast channel misses every blank, also at the begin, where a slow one misses none.
        (np.delete(np.arange(200), [3, 50, 51]), 200, 3),
        (np.arange(55, 6000), 6000, 55),
        (EVERY_TENTH[5:] + 5, 6000, 0),
    ],
)
def test_what_is_missing_of_a_channel_in_a_log_whose_rows_are_another_s(
    rows: NDArray[np.int64], n: int, n_missing: int
) -> None:
    cleaned = clean_channel(in_wide_log(rows, n or rows[-1] + 1), RULES)
    assert refused_by(cleaned) == ({"missing": n_missing, "any": n_missing} if n_missing else {})
    assert cleaned.n_samples == len(rows) + n_missing
    if n_missing == len(LEFT_OUT):
        lost = (np.array(LEFT_OUT) * 10 + rows[0]) * STEP
        np.testing.assert_array_equal(cleaned.time_us[cleaned.refused], lost)


def test_blank_cells_of_a_repeated_row_are_no_samples_of_a_slow_channel() -> None:
    """Row 3 stands four times; the slow channel has its samples in rows 0, 10, 20…"""
    once = in_wide_log(np.arange(0, 600, 10), 600)
    again = [*range(4), 3, 3, 3, *range(4, 600)]
    cleaned = clean_channel(raw(once.time_us[again], once.value[again], once.missing[again]), RULES)
    assert cleaned.n_samples == 60
    assert refused_by(cleaned) == {}


@given(st.lists(st.integers(0, 8), max_size=9))
def test_as_few_as_possible_go_backward(times: list[int]) -> None:
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
def test_one_stamp_far_off_costs_one_sample(at: int, years: int) -> None:
    """Only at the log's very end a stamp in the future cannot be distinguished from a real one."""
    time = stamps(200) + 56 * 365 * 86400 * SECOND
    time[at] += years * 365 * 86400 * SECOND
    cleaned = clean_channel(raw(time, lively(200)), RULES)
    in_order = (at == 0 and years < 0) or (at == 199 and years > 0)
    assert refused_by(cleaned) == ({} if in_order else {"backward_time": 1, "any": 1})
    assert cleaned.n_samples == 200
    assert len(cleaned.time_us) == 200 - (not in_order)


@given(st.lists(st.integers(0, 10**6), max_size=60), st.integers(0, 2**32 - 1))
def test_times_that_are_left_are_strictly_increasing_and_all_are_counted(
    times: list[int], seed: int
) -> None:
    time = np.array(times, dtype=np.int64)
    value = np.random.default_rng(seed).uniform(40, 60, len(time))
    cleaned = clean_channel(raw(time, value), RULES)
    assert (np.diff(cleaned.time_us) > 0).all()
    assert cleaned.n_samples == len(time)
    refused = cleaned.counts["backward_time"] + cleaned.counts["duplicate_time"]
    assert len(cleaned.time_us) + refused == len(time)
    assert cleaned.counts["any"] == refused + int(cleaned.refused.sum())


def test_channels_of_one_table_share_their_order_and_others_have_their_own() -> None:
    """The stamps are compared: a table with other ones is not put in the first one's order."""
    order = order_once()
    first, other = stamps(50), stamps(50)
    first[[20, 21]] = first[[21, 20]]
    other[40] = other[39]
    for time in (first, first.copy(), other, other.copy()):
        assert order(time) is order(time.copy())
        alone = clean_channel(raw(time, lively(50)), RULES)
        shared = clean_channel(raw(time, lively(50)), RULES, order_of_stamps=order)
        np.testing.assert_array_equal(shared.time_us, alone.time_us)
        assert (shared.counts, shared.noted) == (alone.counts, alone.noted)


@given(
    st.lists(st.integers(0, 100), max_size=5),
    st.lists(st.integers(-20, 120), max_size=20).map(sorted),
    st.integers(0, 15),
    st.integers(0, 15),
)
def test_guard_times_are_those_of_the_slow_definition(
    events: list[int], times: list[int], before: int, after: int
) -> None:
    event, time = np.array(sorted(events), np.int64), np.array(times, np.int64)
    expected = [any(-before <= t - e <= after for e in events) for t in times]
    assert near(event, time, before, after).tolist() == expected


def test_a_change_of_just_the_limit_is_no_transient() -> None:
    value = np.array([10.0, 10.5, 10.0])
    assert not transient(value, np.ones(3, np.bool_), 0.125, 4.0).any()


def test_temperature_has_limits_of_its_own_and_what_a_channel_states_wins() -> None:
    rules = ChannelRules.of("oil_temperature", Channel(source="T", unit="degC"))
    assert (rules.frozen_after_s, rules.shortest_gap_s) == (900.0, 5.0)
    stated = {"valid_range": (5.0, 80.0), "resolution": 0.5, "frozen_after_s": 120.0}
    channel = Channel(source="T", unit="degC", **stated)
    rules = ChannelRules.of("oil_temperature", channel)
    assert {name: getattr(rules, name) for name in stated} == stated


def test_maximum_to_half_of_the_resolution() -> None:
    value = np.array([19.98, 19.9899, 19.9901, 20.0 - 1e-12, 20.0, 20.02, np.nan])
    found = at_maximum(value, 20.0, 0.02).tolist()
    assert found == [False, False, True, True, True, True, False]
    assert at_maximum(value, 20.0, 0.0).tolist() == [*[False] * 3, True, True, True, False]
    assert not at_maximum(value, None, 0.02).any()


def test_several_rules_count_each_and_once_under_any() -> None:
    """At its maximum the sensor is out of range here, too; what is not finite is not missing."""
    value = lively(200)
    value[100:104] = 120.0
    value[[10, 20, 30]] = np.nan, np.inf, -np.inf
    cleaned = clean_channel(raw(stamps(200), value), replace(RULES, sensor_maximum=120.0))
    counts = {"not_finite": 3, "out_of_range": 6, "at_maximum": 5, "any": 7}
    assert refused_by(cleaned) == counts
    np.testing.assert_array_equal(np.flatnonzero(cleaned.refused), [10, 20, 30, *range(100, 104)])
    np.testing.assert_array_equal(np.flatnonzero(cleaned.at_maximum), [20, *range(100, 104)])


def slow_hampel(value: Floats, window: int, threshold: float, resolution: float) -> list[bool]:
    """The definition, sample by sample; beyond its ends the signal is mirrored."""
    half = window // 2
    mirrored = np.pad(value, half, mode="reflect")
    flags = []
    for centre in range(len(value)):
        around = [float(value) for value in mirrored[centre : centre + window]]
        middle = statistics.median(around)
        scaled_mad = statistics.median(abs(value - middle) for value in around) * 1.4826022185056018
        # A distance in steps of the sensor is not exceeded by a hundredth of one.
        limit = max(threshold * scaled_mad, (threshold + 0.01) * resolution)
        flags.append(abs(value[centre] - middle) > limit)
    return flags


@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([3, 5, 11, 21]),
    st.sampled_from([2.0, 3.0, 5.0]),
    st.sampled_from([0.0, 0.1, 1.0]),
    st.booleans(),
)
def test_spikes_are_those_of_the_slow_definition(
    seed: int, window: int, threshold: float, resolution: float, in_steps: bool
) -> None:
    rng = np.random.default_rng(seed)
    value = np.cumsum(rng.standard_t(2, 120))
    if in_steps and resolution:
        value = np.round(value / resolution) * resolution
    expected = slow_hampel(value, window, threshold, resolution)
    assert spike(value, window, threshold, resolution).tolist() == expected


def test_reading_beyond_the_floor_by_rounding_is_a_spike() -> None:
    """As the definition has it: 103.01 - 100.0 is more than 3.01."""
    value = np.full(21, 100.0)
    value[10] = 103.01
    assert value[10] - 100.0 > (3.0 + STEP_ROUNDING) * 1.0
    assert np.flatnonzero(spike(value, 11, 3.0, 1.0)).tolist() == [10]


def test_spikes_between_borders_are_judged_by_themselves() -> None:
    value = np.random.default_rng(5).standard_t(2, 300)
    borders = np.array([10, 21, 90, 291])
    alone = [spike(part, 11, 5.0, 0.1) for part in np.split(value, borders)]
    found = spike(value, 11, 5.0, 0.1, borders)
    np.testing.assert_array_equal(found, np.concatenate(alone))
    assert found[:21].any()
    # Fewer samples than a window are not judged.
    assert not found[:10].any()


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 40.0, -45.0]), st.booleans())
def test_samples_before_a_gap_do_not_judge_those_after_it(
    seed: int, level: float, is_silent: bool
) -> None:
    """A gap of silence, or of values that are out of range."""
    after = 50.0 + np.random.default_rng(seed).standard_t(2, 60)
    value = np.concatenate([lively(60) + level, np.full(60, 500.0), after])
    time = stamps(180)
    seen = np.delete(np.arange(180), np.arange(60, 120) if is_silent else [])
    alone = clean_channel(raw(time[120:], after), RULES)
    both = clean_channel(raw(time[seen], value[seen]), RULES)
    np.testing.assert_array_equal(both.refused[-60:], alone.refused)


@pytest.mark.parametrize(("n", "refused"), [(601, 0), (602, 602)])
def test_a_frozen_stretch_of_just_the_limit_is_credible(n: int, refused: int) -> None:
    """601 samples, first to last: 60.0 s."""
    value = lively(2000)
    value[500 : 500 + n] = 42.0
    assert clean_channel(raw(stamps(2000), value), RULES).counts["frozen"] == refused


@given(st.data())
def test_frozen_stretches_are_as_looked_at_pair_by_pair(data: st.DataObject) -> None:
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


def test_a_gap_freezes_nothing() -> None:
    """The same reading before and after a night in the garage: nobody saw it frozen."""
    value = lively(400)
    value[195:205] = 50.1
    time = stamps(400)
    time[200:] += 3600 * SECOND
    assert refused_by(clean_channel(raw(time, value), RULES)) == {}


def test_speed_of_a_halted_motor_is_not_frozen() -> None:
    """An encoder at rest says 0 for hours; that is a standstill, not a fault."""
    rules = ChannelRules.of("speed", Channel(source="n", unit="rpm", resolution=0.1))
    value = lively(3000)
    value[1000:2000] = 0.0
    assert refused_by(clean_channel(raw(stamps(3000), value), rules)) == {}
    value[1000:2000] = 30.0
    stuck = clean_channel(raw(stamps(3000), value), rules)
    assert refused_by(stuck) == {"frozen": 1000, "any": 1000}


@given(st.permutations(range(12)), st.integers(20, 60))
def test_chunks_written_in_any_order_are_all_put_back(order: list[int], size: int) -> None:
    """Files whose names do not sort as their times do; a logger that flushed late."""
    time, value = stamps(12 * size), lively(12 * size)
    rows = np.concatenate([np.arange(piece * size, (piece + 1) * size) for piece in order])
    found = as_read("pressure_difference", time[rows], value[rows])
    np.testing.assert_array_equal(found.time_us, time)
    np.testing.assert_array_equal(found.value, value)
    assert found.counts["any"] == 0
    assert found.noted["backward_time"] == int(backward_time(time[rows]).sum())


def test_a_clock_that_was_set_back_runs_over_times_that_are_taken() -> None:
    for back_us in (30 * STEP, 30 * STEP + STEP // 2, 30 * STEP + 7):
        time = stamps(300)
        time[150:] -= back_us
        found = as_read("pressure_difference", time, lively(300))
        assert found.noted["backward_time"] == 0
        assert found.counts["backward_time"] + found.counts["duplicate_time"] in (30, 31)


def test_of_two_rows_that_contradict_each_other_the_stray_one_is_refused() -> None:
    time = stamps(100) + 3600 * SECOND
    time[1] = 0
    backward = backward_time(time)
    late, stray = written_late(time, backward, time[~backward])
    assert (late.tolist(), stray.tolist()) == ([0], [1])
    found = as_read("pressure_difference", time, lively(100))
    assert found.counts["backward_time"] == 1
    np.testing.assert_array_equal(found.value, np.delete(lively(100), 1))


def test_jitter_is_counted_and_refuses_nothing_and_samples_left_out_are_none() -> None:
    time = stamps(1000)
    time[[100, 500, 700]] += 40_000
    found = as_read("pressure_difference", time, lively(1000))
    assert (found.noted["jitter"], found.counts["any"]) == (6, 0)
    left = np.delete(stamps(1000), [5, 70, 71, 72])
    assert Steps.of(left).n_jittered(left) == 0
