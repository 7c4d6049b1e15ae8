"""Guesses at the columns of a table in any format: times, channels, or names of channels."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from pipeline.config.channels import GOOD_QUALITY
from pipeline.config.logs import LogLayout
from pipeline.setup.guess_cells import Marks, as_number, is_missing, is_number
from pipeline.setup.guess_channels import (
    BRACKETED,
    best_by_channel,
    channel_of,
    preference,
    unit_of,
    words_of,
)
from pipeline.setup.guess_files import files_by_channel
from pipeline.setup.guess_times import (
    TimeGuess,
    guess_time,
    is_clock,
    is_date,
    is_stamp,
    is_time_name,
    number_format,
)

Kind = Literal["timestamp", "stamp", "date", "clock", "number", "text", "nothing"]
Scan = Callable[[Sequence[str]], Iterable[tuple[str, ...]]]
"""Cells of some columns, by name, row by row through a file."""

FEWEST_CHANNELS = 3
"""Channels by which names are a motor's."""

SAMPLES = 50
"""Cells of a channel that are looked at."""

_NAME_COLUMNS = {
    *("channel", "tag", "tagname", "name", "signal", "variable", "sensor", "point", "parameter"),
    *("item", "quantity", "measurement", "kanal", "signalname", "messstelle", "messgröße"),
}
VALUE_WORDS = {"value", "val", "values", "reading", "wert", "messwert", "data", "värde"}
_QUALITY_WORDS = {"quality", "status", "qualität", "kvalitet", "calidad", "qualité"}
_MOTOR_WORDS = {
    *("motor", "machine", "maschinen", "asset", "equipment", "drive", "maschine", "antrieb"),
    *("anlage", "maskin", "moteur", "máquina", "maquina"),
}
_NUMBER_WORDS = {"id", "name", "no", "nr", "number", "nummer", "tag"}
_MOST_SHARED_BY_CHANCE = 0.5  # stamps of a second in which a state changes
_UNIT_COLUMNS = {"unit", "units", "uom", "einheit", "enhet"}

_LABEL = re.compile(r'([A-Za-z_]\w*)="([^"]*)"')
_SERIES = re.compile(r'[\w:]*\{[A-Za-z_]\w*="[^"]*"(?:, ?[A-Za-z_]\w*="[^"]*")*\}')


@dataclass(frozen=True, slots=True)
class GuessedColumn:
    """A column of a table."""

    name: str
    unit: str  # what is written beside the name as a unit; empty for nothing
    kind: Kind  # of its cells; "timestamp" where the file's own type says so
    cells: tuple[str, ...]  # the first ones, as text

    @property
    def filled(self) -> tuple[str, ...]:
        """The cells that hold something."""
        return tuple(cell for cell in self.cells if not is_missing(cell))


@dataclass(frozen=True, slots=True)
class Times:
    """Columns of the time; `date` is empty where it has no column of its own."""

    time: str
    date: str
    guess: TimeGuess
    is_typed: bool = False


@dataclass(frozen=True, slots=True)
class GuessedSource:
    """The place of a channel, with some of its cells."""

    channel: str
    source: str
    unit: str | None  # None where the log does not say it
    samples: tuple[str, ...]
    field: str = ""
    value_column: str = ""  # of a file a channel, where the files' differ

    @property
    def named_field(self) -> str:
        """The field, where it is called something of its own."""
        return "" if self.field == "value" else self.field

    @property
    def place(self) -> str:
        """Column, tag or topic, with a field that has a name."""
        return f"{self.source}.{self.named_field}" if self.named_field else self.source


Candidate = tuple[str, str, str, tuple[str, ...]]
"""Name by which a channel is told, its source, what is written as its unit, and samples."""


@dataclass(frozen=True, slots=True)
class TableLayout:
    """Layout of the channels in a table."""

    kind: LogLayout
    sources: tuple[GuessedSource, ...]
    unused: Mapping[str, tuple[str, ...]]  # samples by name that no channel was found for
    channel_column: str = ""
    value_column: str = ""
    files: tuple[str, ...] = ()  # patterns of the files' names, of a file a channel
    candidates: tuple[Candidate, ...] = ()  # all columns or names, besides those of the time
    # Motors by column, where rows are of several.
    motors: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    quality: str = ""  # column of the rows' quality, in a long table
    # Topics and fields of each of several motors of an MCAP, by what their names begin with.
    fields: Mapping[str, tuple[GuessedSource, ...]] = field(default_factory=dict)


def kind_of(cells: Sequence[str]) -> Kind:
    """Kind of most cells of text.

    Examples
    --------
    >>> kind_of(["1.5", "---", "2"]), kind_of(["06:00:00"]), kind_of(["", "-"])
    ('number', 'clock', 'nothing')
    """
    filled = [cell for cell in cells if not is_missing(cell)]
    tests: tuple[tuple[Kind, Callable[[str], bool]], ...] = (
        ("stamp", is_stamp),
        ("date", is_date),
        ("clock", is_clock),
        ("number", is_number),
    )
    for kind, test in tests:
        if filled and 2 * sum(map(test, filled)) > len(filled):
            return kind
    return "text" if filled else "nothing"


