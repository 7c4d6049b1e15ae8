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
from pipeline.config import Cleaning, SensorHealth, Settings
from pipeline.config.nights import Night
from pipeline.night.cleaning import CleanChannel
from pipeline.night.on_grid import EVEN_SAMPLES, on_grid
from pipeline.night.time_base import (
    INPUTS,
    Quality,
    Samples,
    Zero,
    bring_together,
    grid_period_us,
    zeros_of_halts,
)
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
    samples, counted = bring_together(channels, here, own)
    quality = {(rule.channel, rule.reason): rule for rule in counted}
    assert len(quality) == len(counted)
    return samples, quality


def grid_of(sampled_hz: float) -> int:
    channel = cleaned(np.zeros(0, np.int64), np.zeros(0), period_us=SECOND / sampled_hz)
    return grid_period_us({"speed": channel})


@given(st.integers(1, 10), st.floats(-0.04, 0.04), st.floats(0.01, 2000.0))
def test_jitter_gives_no_grid_of_its_own_and_none_is_faster_than_ten_hertz(
    rate_hz: int, jitter: float, any_rate_hz: float
) -> None:
    assert grid_of(rate_hz * (1 + jitter)) == round(SECOND / rate_hz)
    assert grid_of(any_rate_hz) >= SECOND // 10


@pytest.mark.parametrize(
    ("begin_us", "first", "last"),
    [
        # The first point after the log's first sample, which stands 30 ms off the grid.
        (START + 3600 * SECOND + 30_000, 36_001, 36_600),
        # A night is half open.
        (END - 10 * SECOND, 863_900, 863_999),
        (START, 0, 600),
    ],
)
def test_the_grid_counts_from_the_night_s_start(begin_us: int, first: int, last: int) -> None:
    samples, _ = together(running(60, begin_us))
    np.testing.assert_array_equal(samples.time_us, START + samples.index * samples.period_us)
    assert samples.index.tolist() == [*range(first, last + 1)]


def test_what_is_refused_within_a_session_is_a_loss() -> None:
    """No sample stands on a point of the grid: 30 ms beside it."""
    channels = running(60, START + 30_000)
    channels["leakage_flow"].refused[100:150] = True
    samples, _ = together(channels)
    assert (samples.n_running, len(samples.index)) == (600, 600 - 51)


def test_while_the_logger_is_off_nothing_runs_that_could_be_lost() -> None:
    """From 20 to 40 s; at the two ends there is a sample."""
    channels = running(60)
    for name, channel in channels.items():
        is_on = abs(channel.time_us - START - 30 * SECOND) >= 10 * SECOND
        periods = {"period_us": channel.period_us, "longest_gap_us": channel.longest_gap_us}
        channels[name] = cleaned(channel.time_us[is_on], channel.value[is_on], **periods)
    samples, _ = together(channels)
    assert (samples.n_logged, samples.n_running) == (601 - 199, 601 - 199)
    assert samples.kept_share == 1.0


@pytest.mark.parametrize("rate_hz", [10, 100])
@pytest.mark.parametrize("n", [1, 2, 5])
def test_a_log_that_touches_the_night_with_a_few_samples(rate_hz: int, n: int) -> None:
    """None of them on a point of the grid: there is nothing to keep, and no fault."""
    period = SECOND // rate_hz
    time = START + 3000 + np.arange(n, dtype=np.int64) * period
    time = time[time < START + STEP]
    channels = {name: cleaned(time, np.ones(len(time)), period_us=period) for name in INPUTS}
    samples, quality = together(channels)
    assert len(samples.index) == samples.n_logged == 0
    assert samples.kept_share == 0.0
    assert all(rule.n_refused == 0 for rule in quality.values())


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
    """Still from 100.0 to 109.9 s: refused from 90.0 to 139.9 s; a gap of the flow within it."""
    channels = running(200)
    speed, flow = channels["speed"].value, channels["leakage_flow"]
    speed *= sign
    speed[500:600], speed[1000:1100] = sign * 0.51, sign * 0.49
    awake = (np.arange(2001) < 1020) | (np.arange(2001) > 1060)
    channels["leakage_flow"] = cleaned(flow.time_us[awake], flow.value[awake])
    samples, quality = together(channels)
    assert quality["leakage_flow", "gap"].n_refused == 41
    # Each reason counts, and any once.
    counts = {reason: rule.n_refused for (name, reason), rule in quality.items() if name == BASE}
    assert counts == {"standstill": 100, "guard": 400, "incomplete": 41, "any": 500}
    lost = np.setdiff1d(np.arange(2001), samples.index)
    np.testing.assert_array_equal(lost, range(900, 1400))
    assert (samples.n_running, samples.n_logged, samples.n_turning) == (2001 - 500, 2001, 1901)
    assert samples.kept_share == 1.0


BASE = "time_base"


def test_back_flow_and_its_guard_times() -> None:
    channels = running(200)
    flow = channels["leakage_flow"]
    back = np.arange(2001) == 1000
    channels["leakage_flow"] = replace(flow, refused=back, at_maximum=back)
    samples, quality = together(channels)
    lost = np.setdiff1d(np.arange(2001), samples.index)
    np.testing.assert_array_equal(lost, range(900, 1301))
    assert quality[BASE, "guard"].n_refused == 401
    assert quality[BASE, "standstill"].n_refused == 0


