"""The look of a channel's sampling, and a remark where its config says something else.

Samples that a clock writes lie evenly; those sent on change, or left by a historian's compression,
leave silences: which of the two it was makes no difference to the config. A running total rises.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.config import Channel
from pipeline.ingest import RawChannel

Values = NDArray[np.float64]

# Samples of the head of a log that are looked at, and fewest that tell anything.
HEAD = 20_000
FEWEST = 30
# Larger figures are no readings, and their squares no numbers.
LARGEST = 1e100
# A step is a silence beyond so many of the shortest tenth of steps; a log is irregular where
# silences are so frequent, and take up so much of the time.
SILENCE_STEPS = 3.5
SILENT_STEPS_SHARE = 0.02
SILENT_TIME_SHARE = 0.2
# A running total may be reset or roll over so often; below, it rises all the time.
FALLS_SHARE = 0.005
FEWEST_RISES = 20
# Means of shorter periods cost no accuracy.
SHORTEST_MEAN_S = 4.0
# How far the period of means may be from the one stated, and how often a sample sent on change may
# repeat the one before, as where some are sent after a longest silence.
PERIOD_TOLERANCE = 0.2
REPEATED_SHARE = 0.1


@dataclass(frozen=True, slots=True)
class Sampling:
    """The look of a channel."""

    kind: Literal["periodic", "irregular", "cumulative", "unknown"]
    period_s: float | None = None  # typical distance of two samples; None for fewer than two
    longest_silence_s: float | None = None  # but for the longest hundredth
    share_repeated: float = 0.0  # of the samples, those that repeat the one before


def look_of(raw: RawChannel, *, is_flow: bool = False) -> Sampling:
    """Tell the sampling of a channel from the head of its log; only a flow can be a total."""
    rows = np.flatnonzero(~raw.missing & (np.abs(raw.value) < LARGEST))[:HEAD]
    time_us, first = np.unique(raw.time_us[rows], return_index=True)
    value, steps = raw.value[rows][first], np.diff(time_us) / 1e6
    period = float(np.median(steps)) if steps.size else None
    if value.size < FEWEST or not np.ptp(value):
        return Sampling("unknown", period)
    changes = np.diff(value)
    longest = float(np.quantile(steps, 0.99, method="higher"))
    repeated = float(np.mean(changes == 0))
    if is_flow and _rises(value, changes):
        return Sampling("cumulative", period, longest, repeated)
    # Silences are frequent and take up much of the time: a clock did not write these samples.
    silent = steps > SILENCE_STEPS * np.quantile(steps, 0.1)
    in_silence = steps[silent].sum() / steps.sum()
    is_irregular = silent.mean() >= SILENT_STEPS_SHARE and in_silence >= SILENT_TIME_SHARE
    return Sampling("irregular" if is_irregular else "periodic", period, longest, repeated)


def _rises(value: Values, changes: Values) -> bool:
    """True if values only rise, resets and roll-overs apart."""
    falls = changes < 0
    if int(np.sum(changes > 0)) < FEWEST_RISES or float(np.mean(falls)) > FALLS_SHARE:
        return False
    # A reading that warms up falls now and then by its step; a total falls to its begin.
    return bool(np.all(-changes[falls] > 0.3 * np.ptp(value)))


def words(look: Sampling) -> str:
    """The look in words; empty where nothing can be told.

    Examples
    --------
    >>> words(Sampling("periodic", 0.2)), words(Sampling("periodic", 10.0))
    ('periodic', 'periodic, or means of 10 s')
    """
    if look.kind == "periodic" and (look.period_s or 0.0) >= SHORTEST_MEAN_S:
        return f"periodic, or means of {look.period_s:.3g} s"
    return {
        "periodic": "periodic",
        "irregular": "sent on change, compressed, or lost in part",
        "cumulative": "like a running total",
        "unknown": "",
    }[look.kind]


def configured(channel: Channel) -> str:
    """A channel's sampling as configured, in words."""
    if channel.counts is not None:
        total = channel.counts == "cumulative"
        return "a running total" if total else "counts since the sample before"
    if channel.sampling == "mean":
        return f"means of {channel.mean_of_s:g} s"
    return "periodic" if channel.sampling == "periodic" else "sent on change or compressed"


def remark(channel: Channel, look: Sampling) -> str:
    """The difference between a channel's look and its config, in words; empty for none."""
    if _agrees(channel, look):
        return ""
    if channel.counts == "cumulative":
        advice = "it falls again and again"
    elif look.kind == "cumulative":
        advice = 'then counts = "cumulative", unit = "count" and volume_per_count_cm3'
    elif look.kind == "periodic":
        advice = (
            f"a sample every {look.period_s:.3g} s, {100 * look.share_repeated:.0f} % of them as "
            'the one before; then sampling = "periodic"'
        )
    else:
        advice = (
            'then sampling = "on_change" and longest_silence_s; silences here reach '
            f"{look.longest_silence_s:.3g} s"
        )
    return f"configured as {configured(channel)}, looks {words(look)}: {advice}"


def _agrees(channel: Channel, look: Sampling) -> bool:
    if look.kind == "unknown":
        return True
    if channel.counts is not None or look.kind == "cumulative":
        return (look.kind == "cumulative") == (channel.counts == "cumulative")
    if channel.sampling == "on_change":
        return look.kind == "irregular" or look.share_repeated <= REPEATED_SHARE
    if channel.sampling == "mean":
        off = abs((look.period_s or 0.0) / (channel.mean_of_s or 1.0) - 1.0)
        return look.kind == "periodic" and off < PERIOD_TOLERANCE
    return look.kind == "periodic"
