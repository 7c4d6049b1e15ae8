"""A reading that lies on a limit lies on it in every unit, however its conversion is rounded."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline.config import Channel, Cleaning
from pipeline.ingest import RawChannel
from pipeline.night.channel_rules import ChannelRules
from pipeline.night.cleaning import clean_channel
from pipeline.night.masks import out_of_range
from pipeline.units import CHANNELS, QUANTITIES, UNITS, canonical_unit, from_canonical, to_canonical

Floats = NDArray[np.float64]

SECOND = 1_000_000
RESOLUTION = {"pressure": 0.1, "temperature": 0.1, "speed": 0.1, "flow": 0.02}
ONE_OF_EACH = ("pressure_difference", "oil_temperature", "speed", "leakage_flow")


def as_read(channel: str, value: Floats) -> Iterator[tuple[str, Floats]]:
    """Readings as they come out of a log in each unit, with all digits and in float32."""
    for unit in UNITS[QUANTITIES[channel]]:
        written = from_canonical(channel, value, unit)
        yield unit, to_canonical(channel, written, unit)
        single = written.astype(np.float32).astype(np.float64)
        yield f"{unit} float32", to_canonical(channel, single, unit)


def cleaned(channel: str, value: Floats) -> dict[str, int]:
    """Refused readings by rule, at 10 Hz."""
    quantity = QUANTITIES[channel]
    settings = Channel(
        source="x", unit=canonical_unit(channel), resolution=RESOLUTION[quantity], valid_range=None
    )
    rules = replace(
        ChannelRules.of(channel, settings, Cleaning()), valid_range=(-1e4, 1e4), frozen_after_s=1e4
    )
    time_us = np.arange(value.size) * SECOND // 10
    raw = RawChannel(time_us, value, np.zeros(value.size, dtype=np.bool_), 0)
    return {reason: count for reason, count in clean_channel(raw, rules).counts.items() if count}


@pytest.mark.parametrize("channel", ONE_OF_EACH)
@pytest.mark.parametrize("level", [1, 433, 750, 1099])
def test_a_reading_as_many_steps_off_as_the_threshold_is_no_spike(channel: str, level: int) -> None:
    step, threshold = RESOLUTION[QUANTITIES[channel]], Cleaning().hampel_threshold
    steps = np.full(101, float(level))
    steps[10::20] += threshold * np.array([1, -1, 1, -1, 1])
    for unit, value in as_read(channel, np.round(steps * step, 6)):
        assert cleaned(channel, value) == {}, unit
    steps[50] += np.sign(steps[50] - level)
    for unit, value in as_read(channel, np.round(steps * step, 6)):
        assert cleaned(channel, value) == {"spike": 1, "any": 1}, unit


@pytest.mark.parametrize("channel", CHANNELS)
@pytest.mark.parametrize("limits", [(0.0, 16.0), (-1.0, 60.0), (-20.0, 110.0), (-450.0, 450.0)])
def test_the_ends_of_a_range_are_within_it(channel: str, limits: tuple[float, float]) -> None:
    for unit, value in as_read(channel, np.array(limits)):
        # Of a temperature near 0 °C a float32 in K or °F has few digits left.
        if "float32" not in unit or QUANTITIES[channel] != "temperature":
            assert not out_of_range(value, limits).any(), unit
    outside = np.array([limits[0] - 0.02, limits[1] + 0.02])
    for unit, value in as_read(channel, outside):
        assert out_of_range(value, limits).all(), unit