def test_transients_only_where_asked_for() -> None:
    channels = running(200)
    channels["speed"].value[1000:] += 20.0
    _, quality = together(channels)
    assert (BASE, "transient") not in quality
    samples, quality = together(channels, refuse_transients=True)
    assert quality[BASE, "transient"].n_refused == 2
    assert not {999, 1000} & set(samples.index.tolist())


def slow_definition(
    channel: CleanChannel, grid: Times, *, is_held: bool
) -> tuple[list[float], list[bool]]:
    """Point by point: value, nan where there is none, and whether the channel slept."""
    times, values, silent = channel.time_us.tolist(), [], []
    for point in grid.tolist():
        before = max((i for i, t in enumerate(times) if t <= point), default=None)
        after = min((i for i, t in enumerate(times) if t >= point), default=None)
        after = before if is_held else after
        value = np.nan
        if before is None or after is None:
            silent.append(True)
        else:
            ends = channel.ends is not None and channel.ends[before] and times[before] != point
            apart = (point if is_held else times[after]) - times[before]
            silent.append(bool(ends or apart > channel.longest_gap_us))
            if not (silent[-1] or channel.refused[before] or channel.refused[after]):
                share = 0.0 if is_held or not apart else (point - times[before]) / apart
                value = (1 - share) * channel.value[before]
                value += share * channel.value[after] if share else 0.0
        values.append(float(value))
    return values, silent


ANY_STAMPS = st.lists(st.integers(0, 400), unique=True, max_size=30).map(sorted)
# Begin, and stretches of so many equal steps, mostly from one time of the grid to another.
EVEN_STAMPS = st.tuples(
    st.sampled_from([-200, -50, 0, 5, 30, 390]),
    st.lists(st.tuples(st.integers(1, 9), st.sampled_from([10, 10, 20, 30, 50, 7])), max_size=8),
).map(lambda of: np.cumsum([of[0], *(step for n, step in of[1] for _ in range(n))]).tolist())


@given(
    st.one_of(ANY_STAMPS, EVEN_STAMPS),
    st.integers(0, 2**32 - 1),
    st.integers(1, 60),
    st.booleans(),
    st.booleans(),
    st.sampled_from([10.0, 20.0, 30.0, 50.0]),
    st.sampled_from([2, EVEN_SAMPLES]),
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
    channel = replace(channel, rules=replace(channel.rules, on_change=on_change, hold=hold))
    grid = np.arange(-20, 420, 10, dtype=np.int64)
    # Also where the stretches are shorter than such as pay.
    with patch("pipeline.night.on_grid.EVEN_SAMPLES", even_samples):
        got, present, silent = on_grid(channel, grid, 10)
    expected, asleep = slow_definition(channel, grid, is_held=hold)
    assert silent.tolist() == asleep
    assert present.tolist() == np.isfinite(expected).tolist()
    np.testing.assert_allclose(got, expected, rtol=1e-12, atol=1e-9)


FAST_US = np.arange(1000, dtype=np.int64) * 10_000
CELLS_US = np.arange(1, 100, dtype=np.int64) * STEP


@pytest.mark.parametrize("share", [0.0, 0.6])
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


def zeros(
    still: NDArray[np.bool_], bar: Array, flow: Array, **more: CleanChannel
) -> tuple[Zero | None, Zero | None]:
    channels = {"pressure_difference": channel(bar), "leakage_flow": channel(flow)} | more
    return zeros_of_halts(still, GRID, channels, SensorHealth(without_pressure_at_halts=True))


THREE = ((500, 700), (2000, 2300), (4000, 4200))


def test_the_zeros_are_those_that_were_put_in() -> None:
    truths = (ZERO_BAR, 0.05), (ZERO_FLOW, 0.002)
    for zero, (truth, sd) in zip(zeros(*night(*THREE)), truths, strict=True):
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
    pressure, zero = zeros(still, bar, flow, leakage_flow=channel(flow, stuck))
    # Of three halts there is a scatter.
    assert (zero.standard_error is None) == (pressure.standard_error is None) == (n < 3)
    assert zero.value == pytest.approx(ZERO_FLOW, abs=0.001)


def test_a_halt_that_is_too_short_tells_nothing() -> None:
    just_too_short = SETTLE + NEEDED
    assert zeros(*night((500, 500 + just_too_short))) == (None, None)
    assert None not in zeros(*night((500, 500 + just_too_short + 1)))


@pytest.mark.parametrize(
    ("low_bar", "case_bar", "is_known"),
    [
        *((15.0, 0.0, False), (15.0, 14.0, True), (0.3, 0.0, True), (None, 0.0, False)),
        *((0.3, None, True), (15.0, None, False)),
    ],
)
def test_ports_show_the_zero_of_the_flow_only_where_they_are_near_case_pressure(
    low_bar: float | None, case_bar: float | None, is_known: bool
) -> None:
    """Equal pressures on both ports leak to the case; a difference alone is no proof."""
    still, bar, flow = night(*THREE)
    channels = {"pressure_difference": channel(bar), "leakage_flow": channel(flow)}
    if low_bar is not None:
        ports = {"high_port_pressure": low_bar + bar, "low_port_pressure": np.full(N, low_bar)}
        channels = {name: channel(values) for name, values in ports.items()} | channels
    if case_bar is not None:
        channels["case_pressure"] = channel(np.full(N, case_bar))
    pressure, zero = zeros_of_halts(still, GRID, channels, SensorHealth())
    assert pressure.value == pytest.approx(ZERO_BAR, abs=0.05)
    assert (zero is not None) == is_known
