"""Formats that the kit writes logs in, and the rows of these logs."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.config.channels import Channel, Channels
from pipeline.config.logs import Logs
from pipeline.errors import LogError
from pipeline.ingest import RawLog, read_log, time_span

T0_US = 1_740_808_800_000_000
"""2025-03-01T06:00:00 UTC (``date -u -d @1740808800``)."""

STEP_US = 100_000
"""Between rows."""

NAMES = ("dp", "T", "q")
"""Columns, topics or signals of a log of the kit."""

CHANNELS: Channels = {
    "pressure_difference": Channel(source="dp", unit="bar"),
    "oil_temperature": Channel(source="T", unit="degC"),
    "leakage_flow": Channel(source="q", unit="l/min"),
}

Cell = float | str | None
"""A number, text that is none, or nothing; a channel not logged at a time has no cell then."""


@dataclass(frozen=True)
class Row:
    """Cells logged at one time."""

    time_us: int
    cells: Mapping[str, Cell]


@dataclass(frozen=True)
class Format:
    """A format, and a way to write a log in it.

    Attributes
    ----------
    log_format
        Value of ``logs.format``.
    write
        Writes rows to a path, with the columns, topics or signals that are named.
    wide
        All channels share the rows.
    holds_text
        A reading may be written that is no number.
    is_checked
        Checksums cover all samples.
    names_channels
        A log without samples says which channels it has.
    has_whole_rows
        What stands before the place where a file was cut can be told to be whole.
    keys
        Other keys of ``[logs]``.
    survives_damage
        No damage ends the process. Set it to False where the library beneath crashes: that costs a
        run the motor, not the others.
    """

    name: str
    log_format: str
    write: Callable[[Path, Sequence[Row], Sequence[str]], None]
    wide: bool = True
    holds_text: bool = True
    is_checked: bool = False
    names_channels: bool = True
    has_whole_rows: bool = False
    keys: Mapping[str, Any] = field(default_factory=dict)
    survives_damage: bool = True

    @property
    def logs(self) -> Logs:
        """The config that reads it."""
        return Logs(format=self.log_format, files=("*",), **self.keys)


Check = Callable[[Format, Path], None]


def many_rows(count: int = 200) -> list[Row]:
    """Pressure and flow at 10 Hz, temperature every second."""
    rng = random.Random(7)  # noqa: S311
    rows = []
    for i in range(count):
        cells = {"dp": rng.gauss(200.0, 30.0), "q": rng.gauss(1.3, 0.1)}
        if i % 10 == 0:
            cells["T"] = round(rng.gauss(50.0, 1.0), 1)
        rows.append(Row(T0_US + i * STEP_US, cells))
    return rows


def written(form: Format, folder: Path, rows: Sequence[Row], names: Sequence[str] = NAMES) -> Path:
    """Path of a log of a format with these rows."""
    path = folder / f"log.{form.log_format}"
    form.write(path, rows, names)
    return path


def row(time_us: int, pressure: Cell, temperature: Cell = 50.0, flow: Cell = 1.0) -> Row:
    """A row with a cell of each channel."""
    return Row(time_us, {"dp": pressure, "T": temperature, "q": flow})


def pressures(pressures: Sequence[Cell]) -> list[Row]:
    """Rows with these pressures, at the kit's steps."""
    return [row(T0_US + i * STEP_US, cell) for i, cell in enumerate(pressures)]


def samples(log: RawLog, channel: str) -> list[tuple[int, float]]:
    """Samples of a channel that are not missing."""
    raw = log.channels[channel]
    pairs = zip(raw.time_us[~raw.missing], raw.value[~raw.missing], strict=True)
    return [(int(time), float(value)) for time, value in pairs]


def expected(rows: Sequence[Row], name: str) -> list[tuple[int, float]]:
    """Samples of a column that its rows hold."""
    cells = ((row.time_us, row.cells.get(name)) for row in rows)
    return [(time, cell) for time, cell in cells if isinstance(cell, float)]


def require_equal(one: RawLog, other: RawLog) -> None:
    """Refuse two logs that differ."""
    assert (one.rows, one.first_us, one.last_us) == (other.rows, other.first_us, other.last_us)
    assert one.channels.keys() == other.channels.keys()
    for name, channel in one.channels.items():
        np.testing.assert_array_equal(channel.time_us, other.channels[name].time_us)
        np.testing.assert_array_equal(channel.value, other.channels[name].value)
        np.testing.assert_array_equal(channel.missing, other.channels[name].missing)
        assert channel.unparsed == other.channels[name].unparsed


def outcome(read: Callable[[], object]) -> str:
    """Either "read", or the code of the error; one that is not the log's is raised."""
    try:
        read()
    except LogError as error:
        if error.code == "log_reader":
            raise
        return error.code
    return "read"


def error_of(form: Format, path: Path, channels: Channels = CHANNELS) -> LogError:
    """The error with which a log is refused."""
    try:
        read_log(path, form.logs, channels)
    except LogError as error:
        return error
    raise AssertionError(f"{path.name} is read, and not refused")


def span_code(form: Format, path: Path) -> str:
    """Outcome of asking for a log's span."""
    return outcome(lambda: time_span(path, form.logs, CHANNELS))
