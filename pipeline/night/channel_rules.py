"""The rules that a channel's samples are judged by: its own keys where stated, else the fleet's.

Its samples are readings, changes, means of a period, or counts of a volume: the config says which
(`[channels.<name>] sampling`, `counts`); nothing here guesses.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from pipeline.arrays import SECOND_US, Mask, Times, Values
from pipeline.config import Channel, Cleaning
from pipeline.config.channels import ChannelName
from pipeline.config.logs import Logs
from pipeline.units import FALLBACK_VALID_RANGE

# cm³/µs -> l/min.
CM3_PER_US_TO_L_PER_MIN = 60.0 * SECOND_US / 1000.0
# A counter that falls has rolled over if it thereby counted less than this share of its range.
ROLL_OVER_SHARE = 0.5
# A change is a step of the sensor if this share of all pairs makes it, and so many at least.
STEP_SHARE = 0.05
FEWEST_STEPS = 3
PAIRS_LOOKED_AT = 50_000
# Time without a change after which a sensor is frozen; oil holds its temperature for longer.
FROZEN_AFTER_S, TEMPERATURE_FROZEN_AFTER_S = 60.0, 900.0
# Oil temperature is logged once a second or less: its silence is a gap after this time.
TEMPERATURE_GAP_S = 5.0
# Longest period of a mean that a fit can use: over longer ones conditions change too much.
MAXIMUM_MEAN_S = 10.0
# Where the stamp of a mean stands in its period: what leads from there to the middle.
TO_THE_MIDDLE = {"begin": 0.5, "middle": 0.0, "end": -0.5}


@dataclass(frozen=True, slots=True)
class Sampling:
    """Kind of the samples of a channel."""

    # A sample is written where the value changes: silence is no gap, and there is no period.
    on_change: bool = False
    hold: bool = False  # between two samples the first one holds; else the value is interpolated
    mean_us: float = 0.0  # period of which a sample is the mean; 0: a reading
    shift_us: int = 0  # from the stamp as logged to the time at which the sample holds
    # `cumulative` for a running total, `pulses` for counts since the sample before; None for a
    # flow.
    counts: str | None = None
    volume_per_count_cm3: float = 0.0  # volume of one count
    # Count after which a running total begins at 0 again; None: it does not.
    rolls_over_at: float | None = None

    @classmethod
    def of(cls, channel: Channel) -> Sampling:
        """Return the sampling that a channel's config states."""
        mean_s = channel.mean_of_s or 0.0
        shift_s = channel.time_offset_s + TO_THE_MIDDLE[channel.mean_stamp] * mean_s
        return cls(
            on_change=channel.sampling == "on_change",
            hold=channel.between == "hold",
            mean_us=mean_s * SECOND_US,
            shift_us=round(shift_s * SECOND_US),
            counts=channel.counts,
            volume_per_count_cm3=channel.volume_per_count_cm3 or 0.0,
            rolls_over_at=channel.counter_rolls_over_at,
        )

    def resolution_l_per_min(self, period_us: float | None) -> float:
        """One count more or less in a typical period, as a flow; 0 for a channel of readings."""
        if self.counts is None or not period_us:
            return 0.0
        return self.volume_per_count_cm3 / period_us * CM3_PER_US_TO_L_PER_MIN


PERIODIC = Sampling()


@dataclass(frozen=True, slots=True)
class CountedFlow:
    """A flow from counts."""

    time_us: Times  # middle of each interval, increasing, shape (n,)
    flow_l_per_min: Values  # volume over time; nan where not known, shape (n,)
    # Samples without a known one before them: the first, and those after a gap; shape (n,).
    no_interval: Mask
    # Samples at which a running total fell other than by rolling over, shape (n,).
    counter_reset: Mask


