"""`[logs]` of a motor's file: its log files and their dialect."""

from __future__ import annotations

import codecs
from collections.abc import Iterator
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field

from pipeline.config.databases import Database
from pipeline.config.faults import Misfit
from pipeline.config.field_paths import FieldText
from pipeline.config.readers import FormatName
from pipeline.config.section import NonNegative, Section, Stage, TimeZone
from pipeline.config.time_formats import TimeFormat

LogLayout = Literal["wide", "long", "file_per_channel"]
# Cells of a CSV that mean "no sample". `NaN` does not: it is a reading that is not finite.
MISSING_TOKENS = ("", "-", "--", "---", "null", "NULL", "NA", "N/A", "n/a", "#N/A", "Bad", "BAD")
# Marks that may stand between groups of three digits.
THOUSANDS = (".", ",", "'", "’", " ", "\u00a0", "\u202f", "_")
# Bytes of a pattern of logs; S3 takes no longer names, and most systems 255 bytes a part.
LONGEST_PATTERN, LONGEST_NAME = 1024, 255


def _pattern(pattern: str) -> str:
    """A path or glob of logs below their root."""
    parts = pattern.replace("\\", "/").split("/")
    if pattern.startswith(("/", "\\")) or ".." in parts:
        raise ValueError("expected a path below the log root, without '..'")
    if not pattern.isprintable() or not parts[-1].strip(". "):
        raise ValueError("expected the name of a file, or a glob")
    longest = max(len(part.encode()) for part in parts)
    if longest > LONGEST_NAME or len(pattern.encode()) > LONGEST_PATTERN:
        raise ValueError(
            f"expected names of at most {LONGEST_NAME} bytes, {LONGEST_PATTERN} together"
        )
    if parts[-1] == "**" or any("**" in part and part != "**" for part in parts):
        raise ValueError(
            "expected ** only as a folder of its own, with a file's name or glob behind it"
        )
    return pattern


def _encoding(encoding: str) -> str:
    try:
        codecs.getincrementaldecoder(encoding)()
        " ".encode(encoding)  # an empty text asks no codec
    except (LookupError, ValueError):
        raise ValueError("expected a text encoding, such as utf-8 or cp1252") from None
    return encoding


Pattern = Annotated[str, AfterValidator(_pattern)]
Encoding = Annotated[str, AfterValidator(_encoding)]


class Logs(Section):
    """The motor's log files and their dialect, or the database that has its samples."""

    shapes = Stage.READING

    format: FormatName
    """`csv`, `parquet`, `mcap`, `sql` (a database), or a format that an installed package reads
    ([readers](readers.md))."""
    options: dict[str, Any] = Field({})
    """Options of an installed package's reader."""
    files: Annotated[tuple[Pattern, ...], Stage.NOTHING] = ()
    """Paths or globs below the log root; a path named and absent is an error. Needed without a
    `database`."""
    database: Annotated[Database | None, Stage.NOTHING] = None
    """With `sql`: where the samples are."""
    time: str = "time"
    """Column of the time; MCAP: `log_time` or `publish_time` of the message."""
    time_format: TimeFormat = "iso8601"
    """`iso8601`, `epoch_s`, `epoch_ms`, `epoch_us`, `epoch_ns`, `excel_days` or a strptime
    format."""
    time_zone: TimeZone = "UTC"
    """Zone of time stamps that state none."""
    date_column: str = ""
    """Column of the date, where the time has one of its own; read as `date time`."""
    layout: LogLayout = "wide"
    """CSV, Parquet: one column per channel, one row per sample with the channel's name, or one file
    per channel."""
    channel_column: str = "channel"
    """Layout `long`: column of channels' names."""
    motor_column: str = ""
    """CSV, Parquet: column of the motor's name, where rows are of several."""
    motor_name: str = ""
    """The motor's name in `motor_column`."""
    value_column: str = "value"
    """Layouts `long` and `file_per_channel`: column of the values."""
    separator: str = Field(",", min_length=1, max_length=1)
    """CSV: between cells."""
    decimal: Literal[".", ","] = "."
    """CSV: decimal mark."""
    thousands: str = ""
    """CSV: mark between groups of three digits."""
    encoding: Encoding = "utf-8"
    """CSV: text encoding."""
    skip_rows: int = Field(0, ge=0)
    """CSV: lines before the header."""
    unit_rows: int = Field(0, ge=0)
    """CSV: lines after the header that hold no samples."""
    missing_tokens: tuple[str, ...] = MISSING_TOKENS
    """CSV: content of a cell without a value."""
    settle_s: Annotated[NonNegative, Stage.NOTHING] = 0.0
    """A new file that was written to within this time before a run is left to a later run. Without
    it, only a file that changes during reading is."""
    stamp: FieldText = ""
    """MCAP: path of a time stamp within the message, such as `header.stamp`, to use instead of its
    log time; a number or text there is in `time_format`."""
    salvage: bool = False
    """MCAP: read the part of a truncated or damaged file before the damage, instead of refusing the
    file; the loss is noted."""

    def misfits(self) -> Iterator[Misfit]:
        """Marks of a CSV that cannot stand beside one another; files or a database, not both."""
        separator, thousands, is_sql = self.separator, self.thousands, self.format == "sql"
        if not separator.isascii() or separator in '"\r\n':
            message = "expected a character of ASCII that is no quotation mark"
            yield ("separator",), message, separator
        if separator == self.decimal:
            yield ("separator",), "expected another mark than the decimal mark", separator
        if thousands and thousands not in THOUSANDS:
            message = f"expected one of {', '.join(map(repr, THOUSANDS))}"
            yield ("thousands",), message, thousands
        if thousands and thousands in (self.decimal, separator):
            message = "expected another mark than the decimal mark and the separator"
            yield ("thousands",), message, thousands
        if is_sql != (self.database is not None):
            yield ("database",), 'expected together with format = "sql", and only then', None
        if is_sql and self.files:
            yield ("files",), 'expected no files with format = "sql"', self.files
        if not is_sql and not self.files:
            yield ("files",), "expected at least one path or glob", self.files
        if is_sql and self.layout == "file_per_channel":
            yield ("layout",), 'expected "wide" or "long" with format = "sql"', self.layout
        if bool(self.motor_column) != bool(self.motor_name):
            message = "expected motor_column and motor_name together"
            yield ("motor_name",), message, self.motor_name
