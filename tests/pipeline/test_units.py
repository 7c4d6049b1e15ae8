"""Units against published conversions (NIST SP 811, appendix B.8, unless said otherwise)."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pipeline.arrays import keep_extremes
from pipeline.clock import microseconds
from pipeline.config import Channel
from pipeline.ingest.assembly import raw_channel, readings_of
from pipeline.night.masks import out_of_range
from pipeline.units import (
    CHANNELS,
    FALLBACK_VALID_RANGE,
    QUANTITIES,
    UNITS,
    canonical_unit,
    from_canonical,
    to_canonical,
)


@pytest.mark.parametrize(
    ("channel", "value", "unit", "expected"),
    [
        ("pressure_difference", 20_000_000.0, "Pa", 200.0),
        ("pressure_difference", 100.0, "kPa", 1.0),
        ("high_port_pressure", 1.0, "MPa", 10.0),
        ("low_port_pressure", 1013.25, "mbar", 1.01325),
        ("pressure_difference", 1.0, "psi", 6.894757e-2),
        ("pressure_difference", 1.0, "kgf/cm2", 0.980665),
        ("oil_temperature", 122.0, "degF", 50.0),
        ("oil_temperature", -40.0, "degF", -40.0),
        ("oil_temperature", 273.15, "K", 0.0),
        ("oil_temperature", 323.15, "K", 50.0),
        ("speed", 1.0, "1/s", 60.0),
        ("speed", 1.0, "rad/s", 9.549297),
        ("speed", 360.0, "deg/s", 60.0),
        ("leakage_flow", 1.0, "us_gal/min", 3.785412),
        ("leakage_flow", 1.0, "imperial_gal/min", 4.54609),
        ("leakage_flow", 1.0, "m3/h", 1000.0 / 60.0),
        ("leakage_flow", 1.0, "m3/s", 60_000.0),
        ("leakage_flow", 50.0, "cm3/s", 3.0),
        ("leakage_flow", 250.0, "cm3/min", 0.25),
        ("leakage_flow", 250.0, "ml/min", 0.25),
        ("leakage_flow", 90.0, "l/h", 1.5),
        ("leakage_flow", 0.5, "l/s", 30.0),
        ("running_hours", 2.0, "d", 48.0),
        ("running_hours", 90.0, "min", 1.5),
        ("running_hours", 5400.0, "s", 1.5),
        ("kinematic_viscosity", 46.0, "cSt", 46.0),
        ("kinematic_viscosity", 46e-6, "m2/s", 46.0),
        ("dynamic_viscosity", 35.0, "cP", 35.0),
        ("dynamic_viscosity", 0.035, "Pa.s", 35.0),
    ],
)
def test_published_conversions(channel: str, value: float, unit: str, expected: float) -> None:
    assert to_canonical(channel, [value], unit) == pytest.approx([expected], rel=1e-7, abs=1e-9)
    assert from_canonical(channel, [expected], unit) == pytest.approx([value], rel=1e-7, abs=1e-9)


def test_a_reading_has_the_unit_of_its_time() -> None:
    times = [dt.datetime(2026, 1, day, 12, tzinfo=dt.UTC) for day in (3, 4)]
    earlier_units = tuple(zip(("l/h", "l/s"), times, strict=True))
    channel = Channel(source="drain", unit="l/min", earlier_units=earlier_units)
    first, second = map(microseconds, times)
    time_us = np.array([second, first - 1, first, second - 1])
    readings = readings_of(pa.array([6.0] * 4))
    flow = raw_channel(Path("log"), "leakage_flow", channel, time_us, readings)
    assert flow.value.tolist() == [6.0, 0.1, 360.0, 360.0]


# What such motors and their sensors can show: peaks of 450 bar on either port, no pressure below a
# vacuum, a charge pump's and a case's own limits, mineral oil that still flows, 500 rpm.
USUAL = {
    "pressure_difference": (-450.0, 450.0),
    "high_port_pressure": (-1.0, 450.0),
    "low_port_pressure": (-1.0, 450.0),
    "charge_pressure": (-1.0, 100.0),
    "case_pressure": (-1.0, 50.0),
    "oil_temperature": (-40.0, 120.0),
    "speed": (-500.0, 500.0),
    "leakage_flow": (0.0, 200.0),
    "running_hours": (0.0, 1e6),
    "kinematic_viscosity": (1.0, 5000.0),
    "dynamic_viscosity": (1.0, 5000.0),
}


@pytest.mark.parametrize("channel", CHANNELS)
def test_a_reading_beyond_what_a_channel_can_show_is_refused(channel: str) -> None:
    low, high = USUAL[channel]
    readings = np.array([low - 0.01, low, high, high + 2e-6 * high + 0.001])
    refused = out_of_range(readings, FALLBACK_VALID_RANGE[channel])
    assert refused.tolist() == [True, False, False, True]


def test_a_canonical_reading_keeps_every_digit() -> None:
    values = np.random.default_rng(1).normal(0.0, 300.0, 100)
    for channel in CHANNELS:
        kept = to_canonical(channel, values, canonical_unit(channel))
        np.testing.assert_array_equal(kept, values)


def test_canonical_units_are_those_of_the_tables() -> None:
    units = {"oil_temperature": "degC", "speed": "rpm", "leakage_flow": "l/min"}
    units |= {"kinematic_viscosity": "mm2/s", "dynamic_viscosity": "mPa.s", "running_hours": "h"}
    pressures = {name: "bar" for name in CHANNELS if "pressure" in name}
    assert {channel: canonical_unit(channel) for channel in CHANNELS} == units | pressures


def test_what_is_not_finite_stays_so() -> None:
    for channel, quantity in QUANTITIES.items():
        for unit in UNITS[quantity]:
            values = to_canonical(channel, [np.nan, np.inf, -np.inf], unit)
            np.testing.assert_array_equal(values, [np.nan, np.inf, -np.inf])


def test_the_readings_given_are_not_changed_and_integers_become_float64() -> None:
    assert to_canonical("speed", np.array([1, 2], dtype=np.int16), "rpm").dtype == np.float64
    for unit in ("bar", "psi"):
        values = np.array([1.0, 2.0])
        result = to_canonical("pressure_difference", values, unit)
        result[:] = 0.0
        np.testing.assert_array_equal(values, [1.0, 2.0])


# Thinning


COLUMNS = arrays(
    np.float64,
    st.tuples(st.integers(1, 400), st.integers(1, 4)),
    elements=st.one_of(st.floats(-1e6, 1e6), st.just(np.nan)),
)


@given(columns=COLUMNS, points=st.integers(10, 80))
def test_rows_are_few_from_end_to_end_and_each_column_keeps_its_extremes(
    columns: np.ndarray, points: int
) -> None:
    kept = keep_extremes(columns.T, points)
    assert len(kept) <= points
    assert len(kept) == len(columns) or len(columns) > points
    assert (np.diff(kept) > 0).all()
    assert (kept[0], kept[-1]) == (0, len(columns) - 1)
    for whole, thinned in zip(columns.T, columns[kept].T, strict=True):
        if not np.isnan(whole).all():
            assert np.nanmin(thinned) == np.nanmin(whole)
            assert np.nanmax(thinned) == np.nanmax(whole)


def test_what_fits_is_left_as_it_is() -> None:
    assert keep_extremes(np.zeros((2, 7)), 7).tolist() == [0, 1, 2, 3, 4, 5, 6]
    assert keep_extremes(np.zeros((2, 0)), 7).tolist() == []


def test_each_bin_keeps_its_own_extremes() -> None:
    """Of ten bins of a hundred rows each, a peak up in one and down in the next."""
    flow = np.zeros(1000)
    flow[[150, 270]] = 5.0, -5.0
    flow[777] = 0.5
    kept = keep_extremes([flow], 22).tolist()
    assert {150, 270, 777} <= set(kept)
