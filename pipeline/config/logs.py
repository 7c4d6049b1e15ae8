"""`[logs]` of a motor's file: its log files, forms of their stamps, paths to their fields.

A package gives a reader by an entry point of the group `GROUP`, under the name of its format.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import AfterValidator, Field

from pipeline.config.section import Misfit, Section, Stage, TimeZone

if TYPE_CHECKING:
    import polars as pl

GROUP = "motor_leakage.readers"
BUILT_IN = {name: f"pipeline.ingest.{name}:READER" for name in ("csv", "mcap", "parquet")}


def reader_entry(name: str) -> EntryPoint:
    """Return entry point of a format's reader; nothing is imported.

    Raises ValueError if no package has this name, or several have.
    """
    if name in BUILT_IN:
        return EntryPoint(name, BUILT_IN[name], GROUP)
    entries = [entry for entry in installed_readers() if entry.name == name]
    if not entries:
        names = ", ".join((*BUILT_IN, *sorted({entry.name for entry in installed_readers()})))
        raise ValueError(f"expected a format of those that are built in or installed: {names}")
    if len(entries) > 1:
        packages = " and ".join(sorted(map(reader_version, entries)))
        raise ValueError(f"expected a format of one package: {packages} both have a reader of it")
    return entries[0]


def reader_version(entry: EntryPoint) -> str:
    """Return package and version of an installed reader; empty for a built-in."""
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist else ""


FormatName = Annotated[str, AfterValidator(lambda name: reader_entry(name).name)]
"""Name of a format that a reader is there for."""


@cache
def installed_readers() -> tuple[EntryPoint, ...]:
    """Return entry points of readers of installed packages."""
    return tuple(entry_points(group=GROUP))


EPOCH_UNITS = {"epoch_s": 1_000_000, "epoch_ms": 1_000, "epoch_us": 1, "epoch_ns": 1}
"""Microseconds in a unit of each epoch format (`epoch_ns` is divided by 1000 instead)."""

EXCEL_DAYS = "excel_days"
"""Days since 30 December 1899, a local time; kept to the millisecond, as spreadsheets keep it."""

_DIRECTIVES = frozenset("YymdHIMSfzpbBjaA%")


def require_time_format(time_format: str) -> str:
    """Return the format, if it has a day, hour and minute, and no directive that is not supported.

    Raises ValueError if it is none of the formats that can be read.
    """
    if time_format in ("iso8601", EXCEL_DAYS, *EPOCH_UNITS):
        return time_format
    directives = re.findall(r"%(.?)", time_format)
    if not set(directives) <= _DIRECTIVES:
        raise ValueError(
            f"time format {time_format!r}: iso8601, {', '.join(EPOCH_UNITS)}, "
            f"{EXCEL_DAYS}, or directives of {' '.join('%' + d for d in sorted(_DIRECTIVES))}"
        )
    has = set(directives).intersection
    day = has("Yy") and (has("j") or (has("mbB") and has("d")))
    hour = has("M") and (has("H") or (has("I") and has("p")))
    fraction = "%f" not in time_format or re.search(r"[.,]%f|%M:%S:%f", time_format)
    if not (day and hour and fraction):
        raise ValueError(
            f"time format {time_format!r} names no full day, hour and minute, or has %f without "
            "'.' or ',' before it, or %M:%S:"
        )
    import polars as pl

    try:
        parse_stamps(pl.Series(["?"]), time_format)
    except pl.exceptions.PolarsError as error:
        raise ValueError(f"time format {time_format!r}: {error}") from error
    return time_format


TimeFormat = Annotated[str, AfterValidator(require_time_format)]


def parse_stamps(texts: pl.Series, time_format: str) -> pl.Series:
    """Return time stamps [µs] of text in a format of `time.strptime`; null if it does not fit."""
    # In the words of this parser %f stands for the dot as well, and only %#z knows "Z".
    dotted = time_format.replace(",", ".") if ",%f" in time_format else time_format
    if "%S:%f" in time_format:
        texts = texts.str.replace(r"(:\d\d:\d\d):", "${1}.")
        dotted = time_format.replace("%S:%f", "%S.%f")
    its_format = dotted.replace(".%f", "%.f").replace("%z", "%#z")
    return texts.str.strip_chars().str.to_datetime(
        its_format, time_unit="us", strict=False, exact=True
    )


FieldPath = tuple[str | int, ...]
"""Keys and array positions, from the message inwards."""

_KEY = r"(?:\\.|[^\\.\[\]])+"
_STEP = re.compile(rf"({_KEY})((?:\[\d{{1,9}}\])*)")
_WHOLE = re.compile(rf"{_STEP.pattern}(?:\.{_STEP.pattern})*", re.DOTALL)


def field_path(field: str, topic: str = "") -> FieldPath:
    r"""Return keys and positions that lead to a field.

    They are written as keys with dots between them and positions, counted from 0, in brackets; a
    dot, bracket or backslash within a key has a backslash before it. A leading slash is dropped,
    and so is the topic of the message where it stands before the path.

    Raises ValueError if it is no path.
    """
    if topic.startswith("/") and field.startswith(topic + "."):
        inner = field[len(topic) + 1 :]
    else:
        inner = field.removeprefix("/")
    if not _WHOLE.fullmatch(inner):
        raise ValueError(
            f"field {field!r} is no path such as 'pressure.a' or 'pressures[0].value'; a dot or "
            "bracket within a key is written with a backslash before it"
        )
    path: list[str | int] = []
    for key, positions in _STEP.findall(inner):
        path.append(re.sub(r"\\(.)", r"\1", key, flags=re.DOTALL))
        path.extend(int(position) for position in re.findall(r"\d+", positions))
    return tuple(path)


def path_text(path: FieldPath) -> str:
    """Return a path as it is written in a config."""
    written = [
        f"[{step}]" if isinstance(step, int) else "." + re.sub(r"([\\.\[\]])", r"\\\1", step)
        for step in path
    ]
    return "".join(written).removeprefix(".")


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
