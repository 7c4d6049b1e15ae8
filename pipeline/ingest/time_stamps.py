"""Time stamps of every make to int64 microseconds since 1970, UTC.

Nanoseconds are cut off to microseconds, never rounded up; seconds written as a floating-point
number are rounded.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from pipeline.errors import UsageError

EPOCH_UNITS = {"epoch_s": 1_000_000, "epoch_ms": 1_000, "epoch_us": 1, "epoch_ns": 1}
"""Microseconds in a unit of each epoch format (`epoch_ns` is divided by 1000 instead)."""

EARLIEST_US = int(datetime(1990, 1, 1, tzinfo=UTC).timestamp()) * 1_000_000
LATEST_US = int(datetime(2200, 1, 1, tzinfo=UTC).timestamp()) * 1_000_000
"""Outside is no stamp: a clock never set, seconds for milliseconds, time since the log's start."""

_EPOCH = datetime(1970, 1, 1)
_MICROSECOND = timedelta(microseconds=1)
_MINUTE_US = 60 * 1_000_000
_STEP_BACK_US = 30 * 60 * 1_000_000
_DIRECTIVES = frozenset("YymdHIMSfzpbBj%")


class TimeStampError(ValueError):
    """Time stamps cannot be read as their source says; the readers add file and column."""


@dataclass(frozen=True, slots=True)
class TimeStamps:
    """Time stamps of a column.

    Attributes
    ----------
    time_us : (n,) int64
        UTC, microseconds since 1970; 0 where not readable.
    readable : (n,) bool
        False where the cell was blank, no time, or before 1990 or after 2200.
    """

    time_us: NDArray[np.int64]
    readable: NDArray[np.bool_]


def require_time_format(time_format: str) -> None:
    """Refuse a format without a day, hour and minute, or with a directive that is not supported.

    Raises
    ------
    UsageError
        ``time_format``.

    Examples
    --------
    >>> require_time_format("%d.%m.%Y %H:%M:%S,%f")
    """
    if time_format == "iso8601" or time_format in EPOCH_UNITS:
        return
    directives = re.findall(r"%(.?)", time_format)
    if not set(directives) <= _DIRECTIVES:
        raise UsageError(
            "time_format",
            f"time format {time_format!r}: iso8601, {', '.join(EPOCH_UNITS)}, or "
            f"directives of {' '.join('%' + d for d in sorted(_DIRECTIVES))}",
        )
    has = set(directives).intersection
    day = has("Yy") and (has("j") or (has("mbB") and has("d")))
    hour = has("M") and (has("H") or (has("I") and has("p")))
    fraction = "%f" not in time_format or re.search(r"[.,]%f", time_format)
    if not (day and hour and fraction):
        raise UsageError(
            "time_format",
            f"time format {time_format!r} names no full day, hour and minute, or has %f without "
            "'.' or ',' before it",
        )
    try:
        _strptime(pl.Series(["?"]), time_format)
    except pl.exceptions.PolarsError as error:
        raise UsageError("time_format", f"time format {time_format!r}: {error}") from error


def from_text(texts: pa.ChunkedArray, time_format: str, zone: str) -> TimeStamps:
    """Time stamps written as text.

    Parameters
    ----------
    texts
        Arrow strings; null where the cell is blank.
    time_format
        As in `pipeline.ingest.contract.LogSource`.
    zone
        Zone of stamps that carry none.

    Raises
    ------
    TimeStampError
        A local time does not exist in the zone.

    Examples
    --------
    >>> texts = pa.chunked_array([["2025-03-01T06:00:00.5+01:00", "6 am"]])
    >>> stamps = from_text(texts, "iso8601", "UTC")
    >>> stamps.time_us.tolist(), stamps.readable.tolist()
    ([1740805200500000, 0], [True, False])
    """
    if time_format == "iso8601":
        return _from_iso8601(texts, zone)
    if time_format in EPOCH_UNITS:
        return _from_epoch_text(texts, time_format)
    return _from_strptime(texts, time_format, zone)