# A count may be infinite, and two of them further apart than float64 reaches.
@np.errstate(over="ignore", invalid="ignore")
def flow_from_counts(
    time_us: Times, count: Values, longest_gap_us: float, sampling: Sampling
) -> CountedFlow:
    """Return the flow of a counter of volume between each sample and the sample before."""
    steps = np.diff(time_us, prepend=time_us[:1])
    fresh, reset = count.astype(np.float64), np.zeros(len(count), dtype=np.bool_)
    unknown = steps > longest_gap_us
    unknown[:1] = True
    if sampling.counts == "cumulative":
        fresh = np.diff(count, prepend=np.nan)
        if sampling.rolls_over_at is not None:
            rolled = fresh + sampling.rolls_over_at
            over = (fresh < 0) & (rolled >= 0)
            over &= rolled < ROLL_OVER_SHARE * sampling.rolls_over_at
            fresh = np.where(over, rolled, fresh)
        reset = ~unknown & (fresh < 0)
        unknown |= np.isfinite(count) & np.isnan(fresh)
    known = ~(unknown | reset)
    flow = np.full(len(count), np.nan)
    flow[known] = fresh[known] * sampling.volume_per_count_cm3 / steps[known]
    middle = np.where(unknown, time_us, time_us - steps // 2)
    return CountedFlow(middle, flow * CM3_PER_US_TO_L_PER_MIN, unknown, reset)


def step_of_readings(value: Values) -> float:
    """Return the step in which readings visibly come; 0 where they do not.

    Of a sensor whose resolution nobody stated: the commonest change between neighbours, if it is
    common enough to be a step of the sensor and not of what it measures.
    """
    apart = max(1, len(value) // PAIRS_LOOKED_AT)
    pairs = np.abs(value[1::apart] - value[:-1:apart])
    changes = pairs[pairs > 0]
    if not len(changes):
        return 0.0
    # Rounded to six digits: a conversion of units leaves some noise on equal steps.
    digits = 10.0 ** (np.floor(np.log10(changes)) - 5)
    steps, counts = np.unique(np.round(changes / digits) * digits, return_counts=True)
    commonest = int(np.argmax(counts))
    is_a_step = counts[commonest] >= max(STEP_SHARE * len(pairs), FEWEST_STEPS)
    return float(steps[commonest]) if is_a_step else 0.0


def means_too_long(channels: Mapping[ChannelName, Channel]) -> str | None:
    """Return which channels are means of too long periods for a fit, in words; None: there is none.

    A mean of the inputs is no input of the mean: the leakage is not linear in them.
    """
    found = [
        f"{name} is logged as means of {channel.mean_of_s:g} s"
        for name, channel in channels.items()
        if channel.mean_of_s is not None and channel.mean_of_s > MAXIMUM_MEAN_S
    ]
    if not found:
        return None
    return f"{'; '.join(found)}; at most {MAXIMUM_MEAN_S:g} s are allowed: log it more often"


@dataclass(frozen=True, slots=True)
class ChannelRules:
    """The rules of one channel, resolved from the motor's and the fleet's config."""

    valid_range: tuple[float, float]  # lowest and highest plausible value [bar, °C, rpm or l/min]
    sensor_maximum: float | None  # highest value the sensor gives, or None
    resolution: float  # smallest step of the sensor
    frozen_after_s: float  # longest credible time without a change [s]
    longest_gap_s: float | None  # longer silence is a gap; None: by the sample period
    shortest_gap_s: float = 0.0  # a gap is no shorter, however fast the samples are
    # Values smaller in magnitude never count as frozen: a halted motor's speed stays 0.
    at_rest_below: float = 0.0
    sampling: Sampling = PERIODIC  # what the samples are
    # A row of the log is of this channel alone, so that one without a value says that there is
    # none; else it may only be a row of another channel.
    has_rows_of_its_own: bool = False

    @classmethod
    def of(
        cls, name: str, channel: Channel, cleaning: Cleaning, logs: Logs | None = None
    ) -> ChannelRules:
        """Return the rules of a channel: its own keys where stated, else the fleet's."""
        is_temperature = name == "oil_temperature"
        fallback = TEMPERATURE_FROZEN_AFTER_S if is_temperature else FROZEN_AFTER_S
        # A value that did not change was not sent: silence is no sign of a frozen sensor.
        silence_s = channel.longest_silence_s or 0.0
        fallback = max(fallback, silence_s) if channel.sampling == "on_change" else fallback
        rules = cls(
            valid_range=channel.valid_range or FALLBACK_VALID_RANGE[name],
            sensor_maximum=channel.sensor_maximum,
            resolution=channel.resolution,
            frozen_after_s=channel.frozen_after_s or fallback,
            longest_gap_s=silence_s or None,
            shortest_gap_s=TEMPERATURE_GAP_S if is_temperature else 0.0,
            at_rest_below=cleaning.standstill_rpm if name == "speed" else 0.0,
            sampling=Sampling.of(channel),
            has_rows_of_its_own=logs is not None and logs.layout != "wide",
        )
        # A value that is stated is refused by none.
        anything, ever = (-math.inf, math.inf), math.inf
        stated = replace(rules, valid_range=anything, frozen_after_s=ever, longest_gap_s=ever)
        return rules if channel.constant is None else stated
