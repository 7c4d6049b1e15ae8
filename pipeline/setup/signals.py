"""What of a log may be a motor's channels: columns or tags, each with its quality; motors of rows.

A quality stands beside a column (`PT`, `PT.Quality`; `PT.Value`, `PT.Validity`; `Quality_PT`), all
columns of a row, the values of a long table, or a field of a message.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from itertools import islice

from pipeline.config.logs import MISSING_TOKENS
from pipeline.setup.names import (
    FEWEST_CHANNELS,
    is_in,
    meaning_of,
    unit_named,
    without_unit,
    words_of,
)
from pipeline.setup.tables import SAMPLES, Cells, Column, Quality, Table, is_number

# OPC DA's: without a remark, at a limit, forced by hand, and forced at a limit.
OPC_DA_GOOD = (192, 193, 194, 195, 216, 217, 218, 219)
OPC_DA_CODES = 256
# The two highest of 32 bits of an OPC UA code are its severity.
OPC_UA_UNCERTAIN = 2**30
_ROWS_APART = 20
_SHARED_BY_CHANCE = 0.5  # stamps of a second in which a state changes


def signals_of(table: Table) -> Table:
    """Return the table with the columns, or tags, that may be channels of a motor."""
    return _of_tags(table) or _of_columns(table)


def _of_columns(table: Table) -> Table:
    """Return the columns that may be channels of a log with a row a moment."""
    columns = with_qualities(table.columns) if table.logs["format"] != "mcap" else table.columns
    units = {_words(column.name)[:-1]: column for column in table.columns if _has_units(column)}
    readings = (column for column in columns if column.kind in ("number", "nothing"))
    return replace(table, columns=tuple(_with_unit(column, units) for column in readings))


def _has_units(column: Column) -> bool:
    """Return True for a column that has the unit of each reading of the one beside it."""
    is_named = is_in(_words(column.name)[-1:], "column", "unit")
    return is_named and bool(column.filled) and all(map(unit_named, column.filled))


def _with_unit(column: Column, units: Mapping[Cells, Column]) -> Column:
    """Return a column with the unit, or units, that its rows state beside it."""
    beside = units.get(_without_value(column.name))
    stated = dict.fromkeys(beside.cells if beside else ())
    return replace(column, unit=" or ".join(filter(None, stated)) or column.unit)


def _of_tags(table: Table) -> Table | None:
    """Return the channels of a log with a row a sample and names in a column, or None."""
    columns = [column for column in table.columns if not quality_words(column.name)]
    numbers = [number for number in columns if number.kind == "number"]
    named = [number for number in numbers if is_in(words_of(number.name), "column", "value")]
    values = numbers if len(numbers) == 1 else named
    texts = [text for text in columns if text.kind == "text"]
    units = [text.name for text in texts if is_in(words_of(text.name), "column", "unit")][:1]
    names = [text for text in texts if text.name not in units]
    if len(values) != 1 or not names:
        return None
    # A tag's rows may stand together: its names are those of the whole head.
    head = list(table.rows([text.name for text in names]))
    channels = {
        text.name: {meaning_of(cell).channel for cell in {row[at] for row in head}} - {None}
        for at, text in enumerate(names)
    }
    column = max(names, key=lambda text: len(channels[text.name]))
    seen: dict[str, tuple[list[str], str]] = {}
    for name, cell, *unit in table.rows([column.name, values[0].name, *units]):
        cells, _ = seen.setdefault(name.strip(), ([], next(iter(unit), "")))
        if cell not in MISSING_TOKENS:
            cells.append(cell)
    quality = whole_row_quality(table.columns)
    tags = [
        Column(name, _spread(cells), "number", unit, {"source": name}, quality)
        for name, (cells, unit) in seen.items()
        if name not in MISSING_TOKENS
    ]
    known = {meaning_of(tag.name, tag.unit).channel for tag in tags} - {None}
    if len(known) < 2 - is_in(words_of(column.name)[-1:], "column", "channel"):
        return None
    own = {"layout": "long", "channel_column": column.name, "value_column": values[0].name}
    return replace(table, logs={**table.logs, **own}, columns=tuple(tags))


def unread_columns(table: Table) -> Cells:
    """Return columns of a table that cannot be a channel, each with its cause."""
    texts = (
        f"{column.name} has {next((c for c in column.filled if not is_number(c)), '')!r}, no number"
        for column in table.columns
        if column.kind == "text" and not quality_words(column.name)
    )
    has_values = any(is_in(words_of(column.name), "column", "value") for column in table.columns)
    tags = (
        f"{column.name} has numbers for the names of channels"
        for column in table.columns
        if has_values and column.kind == "number" and _is_of_tags(column.name)
    )
    return (*table.left_out, *texts, *tags)


def _is_of_tags(name: str) -> bool:
    words = words_of(name)
    return is_in(words[:1], "column", "channel") or is_in(words[-1:], "column", "number")


def _spread(cells: Sequence[str]) -> Cells:
    """Return some cells from all over a log: its head may be a standstill."""
    return tuple(cells[:: max(1, len(cells) // SAMPLES)][:SAMPLES])


def cells_of(table: Table) -> Callable[[str], Sequence[str]]:
    """Return cells of a column from all over the head of a log that is read for them, once."""

    @cache
    def rows() -> dict[str, list[str]]:
        names = [column.name for column in table.columns]
        thinned = islice(table.rows(names), 0, None, _ROWS_APART)
        return dict(zip(names, map(list, zip(*thinned, strict=True)), strict=False))

    return lambda name: rows().get(name, []) if table.logs.get("layout") != "long" else []


def columns_without_use(table: Table, signals: Table, motor_columns: Sequence[str]) -> list[str]:
    """Return names of columns that are neither read nor candidates of a channel."""
    logs = signals.logs
    read = {logs.get(key) for key in ("channel_column", "value_column")} | {*motor_columns}
    read |= {column.name for column in signals.columns}
    read |= {column.quality.source for column in signals.columns if column.quality}
    is_long = logs.get("layout") == "long"
    return [
        column.name
        for column in table.columns
        if column.name not in read
        and column.kind != "nothing"
        and not (is_long and is_in(words_of(column.name), "column", "unit"))
        and not _has_units(column)
    ]


def motors_of_rows(column: Column, table: Table, tag: str | None) -> Cells:
    """Return the cells of a column that names the motor of each row, or none where it does not.

    Its name says so, or rows of other cells repeat most of a cell's moments, a stamp or a stamp of
    a `tag`. Of tags, each cell comes with a motor's: others name gauges.
    """
    words = [word for word in words_of(column.name) if not is_in([word], "column", "number")]
    is_named = is_in(words[-1:], "column", "motor")
    if meaning_of(column.name, column.unit).channel or not (is_named or column.kind == "text"):
        return ()
    if column.name == tag or quality_words(column.name):
        return ()
    moments = [*table.times, tag] if tag else table.times
    seen_with: dict[str, set[Cells]] = {}
    for cell, *moment in table.rows([column.name, *moments]):
        if cell not in MISSING_TOKENS:
            seen_with.setdefault(cell.strip(), set()).add(tuple(moment))
    if tag:
        tags = ({moment[-1] for moment in own} for own in seen_with.values())
        channels = ({meaning_of(name).channel for name in own} - {None} for own in tags)
        if min(map(len, channels), default=0) < FEWEST_CHANNELS:
            return ()
    if not (is_named and column.kind == "text"):
        seen = Counter(moment for own in seen_with.values() for moment in own)
        shared = (sum(seen[moment] > 1 for moment in own) / len(own) for own in seen_with.values())
        if min(shared, default=0.0) <= _SHARED_BY_CHANCE:
            return ()
    return tuple(sorted(seen_with)) if len(seen_with) > 1 else ()


# Qualities


def quality_words(name: str) -> Cells:
    """Return the words at the end or begin of a name that are of a quality; empty for none."""
    words = _words(name)
    is_code = words[-1:] == ("code",) and _is_quality(words[-2:-1])
    if is_code or words[-2:] == ("percent", "good"):
        return words[-2:]
    is_beside = len(words) > 1 and (words[-1] == "q" or is_in(words[-1:], "quality", "fault"))
    if is_beside or _is_quality(words[-1:]) or is_in(words[-1:], "quality", "doubt"):
        return words[-1:]
    return words[:1] if _is_quality(words[:1]) else ()


def _words(name: str) -> Cells:
    return words_of(name.replace("(", " ").replace(")", " "))


def _is_quality(words: Sequence[str]) -> bool:
    return any(is_in(words, "quality", kind) for kind in ("column", "validity", "status", "code"))


def good_codes(words: Sequence[str], cells: Iterable[str]) -> tuple[str | int, ...] | None:
    """Return the codes of a good sample, or None where neither name nor cells say them.

    Examples
    --------
    >>> good_codes(["quality"], ["Good", "Bad"]), good_codes(["validity"], ["1", "0"])
    (('Good',), (1,))
    >>> good_codes(["quality"], ["192", "0"]) == OPC_DA_GOOD
    True
    >>> good_codes(["status", "code"], ["0"]), good_codes(["quality"], ["0", "1"])
    ((0,), None)
    >>> good_codes(["error"], ["0", "200"]), good_codes(["quality"], ["0.5", "200"])
    (None, None)
    """
    seen = tuple(dict.fromkeys(cells))
    numbers = {float(cell.replace(",", ".")) for cell in seen if is_number(cell)}
    is_doubt = is_in(words, "quality", "doubt")
    if not numbers:
        if is_doubt:
            return tuple(cell for cell in seen if cell.casefold() == "false") or None
        return tuple(cell for cell in seen if is_in(_words(cell)[:1], "quality", "good")) or None
    # Of an error nobody knows which number is good; a deviation from a setpoint has any.
    is_any = is_in(words, "quality", "fault") or any(number % 1 or number < 0 for number in numbers)
    is_code = tuple(words[-2:]) == ("status", "code") or is_in(words, "quality", "code")
    rules = (
        (not is_any and OPC_DA_GOOD[0] <= max(numbers) < OPC_DA_CODES, OPC_DA_GOOD),
        ((not is_any and max(numbers) >= OPC_UA_UNCERTAIN) or (is_code and numbers == {0.0}), (0,)),
        (is_in(words, "quality", "validity") and numbers <= {0.0, 1.0, 2.0}, (1,)),
        (is_doubt and numbers <= {0.0, 1.0}, (0,)),
    )
    return next((codes for holds, codes in rules if holds), None)


def with_qualities(columns: Sequence[Column]) -> tuple[Column, ...]:
    """Return the columns of readings, each with the quality beside it or that of its whole row."""
    marks = {column.name: column for column in columns if quality_words(column.name)}
    whole = next(_of_rows(column for column in marks.values() if _is_whole(column)), None)
    beside = {_base(column.name): column for column in marks.values() if not _is_whole(column)}
    readings = [column for column in columns if column.name not in marks]
    with_quality, used = list[Column](), set[str]()
    for reading in readings:
        name, plain = reading.name, without_unit(reading.name)
        bases = (_without_value(name), _words(name), _without_value(plain), _words(plain))
        mark = next((beside[base] for base in bases if base in beside), None)
        own = whole if mark is None else _quality(mark)
        used |= {mark.name} if mark else set()
        with_quality.append(replace(reading, quality=own))
    rest = (column for column in beside.values() if column.name not in used)
    return (*with_quality, *rest)


def whole_row_quality(columns: Iterable[Column]) -> Quality | None:
    """Return the quality of a whole row, or None; a machine's status is none."""
    return next(_of_rows(filter(_is_whole, columns)), None)


def _of_rows(columns: Iterable[Column]) -> Iterator[Quality]:
    for column in columns:
        words = quality_words(column.name)
        is_status = len(words) == 1 and is_in(words, "quality", "status")
        if not is_status or good_codes(words, column.filled):
            yield _quality(column)


def _quality(column: Column) -> Quality:
    words = quality_words(column.name)
    return Quality(column.keys["source"], words, column.filled, good_codes(words, column.filled))


def _is_whole(column: Column) -> bool:
    base = _base(column.name)
    is_of_row = all(is_in([word], "quality", "row") or _is_quality([word]) for word in base)
    return bool(quality_words(column.name)) and is_of_row


def _base(name: str) -> Cells:
    """Return the words of a name without those of its quality."""
    words, own = _words(name), quality_words(name)
    return words[: -len(own)] if words[-len(own) :] == own else words[len(own) :]


def _without_value(name: str) -> Cells:
    words = _words(name)
    return words[:-1] if len(words) > 1 and is_in(words[-1:], "column", "value") else words