def from_epoch(
    numbers: NDArray[np.integer[Any]] | NDArray[np.floating[Any]], time_format: str
) -> TimeStamps:
    """Time stamps counted in `time_format` units since 1970, UTC.

    Parameters
    ----------
    numbers : (n,) integer or float64
        nan where the cell is blank.
    time_format
        One of `EPOCH_UNITS`.

    Examples
    --------
    >>> from_epoch(np.array([1740808800.25]), "epoch_s").time_us.tolist()
    [1740808800250000]
    """
    thousandth = time_format == "epoch_ns"
    per_unit = EPOCH_UNITS[time_format]
    # A float64 compares well enough to say that the product fits int64.
    rough = np.asarray(numbers, dtype=np.float64) * per_unit / (1000 if thousandth else 1)
    readable = (rough >= EARLIEST_US) & (rough < LATEST_US)
    kept = np.where(readable, numbers, 0)
    if kept.dtype.kind == "f":
        time_us = np.rint(kept * per_unit) if not thousandth else np.floor(kept / 1000)
    else:
        time_us = kept // 1000 if thousandth else kept.astype(np.int64) * per_unit
    return TimeStamps(time_us.astype(np.int64), readable)


def from_naive(local_us: NDArray[np.int64], readable: NDArray[np.bool_], zone: str) -> TimeStamps:
    """Local wall-clock time of a zone to UTC.

    Where a clock change gives an hour twice, stamps belong to its first pass until they step back
    by half an hour or more, then to the second.

    Parameters
    ----------
    local_us : (n,)
        Wall-clock time as microseconds since 1970.
    readable : (n,)
        Which of them are stamps.

    Raises
    ------
    TimeStampError
        A local time does not exist in the zone: the logger's clock does not follow it.

    Examples
    --------
    >>> noon = np.array([1740830400000000])
    >>> from_naive(noon, np.array([True]), "Europe/Stockholm").time_us.tolist()
    [1740826800000000]
    """
    plausible = readable & (local_us >= EARLIEST_US) & (local_us < LATEST_US)
    if zone == "UTC" or not plausible.any():
        return TimeStamps(np.where(plausible, local_us, 0), plausible)
    local = local_us[plausible]
    first_us, second_us = _offsets_us(local, zone)
    offset_us = np.where(_on_second_pass(local, first_us != second_us), second_us, first_us)
    time_us = np.zeros_like(local_us)
    time_us[plausible] = local - offset_us
    return TimeStamps(time_us, plausible)


