"""Time stamps of every make, as int64 microseconds since 1970, UTC.

Nanoseconds are cut off to microseconds, never rounded up; seconds written as a floating-point
number are rounded. Local time is placed in its zone for a whole log at once: where an hour comes
twice, only the stamps before it tell which pass it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np
import polars as pl
import pyarrow as pa
from numpy.typing import NDArray

from pipeline.config.logs import EPOCH_UNITS, EXCEL_DAYS, parse_stamps
from pipeline.ingest.cells import is_text, nulls

EARLIEST_US = int(datetime(1990, 1, 1, tzinfo=UTC).timestamp()) * 1_000_000
LATEST_US = int(datetime(2200, 1, 1, tzinfo=UTC).timestamp()) * 1_000_000
"""Outside is no stamp: a clock never set, seconds for milliseconds, time since the log's start."""

Numbers = NDArray[np.integer[Any]] | NDArray[np.floating[Any]]

_EPOCH, _MICROSECOND = datetime(1970, 1, 1), timedelta(microseconds=1)
_MINUTE_US = 60 * 1_000_000
_STEP_BACK_US = 30 * 60 * 1_000_000
# Share of repeated stamps in an hour that comes twice, of a file sorted by time.
_IN_PAIRS = 0.45
_EXCEL_ZERO_MS = (datetime(1899, 12, 30) - _EPOCH) // timedelta(milliseconds=1)
_DAY_MS = 86_400_000
_NONE, _LOCAL, WITH_ZONE = 0, 1, 2
_LOOKED_AT = 1000
_EXAMPLE = datetime(2025, 3, 1, 6)


@dataclass(frozen=True, slots=True)
class WrittenStamps:
    """Time stamps as they are written, before local ones are placed in their zone."""

    time_us: NDArray[np.int64]  # since 1970, on the wall clock or in UTC
    kind: NDArray[np.int8]  # 0 no stamp, 1 on the wall clock, 2 in UTC
    example: str | None = None  # the first cell that holds something and no stamp, for a message


@dataclass(frozen=True, slots=True)
class TimeStamps:
    """Time stamps of a log.

    A stamp is not readable where the cell was blank, no time, before 1990 or after 2200, or a local
    time that does not exist.
    """

    time_us: NDArray[np.int64]  # UTC, microseconds since 1970; 0 where not readable
    readable: NDArray[np.bool_]
    skipped: int = 0  # local times that do not exist, as the clock was put forward over them
    example: str | None = None  # the first that is not readable, as it is written, for a message


