"""Samples that the log itself does not call good: refused, counted, and the end of what is held."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from pipeline.config import Channel, Cleaning, MotorSpec
from pipeline.config.logs import Logs
from pipeline.ingest import RawChannel
from pipeline.night.channel_rules import ChannelRules
from pipeline.night.cleaning import CleanChannel, clean_channel
from pipeline.night.fit_night import fit_night
from pipeline.night.resampling import on_grid
from tests.pipeline.night.channels import SECOND, Times, as_read, refused_by
from tests.pipeline.night.noise_free import configured_flow, refused_of
from tests.pipeline.simulated import CANONICAL, Array, night_of, operate, raw

Mask = NDArray[np.bool_]
ON_CHANGE: dict[str, Any] = {"sampling": "on_change", "longest_silence_s": 300.0}
LONG = Logs(format="csv", files=("*.csv",), layout="long")


def cleaned(
    time_us: Times, value: Array, bad: Any, logs: Logs | None = None, **keys: Any
) -> CleanChannel:
    name = "leakage_flow" if "counts" in keys else "pressure_difference"
    channel = Channel(source="x", unit="count" if "counts" in keys else "bar", **keys)
    rules = ChannelRules.of(name, channel, Cleaning(), logs)
    mask = np.zeros(len(value), np.bool_)
    mask[bad] = True
    return clean_channel(as_read(time_us, value, mask), rules)


def at_times(channel: CleanChannel, time_us: Times) -> tuple[Array, Mask, Mask]:
    """Values of an even grid of seconds at some of its times."""
    grid = np.arange(time_us[0], time_us[-1] + 1, SECOND, dtype=np.int64)
    value, present, silent = on_grid(channel, grid, SECOND)
    chosen = (time_us - time_us[0]) // SECOND
    return value[chosen], present[chosen], silent[chosen]


def seconds(n: int) -> Times:
    return np.arange(n, dtype=np.int64) * SECOND


def lively(n: int) -> Array:
    return 100.0 + 20.0 * np.sin(np.arange(n) / 3.0)


class TestPeriodic:
    def test_a_bad_sample_is_refused_under_its_own_reason(self) -> None:
        found = cleaned(seconds(100), lively(100), [10, 11, 50])
        assert refused_by(found) == {"bad_quality": 3, "any": 3}
        assert np.flatnonzero(found.refused).tolist() == [10, 11, 50]
        assert found.n_samples == 100

    def test_bad_samples_judge_no_others(self) -> None:
        """Zeros of a broken sensor, flagged as such, make no spikes of what lies between them."""
        value = lively(200)
        bad = np.flatnonzero(np.arange(200) % 3 > 0)
        value[bad] = 0.0
        found = cleaned(seconds(200), value, bad)
        assert refused_by(found) == {"bad_quality": len(bad), "any": len(bad)}

    def test_a_blank_cell_between_the_samples_of_a_slow_channel_is_none_however_bad(self) -> None:
        """One column of qualities for all channels of a wide log: the row is of another one."""
        value = np.full(100, np.nan)
        value[::10] = lively(10)
        found = cleaned(seconds(100), value, [3, 14, 15, 20])
        assert found.n_samples == 10
        assert refused_by(found) == {"bad_quality": 1, "any": 1}

    def test_a_counter_of_which_a_reading_is_bad_leaves_no_interval(self) -> None:
        total = np.arange(60.0) * 3.0
        total[30] = 7.0
        stated: dict[str, Any] = {"counts": "cumulative", "volume_per_count_cm3": 1.0}
        found = cleaned(seconds(60), total, [30], **stated)
        assert refused_by(found) == {"bad_quality": 1, "no_interval": 2, "any": 3}
        np.testing.assert_allclose(found.value[~found.refused], 0.18)
        pulses = np.full(60, 3.0)
        pulses[30] = 500.0
        stated["counts"] = "pulses"
        found = cleaned(seconds(60), pulses, [30], **stated)
        assert refused_by(found) == {"bad_quality": 1, "no_interval": 1, "any": 2}


class TestOnChange:
    """Silence after a bad sample is a gap; before it the value holds as ever."""

    TIME = np.array([0, 100, 200, 260, 500], dtype=np.int64) * SECOND
    VALUE = np.array([10.0, 20.0, 30.0, 40.0, 50.0])
    GRID = np.array([0, 99, 100, 199, 200, 201, 259, 260, 499, 500, 800, 801]) * SECOND

    def test_held(self) -> None:
        found = cleaned(self.TIME, self.VALUE, [2], between="hold", **ON_CHANGE)
        value, present, silent = at_times(found, self.GRID)
        assert value[present].tolist() == [10, 10, 20, 20, 40, 40, 50, 50]
        assert np.flatnonzero(~present).tolist() == [4, 5, 6, 11]
        # At its own time a bad sample is refused; from there on there is none.
        assert np.flatnonzero(silent).tolist() == [5, 6, 11]

    @pytest.mark.parametrize("between", ["hold", "interpolate"])
    def test_a_bad_row_without_a_value_ends_it_too(self, between: str) -> None:
        """As a historian marks that its source was lost."""
        value = self.VALUE.copy()
        value[2] = np.nan
        found = cleaned(self.TIME, value, [2], between=between, **ON_CHANGE)
        assert refused_by(found) == {"missing": 1, "bad_quality": 1, "any": 1}
        _, present, silent = at_times(found, self.GRID)
        with_value = cleaned(self.TIME, self.VALUE, [2], between=between, **ON_CHANGE)
        np.testing.assert_array_equal(present, at_times(with_value, self.GRID)[1])
        np.testing.assert_array_equal(silent, at_times(with_value, self.GRID)[2])

    def test_a_blank_of_a_wide_log_says_nothing_and_a_row_of_its_own_says_there_is_none(
        self,
    ) -> None:
        value = self.VALUE.copy()
        value[2] = np.nan
        wide = cleaned(self.TIME, value, [], between="hold", **ON_CHANGE)
        assert (wide.n_samples, refused_by(wide)) == (4, {})
        value_at = at_times(wide, np.array([250]) * SECOND)[0]
        assert value_at.tolist() == [20.0]
        own = cleaned(self.TIME, value, [], LONG, between="hold", **ON_CHANGE)
        assert (own.n_samples, refused_by(own)) == (5, {"missing": 1, "any": 1})
        _, present, silent = at_times(own, np.array([199, 250, 260]) * SECOND)
        assert present.tolist() == [True, False, True]
        assert silent.tolist() == [False, True, False]

    @given(
        st.lists(st.tuples(st.integers(1, 400), st.booleans()), min_size=1, max_size=30),
        st.booleans(),
    )
    def test_as_one_by_one(self, steps: list[tuple[int, bool]], hold: bool) -> None:
        """The definition, time by time."""
        time = np.cumsum([step for step, _ in steps]).astype(np.int64) * SECOND
        bad = np.array([flag for _, flag in steps])
        value = np.arange(len(time), dtype=np.float64) + 1.0
        between = "hold" if hold else "interpolate"
        found = cleaned(time, value, np.flatnonzero(bad), between=between, **ON_CHANGE)
        found = replace(found, refused=bad)  # whatever else may refuse
        grid = np.arange(0, int(time[-1]) + 400 * SECOND, 7 * SECOND, dtype=np.int64)
        got, present, _ = at_times(found, grid)
        for at, result in zip(grid.tolist(), np.where(present, got, np.nan).tolist(), strict=True):
            expected = self.slowly(time.tolist(), value.tolist(), bad.tolist(), at, hold)
            assert result == pytest.approx(expected, nan_ok=True)

    @staticmethod
    def slowly(time: list[int], value: list[float], bad: list[bool], at: int, hold: bool) -> float:
        before = [i for i, moment in enumerate(time) if moment <= at]
        if not before or bad[before[-1]]:
            return float("nan")
        last = before[-1]
        if hold:
            return value[last] if at - time[last] <= 300 * SECOND else float("nan")
        if time[last] == at:
            return value[last]
        if last + 1 == len(time) or bad[last + 1] or time[last + 1] - time[last] > 300 * SECOND:
            return float("nan")
        share = (at - time[last]) / (time[last + 1] - time[last])
        return value[last] + share * (value[last + 1] - value[last])


def test_a_night_with_bad_samples_is_the_night_without_them(spec: MotorSpec) -> None:
    """The same model to the last digit, whatever stands in the samples that the log calls bad."""
    moving = operate(minutes=60.0)
    channels = raw(moving.time_us, moving.channels(configured_flow(spec, moving)))
    bad = np.zeros(len(moving.time_us), np.bool_)
    bad[300:420] = bad[2000:2010] = True
    flagged, without = dict(channels), dict(channels)
    for name in CANONICAL:
        one = channels[name]
        nonsense = np.where(bad, 1.0, one.value)
        flagged[name] = RawChannel(one.time_us, nonsense, one.missing, 0, bad)
        without[name] = RawChannel(one.time_us, np.where(bad, np.nan, one.value), bad, 0)
    outcomes = [fit_night(spec, night_of(), channels, {}) for channels in (flagged, without)]
    assert outcomes[0].model == outcomes[1].model != {}
    counted = refused_of(outcomes[0])
    assert {counted[name, "bad_quality"] for name in CANONICAL} == {130}
