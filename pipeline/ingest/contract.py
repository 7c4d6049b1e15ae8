"""What every reader of logs takes and gives, whatever the format of the file.

A reader gets a `LogSource` and gives a `RawLog`: each channel on its own time stamps, in the order
of the file, in canonical units, with what is missing marked. A reader sorts nothing, fills nothing
and judges nothing but the file itself; whether a sample is plausible is for the cleaning stage.

Codes of the `LogError` that readers raise:

- ``log_missing``: there is no such file;
- ``log_not_readable``: not a file, or it may not be opened;
- ``log_empty``: the file has no bytes or no header, or it has no samples and a span was asked for;
- ``log_not_csv``, ``log_not_parquet``, ``log_not_mcap``: it is something else;
- ``log_encoding``: the text is in another encoding, or MCAP messages are in one that is not read;
- ``log_extra_missing``: a package that these messages need is not installed;
- ``log_compression``: chunks of an MCAP file are compressed in a way that is not known;
- ``log_truncated``: the end of the file is missing;
- ``log_damaged``: a checksum, a length or a count contradicts what is there;
- ``log_column_missing``: a column, topic or field is not there; the message says which are;
- ``log_column_twice``: two columns have the name that is asked for;
- ``log_type``: a channel holds something else than numbers;
- ``log_time``: time stamps cannot be read as the source says, or lie in the future;
- ``log_too_large``: more than a reader takes into memory.
"""

from __future__ import annotations

import codecs
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args
from zoneinfo import ZoneInfo

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import LogError, UsageError
from pipeline.ingest.mcap_paths import field_path
from pipeline.ingest.time_stamps import require_time_format
from pipeline.units import conversion

LogFormat = Literal["csv", "parquet", "mcap"]
LogLayout = Literal["wide", "long", "file_per_channel"]


MISSING_TOKENS = ("", "-", "--", "---", "null", "NULL", "NA", "N/A", "n/a", "#N/A", "Bad", "BAD")
"""Cells of a CSV that mean "no sample". ``NaN`` does not: it is a reading that is not finite."""

QualityValue = str | int | float | bool
"""What a column of qualities may hold."""

GOOD_QUALITY: tuple[QualityValue, ...] = ("Good", 192)
"""What historians write beside a good sample: the word, or OPC DA's code without any remark.

0 is not among them. It is good in OPC UA and bad in OPC DA, so whoever has it says which it is.
"""

THOUSANDS = (".", ",", "'", "’", " ", "\u00a0", "\u202f", "_")
"""Marks that may stand between groups of three digits."""


@dataclass(frozen=True, slots=True)
class ChannelSource:
    """Where a channel is found in a log, and how its raw figures become readings.

    Parameters
    ----------
    channel
        Canonical name, one of `pipeline.units.CHANNELS`.
    source
        Name of the column (CSV, Parquet; a path such as ``hydraulics.pressure.a`` where columns of
        Parquet are nested) or topic (MCAP). In the layout "long" what the column of names holds, in
        "file_per_channel" a pattern of the file's name such as ``*_dp_*.csv``.
    unit
        Unit of ``raw * scale + offset``, one of `pipeline.units.UNITS` of the channel's quantity.
    field
        Key in the message, or path of keys and array positions such as ``pressure.a`` or
        ``pressures[0].value`` (MCAP only; `pipeline.ingest.mcap_paths.field_path`).
    scale, offset
        For sensors logged in counts, volts or milliamperes.
    quality_source
        Column of the samples' quality (CSV, Parquet), or its path in the message (MCAP). Empty:
        the log says nothing of its samples.
    quality_good
        What stands there beside a good sample.
    """

    channel: str
    source: str
    unit: str
    field: str = "value"
    scale: float = 1.0
    offset: float = 0.0
    quality_source: str = ""
    quality_good: tuple[QualityValue, ...] = GOOD_QUALITY

    def __post_init__(self) -> None:
        conversion(self.channel, self.unit)
        field_path(self.field, self.source)
        if not (np.isfinite(self.scale) and np.isfinite(self.offset) and self.scale != 0):
            raise UsageError(
                "channel_source",
                f"channel {self.channel}: scale and offset are finite, scale not 0",
            )


