"""The rules on values: ranges, spikes, and sensors that are frozen."""

from __future__ import annotations

import statistics
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.config import Channel, Cleaning
from pipeline.night.channel_rules import ChannelRules
from pipeline.night.cleaning import clean_channel
from pipeline.night.masks import STEP_ROUNDING, at_maximum, frozen, out_of_range, spike
from tests.pipeline.night.channels import RULES, SECOND, Floats, lively, raw, refused_by, stamps


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

    def test_coarse_signal_keeps_its_steps(self) -> None:
        """MAD 0 without the floor: each lone step of the sensor would be a spike."""
        value = np.full(50, 20.0)
        value[[10, 30]] = 20.1, 20.5
        assert not spike(value, 11, 5.0, 0.1).any()
        value[30] = 20.6
        assert np.flatnonzero(spike(value, 11, 5.0, 0.1)).tolist() == [30]

    def test_reading_beyond_the_floor_by_rounding_is_a_spike(self) -> None:
        """As the definition has it: 103.01 - 100.0 is more than 3.01."""
        value = np.full(21, 100.0)
        value[10] = 103.01
        assert value[10] - 100.0 > (3.0 + STEP_ROUNDING) * 1.0
        assert np.flatnonzero(spike(value, 11, 3.0, 1.0)).tolist() == [10]

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


class TestFrozen:
    """60 s without a change beyond the resolution; temperature 900 s."""

    @pytest.mark.parametrize(("n", "refused"), [(601, 0), (602, 602)])
    def test_a_stretch_of_just_the_limit_is_credible(self, n: int, refused: int) -> None:
        """601 samples, first to last: 60.0 s."""
        value = lively(2000)
        value[500 : 500 + n] = 42.0
        assert clean_channel(raw(stamps(2000), value), RULES).counts["frozen"] == refused

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

    def test_a_gap_adds_no_time(self) -> None:
        """The same reading before and after a night in the garage: nobody saw it frozen."""
        value = lively(400)
        value[195:205] = 50.1
        time = stamps(400)
        time[200:] += 3600 * SECOND
        assert refused_by(clean_channel(raw(time, value), RULES)) == {}

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
