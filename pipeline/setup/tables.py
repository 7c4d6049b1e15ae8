"""What every log is to the setup: columns with their first cells, and what the log does not say."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Any

from pipeline.config.logs import MISSING_TOKENS
from pipeline.setup.cells import (
    Marks,
    TimeFormats,
    as_number,
    count_format,
    is_stamp,
    is_time_name,
    time_formats,
)

SAMPLES = 50  # cells of a column that are kept
HEAD_ROWS = 400
TIMES = ("stamp", "date", "clock", "typed")

Cells = tuple[str, ...]
Rows = Iterator[Cells]


@dataclass(frozen=True, slots=True)
class Column:
    """A column, tag or field: its name, how a config finds it, and some of its cells."""

    name: str
    cells: Cells
    kind: str  # as `cells.kind_of` has it; "typed" for times by the file's own type
    unit: str = ""  # what is written beside the name as a unit
    keys: Mapping[str, str] = field(default_factory=dict)  # of ``[channels.…]``, but for the unit

    @property
    def filled(self) -> Cells:
        """The first cells that hold something."""
        return tuple(cell for cell in self.cells if cell not in MISSING_TOKENS)[:SAMPLES]


@dataclass(frozen=True, slots=True)
class Question:
    """What a log does not say; `key` names it in an answer. Without choices any text is one."""

    key: str
    text: str
    choices: Cells = ()


@dataclass(frozen=True, slots=True)
class Table:
    """A log as its first lines, rows or messages tell it."""

    logs: Mapping[str, Any]  # keys of ``[logs]``, but for the files
    questions: tuple[Question, ...]
    columns: tuple[Column, ...]  # but for those of the time
    times: Cells
    marks: Marks = field(default_factory=Marks)
    rows: Callable[[Sequence[str]], Rows] = lambda _: iter(())  # cells of some columns, further on


def timed(table: Table) -> Table:
    """The table with its time found, and without the columns of the time."""
    named = sorted(table.columns, key=lambda one: not is_time_name(one.name))
    of_kind = {kind: [one for one in named if one.kind == kind] for kind in TIMES}
    times, formats = named[:1], TimeFormats({})
    if of_kind["typed"]:
        times = of_kind["typed"][:1]
        formats = TimeFormats({"": ""}, bool(times[0].unit))
    elif of_kind["stamp"] or (of_kind["date"] and of_kind["clock"]):
        times = of_kind["stamp"][:1] or [of_kind["clock"][0], of_kind["date"][0]]
        formats = _formats(table, times[::-1])
    else:
        for one in named:
            counts = [as_number(cell, table.marks) for cell in one.filled]
            is_time = is_time_name(one.name) or one is table.columns[0]
            known = [number for number in counts if number is not None]
            if one.kind == "number" and is_time and count_format(known):
                times, formats = [one], time_formats(one.filled, table.marks.decimal)
                break
    logs, questions, names = dict(table.logs), list(table.questions), [one.name for one in times]
    logs |= dict(zip(("time", "date_column"), names, strict=False))
    set_formats(logs, questions, formats)
    # The other columns of times, such as that of arrival, are no readings either.
    rest = [one for one in table.columns if one.name not in names and one.kind not in TIMES]
    return replace(
        table, logs=logs, questions=tuple(questions), columns=tuple(rest), times=tuple(names)
    )


def _formats(table: Table, columns: Sequence[Column]) -> TimeFormats:
    """Formats of stamps in a column, or in those of date and time."""
    cells = zip(*(one.cells for one in columns), strict=True)
    stamps = [stamp for row in cells if is_stamp(stamp := " ".join(row))][:SAMPLES]
    found = time_formats(stamps)
    if len(found.readings) < 2:
        return found
    # Some stamps from further on tell day from month.
    later = islice(table.rows([one.name for one in columns]), HEAD_ROWS, 200_000, 1000)
    more = [stamp for row in later if is_stamp(stamp := " ".join(row))]
    return time_formats([*stamps, *more])


def set_formats(logs: dict[str, Any], questions: list[Question], formats: TimeFormats) -> None:
    """Keys and questions of the time's format and zone."""
    readings = formats.readings
    if not readings:
        questions.append(Question("time_format", "how are its time stamps written?"))
    elif form := next(iter(readings)):
        logs["time_format"] = form
    if len(readings) > 1:
        said = ", or ".join(f"{reading} by {form}" for form, reading in readings.items())
        questions.append(Question("time_format", f"does it begin on {said}?", tuple(readings)))
    if not formats.has_zone:
        logs["time_zone"] = "UTC"
        questions.append(Question("time_zone", "the stamps name no zone, such as Europe/Oslo"))
