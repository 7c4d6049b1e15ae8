"""What is in a log of any format: its dialect, its columns with their first cells, its time.

Delimited text, Parquet, and MCAP with its topics and their fields: all end up as a `Table`.
"""

from __future__ import annotations

import codecs
import csv
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pyarrow as pa

from pipeline.config.logs import FieldPath, Logs, path_text
from pipeline.errors import LogError
from pipeline.ingest import cells as log_cells
from pipeline.ingest.contract import readable
from pipeline.ingest.csv import read_lines, unpack, wide_encoding
from pipeline.ingest.mcap.decoding import NANOSECONDS, SECONDS
from pipeline.ingest.mcap.log import Topic, read_topics
from pipeline.ingest.parquet import decode, flat, kinds_of, open_parquet, text_paths
from pipeline.setup.names import VOCABULARY, is_in, unit_in, unit_named, words_of
from pipeline.setup.signals import quality_words, whole_row_quality
from pipeline.setup.tables import (
    HEAD_ROWS,
    SAMPLES,
    TIMES,
    Cells,
    Column,
    Quality,
    Question,
    Rows,
    Table,
    TimeFormats,
    count_format,
    find_time,
    is_number,
    is_stamp,
    is_time_name,
    kind_of,
    marks_of,
    set_formats,
    time_formats,
)

_HEAD_BYTES = 2**16
_SCANNED_BYTES = 2**23
_LINES_OF_NAMES = 2  # the second of units
_SEPARATORS = (";", "\t", "|", ",")
Leaf = tuple[pa.Field, pa.Array]
_ENCODINGS = ["cp1252", "cp1250", "cp1251", "cp1254", "gb18030", "shift_jis"]
# Fields beside a reading that are none.
_NO_READINGS = {
    *("seq", "sequence", "sec", "secs", "nanosec", "nsec", "nsecs", "nanos", "seconds"),
    *("nanoseconds", "variance", "covariance", "id", "index", "stamp"),
}
# Units that messages of ROS 2's sensor_msgs are in by their definition.
_STANDARD_UNITS = {("FluidPressure", "fluid_pressure"): "Pa", ("Temperature", "temperature"): "°C"}


def sniff(path: Path, time: str = "") -> Table:
    """Tell the dialect and the columns of a log; `time` is the answer to which has its time.

    Raises LogError if the file cannot be read, or its lines are no table.
    """
    with readable(path):
        with path.open("rb") as file:
            magic = file.read(8)
        if magic.startswith(b"PAR1"):
            return find_time(_parquet(path), path, time)
        if magic.startswith(b"\x89MCAP"):
            return _mcap(path)
        return find_time(_csv(path), path, time)


def header_of(path: Path, logs: Logs) -> dict[str, str]:
    """Return columns of a configured log, each with the unit in its header; none if no table.

    Raises LogError if the file cannot be read.
    """
    if logs.layout != "wide" or logs.format not in ("csv", "parquet"):
        return {}
    with readable(path):
        if logs.format == "parquet":
            with open_parquet(path) as file:
                fields = kinds_of(file)
            return {field.name: _unit_of(field) for field in fields}
        lines = islice(_text_lines(path, logs.encoding, _HEAD_BYTES), logs.skip_rows, HEAD_ROWS)
        header = islice(filter(str.strip, lines), 1 + logs.unit_rows)
        names, *units = [_cells(line, logs.separator) for line in header] or [()]
        return dict.fromkeys(names, "") | dict(zip(names, _units_among(units), strict=False))


# Delimited text


