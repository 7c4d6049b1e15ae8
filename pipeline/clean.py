"""A channel's samples in order, every rule applied, and what each of them refused counted.

Channels are cleaned on their own samples, before the time base: one bad temperature sample,
interpolated to 10 Hz, would spoil nineteen. The rules themselves are in `pipeline.masks`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from pipeline.arrays import SECOND_US, Mask, Times, Values
from pipeline.channel_rules import ChannelRules
from pipeline.clocks import (
    backward_time,
    duplicate_time,
    jittered,
    stray_time,
    typical_period_us,
    written_late,
)
from pipeline.ingest import RawChannel
from pipeline.masks import at_maximum, frozen, missing_sample, out_of_range, spike
from pipeline.sampling import PERIODIC, Sampling, flow_from_counts, step_of_readings


@dataclass(frozen=True, slots=True)
class CleanChannel:
    """A channel's samples in order of time, the refused ones marked.

    Attributes
    ----------
    time_us
        UTC microseconds, strictly increasing, shape (n,).
    value
        In the unit of the tables, shape (n,).
    refused
        Samples that a rule refused, shape (n,).
    at_maximum
        Samples at which the sensor was at its maximum, shape (n,).
    period_us
        Typical distance of two samples; None for fewer than two.
    longest_gap_us
        Longer silence than this is a gap.
    counts
        Refused samples by reason, and ``any`` for those refused at all.
    n_samples
        Samples that the rules looked at.
    noted
        Samples by reason that were kept although it applies: `backward_time` for those put back
        in order, `jitter` for those that came off their period.
    sampling
        What the samples are.
    """

    time_us: Times
    value: Values
    refused: Mask
    at_maximum: Mask
    period_us: float | None
    longest_gap_us: float
    counts: Mapping[str, int]
    n_samples: int
    noted: Mapping[str, int] = field(default_factory=dict)
    sampling: Sampling = PERIODIC


def clean_channel(raw: RawChannel, rules: ChannelRules) -> CleanChannel:
    """Apply every rule of a channel to its own samples.

    Parameters
    ----------
    raw
        Samples as read, in the order of the log.
    rules
        The channel's rules.

    Returns
    -------
    CleanChannel
        Sorted, with blank cells that are no sample left out and all others judged.
    """
    time, value, blank, disorder = _in_order(raw, rules)
    sampling = rules.sampling
    period = typical_period_us(time[~blank])
    longest_gap_us = _longest_gap_us(period, rules)
    missing = blank & False if sampling.on_change else missing_sample(time, blank, period)
    sample = ~blank | missing
    time, value, missing = time[sample], value[sample], missing[sample]
    noted = {"backward_time": disorder.n_put_back}
    if not sampling.on_change:
        noted["jitter"] = int(jittered(time, period).sum())
    masks = {"missing": missing, "not_finite": ~missing & ~np.isfinite(value)}
    if sampling.counts is not None:
        counted = flow_from_counts(time, value, longest_gap_us, sampling)
        time, value = counted.time_us, counted.flow_l_per_min
        masks |= {"no_interval": counted.no_interval, "counter_reset": counted.counter_reset}
    masks |= {
        "out_of_range": out_of_range(value, rules.valid_range),
        "at_maximum": at_maximum(value, rules.sensor_maximum, rules.resolution),
    }
    credible = ~np.logical_or.reduce(list(masks.values()))
    resolution = max(rules.resolution, sampling.resolution_l_per_min(period))
    resolution = resolution or step_of_readings(value[credible])
    # A compressed archive holds only what differs from its neighbourhood.
    stands_out = (
        np.zeros(int(credible.sum()), dtype=np.bool_)
        if sampling.on_change
        else _spike_between_gaps(time[credible], value[credible], longest_gap_us, rules, resolution)
    )
    masks["spike"] = _within(credible, stands_out)
    masks["frozen"] = _within(
        credible, _frozen_in_sight(time[credible], value[credible], longest_gap_us, rules)
    )
    refused = np.logical_or.reduce(list(masks.values()))
    counts = {reason: int(mask.sum()) for reason, mask in masks.items()}
    counts |= {"backward_time": disorder.n_backward, "duplicate_time": disorder.n_duplicate}
    out_of_order = disorder.n_backward + disorder.n_duplicate
    return CleanChannel(
        time_us=time,
        value=value,
        refused=refused,
        at_maximum=masks["at_maximum"],
        period_us=period,
        longest_gap_us=longest_gap_us,
        counts=counts | {"any": int(refused.sum()) + out_of_order},
        n_samples=len(time) + out_of_order,
        noted=noted,
        sampling=sampling,
    )


@dataclass(frozen=True, slots=True)
class _Disorder:
    """Samples, blank cells aside, that were out of order."""

    n_put_back: int
    n_backward: int
    n_duplicate: int


def _in_order(raw: RawChannel, rules: ChannelRules) -> tuple[Times, Values, Mask, _Disorder]:
    """Cells in strict order of their corrected time, and what it took."""
    backward = backward_time(raw.time_us)
    late = np.zeros(len(backward), dtype=np.bool_)
    if rules.puts_in_order:
        late = written_late(raw.time_us, backward)
    backward = (backward & ~late) | stray_time(raw.time_us, late)
    rows = np.flatnonzero(~backward)
    if late.any():
        rows = rows[np.argsort(raw.time_us[rows], kind="stable")]
    repeated = duplicate_time(raw.time_us[rows], np.zeros(len(rows), dtype=np.bool_))
    disorder = _Disorder(
        int((late & ~raw.missing).sum()),
        int((backward & ~raw.missing).sum()),
        int((repeated & ~raw.missing[rows]).sum()),
    )
    rows = rows[~repeated]
    time = raw.time_us[rows] + rules.sampling.shift_us
    return time, raw.value[rows], raw.missing[rows], disorder


def _within(chosen: Mask, flags: Mask) -> Mask:
    """Flags of the chosen samples laid back among all of them."""
    mask = np.zeros(len(chosen), dtype=np.bool_)
    mask[chosen] = flags
    return mask


def _spike_between_gaps(
    time_us: Times,
    value: Values,
    longest_gap_us: float,
    rules: ChannelRules,
    resolution: float,
) -> Mask:
    """Spikes among the samples between two gaps: what was before a gap is no neighbourhood."""
    borders = np.flatnonzero(np.diff(time_us) > longest_gap_us) + 1
    parts = np.split(value, borders)
    window, threshold = rules.hampel_window, rules.hampel_threshold
    return np.concatenate([spike(part, window, threshold, resolution) for part in parts])


def _frozen_in_sight(
    time_us: Times, value: Values, longest_gap_us: float, rules: ChannelRules
) -> Mask:
    """Frozen values; a gap, in which nobody saw the sensor, adds no time to a stretch."""
    steps = np.diff(time_us, prepend=time_us[:1])
    seen_us = np.cumsum(np.where(steps > longest_gap_us, 0, steps))
    stuck = frozen(seen_us, value, rules.resolution, rules.frozen_after_s * SECOND_US)
    # As many counts in each period are a steady flow; none for long is a counter that stopped.
    counting = (value != 0.0) if rules.sampling.counts else np.abs(value) < rules.at_rest_below
    mask: Mask = stuck & ~counting
    return mask


def _longest_gap_us(period_us: float | None, rules: ChannelRules) -> float:
    if rules.longest_gap_s is not None:
        return rules.longest_gap_s * SECOND_US
    return rules.gap_sample_periods * (period_us or 0.0)
