"""Tables in which each channel has rows of its own, and channels in several files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.config.channels import Channels
from pipeline.ingest import RawLog, read_log
from pipeline.ingest.conformance import T0_US
from tests.dialects.columns import Parquet
from tests.dialects.csv_text import Csv

from .sources import Source, column

PRESSURE: Channels = {"pressure_difference": column("dp", "bar")}
WITH_TEMPERATURE: Channels = {**PRESSURE, "oil_temperature": column("T", "degC")}
CHANNELS: Channels = {**WITH_TEMPERATURE, "leakage_flow": column("q", "l/min")}
Cells = dict[str, list[float | str | None]]


TABLES = {"csv": Csv("", written_zone="UTC"), "parquet": Parquet("")}


def write(path: Path, kind: str, cells: Cells) -> None:
    """A table of a row a second."""
    times = T0_US + 1_000_000 * np.arange(len(next(iter(cells.values()))))
    TABLES[kind].table(path, times, cells)


def read(folder: Path, kind: str, cells: Cells, channels: Channels) -> RawLog:
    write(folder / "log", kind, cells)
    return read_log(folder / "log", *Source.of(kind, channels))


def seconds(log: RawLog, channel: str) -> list[int]:
    return ((log.channels[channel].time_us - T0_US) // 1_000_000).tolist()


each_kind = pytest.mark.parametrize("kind", ["csv", "parquet"])


@each_kind
def test_each_channel_has_its_own_rows(tmp_path: Path, kind: str) -> None:
    cells: Cells = {
        "dp": [1.0, None, None, 2.0, None, None, 3.0],
        "T": [None, 50.0, None, None, 51.0, None, None],
        "q": [None, None, 1.5, None, None, 1.6, 1.7],
    }
    log = read(tmp_path, kind, cells, CHANNELS)
    # The last row holds two readings: now and then two channels come at one time.
    assert seconds(log, "pressure_difference") == [0, 3, 6]
    assert seconds(log, "oil_temperature") == [1, 4]
    assert seconds(log, "leakage_flow") == [2, 5, 6]
    assert log.channels["leakage_flow"].value.tolist() == [1.5, 1.6, 1.7]
    assert not any(channel.missing.any() for channel in log.channels.values())
    assert (log.rows, log.notes) == (7, ())
    for channel in log.channels.values():
        for array in (channel.time_us, channel.value, channel.missing):
            assert not array.flags.writeable


@each_kind
def test_a_channel_without_any_reading_keeps_its_blank_cells(tmp_path: Path, kind: str) -> None:
    cells: Cells = {"dp": [1.0, None, 2.0], "T": [None] * 3, "q": [None, 1.5, None]}
    log = read(tmp_path, kind, cells, CHANNELS)
    assert log.channels["oil_temperature"].missing.tolist() == [True] * 3
    assert seconds(log, "leakage_flow") == [1]


def test_two_channels_of_one_column_do_not_share_rows_with_each_other(tmp_path: Path) -> None:
    channels = {**WITH_TEMPERATURE, "high_port_pressure": column("dp", "bar")}
    cells: Cells = {"dp": [1.0, None, 2.0, None], "T": [None, 50.0, None, 51.0]}
    log = read(tmp_path, "csv", cells, channels)
    assert seconds(log, "pressure_difference") == seconds(log, "high_port_pressure") == [0, 2]
    assert seconds(log, "oil_temperature") == [1, 3]


def test_text_that_is_no_number_is_counted_all_the_same(tmp_path: Path) -> None:
    cells: Cells = {"dp": [1.0, None, "ERR", None, 3.0], "T": [None, 50.0, None, 51.0, None]}
    log = read(tmp_path, "csv", cells, WITH_TEMPERATURE)
    assert seconds(log, "pressure_difference") == [0, 4]
    assert log.channels["pressure_difference"].unparsed == 1


APART: Channels = {
    "pressure_difference": column("hydraulics_*", "bar", value_column="dp"),
    "oil_temperature": column("hydraulics_*", "degC", value_column="T"),
    "speed": column("drive_*", "rpm", value_column="n"),
    "leakage_flow": column("drain_*", "l/min"),
}


@each_kind
def test_each_of_several_files_gives_its_channels(tmp_path: Path, kind: str) -> None:
    source = Source.of(kind, APART, layout="file_per_channel")
    for name, cells, expected in (
        (
            "hydraulics_1",
            {"dp": [2.0], "T": [5.0]},
            {"pressure_difference": 2, "oil_temperature": 5},
        ),
        ("drive_1", {"n": [3.0], "torque": [1.0]}, {"speed": 3}),
        ("drain_1", {"value": [1.5]}, {"leakage_flow": 1.5}),
    ):
        write(tmp_path / name, kind, dict(cells))
        log = read_log(tmp_path / name, *source)
        found = {
            key: channel.value.tolist()
            for key, channel in log.channels.items()
            if len(channel.value)
        }
        assert found == {key: [value] for key, value in expected.items()}