def _csv(path: Path) -> Table:
    encoding = _encoding(next(unpack(path, _HEAD_BYTES), b""))
    lines = list(islice(_text_lines(path, encoding, _HEAD_BYTES), HEAD_ROWS))
    tables = {mark: _taken_apart(lines, mark) for mark in _SEPARATORS}
    separator = max(tables, key=lambda mark: tables[mark][0])
    (_, _, width), lined, first = tables[separator]
    head = _header(lined[:first], width)
    if head is None:
        filled = [line for line in lines if line.strip()]
        is_split = any(mark in line for line in filled[:1] for mark in _SEPARATORS)
        if not filled or (is_split and len(filled) <= _LINES_OF_NAMES):
            raise LogError("log_empty", path, "there are no rows below names of columns")
        raise LogError("log_not_csv", path, _why_no_table(lines, separator, width))
    header, units = head
    names = lined[header]
    unit_rows = sum(any(row) for row in lined[header + 1 : first])
    samples = [row for row in lined[first:] if len(row) == width and row != names]
    cells = list(zip(*samples, strict=True)) or [()] * len(names)
    columns = [
        Column(name, own, kind_of(own), unit, {"source": name})
        for name, unit, own in zip(names, units or ("",) * len(names), cells, strict=True)
        if name and names.count(name) == 1
    ]

    def rows(wanted: Sequence[str]) -> Rows:
        places = [names.index(name) for name in wanted]
        below = islice(_text_lines(path, encoding, _SCANNED_BYTES), header + 1 + unit_rows, None)
        for row in (_cells(line, separator) for line in below):
            if len(row) == len(names) and row != names and not row[0].startswith("#"):
                yield tuple(row[place] for place in places)

    numbers = [column for column in columns if column.kind == "number"]
    marks = marks_of(cell for number in numbers for cell in number.cells)
    if separator in (marks.decimal, marks.thousands):
        message = (
            "a comma is in numbers and separates the cells, too: such a log is not read, have it "
            "written with another separator"
        )
        raise LogError("log_not_csv", path, message)
    dialect: dict[str, Any] = {
        "separator": separator,
        "decimal": marks.decimal,
        "thousands": marks.thousands,
        "encoding": encoding,
        "skip_rows": header,
        "unit_rows": unit_rows,
    }
    questions = []
    if not marks.is_certain:
        choices = (marks.decimal, "," if marks.decimal == "." else ".")
        questions = [Question("decimal", "a decimal mark, or between thousands?", choices)]
    known = Logs.model_fields
    logs = {key: value for key, value in dialect.items() if value != known[key].default}
    table = Table({"format": "csv"} | logs, tuple(questions), tuple(columns), (), marks, rows)
    unnamed = (own[0] for name, own in zip(names, cells, strict=True) if own and not name)
    nameless = tuple(f"a column without a name has {cell!r}: name it" for cell in unnamed if cell)
    return replace(table, left_out=(*_repeated(names), *nameless))


def _repeated(names: Sequence[str]) -> Cells:
    """Say of names that are there several times why they are not read."""
    counts = Counter(filter(None, names))
    return tuple(f"{name} is there {n} times" for name, n in counts.items() if n > 1)


def _why_no_table(lines: Sequence[str], separator: str, width: int) -> str:
    """Return what keeps lines from being names with rows of samples below."""
    first = next((line for line in lines if line.strip()), "")
    if first.count('"') % 2:
        how = "a name goes over several lines: have the header written on one"
        return f"{how}, such as {' '.join(first.replace(chr(34), '').split())[:60]!r}"
    if len(_cells(first, separator)) == width - 1:
        return (
            f"rows end with a {separator!r} that the header lacks ({first.strip()[:60]!r}): have "
            "it written behind both, or behind neither"
        )
    return "the first lines are no names of columns with rows of samples below"


def _encoding(head: bytes) -> str:
    """Return first encoding in which the head makes sense, or that which makes most known words."""
    if wide := wide_encoding(head):
        return wide
    if _decodes(head, "utf-8"):
        return "utf-8"
    likely = [name for name in _ENCODINGS if _decodes(head, name)]
    return max(likely, key=lambda name: _words_known(head, name), default="latin-1")


def _decodes(head: bytes, encoding: str) -> bool:
    try:
        codecs.getincrementaldecoder(encoding)().decode(head)
    except UnicodeDecodeError:
        return False
    return True


