"""Tables of samples in any layout, gathered in pieces and given as channels."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from pipeline.arrays import chosen_rows
from pipeline.config.channels import Channel, QualityValue
from pipeline.errors import LogError
from pipeline.ingest.assembly import (
    Readings,
    converted,
    judged,
    raw_channel,
    raw_log,
    span,
    time_name,
    without_rows_of_others,
)
from pipeline.ingest.contract import LogFile, RawChannel, RawLog
from pipeline.ingest.gathering import GatheredReadings, GatheredStamps
from pipeline.ingest.quality import quality_states
from pipeline.ingest.time_stamps import WrittenStamps, placed
from pipeline.ingest.wall_clock import TimeStamps

_MOST_NAMES = 2**15 - 1

_Quality = tuple[str, tuple[QualityValue, ...]]
"""A column of qualities, and what is good there."""


@dataclass(frozen=True, slots=True)
class Columns:
    """Columns of a table that are wanted, each once."""

    time: tuple[str, ...]  # of the time, or of date and time
    name: str | None  # of the channel's name; None where it is not in the rows
    numbers: tuple[str, ...]  # of readings
    qualities: tuple[str, ...] = ()  # of what the log says of its samples
    motor: str | None = None  # of the name of the row's motor; None: all rows are the motor's

    @property
    def all(self) -> tuple[str, ...]:
        """All of them."""
        names = tuple(name for name in (self.name, self.motor) if name is not None)
        return tuple(dict.fromkeys((*self.time, *names, *self.numbers, *self.qualities)))

    def channel_names(self, cells: Mapping[str, pa.ChunkedArray]) -> pa.ChunkedArray | None:
        """Names of the rows' channels; None: rows have none."""
        return None if self.name is None else cells[self.name].cast(pa.string())


def wanted_columns(file: LogFile) -> Columns:
    """Columns that hold time and channels in the layout of a log.

    Raises
    ------
    LogError
        ``log_column_missing``: the file's name is that of no channel.
    """
    logs, channels = file.logs, file.channels
    times = (logs.date_column, logs.time) if logs.date_column else (logs.time,)
    motor = logs.motor_column or None
    if logs.layout == "long":
        qualities = _qualities(channels.values())
        return Columns(times, logs.channel_column, (logs.value_column,), qualities, motor)
    if logs.layout == "file_per_channel":
        here = [channel for channel in channels.values() if is_of_file(channel, file.path)]
        if not here:
            patterns = ", ".join(repr(channel.source) for channel in channels.values())
            raise LogError(
                "log_column_missing",
                file.path,
                f"the file's name is that of no channel: their sources are {patterns}",
            )
        values = dict.fromkeys(channel.value_column or logs.value_column for channel in here)
        return Columns(times, None, tuple(values), _qualities(here), motor)
    numbers = tuple(dict.fromkeys(channel.source for channel in channels.values()))
    return Columns(times, None, numbers, _qualities(channels.values()), motor)


def _qualities(channels: Iterable[Channel]) -> tuple[str, ...]:
    named = (channel.quality_source for channel in channels if channel.quality_source)
    return tuple(dict.fromkeys(named))


def is_of_file(channel: Channel, path: Path) -> bool:
    """True if a file of one channel holds this one."""
    return fnmatchcase(path.name, channel.source)


def _quality_of(channel: Channel) -> _Quality:
    return channel.quality_source, channel.quality_good


