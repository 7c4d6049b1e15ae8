"""Channels of a test's own, and the rules that refused their samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.ingest import RawChannel
from pipeline.night.cleaning import CleanChannel

SECOND = 1_000_000
# Values that no rule of one sample minds, never twice the same, so that nothing is frozen.
LIVELY = np.array([50.0, 50.3, 49.8, 50.1, 49.9, 50.2, 49.7])
Floats = NDArray[np.float64]
Times = NDArray[np.int64]


def lively(n: int) -> Floats:
    return np.resize(LIVELY, n)


def stamps(n: int, rate_hz: float = 10.0) -> Times:
    return np.arange(n, dtype=np.int64) * round(SECOND / rate_hz)


def as_read(
    time_us: Times, value: Floats, bad_quality: NDArray[np.bool_] | None = None
) -> RawChannel:
    """Channel of which every nan is a blank cell."""
    return RawChannel(time_us, value, np.isnan(value), 0, bad_quality)


def refused_by(channel: CleanChannel) -> dict[str, int]:
    """Refused samples by each rule that refused any."""
    return {reason: count for reason, count in channel.counts.items() if count}
