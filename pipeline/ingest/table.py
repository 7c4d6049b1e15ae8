"""Tables of samples in any layout, gathered in pieces and given as channels."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from pipeline.arrays import Rows, chosen_rows
from pipeline.config.channels import Channel, Channels
from pipeline.errors import LogError
from pipeline.ingest.assembly import (
    Gathered,
    Growing,
    Readings,
    drop_bad_stamps,
    no_samples,
    raw_log,
    without_rows_of_others,
)
from pipeline.ingest.contract import LogFile, RawLog, span
from pipeline.ingest.time_stamps import TimeStamps, WrittenStamps, example_of

_MOST_NAMES = 40


@dataclass(frozen=True, slots=True)
class Columns:
    """Columns of a table that are wanted, each once."""

    time: tuple[str, ...]  # of the time, or of date and time
    name: str | None = None  # of the channel's name; None where it is not in the rows
    numbers: tuple[str, ...] = ()  # of readings
    qualities: tuple[str, ...] = ()  # of what the log says of its samples
    motor: str | None = None  # of the name of the row's motor; None: all rows are the motor's

    @property
    def all(self) -> tuple[str, ...]:
        """All of them."""
        names = tuple(name for name in (self.name, self.motor) if name is not None)
        return tuple(dict.fromkeys((*self.time, *names, *self.numbers, *self.qualities)))


def wanted_columns(file: LogFile) -> Columns:
    """Return columns that hold time and channels in the layout of a log.

    Raises LogError: ``log_column_missing``: the file's name is that of no channel.
    """
    logs, channels = file.logs, _channels_of(file)
    times = (logs.date_column, logs.time) if logs.date_column else (logs.time,)
    qualities = dict.fromkeys(
        channel.quality_source for channel in channels.values() if channel.quality_source
    )
    return Columns(
        times,
        logs.channel_column if logs.layout == "long" else None,
        tuple(dict.fromkeys(_column_of(file, channel) for channel in channels.values())),
        tuple(qualities),
        logs.motor_rows[0] if logs.motor_rows else None,
    )


def _channels_of(file: LogFile) -> Channels:
    """Return the channels that a file may hold; of a file a channel those that its name is of."""
    if file.logs.layout != "file_per_channel":
        return file.channels
    here = {
        name: channel
        for name, channel in file.channels.items()
        if fnmatchcase(file.path.name, channel.source)
    }
    if not here:
        patterns = ", ".join(repr(channel.source) for channel in file.channels.values())
        raise LogError(
            "log_column_missing",
            file.path,
            f"the file's name is that of no channel: their sources are {patterns}",
        )
    return here


def _column_of(file: LogFile, channel: Channel) -> str:
    if file.logs.layout == "wide":
        return channel.source
    own = channel.field if file.logs.layout == "file_per_channel" else ""
    return own or file.logs.value_column


def require_columns(
    path: Path, names: Sequence[str], wanted: Sequence[str], parted: str = ""
) -> None:
    """Refuse a table of which a wanted column is missing, or there several times."""
    for name in wanted:
        count = names.count(name)
        if count > 1:
            how = f"{count} columns are called {name!r}: rename one"
            raise LogError("log_column_twice", path, how)
        if not count:
            there = ", ".join(repr(known[:40]) for known in names[:_MOST_NAMES])
            hint = ", not in encoding utf-8: set the right one" if "\ufffd" in there else ""
            how = f"no column {name!r}; {parted}there are {there}{hint}"
            raise LogError("log_column_missing", path, how)


class RawTable:
    """Rows of a log, gathered in the order of the file; each piece is given up once joined.

    `stamps_of` and `readings_of` are how a format's cells are read: those of the time, and those of
    a column by its name.
    """

    def __init__(
        self,
        file: LogFile,
        columns: Columns,
        stamps_of: Callable[[Sequence[pa.ChunkedArray]], WrittenStamps],
        readings_of: Callable[[str, pa.ChunkedArray], Readings],
    ) -> None:
        self.file, self.columns = file, columns
        self._stamps_of, self._readings_of = stamps_of, readings_of
        own = _channels_of(file) if columns.numbers else {}
        self._rows = Gathered(
            file.path, own, {name: _column_of(file, channel) for name, channel in own.items()}
        )
        # Of rows in layout "long": the number of the wanted name, -1 for others.
        self._names = Growing(np.int16)
        self._sources = list(dict.fromkeys(channel.source for channel in file.channels.values()))
        self._seen: dict[str, None] = {}  # the first names, of channels or else of motors
        self._has_motor = columns.motor is None

    def add(self, cells: Mapping[str, pa.ChunkedArray]) -> None:
        """Add rows: their cells by column."""
        columns = self.columns
        if columns.motor is not None and self.file.logs.motor_rows:
            column, motor = self.file.logs.motor_rows
            motors = pc.utf8_trim_whitespace(cells[column].cast(pa.string()))
            own = pc.equal(motors, motor)
            if not self._has_motor:
                self._see(motors)
            if not self._has_motor and pc.any(own).as_py():
                self._has_motor, self._seen = True, {}
            cells = {name: column.filter(own) for name, column in cells.items()}
        if columns.name is not None:
            names = pc.utf8_trim_whitespace(cells[columns.name].cast(pa.string()))
            self._see(names)
            codes = pc.index_in(names, value_set=pa.array(self._sources, pa.string()))
            self._names.append(pc.fill_null(codes, -1).to_numpy().astype(np.int16))
        self._rows.add(
            self._stamps_of([cells[name] for name in columns.time]),
            {name: self._readings_of(name, cells[name]) for name in columns.numbers},
            cells,
        )

    def _see(self, names: pa.ChunkedArray) -> None:
        if len(self._seen) < _MOST_NAMES:
            self._seen |= dict.fromkeys(name for name in pc.unique(names).to_pylist() if name)

    def _names_seen(self) -> str:
        return ", ".join(repr(name[:40]) for name in list(self._seen)[:_MOST_NAMES])

    def span(self) -> tuple[int, int]:
        """Return first and last time stamp; errors as of `judged`, and ``log_empty``."""
        stamps, _ = self._stamps()
        return span(self.file.path, [stamps.time_us[stamps.readable]])

    def log(self, refused: Mapping[str, int]) -> RawLog:
        """Return all rows as a log, with counts of those left out; the table is empty then.

        Raises LogError: ``log_type``; ``log_time`` where more than half of the rows have no time;
        ``log_column_missing`` where a table has rows, and none of the motor, or if long none of
        a wanted channel.
        """
        file, logs = self.file, self.file.logs
        if logs.motor_rows and not self._has_motor and self._seen:
            column, motor = logs.motor_rows
            how = f"no row of motor {motor!r} in column {column!r}; there are "
            raise LogError("log_column_missing", file.path, how + self._names_seen(), column)
        stamps, without_time = self._stamps()
        refused = {**refused, **without_time}
        if logs.layout == "long":
            names = self._names.taken()
            remarks = self._absent(names)
            rows: dict[str, Rows] = {
                source: (names == number) & stamps.readable
                for number, source in enumerate(self._sources)
            }
            by_source = {source: (own, stamps.time_us[own]) for source, own in rows.items()}
            places = {name: by_source[channel.source] for name, channel in file.channels.items()}
            channels = self._rows.channels_at(places)
            count = sum(part.time_us.size for part in channels.values())
            return raw_log(channels, count, refused, remarks)
        readable = chosen_rows(stamps.readable)
        here = self._rows.channels_at(
            dict.fromkeys(file.channels, (readable, stamps.time_us[readable]))
        )
        channels = {name: here.get(name, no_samples()) for name in file.channels}
        if logs.layout == "wide":
            channels = without_rows_of_others(channels, self._rows.columns)
        return raw_log(channels, int(np.count_nonzero(stamps.readable)), refused)

    def _absent(self, names: NDArray[np.int16]) -> list[str]:
        """Return remarks on names that no row of a long table has; none of all is an error."""
        if not names.size:
            return []
        counts = np.bincount(names + 1, minlength=len(self._sources) + 1)
        absent = [
            source for source, count in zip(self._sources, counts[1:], strict=True) if not count
        ]
        if len(absent) == len(self._sources):
            how = f"no row of {absent[0]!r}; there are {self._names_seen()}"
            raise LogError("log_column_missing", self.file.path, how)
        return [f"no row of {name!r}; there are {self._names_seen()}" for name in absent]

    def _stamps(self) -> tuple[TimeStamps, dict[str, int]]:
        logs = self.file.logs
        stamps = self._rows.stamps(logs.time_zone)
        here = f"; here is {stamps.example[:40]!r}" if stamps.example else ""
        name = f"{logs.time!r} in format {logs.time_format} (such as "
        name += f"{example_of(logs.time_format)}{here})"
        (past,), refused = drop_bad_stamps(self.file.path, [stamps], name, self.file.latest_us)
        return past, refused