def example_of(time_format: str) -> str:
    """Return a stamp as a format has it, for a message."""
    if time_format == "iso8601":
        return f"{_EXAMPLE.isoformat()}Z"
    since = _EXAMPLE - _EPOCH
    if time_format == EXCEL_DAYS:
        return str(_EXCEL_ZERO_MS / -_DAY_MS + since / timedelta(days=1))
    if time_format in EPOCH_UNITS:
        per_us = 1000 if time_format == "epoch_ns" else 1
        return str(since // _MICROSECOND * per_us // EPOCH_UNITS[time_format])
    return _EXAMPLE.replace(tzinfo=UTC).strftime(time_format)


def parse_written(columns: Sequence[pa.ChunkedArray], time_format: str) -> WrittenStamps:
    """Return time stamps of a column of time, or of dates and of times of day; null: a blank."""
    column = columns[-1]
    if len(columns) > 1:
        # Imported where it is needed: runs with nothing new read no stamp.
        import pyarrow.compute as pc

        date, clock = (pc.utf8_trim_whitespace(part.cast(pa.string())) for part in columns)
        column = pc.binary_join_element_wise(date, clock, " ")
    if pa.types.is_timestamp(column.type):
        return _from_timestamps(column)
    if not is_text(column.type):
        blank = np.nan if pa.types.is_floating(column.type) else 0
        return parse_numbers(column.fill_null(blank).to_numpy(), time_format)
    texts = column.cast(pa.string())
    stamps = _from_text(texts, time_format)
    strange = np.flatnonzero(stamps.kind == _NONE)[:_LOOKED_AT]
    cells = texts.take(pa.array(strange)).to_pylist() if strange.size else []
    return replace(stamps, example=next((cell for cell in cells if cell and cell.strip()), None))


def _from_text(texts: pa.ChunkedArray, time_format: str) -> WrittenStamps:
    if time_format == "iso8601":
        return _from_iso8601(texts)
    cells = pl.Series("time", texts)
    if time_format in EPOCH_UNITS or time_format == EXCEL_DAYS:
        cells = cells.str.strip_chars()
        counts = cells.cast(pl.Float64, strict=False).fill_null(np.nan).to_numpy()
        stamps = _from_numbers(counts, time_format)
        if time_format == EXCEL_DAYS:
            return stamps
        # Whole numbers apart: as a float64, nanoseconds since 1970 come in steps of 256.
        whole = cells.cast(pl.Int64, strict=False)
        exact = _from_numbers(whole.fill_null(0).to_numpy(), time_format)
        is_whole = whole.is_not_null().to_numpy()
        time_us = np.where(is_whole, exact.time_us, stamps.time_us)
        return WrittenStamps(time_us, np.where(is_whole, exact.kind, stamps.kind))
    if ",%f" in time_format:
        cells = cells.str.replace_all(",", ".", literal=True)
    times = parse_stamps(cells, time_format)
    kind = WITH_ZONE if "%z" in time_format else _LOCAL
    time_us = times.to_physical().fill_null(0).to_numpy()
    return WrittenStamps(time_us, _kinds(times.is_not_null().to_numpy(), kind))


def parse_numbers(numbers: Numbers, time_format: str) -> WrittenStamps:
    """Return time stamps of numbers, nan for a blank; none is one if the format is of text."""
    stamps = _from_numbers(numbers, time_format)
    strange = numbers[np.flatnonzero(stamps.kind == _NONE)[:_LOOKED_AT]].tolist()
    # Blank cells are 0 or nan by now.
    examples = (str(number) for number in strange if number and number == number)
    return replace(stamps, example=next(examples, None))


def _from_numbers(numbers: Numbers, time_format: str) -> WrittenStamps:
    if time_format in EPOCH_UNITS:
        return _from_epoch(numbers, time_format)
    if time_format != EXCEL_DAYS:
        return WrittenStamps(np.zeros(numbers.size, np.int64), np.zeros(numbers.size, np.int8))
    with np.errstate(over="ignore"):
        since_1970_ms = np.asarray(numbers, dtype=np.float64) * _DAY_MS + _EXCEL_ZERO_MS
    fits = np.abs(since_1970_ms) < LATEST_US / 1000
    local_ms = np.rint(np.where(fits, since_1970_ms, 0.0)).astype(np.int64)
    return WrittenStamps(local_ms * 1000, _kinds(fits, _LOCAL))


def _from_epoch(numbers: Numbers, time_format: str) -> WrittenStamps:
    thousandth = time_format == "epoch_ns"
    per_unit = EPOCH_UNITS[time_format]
    units_a_us = 1000 if thousandth else 1
    earliest, latest = (us * units_a_us // per_unit for us in (EARLIEST_US, LATEST_US))
    compared = np.asarray(numbers, np.float64) if numbers.dtype.kind == "f" else numbers
    readable = (compared >= earliest) & (compared < latest)
    counts = numbers if readable.all() else np.where(readable, numbers, 0)
    if counts.dtype.kind == "f":
        time_us = np.rint(counts * per_unit) if not thousandth else np.floor(counts / 1000)
    else:
        time_us = counts // 1000 if thousandth else counts.astype(np.int64) * per_unit
    return WrittenStamps(time_us.astype(np.int64), _kinds(readable, WITH_ZONE))


def _kinds(readable: NDArray[np.bool_], kind: int) -> NDArray[np.int8]:
    return readable * np.int8(kind)  # and `_NONE` elsewhere, which is 0


def _from_iso8601(texts: pa.ChunkedArray) -> WrittenStamps:
    for unit in ("us", "ns"):
        for tz in ("UTC", None):
            try:
                return _from_timestamps(texts.cast(pa.timestamp(unit, tz)))
            except pa.ArrowInvalid:
                continue
    # Slower, where some cell is no stamp, or they are written with and without a zone.
    time_us = np.zeros(len(texts), dtype=np.int64)
    kind = np.zeros(len(texts), dtype=np.int8)
    for i, text in enumerate(texts.to_pylist()):
        try:
            stamp = datetime.fromisoformat((text or "").strip())
        except ValueError:
            continue
        offset = stamp.utcoffset()
        kind[i] = _LOCAL if offset is None else WITH_ZONE
        time_us[i] = (stamp.replace(tzinfo=None) - _EPOCH - (offset or timedelta())) // _MICROSECOND
    return WrittenStamps(time_us, kind)


def _from_timestamps(stamps: pa.ChunkedArray) -> WrittenStamps:
    """Return stamps of an Arrow timestamp column of any unit, in UTC where its type has a zone."""
    kind = WITH_ZONE if stamps.type.tz else _LOCAL
    whole = stamps.cast(pa.int64())
    counts = (whole.fill_null(0) if stamps.null_count else whole).to_numpy()
    readable = ~nulls(stamps)
    unit = stamps.type.unit
    if unit in ("us", "ns"):
        return WrittenStamps(counts // 1000 if unit == "ns" else counts, _kinds(readable, kind))
    per_unit = EPOCH_UNITS[f"epoch_{unit}"]
    latest = LATEST_US // per_unit
    fits = (-latest < counts) & (counts < latest)  # beyond, microseconds may overflow
    return WrittenStamps(np.where(fits, counts, 0) * per_unit, _kinds(readable & fits, kind))


def place_in_zone(stamps: WrittenStamps, zone: str) -> TimeStamps:
    """Return all stamps of a log in UTC, in their order; local ones are on the clocks of the zone.

    Where a clock change gives an hour twice, stamps belong to its first pass until they step back
    by half an hour or more, then to the second; of a file sorted by time, in which they stand in
    pairs, the later ones do. Stamps in an hour that the change leaves out are not readable, and
    counted.
    """
    given = stamps.time_us
    readable = (stamps.kind != _NONE) & (given >= EARLIEST_US) & (given < LATEST_US)
    local = readable & (stamps.kind == _LOCAL)
    # A log of a day at 100 Hz has 69 MB of stamps: none are copied without need.
    time_us, skipped = given if readable.all() else np.where(readable, given, 0), 0
    if zone != "UTC" and local.any():
        walls = given[local]
        first_us, second_us = _offsets_us(walls, zone)
        offset_us = np.where(_on_second_pass(walls, first_us != second_us), second_us, first_us)
        exists = second_us <= first_us
        time_us = time_us.copy()
        time_us[local] = np.where(exists, walls - offset_us, 0)
        readable[local] = exists
        skipped = int(np.count_nonzero(~exists))
    return TimeStamps(time_us, readable, skipped, stamps.example or _implausible(stamps, readable))


def _implausible(stamps: WrittenStamps, readable: NDArray[np.bool_]) -> str | None:
    """Return first stamp that is read and cannot be, such as that of a clock that was never set."""
    if readable.all():
        return None
    rows = np.flatnonzero(~readable & (stamps.kind != _NONE))[:1]
    # Beyond the years of `datetime`, too.
    seconds = [np.datetime64(int(us) // 1_000_000, "s") for us in stamps.time_us[rows]]
    return str(seconds[0]).replace("T", " ") if seconds else None


def _offsets_us(local: NDArray[np.int64], zone: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return offset from UTC on the first and on the second pass; a smaller first: no such time."""
    # Since 1990 all zones have changed their offset at a whole minute, St. John's at 00:01.
    by_row = local // _MINUTE_US
    begins = np.flatnonzero(np.diff(by_row, prepend=by_row[0] - 1))
    minutes, which = np.unique(by_row[begins], return_inverse=True)
    tz = ZoneInfo(zone)
    offsets = np.empty((2, minutes.size), dtype=np.int64)
    for i, minute in enumerate(minutes.tolist()):
        wall = _EPOCH + timedelta(minutes=minute)
        for fold in (0, 1):
            offset = tz.utcoffset(wall.replace(fold=fold)) or timedelta()
            offsets[fold, i] = offset // _MICROSECOND
    of_row = np.repeat(which, np.diff(begins, append=by_row.size))
    return offsets[0, of_row], offsets[1, of_row]


def _on_second_pass(local: NDArray[np.int64], ambiguous: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return True where an hour that comes twice has stepped back, or a stamp in it."""
    if not ambiguous.any():
        return ambiguous
    steps_us = np.diff(local, prepend=local[0])
    repeated = steps_us == 0
    repeated[0] = False
    shares = [np.mean(repeated[of]) if of.any() else 1.0 for of in (ambiguous, ~ambiguous)]
    if shares[0] >= _IN_PAIRS and shares[1] <= 1.0 - 2.0 * _IN_PAIRS and steps_us.min() >= 0:
        return np.asarray(ambiguous & repeated)
    steps_back = np.cumsum((steps_us < -_STEP_BACK_US) & ambiguous)
    before_run = np.maximum.accumulate(np.where(ambiguous, 0, steps_back))
    return np.asarray(ambiguous & (steps_back > before_run))
