"""The time base: the grid, channels on it against a slow reference, joint rules, and halts."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from dataclasses import replace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from pipeline.arrays import SECOND_US
from pipeline.config import Cleaning, SensorHealth, Settings, TimeBase
from pipeline.config.nights import Night
from pipeline.night import resampling
from pipeline.night.channel_rules import Sampling
from pipeline.night.cleaning import CleanChannel
from pipeline.night.halts import Halts, settled_halts
from pipeline.night.resampling import on_grid
from pipeline.night.time_base import Quality, Samples, bring_together, grid_period_us
from tests.pipeline.night.channels import SECOND, STEP, Times, cleaned

START = 1_767_333_600 * SECOND  # 2026-01-02 06:00 UTC
END = START + 24 * 3600 * SECOND


def running(seconds: float, begin_us: int = START, rate_hz: int = 10) -> dict[str, CleanChannel]:
    """A motor that runs: temperature every second, all else at the stated rate."""
    period = SECOND // rate_hz
    time = begin_us + np.arange(round(seconds * rate_hz) + 1) * period
    slow = begin_us + np.arange(int(seconds) + 1) * SECOND
    s = (time - START) / SECOND
    fast = {
        "pressure_difference": 200 + 50 * np.sin(s / 7),
        "speed": 30 + 5 * np.cos(s / 11),
        "leakage_flow": 1 + 0.1 * np.sin(s / 5),
    }
    channels = {
        name: cleaned(time, value, period_us=period, longest_gap_us=5.0 * period)
        for name, value in fast.items()
    }
    temperature = 50 + np.sin((slow - START) / SECOND / 60)
    channels["oil_temperature"] = cleaned(
        slow, temperature, period_us=SECOND, longest_gap_us=5.0 * SECOND
    )
    return channels


def together(
    channels: Mapping[str, CleanChannel], **settings: Any
) -> tuple[Samples, dict[tuple[str, str], Quality]]:
    here = Night(dt.date(2026, 1, 3), START, END)
    own = Settings().model_copy(update={"cleaning": Cleaning(**settings)})
    samples, found = bring_together(channels, here, own)
    keys = [(one.channel, one.reason) for one in found]
    assert len(keys) == len(set(keys))
    return samples, {(one.channel, one.reason): one for one in found}


def grid_of(*rates_hz: float, **settings: float) -> int:
    channels = {
        str(rate): cleaned(np.zeros(0, np.int64), np.zeros(0), period_us=SECOND / rate)
        for rate in rates_hz
    }
    return grid_period_us(channels, TimeBase(**settings))


@given(st.integers(1, 10), st.floats(-0.04, 0.04))
def test_jitter_gives_no_grid_of_its_own(rate_hz: int, jitter: float) -> None:
    assert grid_of(rate_hz * (1 + jitter)) == round(SECOND / rate_hz)


@given(st.floats(0.01, 2000.0))
def test_never_faster_than_ten_hertz_unless_stated(rate_hz: float) -> None:
    assert grid_of(rate_hz) >= SECOND // 10


def test_stated_rate_wins() -> None:
    assert grid_of(5.0, rate_hz=20.0) == 50_000
    assert grid_of(5.0, rate_hz=0.5) == 2 * SECOND


def test_counts_from_the_night_s_start() -> None:
    samples, _ = together(running(60, START + 3600 * SECOND + 30_000))
    np.testing.assert_array_equal(samples.time_us, START + samples.index * samples.period_us)
    # The first point after the log's first sample, which stands 30 ms off the grid.
    assert samples.index[0] == 36_001


def test_night_is_half_open() -> None:
    samples, _ = together(running(30, END - 10 * SECOND))
    assert samples.time_us[-1] == END - STEP
    samples, _ = together(running(30, START))
    assert samples.time_us[0] == START


@pytest.mark.parametrize("rate_hz", [10, 20, 100])
@pytest.mark.parametrize("n", [1, 2, 5])
def test_a_log_that_touches_the_night_with_a_few_samples(rate_hz: int, n: int) -> None:
    """None of them on a point of the grid: there is nothing to keep, and no fault."""
    period = SECOND // rate_hz
    time = START + 3000 + np.arange(n, dtype=np.int64) * period
    time = time[time < START + STEP]
    channels = {name: cleaned(time, np.ones(len(time)), period_us=period) for name in FLEET}
    samples, quality = together(channels)
    assert len(samples.index) == samples.n_logged == 0
    assert samples.kept_share == 0.0
    assert all(one.n_refused == 0 for one in quality.values())


FLEET = ("pressure_difference", "oil_temperature", "speed", "leakage_flow")


@pytest.mark.parametrize("port", ["high_port_pressure", "low_port_pressure"])
def test_a_port_that_is_refused_refuses_the_difference(port: str) -> None:
    channels = running(60)
    pressure = channels.pop("pressure_difference")
    ports = dict.fromkeys(("high_port_pressure", "low_port_pressure"), pressure)
    ports[port] = replace(pressure, refused=np.arange(len(pressure.value)) == 100)
    samples, quality = together({**channels, **ports})
    assert 100 not in samples.index
    assert quality["time_base", "incomplete"].n_refused == 1


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_standstill_and_its_guard_times(sign: float) -> None:
    """Still from 100.0 to 109.9 s: refused from 90.0 to 139.9 s."""
    channels = running(200)
    speed = channels["speed"].value
    speed *= sign
    speed[500:600], speed[1000:1100] = sign * 0.51, sign * 0.49
    samples, quality = together(channels)
    assert quality["time_base", "standstill"].n_refused == 100
    assert quality["time_base", "guard"].n_refused == 100 + 300
    assert quality["time_base", "any"].n_refused == 500
    lost = np.setdiff1d(np.arange(2001), samples.index)
    np.testing.assert_array_equal(lost, range(900, 1400))
    assert samples.n_running == 2001 - 500
    assert samples.kept_share == 1.0


def test_back_flow_and_its_guard_times() -> None:
    channels = running(200)
    flow = channels["leakage_flow"]
    back = np.arange(2001) == 1000
    channels["leakage_flow"] = replace(flow, refused=back, at_maximum=back)
    samples, quality = together(channels)
    lost = np.setdiff1d(np.arange(2001), samples.index)
    np.testing.assert_array_equal(lost, range(900, 1301))
    assert quality["time_base", "guard"].n_refused == 401
    assert quality["time_base", "standstill"].n_refused == 0


def test_transients_only_where_asked_for() -> None:
    channels = running(200)
    channels["speed"].value[1000:] += 20.0
    _, quality = together(channels)
    assert ("time_base", "transient") not in quality
    samples, quality = together(channels, refuse_transients=True)
    assert quality["time_base", "transient"].n_refused == 2
    assert not {999, 1000} & set(samples.index.tolist())


def test_each_reason_counts_and_any_once() -> None:
    """A gap in the flow within a standstill: refused for both, counted once under any."""
    channels = running(200)
    channels["speed"].value[1000:1100] = 0.0
    flow = channels["leakage_flow"]
    awake = (np.arange(2001) < 1020) | (np.arange(2001) > 1060)
    channels["leakage_flow"] = cleaned(flow.time_us[awake], flow.value[awake])
    _, quality = together(channels)
    assert quality["leakage_flow", "gap"].n_refused == 41
    assert quality["time_base", "incomplete"].n_refused == 41
    assert quality["time_base", "standstill"].n_refused == 100
    assert quality["time_base", "any"].n_refused == 500


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


@given(
    st.one_of(ANY_STAMPS, EVEN_STAMPS),
    st.integers(0, 2**32 - 1),
    st.integers(1, 60),
    st.booleans(),
    st.booleans(),
    st.sampled_from([10.0, 20.0, 30.0, 50.0]),
    st.sampled_from([2, resampling.EVEN_SAMPLES]),
)
def test_as_the_slow_definition(
    times: list[int],
    seed: int,
    longest: int,
    on_change: bool,
    hold: bool,
    period_us: float,
    even_samples: int,
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
    # Also where the stretches are shorter than such as pay.
    with patch.object(resampling, "EVEN_SAMPLES", even_samples):
        got, present, silent = on_grid(channel, grid, 10)
    expected, asleep = (slow_hold if hold else slow_interpolation)(channel, grid)
    assert present.tolist() == [one is not None for one in expected]
    assert silent.tolist() == asleep
    np.testing.assert_allclose(
        got[present], [one for one in expected if one is not None], rtol=1e-12, atol=1e-9
    )
    assert np.isnan(got[~present]).all()


FAST_US = np.arange(1000, dtype=np.int64) * 10_000
CELLS_US = np.arange(1, 100, dtype=np.int64) * STEP


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6])
def test_mean_of_what_is_kept_of_the_cell_around_each_point(share: float) -> None:
    rng = np.random.default_rng(1)
    value, refused = rng.normal(0, 1, 1000), rng.random(1000) < share
    value[refused] = np.nan
    channel = cleaned(FAST_US, value, refused, period_us=1e4)
    got, present, silent = on_grid(channel, CELLS_US, STEP)
    assert not silent.any()
    cells = [value[round(at / 1e4) - 5 : round(at / 1e4) + 5] for at in CELLS_US]
    # Of ten samples at least half.
    enough = [np.isfinite(cell).sum() >= 5 for cell in cells]
    assert present.tolist() == enough
    expected = [np.nanmean(cell) for cell, has in zip(cells, enough, strict=True) if has]
    np.testing.assert_allclose(got[present], expected, rtol=1e-12)
    assert np.isnan(got[~present]).all()


@pytest.mark.parametrize(("period_us", "averaged"), [(66_666.0, True), (66_667.0, False)])
def test_more_than_one_and_a_half_samples_a_cell(period_us: float, averaged: bool) -> None:
    """Spikes between points of the grid, which a mean sees and a line does not."""
    value = np.where(FAST_US % STEP == 30_000, 1.0, 0.0)
    got, _, _ = on_grid(cleaned(FAST_US, value, period_us=period_us), CELLS_US, STEP)
    assert bool(got.any()) == averaged


Array = NDArray[np.float64]

N = 6000
GRID = np.arange(N, dtype=np.int64) * SECOND_US
# Left out after the motor has stopped, and needed after that [s]: the defaults.
SETTLE, NEEDED = 45, 20
ZERO_BAR, ZERO_FLOW = 0.7, 0.03


def channel(values: Array, at_maximum: object = False) -> CleanChannel:
    """A cleaned channel of one sample a second."""
    period = {"period_us": SECOND_US, "longest_gap_us": 5.0 * SECOND_US}
    return cleaned(GRID, values, at_maximum=at_maximum, **period)


def night(*halts: tuple[int, int]) -> tuple[NDArray[np.bool_], Array, Array]:
    """Standstill, pressure and flow of a motor that runs but in these halts."""
    still = np.zeros(N, dtype=np.bool_)
    for first, end in halts:
        still[first:end] = True
    generator = np.random.default_rng(1)
    bar = np.where(still, ZERO_BAR, 180.0) + 0.05 * generator.standard_normal(N)
    flow = np.where(still, ZERO_FLOW, 1.4) + 0.002 * generator.standard_normal(N)
    return still, bar, flow


def found(still: NDArray[np.bool_], bar: Array, flow: Array, **more: CleanChannel) -> Halts:
    channels = {"pressure_difference": channel(bar), "leakage_flow": channel(flow)} | more
    return settled_halts(still, GRID, channels, SensorHealth(without_pressure_at_halts=True))


THREE = ((500, 700), (2000, 2300), (4000, 4200))


def test_the_zeros_are_those_that_were_put_in() -> None:
    seen = found(*night(*THREE))
    assert seen.n == 3
    for zero, truth, sd in (
        (seen.pressure_bar, ZERO_BAR, 0.05),
        (seen.flow_l_per_min, ZERO_FLOW, 0.002),
    ):
        assert zero.value == pytest.approx(truth, abs=sd)
        # From the scatter of three medians of 155 samples and more each.
        assert 0 < zero.standard_error < sd / 4


@pytest.mark.parametrize(
    ("disturbed", "is_at_maximum", "n"),
    [
        pytest.param([*range(500, 540), *range(2000, 2040)], False, 3, id="the oil still drains"),
        # Back-flow drives the sensor to it; ten seconds are left of the halt: less than it takes.
        pytest.param([*range(2000, 2290)], True, 2, id="a sensor at its maximum"),
    ],
)
def test_readings_that_are_no_zero_are_left_out(
    disturbed: list[int], is_at_maximum: bool, n: int
) -> None:
    still, bar, flow = night(*THREE)
    flow[disturbed] = 20.0
    stuck = is_at_maximum & np.isin(np.arange(N), disturbed)
    seen = found(still, bar, flow, leakage_flow=channel(flow, stuck))
    assert seen.n == n
    assert seen.flow_l_per_min.value == pytest.approx(ZERO_FLOW, abs=0.001)


def test_a_halt_that_is_too_short_tells_nothing() -> None:
    just_too_short = SETTLE + NEEDED
    assert found(*night((500, 500 + just_too_short))).n == 0
    assert found(*night((500, 500 + just_too_short + 1))).n == 1


@pytest.mark.parametrize(
    ("low_bar", "case_bar", "is_known"),
    [(15.0, 0.0, False), (15.0, 14.0, True), (0.3, 0.0, True), (None, 0.0, False)],
)
def test_ports_show_the_zero_of_the_flow_only_where_they_are_near_case_pressure(
    low_bar: float | None, case_bar: float, is_known: bool
) -> None:
    """Equal pressures on both ports leak to the case; a difference alone is no proof."""
    still, bar, flow = night(*THREE)
    channels = {"pressure_difference": channel(bar), "leakage_flow": channel(flow)}
    if low_bar is not None:
        ports = {"high_port_pressure": low_bar + bar, "low_port_pressure": np.full(N, low_bar)}
        channels = {name: channel(values) for name, values in ports.items()} | channels
    seen = settled_halts(still, GRID, channels, SensorHealth(), case_bar)
    assert seen.n == 3
    assert seen.pressure_bar.value == pytest.approx(ZERO_BAR, abs=0.05)
    assert (seen.flow_l_per_min is not None) == is_known