def find_times(columns: Sequence[GuessedColumn], marks: Marks, path: Path, last: Scan) -> Times:
    """The column of the time, or those of date and time; `marks` are those of numbers.

    The last rows of the log help to tell day from month.
    """
    named = sorted(columns, key=lambda one: not is_time_name(one.name))
    of_kind = {kind: [one for one in named if one.kind == kind] for kind in KINDS_OF_TIME}
    if of_kind["timestamp"]:
        column = of_kind["timestamp"][0]
        return Times(column.name, "", TimeGuess(("iso8601",), bool(column.unit)), is_typed=True)
    if of_kind["stamp"]:
        column = of_kind["stamp"][0]
        stamps = [*column.filled, *(cell for (cell,) in last([column.name]) if is_stamp(cell))]
        return Times(column.name, "", guess_time(stamps, file_name=path.name))
    if of_kind["date"] and of_kind["clock"]:
        date, clock = of_kind["date"][0], of_kind["clock"][0]
        pairs = [*zip(date.cells, clock.cells, strict=True), *last([date.name, clock.name])]
        both = [f"{one} {other}" for one, other in pairs if is_date(one) and is_clock(other)]
        return Times(clock.name, date.name, guess_time(both, file_name=path.name))
    for column in named:
        if column.kind == "number" and (is_time_name(column.name) or column is columns[0]):
            numbers = [as_number(cell, marks) for cell in column.filled]
            if number_format([number for number in numbers if number is not None]):
                return Times(column.name, "", guess_time(column.filled, marks.decimal))
    return Times(named[0].name, "", TimeGuess(()))


KINDS_OF_TIME: tuple[Kind, ...] = ("timestamp", "stamp", "date", "clock")


def find_layout(
    columns: Sequence[GuessedColumn],
    times: Times,
    path: Path,
    scan: Scan,
    read: Callable[[Path], Sequence[GuessedColumn]],
) -> TableLayout:
    """Layout of a table, and the places of its channels.

    `scan` reads on, for names of channels that come later; `read` gives the columns of another log
    of the same make.
    """
    rest = [
        one
        for one in columns
        if one.name not in (times.time, times.date) and one.kind not in KINDS_OF_TIME
    ]
    numbers = [one for one in rest if one.kind == "number"]
    texts = [one for one in rest if one.kind == "text"]
    value = _value_column(numbers)
    if value is not None and texts:
        found = _long(value, texts, scan)
        if found is not None:
            return found
    if len(numbers) == 1 and channel_of(BRACKETED.sub("", numbers[0].name)) is None:
        found = _file_per_channel(numbers[0].name, times, path, read)
        if found is not None:
            return found
    readable = [one for one in rest if one.kind in ("number", "nothing")]
    plain = without_labels([one.name for one in readable])
    candidates = tuple(
        (name, one.name, one.unit, one.filled[:SAMPLES])
        for name, one in zip(plain, readable, strict=True)
    )
    sources, unused = assigned(candidates)
    unused |= {one.name: one.filled[:SAMPLES] for one in texts}
    motors = {one.name: _motors_beside(one, times, scan) for one in (*texts, *numbers)}
    several = {name: own for name, own in motors.items() if len(own) > 1}
    return TableLayout("wide", sources, unused, candidates=candidates, motors=several)


def _motors_beside(column: GuessedColumn, times: Times, scan: Scan) -> tuple[str, ...]:
    """Cells of a column that names the motor of each row; none where it does not.

    Its name says so, or rows of other cells repeat most of a cell's time stamps.
    """
    words = [word for word in words_of(column.name) if word not in _NUMBER_WORDS]
    is_named = bool(words) and words[-1] in _MOTOR_WORDS
    if channel_of(column.name, column.unit) or not (is_named or column.kind == "text"):
        return ()
    stamps: dict[str, set[tuple[str, ...]]] = {}
    wanted = dict.fromkeys((column.name, times.date or times.time, times.time))
    for cell, *stamp in scan(list(wanted)):
        if not is_missing(cell):
            stamps.setdefault(cell.strip(), set()).add(tuple(stamp))
    if not (is_named and column.kind == "text"):
        seen = Counter(stamp for own in stamps.values() for stamp in own)
        shared = (sum(seen[stamp] > 1 for stamp in own) / len(own) for own in stamps.values())
        if min(shared, default=0.0) <= _MOST_SHARED_BY_CHANCE:
            return ()
    return tuple(sorted(stamps))


def without_labels(names: Sequence[str]) -> list[str]:
    """Names of series, ``metric{label="value"}``, as paths of the labels that differ.

    Examples
    --------
    >>> without_labels(['{__name__="p", at="x", m="1"}', '{__name__="p", at="x", m="2"}', "t"])
    ['1/p', '2/p', 't']
    """
    labels = [dict(_LABEL.findall(name)) for name in names]
    labelled = [one for one in labels if one]
    plain = []
    for name, own in zip(names, labels, strict=True):
        metric = own.pop("__name__", "") or name.partition("{")[0]
        apart = [
            value for key, value in own.items() if any(one.get(key) != value for one in labelled)
        ]
        plain.append("/".join((*apart, metric)) if _SERIES.fullmatch(name) else name)
    return plain


