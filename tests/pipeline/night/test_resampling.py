"""Channels on the time base, against a slow reference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.night.channel_rules import Sampling
from pipeline.night.cleaning import CleanChannel
from pipeline.night.resampling import on_grid
from tests.pipeline.night.channels import SECOND, STEP, Times, cleaned


def slow_interpolation(channel: CleanChannel, grid: Times) -> tuple[list[float | None], list[bool]]:
    """The definition, point by point: value where there is one, and whether the channel slept."""
    times = channel.time_us.tolist()
    values: list[float | None] = []
    silent = []
    for point in grid.tolist():
        before = max((i for i, t in enumerate(times) if t <= point), default=None)
        after = min((i for i, t in enumerate(times) if t >= point), default=None)
        value = None
        if before is None or after is None:
            silent.append(True)
        elif before == after:
            silent.append(False)
            if not channel.refused[before]:
                value = float(channel.value[before])
        else:
            distance = times[after] - times[before]
            ends = channel.ends is not None and bool(channel.ends[before])
            silent.append(ends or distance > channel.longest_gap_us)
            good = not (channel.refused[before] or channel.refused[after] or silent[-1])
            if good:
                share = (point - times[before]) / distance
                value = float((1 - share) * channel.value[before] + share * channel.value[after])
        values.append(value)
    return values, silent


def slow_hold(channel: CleanChannel, grid: Times) -> tuple[list[float | None], list[bool]]:
    """The same of a channel whose last sample holds until it is too old, or says that none is."""
    values: list[float | None] = []
    silent = []
    for point in grid.tolist():
        last = int(np.searchsorted(channel.time_us, point, side="right")) - 1
        age = point - int(channel.time_us[last]) if last >= 0 else np.inf
        ended = last >= 0 and channel.ends is not None and bool(channel.ends[last]) and age > 0
        silent.append(ended or age > channel.longest_gap_us)
        good = not silent[-1] and not channel.refused[last]
        values.append(float(channel.value[last]) if good else None)
    return values, silent


ANY_STAMPS = st.lists(st.integers(0, 400), unique=True, max_size=30).map(sorted)
# Begin, and stretches of so many equal steps, mostly from one time of the grid to another.
EVEN_STAMPS = st.tuples(
    st.sampled_from([-200, -50, 0, 5, 30, 390]),
    st.lists(st.tuples(st.integers(1, 9), st.sampled_from([10, 10, 20, 30, 50, 7])), max_size=8),
).map(lambda one: np.cumsum([one[0], *(step for n, step in one[1] for _ in range(n))]).tolist())


class TestInterpolation:
    @given(
        st.one_of(ANY_STAMPS, EVEN_STAMPS),
        st.integers(0, 2**32 - 1),
        st.integers(1, 60),
        st.booleans(),
        st.booleans(),
        st.sampled_from([10.0, 20.0, 30.0, 50.0]),
    )
    def test_as_the_slow_definition(
        self,
        times: list[int],
        seed: int,
        longest: int,
        on_change: bool,
        hold: bool,
        period_us: float,
    ) -> None:
        rng = np.random.default_rng(seed)
        time = np.array(times, np.int64)
        value = rng.normal(0, 10, len(time))
        refused = rng.random(len(time)) < 0.2
        value[refused] = rng.choice([np.nan, np.inf, 1e9], refused.sum())
        channel = cleaned(time, value, refused, period_us=period_us, longest_gap_us=longest)
        channel = replace(channel, ends=rng.random(len(time)) < 0.2) if on_change else channel
        channel = replace(channel, sampling=Sampling(on_change=on_change, hold=hold))
        grid = np.arange(-20, 420, 10, dtype=np.int64)
        got, present, silent = on_grid(channel, grid, 10)
        expected, asleep = (slow_hold if hold else slow_interpolation)(channel, grid)
        assert present.tolist() == [one is not None for one in expected]
        assert silent.tolist() == asleep
        np.testing.assert_allclose(
            got[present], [one for one in expected if one is not None], rtol=1e-12, atol=1e-9
        )
        assert np.isnan(got[~present]).all()

    def test_never_across_a_refused_sample(self) -> None:
        """One refused temperature sample costs the nineteen points between its neighbours."""
        time = np.arange(10, dtype=np.int64) * SECOND
        channel = cleaned(
            time, 50 + time / SECOND, time == 5 * SECOND, period_us=SECOND, longest_gap_us=5e6
        )
        grid = np.arange(91, dtype=np.int64) * STEP
        got, present, silent = on_grid(channel, grid, STEP)
        np.testing.assert_array_equal(np.flatnonzero(~present), range(41, 60))
        np.testing.assert_allclose(got[present], 50 + grid[present] / SECOND, rtol=1e-15)
        assert not silent.any()

    def test_channel_without_samples(self) -> None:
        none = np.zeros(0, np.int64)
        channel = cleaned(none, np.zeros(0), period_us=None)
        got, present, silent = on_grid(channel, np.arange(5) * STEP, STEP)
        assert np.isnan(got).all()
        assert not present.any()
        assert silent.all()


class TestAverage:
    """Channels faster than the grid are averaged over its cells."""

    TIME = np.arange(1000, dtype=np.int64) * 10_000
    GRID = np.arange(1, 100, dtype=np.int64) * STEP

    @pytest.mark.parametrize("share", [0.0, 0.3, 0.6])
    def test_mean_of_what_is_kept_of_the_cell_around_each_point(self, share: float) -> None:
        rng = np.random.default_rng(1)
        value, refused = rng.normal(0, 1, 1000), rng.random(1000) < share
        value[refused] = np.nan
        channel = cleaned(self.TIME, value, refused, period_us=1e4)
        got, present, silent = on_grid(channel, self.GRID, STEP)
        assert not silent.any()
        cells = [value[round(at / 1e4) - 5 : round(at / 1e4) + 5] for at in self.GRID]
        # Of ten samples at least half.
        enough = [np.isfinite(cell).sum() >= 5 for cell in cells]
        assert present.tolist() == enough
        expected = [np.nanmean(cell) for cell, has in zip(cells, enough, strict=True) if has]
        np.testing.assert_allclose(got[present], expected, rtol=1e-12)
        assert np.isnan(got[~present]).all()

    @pytest.mark.parametrize(("period_us", "averaged"), [(66_666.0, True), (66_667.0, False)])
    def test_more_than_one_and_a_half_samples_a_cell(
        self, period_us: float, averaged: bool
    ) -> None:
        """Spikes between points of the grid, which a mean sees and a line does not."""
        value = np.where(self.TIME % STEP == 30_000, 1.0, 0.0)
        got, _, _ = on_grid(cleaned(self.TIME, value, period_us=period_us), self.GRID, STEP)
        assert bool(got.any()) == averaged