@dataclass(frozen=True, slots=True)
class LogSource:
    """How the logs of a motor are written.

    Parameters
    ----------
    format
        "csv", "parquet" or "mcap".
    channels
        The channels that are wanted; each name once.
    time_source
        Column of the time stamps (CSV, Parquet); "log_time" or "publish_time" (MCAP, where any
        other name means "log_time").
    time_format
        "iso8601", "epoch_s", "epoch_ms", "epoch_us", "epoch_ns", "excel_days" or a format of
        `time.strptime`. Parquet columns of type timestamp and MCAP say it themselves.
    time_zone
        Zone of time stamps that do not carry one.
    layout
        "wide": a column a channel; "long": a row a sample, with the channel's name in it;
        "file_per_channel": a file a channel (CSV and Parquet).
    channel_column, value_column
        Columns of the name ("long") and of the value ("long", "file_per_channel").
    date_column
        Column of the date where the time has one of its own (CSV); both are read as
        ``date time`` in `time_format`.
    separator, decimal, thousands, encoding, skip_rows, unit_rows, missing_tokens
        The dialect of a CSV; `skip_rows` lines stand before the header, `unit_rows` after it.
    stamp
        Path of the time stamp within each message, instead of its log time (MCAP): seconds and
        nanoseconds, or a number or text in `time_format`. Empty: none.
    salvage
        Whether a truncated or damaged file gives what stands before the damage (MCAP).
    latest_us
        Samples after this time lie in the future [µs since 1970]; None: a day from now.
    """

    format: LogFormat
    channels: tuple[ChannelSource, ...]
    time_source: str = "time"
    time_format: str = "iso8601"
    time_zone: str = "UTC"
    layout: LogLayout = "wide"
    channel_column: str = "channel"
    value_column: str = "value"
    date_column: str = ""
    separator: str = ","
    decimal: str = "."
    thousands: str = ""
    encoding: str = "utf-8"
    skip_rows: int = 0
    unit_rows: int = 0
    missing_tokens: tuple[str, ...] = MISSING_TOKENS
    stamp: str = ""
    salvage: bool = False
    latest_us: int | None = None

    def __post_init__(self) -> None:
        if self.format not in get_args(LogFormat):
            raise UsageError(
                "log_source", f"log format {self.format!r} is none of csv, parquet, mcap"
            )
        if self.format == "mcap":
            for channel in self.channels:
                if channel.quality_source:
                    field_path(channel.quality_source, channel.source)
        names = [channel.channel for channel in self.channels]
        if not names or len(names) != len(set(names)):
            raise UsageError("log_source", "a log has at least one channel, and each channel once")
        require_time_format(self.time_format)
        if self.stamp:
            field_path(self.stamp)
        _require_dialect(self)


@dataclass(frozen=True, slots=True)
class RawChannel:
    """Samples of one channel as they are in the file; arrays are read-only.

    Attributes
    ----------
    time_us : (n,) int64
        UTC, microseconds since 1970, in the order of the file: backward time is for cleaning to
        refuse.
    value : (n,) float64
        Canonical unit; nan where missing.
    missing : (n,) bool
        The cell was blank or null or held no number. A nan or infinity that stands in the file is
        not missing.
    unparsed
        Number of cells that held something that is no number; they are in `missing` too.
    bad_quality : (n,) bool
        Samples that the log itself does not call good; also blank cells, where their quality is
        stated. None: the source names no quality.
    """

    time_us: NDArray[np.int64]
    value: NDArray[np.float64]
    missing: NDArray[np.bool_]
    unparsed: int
    bad_quality: NDArray[np.bool_] | None = None

    def rows(
        self,
        chosen: NDArray[np.bool_] | NDArray[np.intp] | slice,
        time_us: NDArray[np.int64] | None = None,
    ) -> RawChannel:
        """Some of its samples; the count of what is no number stays that of all.

        Their stamps may be given, so that channels go on sharing them.
        """
        bad = self.bad_quality
        return RawChannel(
            self.time_us[chosen] if time_us is None else time_us,
            self.value[chosen],
            self.missing[chosen],
            self.unparsed,
            None if bad is None else bad[chosen],
        )

    @staticmethod
    def joined(parts: Sequence[RawChannel]) -> RawChannel:
        """Samples one after the other; where a part says nothing of its quality, it is not bad."""
        bad = None
        if any(part.bad_quality is not None for part in parts):
            none = np.bool_(False)
            bad = np.concatenate(
                [
                    np.broadcast_to(none, part.missing.shape)
                    if part.bad_quality is None
                    else part.bad_quality
                    for part in parts
                ]
            )
        return RawChannel(
            np.concatenate([part.time_us for part in parts]),
            np.concatenate([part.value for part in parts]),
            np.concatenate([part.missing for part in parts]),
            sum(part.unparsed for part in parts),
            bad,
        )