def _value_column(numbers: Sequence[GuessedColumn]) -> GuessedColumn | None:
    """The column of values of a long table."""
    if len(numbers) == 1:
        return numbers[0]
    named = [one for one in numbers if VALUE_WORDS & set(words_of(one.name))]
    return named[0] if len(named) == 1 else None


def _long(value: GuessedColumn, texts: Sequence[GuessedColumn], scan: Scan) -> TableLayout | None:
    units = [one for one in texts if _UNIT_COLUMNS & set(words_of(one.name))][:1]
    names = [one for one in texts if one not in units]
    if not names:
        return None
    column = max(names, key=lambda one: len({channel_of(cell) for cell in one.filled} - {None}))
    seen: dict[str, tuple[list[str], str]] = {}
    wanted = [column.name, value.name, *(unit.name for unit in units)]
    for name, cell, *unit in scan(wanted):
        samples, _ = seen.setdefault(name.strip(), ([], unit[0] if unit else ""))
        if len(samples) < SAMPLES and not is_missing(cell):
            samples.append(cell)
    seen = {name: one for name, one in seen.items() if not is_missing(name)}
    channels = {channel_of(name, unit) for name, (_, unit) in seen.items()} - {None}
    is_named = bool(_NAME_COLUMNS & set(words_of(column.name)))
    if len(channels) < 2 - is_named:
        return None
    candidates = tuple((name, name, unit, tuple(samples)) for name, (samples, unit) in seen.items())
    sources, unused = assigned(candidates)
    # Each of another column's words comes with the same names of channels: it is the motor's.
    parts = [one for one in names if one is not column and not _tells_quality(one)]
    motors = {part.name: _motors(scan([part.name, column.name])) for part in parts}
    return TableLayout(
        "long",
        sources,
        unused,
        channel_column=column.name,
        value_column=value.name,
        candidates=candidates,
        motors={name: own for name, own in motors.items() if len(own) > 1},
        quality=next((one.name for one in texts if _tells_quality(one)), ""),
    )


def _motors(rows: Iterable[tuple[str, ...]]) -> tuple[str, ...]:
    """Cells that each stand beside a motor's channels; none where any does not."""
    seen: dict[str, set[str | None]] = {}
    for cell, name in rows:
        seen.setdefault(cell.strip(), set()).add(channel_of(name))
    is_motors = all(len(channels - {None}) >= FEWEST_CHANNELS for channels in seen.values())
    return tuple(sorted(seen)) if is_motors else ()


def _tells_quality(column: GuessedColumn) -> bool:
    """True for a column of what historians write beside a good sample."""
    good = {str(one).lower() for one in GOOD_QUALITY}
    cells = [cell.lower() for cell in column.filled]
    return bool(cells) and bool(good & set(cells)) and is_quality_name(column.name)


def is_quality_name(name: str) -> bool:
    """True if the last word of a name is that of a quality.

    Examples
    --------
    >>> is_quality_name("PT101.Q"), is_quality_name("status"), is_quality_name("Q")
    (True, True, False)
    """
    last = (words_of(name) or ("",))[-1]
    return last in _QUALITY_WORDS or (last == "q" and len(words_of(name)) > 1)


def _file_per_channel(
    value: str, times: Times, path: Path, read: Callable[[Path], Sequence[GuessedColumn]]
) -> TableLayout | None:
    """The layout of a file a channel; None where a file has not one column of values."""
    sources, files = [], []
    for channel, (pattern, example) in files_by_channel(path).items():
        numbers = [one for one in read(example) if one.kind == "number" and one.name != times.time]
        column = next((one for one in numbers if one.name == value), None)
        if column is None and len(numbers) == 1:
            column = numbers[0]
        if column is None:
            return None
        told = (unit_of(channel, text) for text in (column.unit, column.name, example.name) if text)
        unit = next((one for one in told if one), None)
        own = column.name if column.name != value else ""
        samples = column.filled[:SAMPLES]
        sources.append(GuessedSource(channel, pattern, unit, samples, value_column=own))
        files.append(pattern)
    if not sources:
        return None
    return TableLayout(
        "file_per_channel", tuple(sources), {}, value_column=value, files=tuple(files)
    )


def assigned(
    candidates: Sequence[Candidate],
) -> tuple[tuple[GuessedSource, ...], dict[str, tuple[str, ...]]]:
    """Channels among candidates, each once, and the samples of those that are none."""
    named = ((channel_of(one[0], one[2]), one) for one in candidates)
    best = best_by_channel(
        (channel, (preference(channel or "", one[0]),), one) for channel, one in named
    )
    sources = tuple(
        GuessedSource(channel, one[1], unit_said(channel, one), one[3])
        for channel, one in best.items()
    )
    used = {source.source for source in sources}
    return sources, {one[1]: one[3] for one in candidates if one[1] not in used}


def unit_said(channel: str, candidate: Candidate) -> str | None:
    name, _, unit, _ = candidate
    return (unit_of(channel, unit) if unit else None) or unit_of(channel, name)
