"""Channels of a test's own, and the rules that refused their samples."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.config import Channel
from pipeline.config.logs import Logs
from pipeline.ingest import RawChannel
from pipeline.night.cleaning import ChannelRules, CleanChannel, clean_channel
from pipeline.night.masks import NO_BORDERS
from pipeline.night.time_order import Steps
from tests.pipeline.simulated import CANONICAL

SECOND = 1_000_000
STEP = 100_000
# Values that no rule of one sample minds, never twice the same, so that nothing is frozen.
LIVELY = np.array([50.0, 50.3, 49.8, 50.1, 49.9, 50.2, 49.7])
Floats = NDArray[np.float64]
Times = NDArray[np.int64]


RULES = ChannelRules(
    valid_range=(0.0, 100.0),
    sensor_maximum=None,
    resolution=0.1,
    frozen_after_s=60.0,
    longest_gap_s=None,
)


def lively(n: int) -> Floats:
    return np.resize(LIVELY, n)


def stamps(n: int, rate_hz: float = 10.0) -> Times:
    return np.arange(n, dtype=np.int64) * round(SECOND / rate_hz)


def raw(time_us: Times, value: Floats, missing: object = None) -> RawChannel:
    """Channel as a reader leaves it: arrays that cannot be written to."""
    blank = np.zeros(len(value), np.bool_) if missing is None else np.asarray(missing, np.bool_)
    arrays = time_us.copy(), np.where(blank, np.nan, value), blank
    for array in arrays:
        array.flags.writeable = False
    return RawChannel(*arrays, 0)


def as_read(
    name: str, time_us: Times, value: Floats, bad: Any = (), logs: Logs | None = None, **keys: Any
) -> CleanChannel:
    """Channel of a log cleaned by the keys of its config: nan is a blank cell, `bad` are rows."""
    mask = np.zeros(len(value), np.bool_)
    mask[list(bad)] = True
    channel = Channel.model_validate({"source": "x", "unit": CANONICAL[name]} | keys)
    rules = ChannelRules.of(name, channel, logs)
    return clean_channel(RawChannel(time_us, value, np.isnan(value), 0, mask), rules)


def refused_by(channel: CleanChannel) -> dict[str, int]:
    """Refused samples by each rule that refused any."""
    return {reason: count for reason, count in channel.counts.items() if count}


def cleaned(
    time_us: Times,
    value: Floats,
    refused: object = False,
    *,
    period_us: float | None = float(STEP),
    longest_gap_us: float = 5.0 * STEP,
    at_maximum: object = False,
) -> CleanChannel:
    n, times = len(time_us), np.asarray(time_us, np.int64)
    steps = Steps(period_us, NO_BORDERS).with_period(times)
    return CleanChannel(
        time_us=times,
        value=np.asarray(value, np.float64),
        refused=np.broadcast_to(np.asarray(refused, np.bool_), n).copy(),
        at_maximum=np.broadcast_to(np.asarray(at_maximum, np.bool_), n).copy(),
        steps=steps,
        longest_gap_us=longest_gap_us,
        gaps=steps.longer_than(longest_gap_us, times),
        rules=RULES,
        counts={},
        n_samples=n,
    )
