"""Columns of quality beside readings, and which of their codes are those of a good sample.

A quality stands beside a column (`PT`, `PT.Quality`; `PT.Value`, `PT.Validity`; `PT`,
`Quality_PT`), beside all columns of a row, beside the values of a long table, or beside a field of
a message.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from pipeline.setup.names import is_in, words_of
from pipeline.setup.tables import Cells, Column, Quality, is_number

# OPC DA's: without a remark, at a limit, forced by hand, and forced at a limit.
OPC_DA_GOOD = (192, 193, 194, 195, 216, 217, 218, 219)
OPC_DA_CODES = 256
# The two highest of 32 bits of an OPC UA code are its severity.
OPC_UA_UNCERTAIN = 2**30


def quality_words(name: str) -> Cells:
    """Return the words at the end or begin of a name that are those of a quality; empty for none.

    Examples
    --------
    >>> [quality_words(name) for name in ("PT.Q", "PT_Status_Code", "Quality(PT)", "Q", "PT")]
    [('q',), ('status', 'code'), ('quality',), (), ()]
    """
    words = _words(name)
    if words[-1:] == ("code",) and _is_quality(words[-2:-1]):
        return words[-2:]
    if _is_quality(words[-1:]) or (words[-1:] == ("q",) and len(words) > 1):
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
    """
    seen = tuple(dict.fromkeys(cells))
    numbers = {float(cell.replace(",", ".")) for cell in seen if is_number(cell)}
    if not numbers:
        return tuple(cell for cell in seen if is_in(_words(cell)[:1], "quality", "good")) or None
    is_code = tuple(words[-2:]) == ("status", "code") or is_in(words, "quality", "code")
    rules = (
        (OPC_DA_GOOD[0] <= max(numbers) < OPC_DA_CODES, OPC_DA_GOOD),
        (max(numbers) >= OPC_UA_UNCERTAIN or (is_code and numbers == {0.0}), (0,)),
        (is_in(words, "quality", "validity") and numbers <= {0.0, 1.0, 2.0}, (1,)),
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
        mark = beside.get(_without_value(reading.name)) or beside.get(_words(reading.name))
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
    return bool(quality_words(column.name)) and not _base(column.name)


def _base(name: str) -> Cells:
    """Return the words of a name without those of its quality."""
    words, own = _words(name), quality_words(name)
    return words[: -len(own)] if words[-len(own) :] == own else words[len(own) :]


def _without_value(name: str) -> Cells:
    words = _words(name)
    return words[:-1] if len(words) > 1 and is_in(words[-1:], "column", "value") else words
