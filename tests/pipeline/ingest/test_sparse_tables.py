"""Tables in which each channel has rows of its own, and channels in several files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.config.channels import Channels
from pipeline.ingest import RawLog, read_log
from pipeline.ingest.conformance import T0_US, Cell
from tests.dialects import Csv, write_parquet

from .sources import Source, column

CHANNELS: Channels = {
    "high_port_pressure": column("dp", "bar"),
    "pressure_difference": column("dp", "bar"),
    "oil_temperature": column("T", "degC"),
    "leakage_flow": column("q", "l/min"),
}
WRITERS = {"csv": Csv(written_zone="UTC").table, "parquet": write_parquet}
Cells = dict[str, list[Cell]]


def read(path: Path, kind: str, cells: Cells, source: Source) -> RawLog:
    """The log that a table of a row a second is read as."""
    times = T0_US + 1_000_000 * np.arange(len(next(iter(cells.values()))))
    WRITERS[kind](path, times, cells)
    return read_log(path, *source)


@pytest.mark.parametrize("kind", ["csv", "parquet"])
@pytest.mark.parametrize(
    ("cells", "seconds"),
    [
        # The last row holds two readings: now and then two channels come at one time.
        pytest.param(
            {
                "dp": [1.0, None, None, 2.0, None, None, 3.0],
                "T": [None, 50.0, None, None, 51.0, None, None],
                "q": [None, None, 1.5, None, None, 1.6, 1.7],
            },
            {"dp": [0, 3, 6], "T": [1, 4], "q": [2, 5, 6]},
            id="each its own",
        ),
        pytest.param(
            {"dp": [1.0, None, 2.0], "T": [None] * 3, "q": [None, 1.5, None]},
            {"dp": [0, 2], "T": [0, 1, 2], "q": [1]},
            id="one without any",
        ),
        pytest.param(
            {"dp": [1.0, None, "ERR", None, 3.0], "T": [None, 50.0, None, 51.0, None]},
            {"dp": [0, 4], "T": [1, 3]},
            id="text",
        ),
    ],
)
def test_rows_that_are_blank_for_others_are_none_of_a_channel(
    tmp_path: Path, kind: str, cells: Cells, seconds: dict[str, list[int]]
) -> None:
    if kind == "parquet":  # which has numbers alone
        of_numbers = cells.items()
        cells = {name: [None if cell == "ERR" else cell for cell in of] for name, of in of_numbers}
    channels = {name: own for name, own in CHANNELS.items() if own.source in cells}
    log = read(tmp_path / "log", kind, cells, Source.of(kind, channels))
    for name, channel in log.channels.items():
        here = (channel.time_us - T0_US) // 1_000_000
        assert here.tolist() == seconds[channels[name].source]
        assert not channel.missing.any() or channels[name].source == "T"
        assert channel.unparsed == cells[channels[name].source].count("ERR")
        assert not any(a.flags.writeable for a in (channel.time_us, channel.value, channel.missing))
    assert (log.rows, log.notes) == (len(cells["dp"]), ())


APART: Channels = {
    "pressure_difference": column("hydraulics_*", "bar", value_column="dp"),
    "oil_temperature": column("hydraulics_*", "degC", value_column="T"),
    "speed": column("drive_*", "rpm", value_column="n"),
    "leakage_flow": column("drain_*", "l/min"),
}


@pytest.mark.parametrize("kind", ["csv", "parquet"])
@pytest.mark.parametrize(
    ("name", "cells", "expected"),
    [
        ("hydraulics_1", {"dp": 2.0, "T": 5.0}, {"pressure_difference": 2, "oil_temperature": 5}),
        ("drive_1", {"n": 3.0, "torque": 1.0}, {"speed": 3}),
        ("drain_1", {"value": 1.5}, {"leakage_flow": 1.5}),
    ],
)
def test_each_of_several_files_gives_its_channels(
    tmp_path: Path, kind: str, name: str, cells: dict[str, float], expected: dict[str, float]
) -> None:
    source = Source.of(kind, APART, layout="file_per_channel")
    log = read(tmp_path / name, kind, {key: [cell] for key, cell in cells.items()}, source)
    found = {key: part.value.tolist() for key, part in log.channels.items() if len(part.value)}
    assert found == {key: [value] for key, value in expected.items()}
