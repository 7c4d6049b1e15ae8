"""How a channel is sampled: evenly, as by a clock, or on change, with silences between.

Samples that are sent on change, or left by a historian's compression, leave silences. A running
total rises.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.arrays import Array, Times
from pipeline.config import Channel
from pipeline.config.channels import COUNTED
from pipeline.ingest import RawChannel

# Samples of the head of a log that are looked at, and fewest that tell anything.
HEAD, FEWEST = 20_000, 30
# Larger figures are no readings, and their squares no numbers.
LARGEST = 1e100
# A step is a silence beyond so many of the shortest tenth of steps; a log is irregular where
# silences are so frequent, and take up so much of the time.
SILENCE_STEPS, SILENT_STEPS_SHARE, SILENT_TIME_SHARE = 3.5, 0.02, 0.2
# Silences that are proposed [s]: the first that covers this share of the time.
SILENCES_S, COVERED_TIME_SHARE = (10, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200), 0.99
# Of values that are sent when they changed by a step, the smallest changes are near the typical.
STEP_SHARE = 0.5
# A running total may be reset or roll over so often; below, it rises all the time.
FALLS_SHARE, FEWEST_RISES = 0.005, 20


def silence_keys(raw: RawChannel, every_us: Times) -> dict[str, Any]:
    """Return the keys of a channel that is sent on change or compressed; empty for any other.

    Silences in which no channel has a row, of stamps `every_us` in order, are the logger's own.
    """
    time_us, value = _head(raw)
    if value.size < FEWEST or not np.ptp(value):
        return {}
    begins = np.searchsorted(every_us, time_us[:-1], "right")
    is_alone = np.searchsorted(every_us, time_us[1:]) == begins
    steps = np.diff(time_us) / 1e6
    is_short = steps <= SILENCE_STEPS * np.quantile(steps, 0.1)
    steps = steps[~is_alone | is_short]
    if not _is_irregular(steps):
        return {}
    ordered = np.sort(steps)
    needed_s = ordered[np.searchsorted(np.cumsum(ordered), COVERED_TIME_SHARE * ordered.sum())]
    silence_s = next((seconds for seconds in SILENCES_S if seconds >= needed_s), SILENCES_S[-1])
    changes = np.abs(np.diff(value))
    smallest, typical = np.quantile(changes[changes > 0], (0.05, 0.5))
    keys: dict[str, Any] = {"sampling": "on_change", "longest_silence_s": float(silence_s)}
    return keys | ({"between": "hold"} if smallest > STEP_SHARE * typical else {})


def sampling_note(name: str, channel: Channel, raw: RawChannel) -> str:
    """Return where a channel's samples do not look as configured, and what to set; else nothing."""
    time_us, value = _head(raw)
    if value.size < FEWEST or not np.ptp(value):
        return ""
    if name == COUNTED and _rises(value) != (channel.counts == "cumulative"):
        if channel.counts == "cumulative":
            return f"{name}: configured as a running total, and falls again and again"
        keys = 'counts = "cumulative", unit = "count" and volume_per_count_cm3'
        return f"{name}: looks like a running total: then {keys}"
    steps = np.diff(time_us) / 1e6
    if not _is_irregular(steps) or channel.sampling == "on_change" or channel.counts is not None:
        return ""
    # Without the longest hundredth.
    reach = float(np.quantile(steps, 0.99, method="higher"))
    return (
        f"{name}: looks sent on change, compressed, or lost in part: then sampling = "
        f'"on_change" and longest_silence_s; silences here reach {reach:.3g} s'
    )


def _head(raw: RawChannel) -> tuple[Times, Array]:
    """Stamps and values of the first readings."""
    rows = np.flatnonzero(~raw.missing & (np.abs(raw.value) < LARGEST))[:HEAD]
    time_us, first = np.unique(raw.time_us[rows], return_index=True)
    return time_us, raw.value[rows][first]


def _is_irregular(steps: Array) -> bool:
    """True if silences are frequent and take up much of the time: no clock wrote these samples."""
    if not len(steps):
        return False
    silent = steps > SILENCE_STEPS * np.quantile(steps, 0.1)
    is_frequent = float(silent.mean()) >= SILENT_STEPS_SHARE
    return is_frequent and float(steps[silent].sum() / steps.sum()) >= SILENT_TIME_SHARE


def _rises(value: Array) -> bool:
    """True if values only rise, resets and roll-overs apart."""
    changes = np.diff(value)
    falls = changes < 0
    if int(np.sum(changes > 0)) < FEWEST_RISES or float(np.mean(falls)) > FALLS_SHARE:
        return False
    # A reading that warms up falls now and then by its step; a total falls to its begin.
    return bool(np.all(-changes[falls] > 0.3 * np.ptp(value)))
