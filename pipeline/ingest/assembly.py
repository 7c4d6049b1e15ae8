"""Steps that all readers share: readings are gathered in pieces, judged and converted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pipeline.arrays import Rows
from pipeline.clock import IN_FUTURE, microseconds
from pipeline.config.channels import Channel, Channels, QualityValue
from pipeline.errors import LogError
from pipeline.ingest.cells import is_bad, may_be_number, nulls, quality_states
from pipeline.ingest.contract import LogFile, RawChannel, RawLog
from pipeline.ingest.time_stamps import (
    TimeStamps,
    WrittenStamps,
    parse_numbers,
    place_in_zone,
)
from pipeline.messages import counted
from pipeline.units import canonical_unit, to_canonical

_T = TypeVar("_T", bound=np.generic)


@dataclass(frozen=True, slots=True)
class Readings:
    """Raw figures of a channel, before scale, offset and unit."""

    raw: NDArray[np.float64]  # nan where missing
    missing: NDArray[np.bool_]
    unparsed: NDArray[np.bool_]  # part of `missing`: there was something, and it is no number
    example: str | None = None  # the first of these, for a message

    def rows(self, chosen: Rows) -> Readings:
        """Return the readings of some rows."""
        raw = self.raw[chosen]
        # Marks of no cell are alike in all rows.
        marks = chosen if self.missing.any() else slice(raw.size)
        return Readings(raw, self.missing[marks], self.unparsed[marks], self.example)


def readings_of(column: pa.Array | pa.ChunkedArray) -> Readings:
    """Return readings of a column of numbers; null where missing."""
    # Not safe: an integer beyond 2**53 may lose its last digits, it is a measurement all the same.
    numbers = column.cast(pa.float64(), safe=False)
    missing, none = nulls(column), np.zeros(len(column), dtype=np.bool_)
    raw = numbers.fill_null(np.nan) if column.null_count else numbers
    return Readings(raw.to_numpy(), missing, none)


def _in_canonical_unit(
    name: str, channel: Channel, time_us: NDArray[np.int64], raw: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return figures of a channel with scale, offset and unit applied."""
    # A reading may be beyond float64 in another unit, or a signalling nan: it is then not finite.
    with np.errstate(over="ignore", invalid="ignore"):
        if channel.scale != 1.0 or channel.offset != 0.0:
            raw = raw * channel.scale
            raw += channel.offset
    # Counts are read as they are; cleaning makes a flow of them.
    if channel.is_counted or channel.units == (canonical_unit(name),):
        return raw
    readings = to_canonical(name, raw, channel.unit)
    for unit, end in reversed(channel.earlier_units):
        is_before = time_us < microseconds(end)
        readings = np.where(is_before, to_canonical(name, raw, unit), readings)
    return readings


def raw_channel(
    path: Path,
    name: str,
    channel: Channel,
    time_us: NDArray[np.int64],
    readings: Readings,
    quality: NDArray[np.uint8] | None = None,
) -> RawChannel:
    """Return channel of readings as logged, with their `quality_states` if the log has them.

    Raises LogError: ``log_type``: the channel holds something, but not a single number.
    """
    bad = None if quality is None else is_bad(quality, readings.missing)
    unparsed = int(np.count_nonzero(readings.unparsed))
    is_marked = bad is not None and bool(bad[readings.unparsed].all())
    if unparsed and readings.missing.all() and not is_marked:
        raise LogError(
            "log_type",
            path,
            f"{channel.source} (channel {name}) holds no number in {counted(unparsed, 'cell')}, "
            f"such as {readings.example!r}: give the right column, decimal sign or missing_tokens",
            channel.source,
        )
    value = _in_canonical_unit(name, channel, time_us, readings.raw)
    return _freeze(RawChannel(time_us, value, readings.missing, unparsed, bad, readings.example))


def _freeze(channel: RawChannel) -> RawChannel:
    for array in (channel.time_us, channel.value, channel.missing, channel.bad_quality):
        if array is not None:
            array.flags.writeable = False
    return channel


class Growing(Generic[_T]):
    """An array that grows at its end, where it lies; a lone piece is kept as it is.

    Pieces that are kept until they are joined would leave holes in the memory that a day at 100 Hz
    cannot use: 0.3 GiB.
    """

    def __init__(self, dtype: type[_T]) -> None:
        self._dtype, self._first = dtype, np.empty(0, dtype)
        self._bytes = bytearray()  # of all pieces, once there are two

    def append(self, piece: NDArray[_T]) -> None:
        """Add a piece at the end."""
        if not self._first.size:
            self._first = piece
            return
        # A large array is moved by its pages, not copied.
        for part in (piece,) if self._bytes else (self._first, piece):
            self._bytes += part.tobytes()

    def taken(self) -> NDArray[_T]:
        """Return all elements, to be given up."""
        return np.frombuffer(self._bytes, self._dtype) if self._bytes else self._first


