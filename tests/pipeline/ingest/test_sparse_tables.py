"""Tables in which each channel has rows of its own, and channels in several files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.config import ConfigError
from pipeline.config.channels import Channels
from pipeline.ingest import RawLog, read_log
from pipeline.ingest.conformance import T0_US, Cell
from pipeline.night.cleaning import ChannelRules, clean_channel
from tests.dialects import Csv, write_parquet
from tests.pipeline.simulated import load_motor, motor_toml, operate, write_log

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
    "pressure_difference": column("hydraulics_*", "bar", field="dp"),
    "oil_temperature": column("hydraulics_*", "degC", field="T"),
    "speed": column("drive_*", "rpm", field="n"),
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


# Constants in place of a channel


STATED = motor_toml("M1").replace('source = "speed"', "constant = 1485.0")
PRESSURE = '\n[channels.case_pressure]\nconstant = 145.0377\nunit = "psi"\n'


def test_a_constant_has_its_value_wherever_there_is_a_drain_flow(tmp_path: Path) -> None:
    """In the unit of the tables; no rule refuses it, neither of range nor of a frozen sensor."""
    spec, operation = load_motor(tmp_path, STATED + PRESSURE), operate()
    path = tmp_path / "logs" / "M1" / "a.parquet"
    values = operation.channels(operation.pressure_bar)
    values["leakage_flow"][3] = np.nan
    write_log(path, operation.time_us, values)
    log = read_log(path, spec.file.logs, spec.file.channels)
    names = ["pressure_difference", "case_pressure", "oil_temperature", "speed", "leakage_flow"]
    assert list(log.channels) == names
    flow = log.channels["leakage_flow"]
    for name, constant in (("speed", 1485.0), ("case_pressure", 10.0)):
        raw, channel = log.channels[name], spec.file.channels[name]
        np.testing.assert_array_equal(raw.time_us, operation.time_us)
        np.testing.assert_array_equal(raw.missing, flow.missing)
        np.testing.assert_allclose(raw.value[~raw.missing], constant, rtol=1e-6)
        rules = ChannelRules.of(name, channel, spec.file.logs)
        assert not clean_channel(raw, rules).refused[~raw.missing].any()


@pytest.mark.parametrize(
    ("before", "after", "key"),
    [
        ("constant = 1485.0", 'constant = 1485.0\nsource = "speed"', "channels.speed.source"),
        ("constant = 1485.0", "constant = 1485.0\nresolution = 0.1", "channels.speed.resolution"),
        ("constant = 1485.0", "", "channels.speed.source"),
        ('source = "leakage_flow"', "constant = 1.5", "channels.leakage_flow.constant"),
    ],
)
def test_what_cannot_be_stated(tmp_path: Path, before: str, after: str, key: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_motor(tmp_path, STATED.replace(before, after))
    assert [fault.key for fault in caught.value.faults] == [key]
