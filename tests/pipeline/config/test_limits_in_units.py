"""A reading that lies on a limit lies on it in every unit, however its conversion is rounded."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline.config import Channel, Cleaning, TimeBase
from pipeline.ingest import RawChannel
from pipeline.night.channel_rules import ChannelRules
from pipeline.night.cleaning import clean_channel
from pipeline.night.masks import frozen, out_of_range, transient
from pipeline.night.time_base import bring_together
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


def test_as_fast_as_standstill_goes_is_no_standstill() -> None:
    rpm = Cleaning().standstill_rpm
    n = 600
    for unit, speed in as_read("speed", np.array([rpm, rpm - 0.1] * (n // 2))):
        channels = {}
        for name in ONE_OF_EACH:
            value = speed if name == "speed" else 50.0 + np.arange(n) % 2
            raw = RawChannel(np.arange(n) * SECOND, value, np.zeros(n, dtype=np.bool_), 0)
            settings = Channel(source="x", unit=canonical_unit(name), resolution=0.1)
            channels[name] = clean_channel(raw, ChannelRules.of(name, settings, Cleaning()))
        _, quality = bring_together(channels, 0, n * SECOND, TimeBase(), Cleaning())
        still = {one.n_refused for one in quality if one.reason == "standstill"}
        assert still == {n // 2}, unit


def test_a_change_as_fast_as_the_limit_is_no_transient() -> None:
    value = np.arange(0.0, 100.0, 0.5)
    present = np.ones(value.size, dtype=np.bool_)
    for unit, speed in as_read("speed", value):
        if "float32" in unit:
            # The difference of two readings has few digits left.
            continue
        assert not transient(speed, present, 0.1, 5.0).any(), unit
        assert transient(speed, present, 0.1, 4.9).all(), unit


def test_a_sensor_that_stays_on_a_step_is_frozen() -> None:
    time_us = np.arange(100) * SECOND
    for level in (0.1, 49.95, 180.0):
        for unit, value in as_read("pressure_difference", np.full(100, level)):
            noisy = np.where(time_us % 2, value, level)
            assert frozen(time_us, noisy, 0.1, 50.0 * SECOND).all(), unit