@dataclass(frozen=True, slots=True)
class RawLog:
    """A log as read.

    Attributes
    ----------
    channels
        By canonical name, all that the source names.
    rows
        Rows (CSV, Parquet) or messages of the topics read (MCAP) that have a time stamp.
    first_us, last_us
        Smallest and largest time stamp; None without rows.
    notes
        What was left out, each with its count and reason, one line each.
    refused_rows
        Rows or messages left out, as the notes say.
    """

    channels: Mapping[str, RawChannel]
    rows: int
    first_us: int | None
    last_us: int | None
    notes: tuple[str, ...] = ()
    refused_rows: int = 0

    def stamps(self) -> list[NDArray[np.int64]]:
        """Time stamps of all channels, as `different_stamps`."""
        return different_stamps(self.channels.values())


def different_stamps(channels: Iterable[RawChannel]) -> list[NDArray[np.int64]]:
    """Time stamps of channels, the empty ones left out, and what several share once.

    Channels of one table have one array of stamps, which is then looked through once.
    """
    arrays = {(part.time_us.ctypes.data, part.time_us.size): part.time_us for part in channels}
    return [time_us for time_us in arrays.values() if time_us.size]


def _require_dialect(source: LogSource) -> None:
    """Refuse a dialect that no CSV can be read with."""
    if len(source.separator) != 1 or not source.separator.isascii() or source.separator in '"\r\n':
        raise UsageError("log_source", f"separator {source.separator!r} is not one character")
    if source.decimal not in {".", ","} or source.decimal == source.separator:
        raise UsageError(
            "log_source",
            f"decimal {source.decimal!r} is neither '.' nor ',', or it is the separator",
        )
    if source.thousands and (
        source.thousands not in THOUSANDS or source.thousands in (source.decimal, source.separator)
    ):
        raise UsageError(
            "log_source",
            f"thousands {source.thousands!r} is none of {', '.join(map(repr, THOUSANDS))}, or it "
            "is the decimal mark or the separator",
        )
    if source.skip_rows < 0 or source.unit_rows < 0:
        raise UsageError("log_source", "skip_rows and unit_rows are not negative")
    if source.layout not in get_args(LogLayout):
        raise UsageError("log_source", f"layout {source.layout!r} is not known")
    try:
        codecs.getincrementaldecoder(source.encoding)()
        " ".encode(source.encoding)
    except (LookupError, ValueError) as error:
        raise UsageError("log_source", f"encoding {source.encoding!r} is not known") from error
    try:
        ZoneInfo(source.time_zone)
    except (OSError, ValueError, KeyError) as error:
        raise UsageError("log_source", f"time zone {source.time_zone!r} is not known") from error


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """A file that is read: what is none, and what fails in it, is a `LogError`.

    Raises
    ------
    LogError
        ``log_missing``, ``log_not_readable``, ``log_empty``, ``log_too_large``.
    """
    try:
        if not path.exists():
            raise LogError("log_missing", path, "there is no such file")
        if not path.is_file():
            raise LogError("log_not_readable", path, "this is no file")
        if not path.stat().st_size:
            raise LogError("log_empty", path, "the file has no bytes")
        yield
    except OSError as error:
        reason = error.strerror or error
        raise LogError("log_not_readable", path, f"the file cannot be read: {reason}") from error
    except MemoryError as error:
        message = "it takes more memory than there is: split the log"
        raise LogError("log_too_large", path, message) from error