def _offsets_us(local: NDArray[np.int64], zone: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Offset from UTC on the first and on the second pass of each local time."""
    # Since 1990 all zones have changed their offset at a whole minute, St. John's at 00:01.
    minutes, which = np.unique(local // _MINUTE_US, return_inverse=True)
    tz = ZoneInfo(zone)
    offsets = np.empty((2, minutes.size), dtype=np.int64)
    for i, minute in enumerate(minutes.tolist()):
        wall = _EPOCH + timedelta(microseconds=minute * _MINUTE_US)
        for fold in (0, 1):
            offset = tz.utcoffset(wall.replace(fold=fold))
            offsets[fold, i] = 0 if offset is None else offset // _MICROSECOND
    if (offsets[1] > offsets[0]).any():
        minute = int(minutes[np.argmax(offsets[1] > offsets[0])])
        wall = _EPOCH + timedelta(microseconds=minute * _MINUTE_US)
        raise TimeStampError(
            f"local time {wall:%Y-%m-%d %H:%M} does not exist in zone {zone}: where the logger's "
            "clock does not change over, set time_zone to a fixed one such as Etc/GMT-1"
        )
    return offsets[0, which], offsets[1, which]


def _on_second_pass(local: NDArray[np.int64], ambiguous: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """True where an hour that comes twice has stepped back since it began."""
    if not ambiguous.any():
        return ambiguous
    steps_back = np.cumsum((np.diff(local, prepend=local[0]) < -_STEP_BACK_US) & ambiguous)
    before_run = np.maximum.accumulate(np.where(ambiguous, 0, steps_back))
    return np.asarray(ambiguous & (steps_back > before_run))


def _from_iso8601(texts: pa.ChunkedArray, zone: str) -> TimeStamps:
    for unit in ("us", "ns"):
        for tz in ("UTC", None):
            try:
                stamps = texts.cast(pa.timestamp(unit, tz))
            except pa.ArrowInvalid:
                continue
            return from_arrow_timestamps(stamps, zone)
    return _from_iso8601_cell_by_cell(texts.to_pylist(), zone)


def from_arrow_timestamps(stamps: pa.ChunkedArray, zone: str) -> TimeStamps:
    """Time stamps of an Arrow timestamp column, of any unit, with or without a zone.

    Parameters
    ----------
    stamps
        Column of a timestamp type; null where there is none. With a zone in its type it is in UTC
        already.
    zone
        Zone of a column without one.
    """
    readable = stamps.is_valid().to_numpy().astype(bool)
    counts = pc.fill_null(stamps.cast(pa.int64()), 0).to_numpy()
    unit = stamps.type.unit
    if unit == "ns":
        time_us = counts // 1000
    else:
        per_unit = EPOCH_UNITS[f"epoch_{unit}"]
        fits = np.abs(counts.astype(np.float64)) < LATEST_US / per_unit
        time_us = np.where(fits, counts, 0) * per_unit
    return from_naive(time_us, readable, "UTC" if stamps.type.tz else zone)


def _from_iso8601_cell_by_cell(texts: list[str | None], zone: str) -> TimeStamps:
    """Slower, for a column in which some cell is no stamp, or written with and without zone."""
    time_us = np.zeros(len(texts), dtype=np.int64)
    kind = np.zeros(len(texts), dtype=np.int8)  # 0 no stamp, 1 local, 2 with its own zone
    for i, text in enumerate(texts):
        try:
            stamp = datetime.fromisoformat((text or "").strip())
        except ValueError:
            continue
        offset = stamp.utcoffset()
        kind[i] = 1 if offset is None else 2
        time_us[i] = (stamp.replace(tzinfo=None) - _EPOCH - (offset or timedelta())) // _MICROSECOND
    local = from_naive(time_us, kind == 1, zone)
    return _either(local, from_naive(time_us, kind == 2, "UTC"))


def _from_epoch_text(texts: pa.ChunkedArray, time_format: str) -> TimeStamps:
    try:
        whole = texts.cast(pa.int64())
    except pa.ArrowInvalid:
        return _from_epoch_cell_by_cell(texts, time_format)
    return from_epoch(pc.fill_null(whole, 0).to_numpy(), time_format)


def _from_epoch_cell_by_cell(texts: pa.ChunkedArray, time_format: str) -> TimeStamps:
    """Slower, for a column with fractions, or in which some cell is no number."""
    cells = pl.Series("time", texts).str.strip_chars()
    whole = cells.cast(pl.Int64, strict=False)
    # Whole numbers apart: as a float64, nanoseconds since 1970 come in steps of 256.
    as_whole = from_epoch(whole.fill_null(0).to_numpy(), time_format)
    parsed = cells.cast(pl.Float64, strict=False).fill_null(np.nan).to_numpy()
    as_float = from_epoch(np.where(whole.is_null().to_numpy(), parsed, np.nan), time_format)
    return _either(as_whole, as_float)


def _either(one: TimeStamps, other: TimeStamps) -> TimeStamps:
    """Stamps of two readings of one column, where each cell is readable in one of them at most."""
    return TimeStamps(one.time_us + other.time_us, one.readable | other.readable)


def _from_strptime(texts: pa.ChunkedArray, time_format: str, zone: str) -> TimeStamps:
    if ",%f" in time_format:
        texts = pc.replace_substring(texts, ",", ".")
    stamps = _strptime(pl.Series("time", texts), time_format)
    readable = stamps.is_not_null().to_numpy()
    time_us = stamps.to_physical().fill_null(0).to_numpy()
    return from_naive(time_us, readable, "UTC" if "%z" in time_format else zone)


def _strptime(texts: pl.Series, time_format: str) -> pl.Series:
    # In the words of this parser %f stands for the dot as well, and only %#z knows "Z".
    dotted = time_format.replace(",", ".") if ",%f" in time_format else time_format
    its_format = dotted.replace(".%f", "%.f").replace("%z", "%#z")
    return texts.str.strip_chars().str.to_datetime(
        its_format, time_unit="us", strict=False, exact=True
    )
