"""Time stamps of every make, as int64 microseconds since 1970, UTC.

Nanoseconds are cut off to microseconds, never rounded up; seconds written as a floating-point
number are rounded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
import polars as pl
import pyarrow as pa
from numpy.typing import NDArray

from pipeline.config.time_formats import EPOCH_UNITS, EXCEL_DAYS, parsed
from pipeline.ingest.arrow_types import is_text, nulls
from pipeline.ingest.wall_clock import (
    EARLIEST_US,
    EPOCH,
    LATEST_US,
    MICROSECOND,
    TimeStamps,
    from_naive,
)

_EXCEL_ZERO_MS = (datetime(1899, 12, 30) - EPOCH) // timedelta(milliseconds=1)
_DAY_MS = 86_400_000
_NONE, _LOCAL, WITH_ZONE = 0, 1, 2
_LOOKED_AT = 1000
_EXAMPLE = datetime(2025, 3, 1, 6)


@dataclass(frozen=True, slots=True)
class WrittenStamps:
    """Time stamps as they are written, before local ones are placed in their zone.

    Where an hour comes twice only the stamps before it tell which pass it is, so that a log which
    is read in pieces is placed as a whole.
    """

    time_us: NDArray[np.int64]  # since 1970, on the wall clock or in UTC
    kind: NDArray[np.int8]  # 0 no stamp, 1 on the wall clock, 2 in UTC
    example: str | None = None  # the first cell that holds something and no stamp, for a message


def example_of(time_format: str) -> str:
    """A stamp as a format has it, for a message.

    Examples
    --------
    >>> example_of("%d.%m.%Y %H:%M:%S"), example_of("epoch_ms")
    ('01.03.2025 06:00:00', '1740808800000')
    """
    if time_format == "iso8601":
        return f"{_EXAMPLE.isoformat()}Z"
    since = _EXAMPLE - EPOCH
    if time_format == EXCEL_DAYS:
        return str(_EXCEL_ZERO_MS / -_DAY_MS + since / timedelta(days=1))
    if time_format in EPOCH_UNITS:
        per_us = 1000 if time_format == "epoch_ns" else 1
        return str(since // MICROSECOND * per_us // EPOCH_UNITS[time_format])
    return _EXAMPLE.replace(tzinfo=UTC).strftime(time_format)


def written(columns: Sequence[pa.ChunkedArray], time_format: str) -> WrittenStamps:
    """Time stamps of a column of time, or of one of dates and one of times of day."""
    column = columns[-1]
    if len(columns) > 1:
        # Imported where it is needed: runs with nothing new read no stamp.
        import pyarrow.compute as pc

        date, clock = (pc.utf8_trim_whitespace(part.cast(pa.string())) for part in columns)
        column = pc.binary_join_element_wise(date, clock, " ")
    if pa.types.is_timestamp(column.type):
        return written_as_timestamps(column)
    if is_text(column.type):
        return written_as_text(column.cast(pa.string()), time_format)
    blank = np.nan if pa.types.is_floating(column.type) else 0
    return written_as_numbers(column.fill_null(blank).to_numpy(), time_format)


def written_as_text(texts: pa.ChunkedArray, time_format: str) -> WrittenStamps:
    """Time stamps of a column of text, as they are written; a null is a blank cell.

    Examples
    --------
    >>> texts = pa.chunked_array([["2025-03-01T06:00:00.5+01:00", "6 am"]])
    >>> stamps = placed(written_as_text(texts, "iso8601"), "UTC")
    >>> stamps.time_us.tolist(), stamps.readable.tolist(), stamps.example
    ([1740805200500000, 0], [True, False], '6 am')
    """
    stamps = _written_as_text(texts, time_format)
    strange = np.flatnonzero(stamps.kind == _NONE)[:_LOOKED_AT]
    if not strange.size:
        return stamps
    cells = (cell for cell in texts.take(pa.array(strange)).to_pylist() if cell and cell.strip())
    return replace(stamps, example=next(cells, None))


def _written_as_text(texts: pa.ChunkedArray, time_format: str) -> WrittenStamps:
    if time_format == "iso8601":
        return _from_iso8601(texts)
    if time_format in EPOCH_UNITS:
        return _from_epoch_text(texts, time_format)
    if time_format == EXCEL_DAYS:
        days = pl.Series("time", texts).str.strip_chars().cast(pl.Float64, strict=False)
        return written_as_numbers(days.fill_null(np.nan).to_numpy(), time_format)
    return _from_strptime(texts, time_format)


def written_as_numbers(
    numbers: NDArray[np.integer[Any]] | NDArray[np.floating[Any]], time_format: str
) -> WrittenStamps:
    """Time stamps of a column of numbers, as they are written; a nan is a blank cell.

    The format is one of `EPOCH_UNITS`, or `EXCEL_DAYS`.

    Examples
    --------
    >>> written_as_numbers(np.array([45717.25]), "excel_days").time_us.tolist()
    [1740808800000000]
    """
    stamps = _written_as_numbers(numbers, time_format)
    strange = numbers[np.flatnonzero(stamps.kind == _NONE)[:_LOOKED_AT]].tolist()
    # Blank cells are 0 or nan by now.
    examples = (str(number) for number in strange if number and number == number)
    return replace(stamps, example=next(examples, None))


def _written_as_numbers(
    numbers: NDArray[np.integer[Any]] | NDArray[np.floating[Any]], time_format: str
) -> WrittenStamps:
    if time_format in EPOCH_UNITS:
        stamps = from_epoch(numbers, time_format)
        return WrittenStamps(stamps.time_us, _kinds(stamps.readable, WITH_ZONE))
    with np.errstate(over="ignore"):
        since_1970_ms = np.asarray(numbers, dtype=np.float64) * _DAY_MS + _EXCEL_ZERO_MS
    fits = np.abs(since_1970_ms) < LATEST_US / 1000
    local_ms = np.rint(np.where(fits, since_1970_ms, 0.0)).astype(np.int64)
    return WrittenStamps(local_ms * 1000, _kinds(fits, _LOCAL))


def placed(stamps: WrittenStamps, zone: str) -> TimeStamps:
    """All stamps of a log in UTC, in their order; local ones are of the zone."""
    local, in_utc = stamps.kind == _LOCAL, stamps.kind == WITH_ZONE
    if not local.any():
        found = from_naive(stamps.time_us, in_utc, "UTC")
    else:
        found = from_naive(stamps.time_us, local, zone)
        if in_utc.any():
            found = _either(found, from_naive(stamps.time_us, in_utc, "UTC"))
    return replace(found, example=stamps.example or _implausible(stamps, found.readable))


def _implausible(stamps: WrittenStamps, readable: NDArray[np.bool_]) -> str | None:
    """The first stamp that is read and cannot be, such as one of a clock that was never set."""
    if readable.all():
        return None
    rows = np.flatnonzero(~readable & (stamps.kind != _NONE))[:1]
    # Beyond the years of `datetime`, too.
    seconds = [np.datetime64(int(us) // 1_000_000, "s") for us in stamps.time_us[rows]]
    return str(seconds[0]).replace("T", " ") if seconds else None


def _kinds(readable: NDArray[np.bool_], kind: int) -> NDArray[np.int8]:
    return readable * np.int8(kind)  # and `_NONE` elsewhere, which is 0


def from_epoch(
    numbers: NDArray[np.integer[Any]] | NDArray[np.floating[Any]], time_format: str
) -> TimeStamps:
    """Time stamps counted since 1970, UTC, in one of `EPOCH_UNITS`; a nan is a blank cell.

    Examples
    --------
    >>> from_epoch(np.array([1740808800.25]), "epoch_s").time_us.tolist()
    [1740808800250000]
    """
    thousandth = time_format == "epoch_ns"
    per_unit = EPOCH_UNITS[time_format]
    units_a_us = 1000 if thousandth else 1
    earliest, latest = (us * units_a_us // per_unit for us in (EARLIEST_US, LATEST_US))
    compared = np.asarray(numbers, np.float64) if numbers.dtype.kind == "f" else numbers
    readable = (compared >= earliest) & (compared < latest)
    kept = numbers if readable.all() else np.where(readable, numbers, 0)
    if kept.dtype.kind == "f":
        time_us = np.rint(kept * per_unit) if not thousandth else np.floor(kept / 1000)
    else:
        time_us = kept // 1000 if thousandth else kept.astype(np.int64) * per_unit
    return TimeStamps(time_us.astype(np.int64), readable)


def _from_iso8601(texts: pa.ChunkedArray) -> WrittenStamps:
    for unit in ("us", "ns"):
        for tz in ("UTC", None):
            try:
                stamps = texts.cast(pa.timestamp(unit, tz))
            except pa.ArrowInvalid:
                continue
            return written_as_timestamps(stamps)
    return _from_iso8601_cell_by_cell(texts.to_pylist())


def written_as_timestamps(stamps: pa.ChunkedArray) -> WrittenStamps:
    """Time stamps of an Arrow timestamp column of any unit, in UTC where its type has a zone."""
    kind = WITH_ZONE if stamps.type.tz else _LOCAL
    whole = stamps.cast(pa.int64())
    counts = (whole.fill_null(0) if stamps.null_count else whole).to_numpy()
    readable = ~nulls(stamps)
    unit = stamps.type.unit
    if unit == "ns":
        return WrittenStamps(counts // 1000, _kinds(readable, kind))
    if unit == "us":
        return WrittenStamps(counts, _kinds(readable, kind))
    per_unit = EPOCH_UNITS[f"epoch_{unit}"]
    latest = LATEST_US // per_unit
    fits = (-latest < counts) & (counts < latest)  # beyond, microseconds may overflow
    time_us = np.where(fits, counts, 0) * per_unit
    return WrittenStamps(time_us, _kinds(readable & fits, kind))


def _from_iso8601_cell_by_cell(texts: list[str | None]) -> WrittenStamps:
    """Slower, for a column in which some cell is no stamp, or written with and without zone."""
    time_us = np.zeros(len(texts), dtype=np.int64)
    kind = np.zeros(len(texts), dtype=np.int8)
    for i, text in enumerate(texts):
        try:
            stamp = datetime.fromisoformat((text or "").strip())
        except ValueError:
            continue
        offset = stamp.utcoffset()
        kind[i] = _LOCAL if offset is None else WITH_ZONE
        time_us[i] = (stamp.replace(tzinfo=None) - EPOCH - (offset or timedelta())) // MICROSECOND
    return WrittenStamps(time_us, kind)


def _from_epoch_text(texts: pa.ChunkedArray, time_format: str) -> WrittenStamps:
    try:
        whole = texts.cast(pa.int64())
    except pa.ArrowInvalid:
        return _from_epoch_cell_by_cell(texts, time_format)
    return written_as_numbers(whole.fill_null(0).to_numpy(), time_format)


def _from_epoch_cell_by_cell(texts: pa.ChunkedArray, time_format: str) -> WrittenStamps:
    """Slower, for a column with fractions, or in which some cell is no number."""
    cells = pl.Series("time", texts).str.strip_chars()
    whole = cells.cast(pl.Int64, strict=False)
    # Whole numbers apart: as a float64, nanoseconds since 1970 come in steps of 256.
    as_whole = from_epoch(whole.fill_null(0).to_numpy(), time_format)
    parsed = cells.cast(pl.Float64, strict=False).fill_null(np.nan).to_numpy()
    as_float = from_epoch(np.where(whole.is_null().to_numpy(), parsed, np.nan), time_format)
    stamps = _either(as_whole, as_float)
    return WrittenStamps(stamps.time_us, _kinds(stamps.readable, WITH_ZONE))


def _either(one: TimeStamps, other: TimeStamps) -> TimeStamps:
    """Stamps of two readings of one column, where each cell is readable in one of them at most."""
    return TimeStamps(one.time_us + other.time_us, one.readable | other.readable, one.skipped)


def _from_strptime(texts: pa.ChunkedArray, time_format: str) -> WrittenStamps:
    cells = pl.Series("time", texts)
    if ",%f" in time_format:
        cells = cells.str.replace_all(",", ".", literal=True)
    stamps = parsed(cells, time_format)
    kind = WITH_ZONE if "%z" in time_format else _LOCAL
    readable = stamps.is_not_null().to_numpy()
    return WrittenStamps(stamps.to_physical().fill_null(0).to_numpy(), _kinds(readable, kind))