class _Column:
    """Readings of a column or field."""

    def __init__(self) -> None:
        self.raw = Growing(np.float64)
        self.missing, self.unparsed = Growing(np.bool_), Growing(np.bool_)
        self.example: str | None = None

    def add(self, part: Readings) -> None:
        self.raw.append(part.raw)
        self.missing.append(part.missing)
        self.unparsed.append(part.unparsed)
        examples = [cell for cell in (self.example, part.example) if cell]
        self.example = max(examples, key=may_be_number, default=None)

    def taken(self) -> Readings:
        parts = self.raw.taken(), self.missing.taken(), self.unparsed.taken()
        return Readings(*parts, self.example)


class Gathered:
    """Rows of a table, or messages of a topic, in the order of the file.

    `columns` are those, or the fields, that hold the readings of each channel. Two channels may
    share them.
    """

    def __init__(self, path: Path, channels: Channels, columns: Mapping[Any, Any]) -> None:
        self.path, self.channels, self.columns = path, channels, columns
        self._time_us, self._kind = Growing(np.int64), Growing(np.int8)
        self._example: str | None = None
        self._readings = {column: _Column() for column in columns.values()}
        self._states: dict[tuple[str, tuple[QualityValue, ...]], Growing[np.uint8]] = {
            (channel.quality_source, channel.quality_good): Growing(np.uint8)
            for channel in channels.values()
            if channel.quality_source
        }

    def add(
        self,
        stamps: WrittenStamps,
        readings: Mapping[Any, Readings],
        qualities: Mapping[str, pa.Array | pa.ChunkedArray],
    ) -> None:
        """Add a piece: readings by column, and cells by the channels' `quality_source`."""
        self._time_us.append(stamps.time_us)
        self._kind.append(stamps.kind)
        self._example = self._example or stamps.example
        for column, known in self._readings.items():
            known.add(readings[column])
        for (source, good), states in self._states.items():
            states.append(quality_states(self.path, source, qualities[source], good))

    def stamps(self, zone: str) -> TimeStamps:
        """Return time stamps of all rows, which are given up."""
        stamps = WrittenStamps(self._time_us.taken(), self._kind.taken(), self._example)
        return place_in_zone(stamps, zone)

    def channels_at(
        self, places: Mapping[Any, tuple[Rows, NDArray[np.int64]]]
    ) -> dict[str, RawChannel]:
        """Return channels by their rows and time stamps; all rows are given up.

        A column is given up with its last channel, so that a long log is not held twice.
        """
        raw_channels: dict[str, RawChannel] = {}
        states = {key: marks.taken() for key, marks in self._states.items()}
        for column in list(self._readings):
            readings = self._readings.pop(column).taken()
            for name, channel in self.channels.items():
                if self.columns[name] == column:
                    rows, time_us = places[name]
                    marks = states.get((channel.quality_source, channel.quality_good))
                    own = None if marks is None else marks[rows]
                    some = readings.rows(rows)
                    raw_channels[name] = raw_channel(self.path, name, channel, time_us, some, own)
        return {name: raw_channels[name] for name in self.channels}


def drop_bad_stamps(
    path: Path, parts: Sequence[TimeStamps], name: str, latest_us: int
) -> tuple[list[TimeStamps], dict[str, int]]:
    """Return stamps without those in the future; counts of rows without a good time, by reason.

    The parts are judged together; `name` says what the stamps are called and how they were read.
    The future begins after `latest_us` [µs since 1970].

    Raises LogError: ``log_time``: more than half of the rows have no good time.
    """
    rows = sum(part.readable.size for part in parts)
    ahead = sum(int(np.count_nonzero(part.time_us > latest_us)) for part in parts)
    skipped = sum(part.skipped for part in parts)
    unreadable = rows - sum(int(np.count_nonzero(part.readable)) for part in parts)
    for count, what in (
        (
            ahead,
            f", read as {name}, lie {IN_FUTURE} by this machine's clock: set the clock that is "
            "wrong, this machine's or the logger's, or give the right time format; a later run "
            "tries again",
        ),
        (
            skipped,
            f", read as {name}, lie in an hour that does not exist in the zone, as its clocks go "
            "forward: where the logger's clock does not, set time_zone to a fixed zone such as "
            "Etc/GMT-1",
        ),
        (
            unreadable + ahead,
            f" cannot be read as {name}, lie before 1990 or after 2200, or in the future: give the "
            "right time format, or have the logger's clock set",
        ),
    ):
        if 2 * count > rows:
            raise LogError("log_time", path, f"{count} of {rows} time stamps{what}")
    past = list(parts)
    if ahead:
        past = [replace(p, readable=p.readable & (p.time_us <= latest_us)) for p in parts]
    return past, {
        "row without a readable time": unreadable - skipped,
        "row at a local time that the zone's clock change leaves out": skipped,
        f"row with a time {IN_FUTURE}": ahead,
    }


