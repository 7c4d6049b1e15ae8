"""Apparent sampling of a channel, on signals logged in each way by its definition."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from pipeline.config import Channel
from pipeline.ingest import RawChannel
from pipeline.setup.channel_check import Sampling, configured, look_of, remark, words

Array = NDArray[np.float64]
Logged = tuple[Array, Array]
"""Times [s] and values."""

STEP_S, SECONDS = 0.02, 7200.0
TIME_S = np.arange(round(SECONDS / STEP_S)) * STEP_S
RESOLUTION = {"load": 0.1, "temperature": 0.1, "flow": 0.02}


def wandering(seed: int, mean: float, sd: float, tau_s: float) -> Array:
    """An Ornstein-Uhlenbeck process: fluctuates about its mean and forgets within tau."""
    keep = np.exp(-STEP_S / tau_s)
    shocks = np.random.default_rng([7, seed]).standard_normal(TIME_S.size)
    shocks[1:] *= np.sqrt(1.0 - keep**2)
    found: Array = mean + sd * lfilter([1.0], [1.0, -keep], shocks)
    return found


def signal(name: str, seed: int) -> Array:
    """Signal as a sensor sees it, including its own noise of half a step."""
    rng = np.random.default_rng([8, seed])
    if name == "load":
        # Levels drawn at random, each held for a random time, with ramps between them.
        times = np.cumsum(rng.exponential(15.0, 2000).clip(1.0))
        edges = np.sort(np.r_[0.0, times, times + 1.0])
        value = np.interp(TIME_S, edges, np.repeat(rng.uniform(20.0, 250.0, 2001), 2)[:-1])
    elif name == "temperature":
        value = wandering(seed, 50.0, 3.0, 900.0)
    else:
        value = wandering(seed, 1.5, 0.4, 20.0)
    return value + 0.5 * RESOLUTION[name] * rng.standard_normal(value.size)


def sampled(value: Array, period_s: float, resolution: float = 0.0) -> Logged:
    """A reading every so often."""
    read = value[:: round(period_s / STEP_S)]
    steps = np.round(np.rint(read / resolution) * resolution, 9) if resolution else read
    return np.arange(read.size) * period_s, steps


def sent_on_change(value: Array, resolution: float, dead_band: float) -> Logged:
    """A sample when a scan finds a value further than the dead band from the one last sent."""
    time_s, scans = sampled(value, 0.2, resolution)
    kept = [0]
    for i, one in enumerate(scans.tolist()):
        if abs(one - scans[kept[-1]]) > dead_band * (1.0 + 1e-9):
            kept.append(i)
    return time_s[kept], scans[kept]


def swinging_door(value: Array, resolution: float, deviation: float) -> Logged:
    """The scans that Bristol's swinging door (US patent 4,669,097) leaves.

    From the last stored point two doors, hinged a deviation above and below it, swing open as
    scans come; once they are no longer closed towards each other, the scan before is stored.
    """
    time_s, scans = sampled(value, 1.0, resolution)
    kept, upper, lower = [0], -np.inf, np.inf
    for i in range(1, time_s.size):
        rise, since = scans[i] - scans[kept[-1]], time_s[i] - time_s[kept[-1]]
        upper, lower = (
            max(upper, (rise - deviation) / since),
            min(lower, (rise + deviation) / since),
        )
        if upper > lower:
            kept.append(i - 1)
            rise, since = scans[i] - scans[i - 1], time_s[i] - time_s[i - 1]
            upper, lower = (rise - deviation) / since, (rise + deviation) / since
    return time_s[kept], scans[kept]


def counted(flow: Array, period_s: float, volume_cm3: float, rolls_over: float = 1e9) -> Logged:
    """Running total of whole counts of a volume, of a flow in l/min."""
    total = np.floor(123.0 + np.cumsum(np.maximum(flow, 0.0)) * STEP_S / 0.06 / volume_cm3)
    time_s, count = sampled(total, period_s)
    return time_s, count % rolls_over


def look(logged: Logged, name: str = "load") -> Sampling:
    time_us = 1_767_303_000_000_000 + np.rint(logged[0] * 1e6).astype(np.int64)
    blank = np.zeros(time_us.size, dtype=np.bool_)
    return look_of(RawChannel(time_us, logged[1], blank, 0), is_flow=name == "flow")


def of_a_clock(value: Array, step: float) -> Iterator[Logged]:
    rng = np.random.default_rng(1)
    for period_s in (0.2, 1.0, 10.0, 60.0):
        yield sampled(value, period_s, step)
    yield sampled(value, 0.2)
    time_s, read = sampled(value, 1.0, step)
    yield np.sort(time_s + 0.15 * rng.standard_normal(time_s.size)), read
    time_s, read = sampled(value, 0.2, step)
    kept = rng.uniform(size=time_s.size) >= 0.33
    yield time_s[kept], read[kept]
    yield time_s, read + 900 * step * (rng.uniform(size=read.size) < 0.002)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", RESOLUTION)
def test_readings_look_periodic_and_nothing_else(name: str, seed: int) -> None:
    for logged in of_a_clock(signal(name, seed), RESOLUTION[name]):
        assert look(logged, name).kind == "periodic"


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("name", "steps"),
    [*(("load", steps) for steps in (1, 5, 20)), ("temperature", 3), ("flow", 5), ("flow", 20)],
)
def test_values_sent_on_change_or_compressed_look_irregular(
    name: str, steps: int, seed: int
) -> None:
    one, step = signal(name, seed), RESOLUTION[name]
    sent = sent_on_change(one, step, steps * step)
    found = look(sent, name)
    assert found.kind == "irregular"
    # The longest but for a hundredth: of use as longest_silence_s.
    assert 0.98 < np.mean(np.diff(sent[0]) <= (found.longest_silence_s or 0.0)) <= 1.0
    assert look(swinging_door(one, step, max(steps, 5) * step), name).kind == "irregular"


@pytest.mark.parametrize("period_s", [0.2, 1.0, 10.0])
def test_a_running_total(period_s: float) -> None:
    flow = wandering(3, 1.5, 0.4, 20.0)
    for volume_cm3 in (1.0, 10.0):
        assert look(counted(flow, period_s, volume_cm3), "flow").kind == "cumulative"
    if period_s < 10.0:
        assert look(counted(flow, period_s, 10.0, 10_000.0), "flow").kind == "cumulative"


def test_few_samples_or_no_change_tell_nothing() -> None:
    for count in (0, 1, 5):
        assert look((np.arange(float(count)), np.arange(float(count)))).kind == "unknown"
    assert look((np.arange(500.0), np.full(500, 3.0))).kind == "unknown"
    assert words(Sampling("unknown")) == ""


PLAIN = {"source": "x", "unit": "l/min"}
SENT = {"sampling": "on_change", "longest_silence_s": 60.0}
TOTAL = {"unit": "count", "counts": "cumulative", "volume_per_count_cm3": 1.0}
ADVICE = {
    "irregular": "silences here reach 30 s",
    "cumulative": 'unit = "count" and volume_per_count_cm3',
    "periodic": '1 % of them as the one before; then sampling = "periodic"',
}


@pytest.mark.parametrize(
    ("config", "agreeing"),
    [
        ({}, {"periodic"}),
        (SENT, {"periodic", "irregular"}),
        ({"sampling": "mean", "mean_of_s": 10.0}, {"periodic"}),
        ({"sampling": "mean", "mean_of_s": 60.0}, set()),
        (TOTAL, {"cumulative"}),
        (TOTAL | {"counts": "pulses"}, {"periodic", "irregular"}),
    ],
    ids=["periodic", "on_change", "mean", "mean of another period", "cumulative", "pulses"],
)
def test_a_remark_where_look_and_config_disagree(
    config: dict[str, Any], agreeing: set[str]
) -> None:
    channel = Channel.model_validate(PLAIN | config)
    for kind, advice in ADVICE.items():
        told = remark(channel, Sampling(kind, 10.0, 30.0, 0.01))
        said = f"configured as {configured(channel)}, looks {words(Sampling(kind, 10.0))}"
        if kind in agreeing:
            assert told == ""
        else:
            assert told.startswith(said)
            assert told.endswith("falls again and again" if config == TOTAL else advice)
    assert remark(channel, Sampling("unknown")) == ""


def test_a_value_that_repeats_was_not_sent_on_change() -> None:
    sent = Channel.model_validate(PLAIN | SENT)
    assert "45 % of them as the one before" in remark(sent, Sampling("periodic", 0.2, 0.2, 0.45))
