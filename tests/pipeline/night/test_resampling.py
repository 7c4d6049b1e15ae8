"""Channels on the time base, against a slow reference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

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
        st.sampled_from([10.0, 20.0, 30.0, 50.0]),
    )
    def test_as_the_slow_definition(
        self,
        times: list[int],
        seed: int,
        longest: int,
        on_change: bool,
        period_us: float,
    ) -> None:
        rng = np.random.default_rng(seed)
        time = np.array(times, np.int64)
        value = rng.normal(0, 10, len(time))
        refused = rng.random(len(time)) < 0.2
        value[refused] = rng.choice([np.nan, np.inf, 1e9], refused.sum())
        channel = cleaned(time, value, refused, period_us=period_us, longest_gap_us=longest)
        channel = replace(channel, ends=rng.random(len(time)) < 0.2) if on_change else channel
        grid = np.arange(-20, 420, 10, dtype=np.int64)
        got, present, silent = on_grid(channel, grid, 10)
        expected, asleep = slow_interpolation(channel, grid)
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

    def test_mean_of_the_cell_around_each_point(self) -> None:
        value = np.random.default_rng(1).normal(0, 1, 1000)
        got, present, silent = on_grid(cleaned(self.TIME, value, period_us=1e4), self.GRID, STEP)
        assert present.all()
        assert not silent.any()
        expected = [
            value[(from_point >= -STEP // 2) & (from_point < STEP // 2)].mean()
            for from_point in (self.TIME - point for point in self.GRID)
        ]
        np.testing.assert_allclose(got, expected, rtol=1e-12)

    def test_refused_samples_do_not_count(self) -> None:
        value = np.ones(1000)
        refused = np.arange(1000) % 10 < 5
        value[refused] = np.nan
        got, present, _ = on_grid(
            cleaned(self.TIME, value, refused, period_us=1e4), self.GRID, STEP
        )
        assert present.all()
        np.testing.assert_array_equal(got, 1.0)

    def test_less_than_half_of_a_cell_is_no_value(self) -> None:
        refused = np.arange(1000) % 10 < 6
        channel = cleaned(self.TIME, np.ones(1000), refused, period_us=1e4)
        got, present, silent = on_grid(channel, self.GRID, STEP)
        assert not present.any()
        assert np.isnan(got).all()
        assert not silent.any()
