"""A channel's samples in order, every rule applied, and what each of them refused counted.

Channels are cleaned on their own samples, before the time base: one bad temperature sample,
interpolated to 10 Hz, would spoil nineteen. The rules themselves are in `pipeline.masks`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from pipeline.arrays import SECOND_US, Mask, Times, Values, chosen_rows
from pipeline.channel_rules import ChannelRules
from pipeline.clocks import jittered, typical_period_us
from pipeline.ingest import RawChannel
from pipeline.masks import ROUNDING, at_maximum, frozen, out_of_range, spike
from pipeline.order import Orders, carried_over, in_order, samples_of
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
    ends
        Samples of an on-change channel from which on there is no value, shape (n,); None: none.
    n_carried
        Samples at the front that are from before the night, 0 or 1; no count has them.
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
    ends: Mask | None = None
    n_carried: int = 0


def clean_channel(
    raw: RawChannel,
    rules: ChannelRules,
    night_start_us: int | None = None,
    orders: Orders | None = None,
) -> CleanChannel:
    """Apply every rule of a channel to its own samples.

    Parameters
    ----------
    raw
        Samples as read, in the order of the log.
    rules
        The channel's rules.
    night_start_us
        Of what lies before it, the last sample of an on-change channel carries over, and no rule
        counts it; None: all samples are of the night.
    orders
        Of the channels that were cleaned before and may have the same stamps; None: there are none.

    Returns
    -------
    CleanChannel
        Sorted, with blank cells that are no sample left out and all others judged.
    """
    early = np.zeros(len(raw.time_us), dtype=np.bool_)
    if night_start_us is not None:
        early = raw.time_us < night_start_us
    cells, disorder = in_order(raw.rows(chosen_rows(~early)), rules, orders or Orders())
    blank = cells.missing.any()
    period = typical_period_us(cells.time_us[~cells.missing] if blank else cells.time_us)
    longest_gap_us = _longest_gap_us(period, rules)
    samples = samples_of(cells, rules, period)
    noted = {"backward_time": disorder.n_put_back}
    if not rules.sampling.on_change:
        noted["jitter"] = int(jittered(samples.time_us, period).sum())
    n_carried = 0
    if night_start_us is not None and early.any():
        carried = carried_over(raw.rows(early), rules, night_start_us - longest_gap_us)
        n_carried, samples = len(carried.time_us), RawChannel.joined([carried, samples])
    time, value, masks = _judged(samples, rules, period, longest_gap_us)
    refused = np.logical_or.reduce(list(masks.values()))
    counts = {reason: int(mask[n_carried:].sum()) for reason, mask in masks.items()}
    counts |= {"backward_time": disorder.n_backward, "duplicate_time": disorder.n_duplicate}
    out_of_order = disorder.n_backward + disorder.n_duplicate
    return CleanChannel(
        time_us=time,
        value=value,
        refused=refused,
        at_maximum=masks["at_maximum"],
        period_us=period,
        longest_gap_us=longest_gap_us,
        counts=counts | {"any": int(refused[n_carried:].sum()) + out_of_order},
        n_samples=len(time) - n_carried + out_of_order,
        noted=noted,
        sampling=rules.sampling,
        ends=_ends(masks) if rules.sampling.on_change else None,
        n_carried=n_carried,
    )


def _ends(masks: Mapping[str, Mask]) -> Mask:
    """Samples that say that there is no value from there on."""
    found: Mask = masks["missing"] | masks["not_finite"]
    return found | masks["bad_quality"] if "bad_quality" in masks else found


def _judged(
    samples: RawChannel, rules: ChannelRules, period_us: float | None, longest_gap_us: float
) -> tuple[Times, Values, dict[str, Mask]]:
    """Times and values, of a counter as a flow, and which samples each rule refuses."""
    time, value, sampling = samples.time_us, samples.value, rules.sampling
    masks = {"missing": samples.missing, "not_finite": ~samples.missing & ~np.isfinite(value)}
    if samples.bad_quality is not None:
        masks["bad_quality"] = samples.bad_quality
    if sampling.counts is not None:
        trusted = (
            value if samples.bad_quality is None else np.where(samples.bad_quality, np.nan, value)
        )
        counted = flow_from_counts(time, trusted, longest_gap_us, sampling)
        time, value = counted.time_us, counted.flow_l_per_min
        masks |= {"no_interval": counted.no_interval, "counter_reset": counted.counter_reset}
    masks |= {
        "out_of_range": out_of_range(value, rules.valid_range),
        "at_maximum": at_maximum(value, rules.sensor_maximum, rules.resolution),
    }
    credible = ~np.logical_or.reduce(list(masks.values()))
    resolution = max(rules.resolution, sampling.resolution_l_per_min(period_us))
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
    return time, value, masks


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
    at_rest_below = (1.0 - ROUNDING) * rules.at_rest_below
    counting = (value != 0.0) if rules.sampling.counts else np.abs(value) < at_rest_below
    mask: Mask = stuck & ~counting
    return mask


def _longest_gap_us(period_us: float | None, rules: ChannelRules) -> float:
    if rules.longest_gap_s is not None:
        return rules.longest_gap_s * SECOND_US
    return rules.gap_sample_periods * (period_us or 0.0)
