"""The last steps that all readers share: a channel's readings are judged, converted and kept."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pipeline.config.motors import Channel, Logs
from pipeline.errors import LogError
from pipeline.ingest.contract import RawChannel, RawLog, different_stamps
from pipeline.ingest.quality import is_bad
from pipeline.ingest.time_stamps import example_of
from pipeline.ingest.wall_clock import TimeStamps
from pipeline.units import convert_to_canonical

_T = TypeVar("_T", bound=np.generic)

_DAY_US = 86_400_000_000


@dataclass(frozen=True, slots=True)
class Readings:
    """Raw figures of one channel, before scale, offset and unit.

    Attributes
    ----------
    raw : (n,) float64
        nan where missing.
    missing : (n,) bool
    unparsed : (n,) bool
        Part of `missing`: there was something, and it is no number.
    example
        The first thing that is no number, for a message.
    """

    raw: NDArray[np.float64]
    missing: NDArray[np.bool_]
    unparsed: NDArray[np.bool_]
    example: str | None = None

    def rows(self, kept: NDArray[np.bool_]) -> Readings:
        """The readings of some rows."""
        if kept.all():
            return self
        return Readings(self.raw[kept], self.missing[kept], self.unparsed[kept], self.example)

    @staticmethod
    def joined(parts: Sequence[Readings]) -> Readings:
        """Readings one after the other."""
        examples = (part.example for part in parts if part.example is not None)
        return Readings(
            np.concatenate([np.empty(0), *(part.raw for part in parts)]),
            _joined_marks([part.missing for part in parts]),
            _joined_marks([part.unparsed for part in parts]),
            next(examples, None),
        )


def raw_channel(
    path: Path,
    name: str,
    channel: Channel,
    time_us: NDArray[np.int64],
    readings: Readings,
    quality: NDArray[np.uint8] | None = None,
) -> RawChannel:
    """Channel in its canonical unit.

    Parameters
    ----------
    path, name, channel
        The log, and the channel's name and place in it.
    time_us : (n,) int64
    readings
        As they stand in the log.
    quality : (n,) uint8
        Of `quality_states`; None: the log says nothing of its samples.

    Raises
    ------
    LogError
        ``log_type``: the channel holds something, but not one number.
    """
    readings = in_canonical_unit(name, channel, readings)
    return canonical_channel(path, name, channel, time_us, readings, quality)


def in_canonical_unit(name: str, channel: Channel, readings: Readings) -> Readings:
    """Readings of a channel after scale, offset and unit."""
    raw = readings.raw.copy()
    convert_in_place(name, channel, raw)
    return replace(readings, raw=raw)


def convert_in_place(name: str, channel: Channel, raw: NDArray[np.float64]) -> None:
    """Scale, offset and unit of a channel applied to figures that are the caller's own."""
    # A reading may be beyond float64 in another unit, or a signalling nan: it is then not finite.
    with np.errstate(over="ignore", invalid="ignore"):
        if channel.scale != 1.0 or channel.offset != 0.0:
            raw *= channel.scale
            raw += channel.offset
        # Counts are read as they are; cleaning makes a flow of them.
        if channel.counts is None:
            convert_to_canonical(name, raw, channel.unit)


def canonical_channel(
    path: Path,
    name: str,
    channel: Channel,
    time_us: NDArray[np.int64],
    readings: Readings,
    quality: NDArray[np.uint8] | None = None,
) -> RawChannel:
    """Channel whose readings are in its canonical unit already; otherwise as `raw_channel`."""
    bad = None if quality is None else is_bad(quality, readings.missing)
    unparsed = int(np.count_nonzero(readings.unparsed))
    told = bad is not None and bool(bad[readings.unparsed].all())
    if unparsed and readings.missing.all() and not told:
        raise LogError(
            "log_type",
            path,
            f"{channel.source} (channel {name}) holds no number in {unparsed} cells, such "
            f"as {readings.example!r}: give the right column, decimal sign or missing_tokens",
            channel.source,
        )
    return RawChannel(
        _frozen(time_us),
        _frozen(readings.raw),
        _frozen(readings.missing),
        unparsed,
        None if bad is None else _frozen(bad),
    )


def time_name(logs: Logs, example: str | None = None) -> str:
    """How the time column of a table is named in messages, with a stamp that is not readable."""
    form = logs.time_format
    here = f"; here is {example[:40]!r}" if example else ""
    return f"{logs.time!r} in format {form} (such as {example_of(form)}{here})"


def judged(path: Path, stamps: TimeStamps, name: str) -> tuple[TimeStamps, dict[str, int]]:
    """Stamps without those in the future, and how many rows have no good time, by reason.

    Parameters
    ----------
    name
        What the stamps are called and how they were read.

    Raises
    ------
    LogError
        ``log_time``: more than half of the rows have no good time.
    """
    (past,), refused = judged_together(path, [stamps], name)
    return past, refused


def judged_together(
    path: Path, parts: Sequence[TimeStamps], name: str
) -> tuple[list[TimeStamps], dict[str, int]]:
    """Stamps of a log that come in parts, judged as one; otherwise as `judged`."""
    latest_us = time.time_ns() // 1000 + _DAY_US
    rows = sum(part.readable.size for part in parts)
    ahead = sum(int(np.count_nonzero(_future(part, latest_us))) for part in parts)
    skipped = sum(part.skipped for part in parts)
    unreadable = rows - sum(int(np.count_nonzero(part.readable)) for part in parts)
    _require_time(path, rows, {"ahead": ahead, "skipped": skipped, "unreadable": unreadable}, name)
    past = list(parts)
    if ahead:
        past = [replace(p, readable=p.readable & ~_future(p, latest_us)) for p in parts]
    return past, {
        "rows without a readable time": unreadable - skipped,
        "rows at a local time that the zone's clock change leaves out": skipped,
        "rows with a time more than a day in the future": ahead,
    }


