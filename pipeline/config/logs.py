"""`[logs]` of a motor's file: its log files and their dialect."""

from __future__ import annotations

import codecs
from collections.abc import Iterator
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field

from pipeline.config.dialect import FormatName, TimeFormat, field_path
from pipeline.config.section import Misfit, Section, Stage, TimeZone

# Cells of a CSV that mean "no sample". `NaN` does not: it is a reading that is not finite.
MISSING_TOKENS = ("", "-", "--", "---", "null", "NULL", "NA", "N/A", "n/a", "#N/A", "Bad", "BAD")
# Marks that may stand between groups of three digits.
THOUSANDS = (".", ",", "'", "’", " ", "\u00a0", "\u202f", "_")
# Times that a record of MCAP has itself.
RECORD_TIMES = ("log_time", "publish_time")
# Bytes of a pattern of logs; S3 takes no longer names, and most systems 255 bytes a part.
LONGEST_PATTERN, LONGEST_NAME = 1024, 255


def _pattern(pattern: str) -> str:
    """Return a path or glob of logs below their root."""
    parts = pattern.replace("\\", "/").split("/")
    longest = max(len(part.encode()) for part in parts)
    if pattern.startswith(("/", "\\")) or ".." in parts:
        raise ValueError("expected a path below the log root, without '..'")
    if not pattern.isprintable() or not parts[-1].strip(". "):
        raise ValueError("expected the name of a file, or a glob")
    if longest > LONGEST_NAME or len(pattern.encode()) > LONGEST_PATTERN:
        raise ValueError(
            f"expected names of at most {LONGEST_NAME} bytes, {LONGEST_PATTERN} in all"
        )
    if parts[-1] == "**" or any("**" in part and part != "**" for part in parts):
        raise ValueError("expected ** only as a folder, with a file's name or glob behind it")
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
    """The motor's log files and their dialect."""

    shapes = Stage.READING

    format: FormatName
    """`csv`, `parquet`, `mcap`, or a format of an installed package."""
    options: dict[str, Any] = Field({})
    """Options of an installed package's reader."""
    files: Annotated[tuple[Pattern, ...], Stage.NOTHING]
    """Paths or globs below the log root."""
    time: str = "time"
    """Column of the time; MCAP: `log_time`, `publish_time`, or the path of the time stamp in the
    message, such as `header.stamp`."""
    time_format: TimeFormat = "iso8601"
    """`iso8601`, `epoch_s`, `epoch_ms`, `epoch_us`, `epoch_ns`, `excel_days` or a strptime
    format."""
    time_zone: TimeZone = "UTC"
    """Zone of time stamps that state none."""
    date_column: str = ""
    """Column of the date, where it has its own."""
    layout: Literal["wide", "long", "file_per_channel"] = "wide"
    """A column per channel (`wide`), a row per sample (`long`), or `file_per_channel`."""
    channel_column: str = "channel"
    """Layout `long`: column of channels' names."""
    motor_rows: tuple[str, str] | None = None
    """Column of motors' names, where rows are of several, and the motor's name in it."""
    value_column: str = "value"
    """Column of the values, unless `wide`; MCAP: field of the message."""
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
    """CSV: lines after the header without samples."""
    missing_tokens: tuple[str, ...] = MISSING_TOKENS
    """CSV: content of a cell without a value."""

    def misfits(self) -> Iterator[Misfit]:
        separator, thousands = self.separator, self.thousands
        if not separator.isascii() or separator in '"\r\n':
            yield self.at("separator", "expected a character of ASCII that is no quotation mark")
        if not self.files:
            yield self.at("files", "expected at least one path or glob")
        if separator == self.decimal:
            yield self.at("separator", "expected another mark than the decimal mark")
        if thousands and thousands not in THOUSANDS:
            yield self.at("thousands", f"expected one of {', '.join(map(repr, THOUSANDS))}")
        if thousands and thousands in (self.decimal, separator):
            message = "expected another mark than the decimal mark and the separator"
            yield self.at("thousands", message)
        try:
            field_path(self.stamp or "time")
        except ValueError as error:
            yield self.at("time", str(error))

    @property
    def stamp(self) -> str:
        """Path of the time stamp in a message of MCAP; empty where it is that of the record."""
        is_path = self.format == "mcap" and "time" in self.model_fields_set
        return self.time if is_path and self.time not in RECORD_TIMES else ""