def _words_known(head: bytes, encoding: str) -> int:
    # Line by line: a bracket that is open at a line's end encloses nothing of the next.
    lines = head.decode(encoding, "replace").splitlines()
    words = {word for line in lines for word in words_of(line)}
    return sum(
        is_in([word], "quantity", quantity) for quantity in VOCABULARY["quantity"] for word in words
    )


def _text_lines(path: Path, encoding: str, most_bytes: int) -> Iterator[str]:
    """Yield lines of the first bytes of a text, but for a line that is cut."""
    done = 0
    for data in read_lines(path, encoding, min(most_bytes, 2**20)):
        if data.endswith((b"\n", b"\r")):
            yield from data.decode().splitlines()
        done += len(data)
        if done >= most_bytes:
            return


def _cells(line: str, separator: str) -> Cells:
    try:
        return tuple(cell.strip() for cell in next(csv.reader([line], delimiter=separator), []))
    except csv.Error:
        return ()


def _taken_apart(
    lines: Sequence[str], separator: str
) -> tuple[tuple[bool, float, int], list[Cells], int]:
    """Return how well the cells between separators are a table, the cells and first row of samples.

    Is there a line above it that may have names, which share of cells are samples, and the width.
    """
    rows = [_cells(line, separator) for line in lines]
    # The rows of samples are the last ones, whatever stands before them.
    tail = Counter(len(row) for row in rows[len(rows) // 2 :] if len(row) > 1)
    width = max(tail, key=lambda length: (tail[length], length), default=1)
    samples = [sum(map(_holds_sample, row)) if len(row) == width else 0 for row in rows]
    # A line of a preamble may hold a sample or two, and others follow it that hold none.
    least = max(min(2, max(samples, default=0)), 1)
    places = [place for place, row in enumerate(rows) if row]
    starts = (
        at
        for at, place in enumerate(places)
        if samples[place] >= least and all(samples[near] for near in places[at : at + 3])
    )
    start = next(starts, None)
    if width < 2 or start is None:
        return (False, 0.0, 1), rows, 0
    first = places[start]
    share = sum(samples[first:]) / (width * len(places[start:]))
    is_named = start > 0 and len(rows[places[start - 1]]) == width
    return (is_named, share, width), rows, first


def _holds_sample(cell: str) -> bool:
    return is_number(cell) or kind_of([cell]) in TIMES


def _header(above: Sequence[Cells], width: int) -> tuple[int, Cells] | None:
    """Return line that has the names, and the cells of a line of units below it; None without.

    They are above the rows of samples.
    """
    wide = [at for at, line in enumerate(above) if len(line) == width]
    # Annotations, such as "#datatype", are no names where others are there.
    block = [at for at in wide if not above[at][0].startswith("#")] or wide
    if not block:
        return None

    def fit(at: int) -> tuple[bool, int, int]:
        return any(map(is_time_name, above[at])), len({*above[at]} - {""}), -at

    header = max(block, key=fit)
    below = [above[at] for at in block if at > header]
    # The same in all cells are types of numbers, such as "F".
    units = [cells for cells in below if len(set(cells[1:]) - {""}) > 1 or len(cells) == 2]
    return header, _units_among(units)


def _units_among(rows: Iterable[Cells]) -> Cells:
    """Return the line that has the most names of units."""
    return max(rows, key=lambda cells: sum(map(bool, map(unit_named, cells))), default=())


# Parquet


def _parquet(path: Path) -> Table:
    leaves = next(_leaves(path, HEAD_ROWS))
    columns = [column for leaf in leaves if (column := _column(*leaf)) is not None]
    known = {column.name for column in columns}
    with open_parquet(path) as file:
        kinds = {field.name: field.type for field in file.schema_arrow}
        repeated = _repeated(file.schema_arrow.names)
    others = tuple(
        f"{own.name} is of type {own.type}" for own, _ in leaves if own.name not in known
    )
    apart = {
        n: kind for n, kind in kinds.items() if pa.types.is_date(kind) or pa.types.is_time(kind)
    }
    if apart and not any(column.kind in ("stamp", "typed") for column in columns):
        shown = ", ".join(f"{name} ({kind})" for name, kind in apart.items())
        message = f"its time is apart, in {shown}: have a single column of timestamps written"
        raise LogError("log_time", path, message)
    if not columns or not len(leaves[0][1]):
        what = "rows" if columns else "columns that can be read"
        raise LogError("log_empty", path, f"the file has no {what}")

    def rows(wanted: Sequence[str]) -> Rows:
        """Yield the first rows of each text in the first of the columns, piece by piece."""
        for leaves in _leaves(path, 2**17, list(wanted)):
            frame = pl.DataFrame({field.name: pl.Series(values) for field, values in leaves})
            first = frame.select(wanted).group_by(wanted[0], maintain_order=True).head(SAMPLES)
            yield from (tuple(map(_text, row)) for row in first.select(wanted).iter_rows())

    table = Table({"format": "parquet"}, (), tuple(columns), (), rows=rows)
    return replace(table, left_out=(*repeated, *others))


def _leaves(path: Path, size: int, wanted: list[str] | None = None) -> Iterator[list[Leaf]]:
    """Yield columns, and those within them by their paths, piece by piece; the last is empty."""
    with open_parquet(path) as file:
        texts = text_paths(kinds_of(file))
    with open_parquet(path, texts) as file:
        none = pa.RecordBatch.from_pylist([], schema=file.schema_arrow)
        for batch in chain(file.iter_batches(batch_size=size, columns=wanted), [none]):
            batch.validate(full=True)
            table = flat(pa.Table.from_batches([batch]))
            yield [
                (field, _narrow(decode(path, field.name, values.combine_chunks())))
                for field, values in zip(table.schema, table.columns, strict=True)
                if table.schema.names.count(field.name) == 1
            ]


def _narrow(values: pa.Array) -> pa.Array:
    """Return values as Polars can have them, which knows no decimals of 256 bits."""
    return values.cast(pa.float64()) if pa.types.is_decimal256(values.type) else values


def _unit_of(field: pa.Field) -> str:
    """Return the unit in the metadata of a column, a factor before it; empty for none."""
    stated = {key.lower(): value for key, value in (field.metadata or {}).items()}
    factor, unit = (
        next((stated[key].decode(errors="replace") for key in keys if key in stated), "")
        for keys in ((b"scale", b"factor", b"multiplier"), (b"unit", b"units", b"uom"))
    )
    return f"{factor} {unit}" if factor not in ("", "1", "1.0") else unit


def _column(field: pa.Field, values: pa.Array) -> Column | None:
    """Return a column of times, numbers, text or truth values; None for what is none of them."""
    kind, keys = values.type, {"source": field.name}
    if pa.types.is_timestamp(kind):
        # In the place of a unit: what the type says of the zone.
        counts = values.cast(pa.timestamp("us", kind.tz), safe=False).cast(pa.int64())
        cells = tuple(map(_text, counts.to_pylist()))
        return Column(field.name, cells, "typed", kind.tz or "", keys)
    is_bare = pa.types.is_null(kind) or pa.types.is_boolean(kind)
    if not (log_cells.is_number(kind) or log_cells.is_text(kind) or is_bare):
        return None
    cells = tuple(map(_text, values.to_pylist()))
    return Column(field.name, cells, kind_of(cells), _unit_of(field), keys)


def _text(cell: object) -> str:
    return "" if cell is None else str(cell)


# MCAP


def _mcap(path: Path) -> Table:
    topics = read_topics(path)
    columns = [field for topic in topics for field in _fields(topic, is_lone=len(topics) == 1)]
    logs: dict[str, Any] = {"format": "mcap", "time": "log_time"}
    questions: list[Question] = []
    of_readings = {column.keys["source"] for column in columns}
    if stamp := _stamp([topic for topic in topics if topic.name in of_readings]):
        logs["time"] = path_text(stamp[0])
        set_formats(logs, questions, stamp[1])
    faults = tuple(
        f"{topic.name}: {path_text(at)} is text ({text!r}): have it written as a number"
        for topic in topics
        for at, text in topic.texts.items()
        if is_number(text)
    )
    return Table(logs, tuple(questions), tuple(columns), (), faults=faults)


def _fields(topic: Topic, *, is_lone: bool) -> Iterator[Column]:
    stamps = {path[:-1] for path in _stamp_paths(topic)}
    paths = [
        path
        for path, numbers in topic.fields.items()
        if path[:-1] not in stamps and _key(path).lower() not in _NO_READINGS and _finite(numbers)
        if not quality_words(_key(path))
        if not (is_time_name(_key(path)) and count_format(_finite(numbers)))
    ]
    for path in paths:
        text = path_text(path)
        # A field that is called nothing of its own is its topic's reading.
        is_value = is_in(words_of(_key(path)), "column", "value")
        whole = text if is_lone and len(paths) > 1 else f"{topic.name}.{text}"
        name = topic.name if is_value and len(path) == 1 else whole
        texts = topic.texts.items()
        beside = [
            word for at, word in texts if at[:-1] == path[:-1] and at[-1] in ("unit", "units")
        ]
        kind = topic.schema.split("/")[-1].split(".")[-1]
        unit = _STANDARD_UNITS.get((kind, text)) or next(iter(beside), "")
        cells = tuple(f"{number:.6g}" for number in _finite(topic.fields[path]))
        keys = {"source": topic.name} | ({"field": text} if text != "value" else {})
        unit = unit or topic.units.get(path) or topic.units.get(()) or ""
        unit = unit or unit_in(topic.descriptions.get(path, "")) or ""
        unit = unit or (text if unit_named(text) else "")
        yield Column(name, cells, "number", unit, keys, _quality_beside(topic, path))


def _quality_beside(topic: Topic, path: FieldPath) -> Quality | None:
    """Return the quality of a field: a field beside it, or of the message."""
    beside = {
        at: tuple(f"{number:.15g}" for number in _finite(topic.fields[at])) for at in topic.fields
    }
    beside |= {at: (text,) for at, text in topic.texts.items()}
    for parent in dict.fromkeys((path[:-1], ())):
        columns = [
            Column(str(at[-1]), cells, "text", keys={"source": path_text(at)})
            for at, cells in beside.items()
            if at[:-1] == parent
        ]
        if quality := whole_row_quality(columns):
            return quality
    return None


def _key(path: FieldPath) -> str:
    return next(step for step in reversed(path) if isinstance(step, str))


def _finite(numbers: Sequence[float]) -> list[float]:
    return [number for number in numbers if np.isfinite(number)]


def _stamp_paths(topic: Topic) -> list[FieldPath]:
    """Return paths of the seconds of stamps that have nanoseconds beside them."""
    return [
        path
        for path in topic.fields
        if path[-1] in SECONDS and any((*path[:-1], name) in topic.fields for name in NANOSECONDS)
    ]


def _stamp(topics: Sequence[Topic]) -> tuple[FieldPath, TimeFormats] | None:
    """Return a stamp that all messages have, written alike."""
    by_topic = [dict(_stamps_of(topic)) for topic in topics]
    stamps = by_topic[0].items() if by_topic else ()
    return next((stamp for stamp in stamps if all(stamp in own.items() for own in by_topic)), None)


def _stamps_of(topic: Topic) -> Iterator[tuple[FieldPath, TimeFormats]]:
    for path in _stamp_paths(topic):
        if path[:-1] and count_format(_finite(topic.fields[path])) == "epoch_s":
            yield path[:-1], TimeFormats({"": ""}, has_zone=True)
    for path, numbers in topic.fields.items():
        form = count_format(_finite(numbers)) if is_time_name(str(path[-1])) else None
        if form:
            yield path, TimeFormats({form: ""}, form != "excel_days")
    for path, text in topic.texts.items():
        if is_stamp(text):
            yield path, time_formats([text])