def _future(stamps: TimeStamps, latest_us: int) -> NDArray[np.bool_]:
    return stamps.readable & (stamps.time_us > latest_us)


def _require_time(path: Path, rows: int, counts: Mapping[str, int], name: str) -> None:
    """More than half of the rows without a good time are an error ``log_time``."""
    if 2 * counts["ahead"] > rows:
        raise LogError(
            "log_time",
            path,
            f"{counts['ahead']} of {rows} time stamps, read as {name}, lie more than a day in the "
            "future: have the logger's clock set, or give the right time format",
        )
    if 2 * counts["skipped"] > rows:
        raise LogError(
            "log_time",
            path,
            f"{counts['skipped']} of {rows} time stamps, read as {name}, lie in an hour that does "
            "not exist in the zone, as its clocks go forward: where the logger's clock does not, "
            "set time_zone to a fixed one such as Etc/GMT-1",
        )
    without = counts["unreadable"] + counts["ahead"]
    if 2 * without > rows:
        raise LogError(
            "log_time",
            path,
            f"{without} of {rows} time stamps cannot be read as {name}, lie before 1990 or after "
            "2200, or in the future: give the right time format, or have the logger's clock set",
        )


def without_rows_of_others(
    channels: Mapping[str, RawChannel], columns: Mapping[str, str]
) -> dict[str, RawChannel]:
    """Channels of a table without those blank cells that tell of no missing reading.

    Where each channel is logged at times of its own, a table has a row for each of them, which is
    blank for the others. So is a channel most of whose readings stand alone in their rows; one that
    shares them was to have a reading there.

    Parameters
    ----------
    channels
        By name, all of the same rows.
    columns
        Column of each channel; several may have the same.

    Examples
    --------
    >>> def channel(*value):
    ...     return RawChannel(np.arange(4), np.array(value), np.isnan(value), 0)
    >>> one, other = channel(1.0, np.nan, 2.0, np.nan), channel(np.nan, 7.0, np.nan, 8.0)
    >>> apart = without_rows_of_others({"a": one, "b": other}, {"a": "x", "b": "y"})
    >>> apart["a"].time_us.tolist(), apart["b"].time_us.tolist()
    ([0, 2], [1, 3])
    """
    by_column = {columns[name]: channel.missing for name, channel in channels.items()}
    if len(by_column) < 2 or not any(missing.any() for missing in by_column.values()):
        return dict(channels)
    readings = np.zeros(next(iter(by_column.values())).size, dtype=np.int16)
    for missing in by_column.values():
        readings += ~missing
    apart: dict[str, RawChannel] = {}
    for name, channel in channels.items():
        of_its_rows = readings[~channel.missing]
        alone = 2 * np.count_nonzero(of_its_rows == 1) > of_its_rows.size
        # What a row says of a reading's quality counts though the reading is blank.
        told = (
            ~channel.missing
            if channel.bad_quality is None
            else (~channel.missing | channel.bad_quality)
        )
        apart[name] = _rows(channel, told) if alone else channel
    return apart


def _rows(channel: RawChannel, kept: NDArray[np.bool_]) -> RawChannel:
    """Some rows of everything that a channel has of each."""
    values = {one.name: getattr(channel, one.name) for one in fields(channel)}
    chosen: dict[str, Any] = {
        name: _frozen(value[kept])
        for name, value in values.items()
        if isinstance(value, np.ndarray)
    }
    return replace(channel, **chosen)


def raw_log(
    channels: Mapping[str, RawChannel],
    rows: int,
    refused: Mapping[str, int],
    remarks: Sequence[str] = (),
) -> RawLog:
    """Log from its channels, with a note for each reason for which something was left out."""
    times = different_stamps(channels.values())
    return RawLog(
        channels=channels,
        rows=rows,
        first_us=min((int(time_us.min()) for time_us in times), default=None),
        last_us=max((int(time_us.max()) for time_us in times), default=None),
        notes=tuple(f"{count} {reason}" for reason, count in refused.items() if count)
        + tuple(remarks),
        refused_rows=sum(refused.values()),
    )


def span(path: Path, parts: Iterable[NDArray[np.int64]]) -> tuple[int, int]:
    """Smallest and largest time stamp of a file's parts; none is an error ``log_empty``."""
    times = [part for part in parts if part.size]
    if not times:
        raise LogError("log_empty", path, "the log holds no samples, so it has no time span")
    return min(int(part.min()) for part in times), max(int(part.max()) for part in times)


def _joined_marks(parts: Sequence[NDArray[np.bool_]]) -> NDArray[np.bool_]:
    # Zeros that are never written take no memory.
    if not any(part.any() for part in parts):
        return np.zeros(sum(part.size for part in parts), dtype=np.bool_)
    return np.concatenate(parts)


def _frozen(values: NDArray[_T]) -> NDArray[_T]:
    view = values.view()
    view.flags.writeable = False
    return view
