"""How a log seems to be written: the TOML to paste into a motor's file.

A guess from the first lines, each part by what most of them agree on; the reader judges it in the
end. What cannot be told, such as a channel's unit, is left as a question in a comment.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from pipeline.errors import LogError
from pipeline.ingest.csv_text import read_lines, unpacked
from pipeline.ingest.guesses import (
    channel_of,
    decimal_and_thousands,
    is_number,
    is_time_name,
    time_format_of,
    unit_of,
)
from pipeline.units import CHANNELS

_HEAD_BYTES = 2**16
_MOST_LINES = 400
_SEPARATORS = (";", "\t", "|", ",")
_ENCODINGS = ("utf-8", "cp1252")


@dataclass(frozen=True, slots=True)
class CsvGuess:
    """What the first lines of a CSV tell.

    Attributes
    ----------
    names, units
        Cells of the header and of the line of units below it, if there is one.
    columns
        First cells of each column.
    """

    encoding: str
    separator: str
    skip_rows: int
    unit_rows: int
    names: tuple[str, ...]
    units: tuple[str, ...]
    columns: tuple[tuple[str, ...], ...]


def suggest(path: Path) -> str:
    """TOML of ``[logs]`` and ``[channels]`` for a log file.

    Parameters
    ----------
    path
        A CSV (plain, gzip or Zstandard), a Parquet file or an MCAP.

    Returns
    -------
    str
        Tables to paste; what is a guess or missing has a comment.

    Raises
    ------
    LogError
        The file cannot be read, or its lines are no table.
    """
    if not path.exists():
        raise LogError("log_missing", path, "there is no such file")
    try:
        with path.open("rb") as file:
            magic = file.read(8)
        if magic.startswith(b"PAR1"):
            return "\n".join(_parquet_lines(path)) + "\n"
        if magic.startswith(b"\x89MCAP"):
            return "\n".join([*_logs_lines(path, "mcap"), *_questions(CHANNELS)]) + "\n"
        return "\n".join(_csv_lines(path, guess_csv(path))) + "\n"
    except OSError as error:
        raise LogError("log_not_readable", path, f"the file cannot be read: {error}") from error


def guess_csv(path: Path) -> CsvGuess:
    """Encoding, separator, header and first cells of a CSV.

    Raises
    ------
    LogError
        ``log_not_csv``: no two lines have the same number of cells, more than one.
    """
    encoding = _encoding(path)
    lines = _first_lines(path, encoding)
    found = [
        (width, -rank, separator, begin)
        for rank, separator in enumerate(_SEPARATORS)
        for width, begin in [_table(lines, separator)]
    ]
    width, _, separator, begin = max(found)
    if width < 2:
        raise LogError("log_not_csv", path, "the first lines are no table of two columns or more")
    rows = [_cells(line, separator) for line in lines[begin:]]
    names = rows[0]
    samples = 1
    while samples < min(4, len(rows)) and not any(map(is_number, rows[samples])):
        samples += 1
    same = [row for row in rows[samples:] if len(row) == width and row != names]
    units = rows[1] if samples > 1 else ()
    return CsvGuess(
        encoding, separator, begin, samples - 1, names, units, tuple(zip(*same, strict=True))
    )


def _encoding(path: Path) -> str:
    head = next(unpacked(path, _HEAD_BYTES), b"")
    for bom, name in (
        (codecs.BOM_UTF8, "utf-8"),
        (codecs.BOM_UTF16_LE, "utf-16"),
        (codecs.BOM_UTF16_BE, "utf-16"),
    ):
        if head.startswith(bom):
            return name
    # Text has no NUL: in UTF-16 every other byte of plain letters is one.
    if 5 * head.count(0) > 2 * len(head):
        return "utf-16-be" if head[:1] == b"\0" else "utf-16-le"
    for name in _ENCODINGS:
        try:
            codecs.getincrementaldecoder(name)().decode(head)
        except UnicodeDecodeError:
            continue
        return name
    return "latin-1"


def _first_lines(path: Path, encoding: str) -> list[str]:
    data = next(iter(read_lines(path, encoding, _HEAD_BYTES))).data
    return [line.decode() for line in islice(data.splitlines(), _MOST_LINES)]


def _cells(line: str, separator: str) -> tuple[str, ...]:
    parts = line.split(separator)
    return tuple(part.strip().strip('"').strip() for part in parts)


def _table(lines: Sequence[str], separator: str) -> tuple[int, int]:
    """Number of cells that most lines have, and the first line that has as many."""
    counts = [line.count(separator) + 1 for line in lines]
    wide = [count for count in counts if count > 1]
    # A decimal comma makes rows of many widths; what separates makes one.
    width = max(set(wide), key=wide.count, default=1)
    if 2 * wide.count(width) <= len([line for line in lines if line.strip()]) - 3:
        return 1, 0
    begin = counts.index(width) if width in counts else 0
    cells = _cells(lines[begin], separator) if lines else ()
    return (width, begin) if not any(map(is_number, cells)) else (1, 0)


def _csv_lines(path: Path, guess: CsvGuess) -> Iterator[str]:
    times = [i for i, name in enumerate(guess.names) if is_time_name(name)] or [0]
    time = times[0]
    decimal, thousands = decimal_and_thousands(
        [cell for i, column in enumerate(guess.columns) if i not in times for cell in column],
        guess.separator,
    )
    columns = [cell for cell in (guess.columns[time] if guess.columns else ()) if cell]
    time_format = time_format_of(columns, decimal)
    yield from _logs_lines(path, "csv")
    yield f"time = {_quoted(guess.names[time])}"
    known = time_format or "iso8601"
    yield f"time_format = {_quoted(known)}" + ("" if time_format else "  # not recognised: which?")
    if time_format and not re.search(r"epoch|%z", time_format) and not _has_zone(columns):
        yield 'time_zone = "UTC"  # the stamps name no zone: which is it?'
    defaults = {
        "separator": (guess.separator, ","),
        "decimal": (decimal, "."),
        "thousands": (thousands, ""),
        "encoding": (guess.encoding, "utf-8"),
    }
    yield from (
        f"{key} = {_quoted(value)}"
        for key, (value, default) in defaults.items()
        if value != default
    )
    if guess.skip_rows:
        yield f"skip_rows = {guess.skip_rows}"
    if guess.unit_rows:
        yield f"unit_rows = {guess.unit_rows}"
    units = guess.units or ("",) * len(guess.names)
    others = [i for i in range(len(guess.names)) if i not in times]
    yield from _channel_lines([guess.names[i] for i in others], [units[i] for i in others])


def _has_zone(stamps: Sequence[str]) -> bool:
    return any(re.search(r"(Z|[+-]\d\d:?\d\d)$", stamp) for stamp in stamps)


def _parquet_lines(path: Path) -> Iterator[str]:
    try:
        with pq.ParquetFile(path) as file:
            schema = file.schema_arrow
            names = [file.schema.column(i).path for i in range(len(file.schema))]
    except (OSError, ValueError, pa.ArrowException) as error:
        raise LogError("log_damaged", path, f"the Parquet file cannot be read: {error}") from error
    times = [name for name in names if is_time_name(name)] or names[:1]
    yield from _logs_lines(path, "parquet")
    yield f"time = {_quoted(times[0])}"
    kind = str(schema.field(times[0]).type) if times[0] in schema.names else ""
    if not kind.startswith("timestamp"):
        yield f'time_format = "iso8601"  # the column is of type {kind or "?"}: which?'
    elif "tz=" not in kind:
        yield 'time_zone = "UTC"  # the stamps name no zone: which is it?'
    rest = [name for name in names if name not in times]
    yield from _channel_lines(rest, [""] * len(rest))


def _logs_lines(path: Path, log_format: str) -> Iterator[str]:
    yield "[logs]"
    yield f'format = "{log_format}"'
    suffix = "".join(path.suffixes[-2:]) if path.suffix in (".gz", ".zst") else path.suffix
    yield f"files = [{_quoted(f'{path.parent.name}/*{suffix}')}]  # below the log root"


def _channel_lines(names: Sequence[str], units: Sequence[str]) -> Iterator[str]:
    found: dict[str, tuple[str, str]] = {}
    unused: list[str] = []
    for name, unit in zip(names, units, strict=True):
        channel = channel_of(name)
        if channel is None or channel in found:
            unused.append(name)
        else:
            found[channel] = (name, unit)
    for channel, (name, unit) in found.items():
        known = unit_of(channel, unit) or unit_of(channel, name)
        yield ""
        yield f"[channels.{channel}]"
        yield f"source = {_quoted(name)}"
        yield f'unit = "{known}"' if known else 'unit = "?"  # the log does not say it'
    missing = {"oil_temperature", "speed", "leakage_flow"} - found.keys()
    if not {"pressure_difference", "high_port_pressure"} & found.keys():
        missing.add("pressure_difference")
    yield from _questions([name for name in CHANNELS if name in missing])
    if unused:
        yield ""
        yield "# columns not used: " + ", ".join(map(_quoted, unused))


def _questions(channels: Sequence[str]) -> Iterator[str]:
    if channels:
        yield ""
        yield "# not found, give source and unit: " + ", ".join(channels)


def _quoted(text: str) -> str:
    """Text as a TOML string."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c.isprintable() else f"\\u{ord(c):04x}" for c in escaped) + '"'