class RawTable:
    """Rows of a log, gathered in the order of the file; each piece is given up once joined."""

    def __init__(self, file: LogFile) -> None:
        self.path = file.path
        self.logs = file.logs
        self.latest_us = file.latest_us
        self.channels = file.channels
        self._written = GatheredStamps()
        self._readings: dict[str, GatheredReadings] = {}  # by column, as they stand
        self._names: list[NDArray[np.int16]] = []
        self._seen: dict[str, int] = {}
        # Of all rows, by what they are called and what is good.
        self._states: dict[_Quality, list[NDArray[np.uint8]]] = {}
        self._motors: set[str] = set()

    def of_motor(
        self, columns: Columns, cells: Mapping[str, pa.ChunkedArray]
    ) -> Mapping[str, pa.ChunkedArray]:
        """The cells of the motor's own rows."""
        if columns.motor is None:
            return cells
        motors = pc.utf8_trim_whitespace(cells[columns.motor].cast(pa.string()))
        self._motors |= set(pc.unique(motors).drop_null().to_pylist()) - {""}
        own = pc.equal(motors, self.logs.motor_name)
        return {name: column.filter(own) for name, column in cells.items()}

    def add(
        self,
        written: WrittenStamps,
        readings: Mapping[str, Readings],
        names: pa.ChunkedArray | None,
        qualities: Mapping[str, pa.ChunkedArray],
    ) -> None:
        """Add rows: their times, readings and qualities by column, and names in layout "long"."""
        self._written.add(written)
        for column, part in readings.items():
            self._readings.setdefault(column, GatheredReadings()).add(part)
        if names is not None:
            self._names.append(self._codes(names))
        for column, good in dict.fromkeys(map(_quality_of, self.channels.values())):
            if column in qualities:
                states = quality_states(self.path, column, qualities[column], good)
                self._states.setdefault((column, good), []).append(states)

    def _codes(self, names: pa.ChunkedArray) -> NDArray[np.int16]:
        """Number of each row's name among those seen so far; -1 where there is none."""
        trimmed = pc.utf8_trim_whitespace(names)
        for name in pc.unique(trimmed).to_pylist():
            if name:
                self._seen.setdefault(name, len(self._seen))
        if len(self._seen) > _MOST_NAMES:
            raise LogError(
                "log_type",
                self.path,
                f"column {self.logs.channel_column!r} holds more than {_MOST_NAMES} names: it is "
                "not that of channels",
                self.logs.channel_column,
            )
        known = pa.array(list(self._seen), pa.string())
        codes: NDArray[np.int16] = (
            pc.fill_null(pc.index_in(trimmed, value_set=known), -1).to_numpy().astype(np.int16)
        )
        return codes

    def span(self) -> tuple[int, int]:
        """First and last time stamp; errors as of `judged`, and ``log_empty``."""
        stamps, _ = self._stamps()
        return span(self.path, [stamps.time_us[stamps.readable]])

    def log(self, refused: Mapping[str, int]) -> RawLog:
        """All rows as a log, with counts of those left out before; the table is empty afterwards.

        Raises
        ------
        LogError
            ``log_type``; ``log_time`` where more than half of the rows have no time;
            ``log_column_missing`` where a table has rows, and none of the motor, or a long one
            none of a wanted channel.
        """
        if self._motors and self.logs.motor_name not in self._motors:
            there = ", ".join(repr(name[:40]) for name in sorted(self._motors)[:40])
            raise LogError(
                "log_column_missing",
                self.path,
                f"no row of motor {self.logs.motor_name!r} in column {self.logs.motor_column!r}; "
                f"there are {there}",
                self.logs.motor_column,
            )
        stamps, without_time = self._stamps()
        refused = {**refused, **without_time}
        if self.logs.layout == "long":
            return self._long_log(stamps, refused)
        rows = chosen_rows(stamps.readable)
        time_us = stamps.time_us[rows]
        states = self._joined_states()
        columns = {name: self._column(channel) for name, channel in self.channels.items()}
        channels: dict[str, RawChannel] = {}
        # A column is given up with its last channel, so that a long log is not held twice.
        for column in dict.fromkeys(columns.values()):
            readings = self._taken(column)
            readings = readings.rows(rows) if column is not None else readings
            for name, channel in self.channels.items():
                if columns[name] == column:
                    here = time_us if column is not None else np.empty(0, np.int64)
                    quality = None if column is None else states.get(_quality_of(channel))
                    own = None if quality is None else quality[rows]
                    made = converted(name, channel, readings)
                    channels[name] = raw_channel(self.path, name, channel, here, made, own)
        channels = {name: channels[name] for name in self.channels}
        if self.logs.layout == "wide":
            sources: dict[str, str] = {name: one.source for name, one in self.channels.items()}
            channels = without_rows_of_others(channels, sources)
        return raw_log(channels, time_us.size, refused)

    def _column(self, channel: Channel) -> str | None:
        """Column of a channel; None where it is in another file."""
        if self.logs.layout == "wide":
            return channel.source
        own = channel.value_column or self.logs.value_column
        return own if is_of_file(channel, self.path) else None

    def _taken(self, column: str | None) -> Readings:
        return self._readings.pop(column or "", GatheredReadings()).taken()

    def _joined_states(self) -> dict[_Quality, NDArray[np.uint8]]:
        return {quality: np.concatenate(parts) for quality, parts in self._states.items()}

    def _long_log(self, stamps: TimeStamps, refused: Mapping[str, int]) -> RawLog:
        names = np.concatenate([np.empty(0, np.int16), *self._names])
        readings = self._taken(self.logs.value_column)
        states = self._joined_states()
        channels: dict[str, RawChannel] = {}
        for name, channel in self.channels.items():
            rows = (names == self._seen.get(channel.source, -2)) & stamps.readable
            channels[name] = raw_channel(
                self.path,
                name,
                channel,
                stamps.time_us[rows],
                converted(name, channel, readings.rows(rows)),
                None if (own := states.get(_quality_of(channel))) is None else own[rows],
            )
        sources = [channel.source for channel in self.channels.values()]
        absent = [name for name in sources if name not in self._seen]
        there = ", ".join(repr(name[:40]) for name in list(self._seen)[:40])
        if names.size and len(absent) == len(sources):
            raise LogError(
                "log_column_missing", self.path, f"no row of {absent[0]!r}; there are {there}"
            )
        remarks = [f"no row of {name!r}; there are {there}" for name in absent if names.size]
        rows_read = sum(part.time_us.size for part in channels.values())
        return raw_log(channels, rows_read, refused, remarks)

    def _stamps(self) -> tuple[TimeStamps, dict[str, int]]:
        stamps = placed(self._written.taken(), self.logs.time_zone)
        name = time_name(self.logs, stamps.example)
        (past,), refused = judged(self.path, [stamps], name, self.latest_us)
        return past, refused
