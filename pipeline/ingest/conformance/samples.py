"""Checks of what a reader gives: samples, units, what is missing, order and span."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np

from pipeline.config.channels import Channel, Channels
from pipeline.ingest import read_log, time_span
from pipeline.ingest.conformance.formats import (
    CHANNELS,
    STEP_US,
    T0_US,
    Cell,
    Format,
    error_of,
    expected,
    many_rows,
    pressures,
    require_equal,
    row,
    samples,
    written,
)


def every_sample_comes_back_to_the_last_digit(form: Format, folder: Path) -> None:
    """Times, values, order of channels, and no notes."""
    rows = many_rows()
    log = read_log(written(form, folder, rows), form.logs, CHANNELS)
    assert list(log.channels) == list(CHANNELS)
    for name, channel in CHANNELS.items():
        assert samples(log, name) == expected(rows, channel.source)
        assert log.channels[name].unparsed == 0
    assert (log.notes, log.refused_rows) == ((), 0)


def a_channel_logged_less_often_is_missing_in_between_or_not_there(
    form: Format, folder: Path
) -> None:
    """A blank cell where rows are shared, no sample where they are not."""
    log = read_log(written(form, folder, many_rows()), form.logs, CHANNELS)
    temperature = log.channels["oil_temperature"]
    assert temperature.time_us.size == (200 if form.wide else 20)
    assert temperature.missing.sum() == (180 if form.wide else 0)
    assert np.isnan(temperature.value[temperature.missing]).all()
    assert log.rows == (200 if form.wide else 420)


def arrays_have_the_types_of_the_contract_and_cannot_be_written(form: Format, folder: Path) -> None:
    """Int64 times, float64 values, truth values, of one length, and read-only."""
    log = read_log(written(form, folder, many_rows()), form.logs, CHANNELS)
    for channel in log.channels.values():
        kinds = [one.dtype for one in (channel.time_us, channel.value, channel.missing)]
        assert kinds == [np.int64, np.float64, np.bool_]
        for values in (channel.time_us, channel.value, channel.missing):
            assert values.shape == (channel.time_us.size,)
            assert not values.flags.writeable


def scale_offset_and_unit_make_the_canonical_reading(form: Format, folder: Path) -> None:
    """A 4–20 mA transmitter for 0–400 bar, here in psi; °F; US gallons."""
    channels: Channels = {
        "pressure_difference": Channel(source="dp", unit="psi", scale=362.5943, offset=-1450.377),
        "oil_temperature": Channel(source="T", unit="degF"),
        "leakage_flow": Channel(source="q", unit="us_gal/min"),
    }
    log = read_log(written(form, folder, [row(T0_US, 12.0, 122.0)]), form.logs, channels)
    np.testing.assert_allclose(log.channels["pressure_difference"].value, [200.0], rtol=1e-6)
    np.testing.assert_allclose(log.channels["oil_temperature"].value, [50.0])
    np.testing.assert_allclose(log.channels["leakage_flow"].value, [3.785411784])


def a_reading_too_large_for_another_unit_is_not_finite(form: Format, folder: Path) -> None:
    """1e309 m3/s."""
    channels: Channels = {"leakage_flow": Channel(source="q", unit="m3/s", scale=10.0)}
    log = read_log(written(form, folder, [row(T0_US, 1.0, 1.0, 1e308)]), form.logs, channels)
    assert log.channels["leakage_flow"].value.tolist() == [np.inf]


def blank_and_null_are_missing_but_nan_and_infinity_are_readings(
    form: Format, folder: Path
) -> None:
    """Cleaning refuses what is not finite; a reader passes it on."""
    values = [1.0, None, float("nan"), float("inf"), float("-inf"), 2.0]
    log = read_log(written(form, folder, pressures(values)), form.logs, CHANNELS)
    channel = log.channels["pressure_difference"]
    assert channel.missing.tolist() == [False, True, False, False, False, False]
    np.testing.assert_array_equal(
        channel.value, [1.0, np.nan, np.nan, np.inf, -np.inf, 2.0], strict=True
    )
    assert channel.unparsed == 0


def a_channel_that_is_null_throughout_is_missing_throughout(form: Format, folder: Path) -> None:
    """No error: the others are good."""
    log = read_log(written(form, folder, pressures([None] * 5)), form.logs, CHANNELS)
    assert log.channels["pressure_difference"].missing.all()
    assert log.channels["pressure_difference"].unparsed == 0
    assert not log.channels["leakage_flow"].missing.any()


def text_that_is_no_number_is_missing_and_counted(form: Format, folder: Path) -> None:
    """Counted in its channel alone."""
    cells: list[Cell] = [1.0, "ERR", 2.0, "1.2.3", None, "0x10", "true", 3.0]
    log = read_log(written(form, folder, pressures(cells)), form.logs, CHANNELS)
    channel = log.channels["pressure_difference"]
    assert channel.unparsed == 4
    assert channel.value[~channel.missing].tolist() == [1.0, 2.0, 3.0]
    assert channel.missing.sum() == 5
    assert log.channels["leakage_flow"].unparsed == 0


def a_channel_without_one_number_is_an_error_of_type(form: Format, folder: Path) -> None:
    """With an example of what is there."""
    error = error_of(form, written(form, folder, pressures(["broken wire"] * 5)))
    assert error.code == "log_type"
    assert "'broken wire'" in error.message


def backward_and_repeated_time_stays_in_the_order_of_the_file(form: Format, folder: Path) -> None:
    """A reader sorts nothing."""
    offsets = [0, 5, 3, 3, 9, 1]
    rows = [row(T0_US + offset * STEP_US, float(i)) for i, offset in enumerate(offsets)]
    log = read_log(written(form, folder, rows), form.logs, CHANNELS)
    channel = log.channels["pressure_difference"]
    assert ((channel.time_us - T0_US) // STEP_US).tolist() == offsets
    assert channel.value.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    assert (log.first_us, log.last_us) == (T0_US, T0_US + 9 * STEP_US)


def time_span_is_that_of_the_samples(form: Format, folder: Path) -> None:
    """With and without reading everything."""
    path = written(form, folder, many_rows(3000))
    log = read_log(path, form.logs, CHANNELS)
    span = (T0_US, T0_US + 2999 * STEP_US)
    assert time_span(path, form.logs, CHANNELS) == (log.first_us, log.last_us) == span


def two_readings_are_equal_and_travel_between_processes(form: Format, folder: Path) -> None:
    """The same file gives the same log."""
    path = written(form, folder, many_rows())
    log = read_log(path, form.logs, CHANNELS)
    require_equal(log, read_log(path, form.logs, CHANNELS))
    require_equal(log, pickle.loads(pickle.dumps(log)))  # noqa: S301


def only_what_is_wanted_is_read(form: Format, folder: Path) -> None:
    """One channel of three."""
    wanted: Channels = {"pressure_difference": CHANNELS["pressure_difference"]}
    log = read_log(written(form, folder, many_rows()), form.logs, wanted)
    assert list(log.channels) == ["pressure_difference"]
    assert log.rows == 200


def one_source_may_feed_two_channels(form: Format, folder: Path) -> None:
    """In different units."""
    channels: Channels = {
        "high_port_pressure": Channel(source="dp", unit="kPa"),
        "pressure_difference": CHANNELS["pressure_difference"],
    }
    found = read_log(written(form, folder, many_rows()), form.logs, channels).channels
    np.testing.assert_allclose(
        found["high_port_pressure"].value * 100.0, found["pressure_difference"].value, rtol=1e-12
    )
