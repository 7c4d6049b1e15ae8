"""Apparent sampling of a channel, on signals logged in each way by its definition."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from pipeline.config import Channel
from pipeline.ingest import RawChannel
from pipeline.setup.check import sampling_note

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


def counted(flow: Array, period_s: float, volume_cm3: float, rolls_over: float = 1e9) -> Logged:
    """Running total of whole counts of a volume, of a flow in l/min."""
    total = np.floor(123.0 + np.cumsum(np.maximum(flow, 0.0)) * STEP_S / 0.06 / volume_cm3)
    time_s, count = sampled(total, period_s)
    return time_s, count % rolls_over


SENT = {"sampling": "on_change", "longest_silence_s": 60.0}
TOTAL = {"unit": "count", "counts": "cumulative", "volume_per_count_cm3": 1.0}


def note(logged: Logged, name: str = "load", **config: Any) -> str:
    time_us = 1_767_303_000_000_000 + np.rint(logged[0] * 1e6).astype(np.int64)
    blank = np.zeros(time_us.size, dtype=np.bool_)
    channel = Channel.model_validate({"source": "x", "unit": "l/min"} | config)
    place = "leakage_flow" if name == "flow" else name
    return sampling_note(place, channel, RawChannel(time_us, logged[1], blank, 0))


@pytest.mark.parametrize("name", RESOLUTION)
def test_readings_of_a_clock_look_as_configured(name: str) -> None:
    """At any period, without steps, with stamps that jitter, a third lost, or spikes."""
    step, rng, value = RESOLUTION[name], np.random.default_rng(1), signal(name, 1)
    time_s, read = sampled(value, 0.2, step)
    kept = rng.uniform(size=time_s.size) >= 0.33
    jitter = np.sort(time_s[::5] + 0.15 * rng.standard_normal(time_s[::5].size))
    logs = [sampled(value, period_s, step) for period_s in (0.2, 1.0, 10.0, 60.0)]
    logs += [sampled(value, 0.2), (jitter, read[::5]), (time_s[kept], read[kept])]
    logs += [(time_s, read + 900 * step * (rng.uniform(size=read.size) < 0.002))]
    for logged in logs:
        assert note(logged, name) == ""
        assert ("falls again and again" in note(logged, name, **TOTAL)) == (name == "flow")


@pytest.mark.parametrize(
    ("name", "steps"),
    [*(("load", steps) for steps in (1, 5, 20)), ("temperature", 3), ("flow", 5), ("flow", 20)],
)
def test_values_sent_on_change_look_it(name: str, steps: int) -> None:
    one, step = signal(name, 2), RESOLUTION[name]
    logged = sent_on_change(one, step, steps * step)
    said = note(logged, name)
    assert 'then sampling = "on_change" and longest_silence_s' in said
    # The longest but for a hundredth: of use as longest_silence_s.
    reach = float(said.split()[-2])
    assert 0.98 < np.mean(np.diff(logged[0]) <= 1.01 * reach) <= 1.0
    assert note(logged, name, **SENT) == ""
    assert note(logged, "speed", **(TOTAL | {"counts": "pulses"})) == ""


@pytest.mark.parametrize("period_s", [0.2, 1.0, 10.0])
def test_a_running_total(period_s: float) -> None:
    flow = wandering(3, 1.5, 0.4, 20.0)
    logs = [counted(flow, period_s, volume_cm3) for volume_cm3 in (1.0, 10.0)]
    logs += [counted(flow, period_s, 10.0, 10_000.0)] if period_s < 10.0 else []
    for logged in logs:
        assert "looks like a running total: then counts = " in note(logged, "flow")
        assert note(logged, "flow", **TOTAL) == ""


def test_few_samples_or_no_change_tell_nothing() -> None:
    for count in (0, 1, 5):
        assert note((np.arange(float(count)), np.arange(float(count))), **TOTAL) == ""
    assert note((np.arange(500.0), np.full(500, 3.0)), "flow", **TOTAL) == ""