def no_samples() -> RawChannel:
    """Return a channel of which a file holds nothing."""
    none = np.empty(0, np.bool_)
    return _freeze(RawChannel(np.empty(0, np.int64), np.empty(0), none, 0))


def without_rows_of_others(
    channels: Mapping[str, RawChannel], columns: Mapping[str, str]
) -> dict[str, RawChannel]:
    """Return channels of a table without those blank cells that tell of no missing reading.

    Where each channel is logged at times of its own, a table has a row for each of them, which is
    blank for the others. So is a channel most of whose readings stand alone in their rows; if it
    shares them, it was to have a reading there. Several channels may be of the same column.
    """
    by_column = {columns[name]: channel.missing for name, channel in channels.items()}
    if len(by_column) < 2 or not any(missing.any() for missing in by_column.values()):
        return dict(channels)
    apart: dict[str, RawChannel] = {}
    for name, channel in channels.items():
        filled = ~channel.missing
        others = (missing for column, missing in by_column.items() if column != columns[name])
        alone = reduce(np.logical_and, others, filled)
        # What a row says of a reading's quality counts though the reading is blank.
        rows = filled if channel.bad_quality is None else filled | channel.bad_quality
        stands_alone = 2 * np.count_nonzero(alone) > np.count_nonzero(filled)
        apart[name] = _freeze(channel.rows(rows)) if stands_alone else channel
    return apart


def raw_log(
    channels: Mapping[str, RawChannel],
    rows: int,
    refused: Mapping[str, int],
    remarks: Sequence[str] = (),
) -> RawLog:
    """Return a log with a note for each reason, which begins with the noun of what is counted."""
    parted = ((reason.partition(" "), count) for reason, count in refused.items() if count)
    notes = [f"{counted(count, noun)} {what}" for (noun, _, what), count in parted]
    return RawLog(channels, rows, (*notes, *remarks), sum(refused.values()))


@dataclass(frozen=True, slots=True)
class Samples:
    """Samples of a channel as an installed reader finds them; arrays of shape (n,)."""

    time_us: NDArray[np.int64]  # UTC, microseconds since 1970, in the order of the file
    value: NDArray[np.float64]  # as logged, before scale, offset and unit
    missing: NDArray[np.bool_] | None = None  # samples that hold no number; None: all hold numbers
    quality: NDArray[Any] | None = None  # codes, text or numbers; None: the log has none


def log_of_samples(file: LogFile, samples: Mapping[str, Samples]) -> RawLog:
    """Return log of what an installed reader has, by channel: converted, judged and counted.

    Raises LogError: ``log_time``: more than half of the time stamps lie in the future, before 1990
    or after 2200; ``log_reader``: a channel's quality is asked for, and there is none.
    """
    counts = (samples[name].time_us for name in file.channels)
    parts = [place_in_zone(parse_numbers(count, "epoch_us"), "UTC") for count in counts]
    stamps, refused = drop_bad_stamps(file.path, parts, "microseconds since 1970", file.latest_us)
    channels: dict[str, RawChannel] = {}
    for (name, channel), stamp in zip(file.channels.items(), stamps, strict=True):
        own, readable = samples[name], stamp.readable
        none = np.zeros(own.value.size, np.bool_)
        missing = none if own.missing is None else own.missing
        readings = Readings(np.where(missing, np.nan, own.value), missing, none).rows(readable)
        states = None
        if channel.quality_source:
            if own.quality is None:
                how = f"the format has no quality {channel.quality_source!r}: remove quality_source"
                raise LogError("log_reader", file.path, how, channel.quality_source)
            cells, good = pa.array(own.quality), channel.quality_good
            states = quality_states(file.path, channel.quality_source, cells, good)[readable]
        time_us = stamp.time_us[readable]
        channels[name] = raw_channel(file.path, name, channel, time_us, readings, states)
    rows = sum(raw.time_us.size for raw in channels.values())
    return raw_log(channels, rows, refused)
