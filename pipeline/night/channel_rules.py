"""The rules that a channel's samples are judged by: its own keys where stated, else the fleet's."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pipeline.config import Channel, Cleaning
from pipeline.config.channels import FALLBACK_VALID_RANGE
from pipeline.config.logs import Logs
from pipeline.night.sampling import PERIODIC, Sampling

TEMPERATURE_FROZEN_AFTER_S = 900.0


@dataclass(frozen=True, slots=True)
class ChannelRules:
    """The rules of one channel, resolved from the motor's and the fleet's config."""

    valid_range: tuple[float, float]  # lowest and highest plausible value [bar, °C, rpm or l/min]
    sensor_maximum: float | None  # highest value the sensor gives, or None
    resolution: float  # smallest step of the sensor
    # hampel_window, hampel_threshold: samples in the window; limit in scaled MAD.
    hampel_window: int
    hampel_threshold: float
    frozen_after_s: float  # longest credible time without a change [s]
    # gap_sample_periods, longest_gap_s: silence that is a gap: in sample periods, unless stated in
    # seconds.
    gap_sample_periods: float
    longest_gap_s: float | None
    # Values smaller in magnitude never count as frozen: a halted motor's speed stays 0.
    at_rest_below: float = 0.0
    sampling: Sampling = PERIODIC  # what the samples are
    puts_in_order: bool = True  # samples written late are put back in their place, not refused
    # A row of the log is of this channel alone, so that one without a value says that there is
    # none; else it may only be a row of another channel.
    has_rows_of_its_own: bool = False

    @classmethod
    def of(
        cls, name: str, channel: Channel, cleaning: Cleaning, logs: Logs | None = None
    ) -> ChannelRules:
        """The rules of a channel: its own keys where stated, else the fleet's."""
        if channel.constant is not None:
            return cls.of_a_constant(cleaning)
        is_temperature = name == "oil_temperature"
        fallback = TEMPERATURE_FROZEN_AFTER_S if is_temperature else cleaning.frozen_after_s
        # A value that did not change was not sent: silence is no sign of a frozen sensor.
        silence_s = channel.longest_silence_s or 0.0
        fallback = max(fallback, silence_s) if channel.sampling == "on_change" else fallback
        temperature_gap_s = max(
            cleaning.temperature_gap_s, cleaning.gap_sample_periods * (channel.mean_of_s or 0.0)
        )
        return cls(
            valid_range=channel.valid_range or FALLBACK_VALID_RANGE[name],
            sensor_maximum=channel.sensor_maximum,
            resolution=channel.resolution,
            hampel_window=cleaning.hampel_window,
            hampel_threshold=cleaning.hampel_threshold,
            frozen_after_s=channel.frozen_after_s or fallback,
            gap_sample_periods=cleaning.gap_sample_periods,
            longest_gap_s=silence_s or (temperature_gap_s if is_temperature else None),
            at_rest_below=cleaning.standstill_rpm if name == "speed" else 0.0,
            sampling=Sampling.of(channel),
            puts_in_order=cleaning.out_of_order == "sort",
            has_rows_of_its_own=logs is not None and logs.layout != "wide",
        )

    @classmethod
    def of_a_constant(cls, cleaning: Cleaning) -> ChannelRules:
        """The rules of a value that is stated: none refuses it."""
        return cls(
            valid_range=(-math.inf, math.inf),
            sensor_maximum=None,
            resolution=0.0,
            hampel_window=cleaning.hampel_window,
            hampel_threshold=cleaning.hampel_threshold,
            frozen_after_s=math.inf,
            gap_sample_periods=cleaning.gap_sample_periods,
            longest_gap_s=math.inf,
            puts_in_order=cleaning.out_of_order == "sort",
        )
