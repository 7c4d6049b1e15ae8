"""A fleet proposed from a plant's logs: its motors, their channels, and what has to be asked.

Nothing ambiguous is decided: it is a `Question`, whose answer is taken as it stands.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from glob import escape
from pathlib import Path
from typing import Any

from pipeline.config.channels import GOOD_QUALITY
from pipeline.config.logs import MISSING_TOKENS
from pipeline.errors import LogError
from pipeline.logs.finding import SUFFIXES, logs_below, suffix_of
from pipeline.setup.cells import Marks
from pipeline.setup.names import FEWEST_CHANNELS, groups_of, is_in, meaning_of, words_of
from pipeline.setup.questions import Asked, Chooser
from pipeline.setup.sniff import sniff
from pipeline.setup.tables import SAMPLES, Cells, Column, Question, Table

# A date, with a time or without, or a long number: what differs from file to file of one kind.
VARYING = re.compile(
    r"(?<!\d)(?:20\d\d[-_.]?\d\d[-_.]?\d\d(?:[-_T. ]?\d\d[-_.]?\d\d(?:[-_.]?\d\d)?)?|\d{6,})(?!\d)"
)
LARGEST_LOG_BYTES = 200 << 20  # of one that is read to look into it
_SHOWN = 12
_SHARED_BY_CHANCE = 0.5  # stamps of a second in which a state changes


@dataclass(frozen=True, slots=True)
class ProposedMotor:
    """A motor as its logs tell it."""

    name: str  # in the log; empty where nothing there names it
    motor_id: str
    logs: Mapping[str, Any]  # keys of ``[logs]``; what is asked is there as assumed
    channels: Mapping[str, Column]  # in the config's units; without one where it is asked
    files: tuple[Path, ...]


@dataclass(frozen=True, slots=True)
class Proposal:
    """A fleet to look at, with the questions that are open."""

    log_root: Path
    motors: tuple[ProposedMotor, ...]
    questions: tuple[Question, ...]
    unused: tuple[str, ...]  # names of columns and tags that are no channel's
    faults: tuple[str, ...]  # logs that cannot be read


@dataclass(frozen=True, slots=True)
class _Kind:
    """Files that differ by date alone."""

    pattern: str
    files: tuple[Path, ...]
    name: str  # what names them


def propose(source: Path, answers: Mapping[str, str], root: Path | None = None) -> Proposal:
    """Propose a fleet from a log, or a folder of logs; patterns of files are below `root`.

    Raises LogError if there is no log, or none can be read, and UsageError (``answer``) for an
    answer that cannot be.
    """
    if not source.exists():
        raise LogError("log_missing", source, "there is no such file or folder")
    files = sorted(logs_below(source)) if source.is_dir() else [source.resolve()]
    if not files:
        raise LogError("log_empty", source, f"there is no log ({', '.join(SUFFIXES)}) in it")
    root = root or (source.resolve() if source.is_dir() else source.resolve().parent)
    motors, faults = list[ProposedMotor](), list[str]()
    asked, unread = Asked(answers), 0
    for kind in _kinds(files, root):
        try:
            table = sniff(kind.files[-1])
        except LogError as error:
            faults.append(f"{error.code}: {error.message}")
            unread += 1
            continue
        asked.log = kind.name
        found = _motors(table, kind, asked)
        motors += found
        if not found:
            columns = ", ".join(one.name for one in table.columns[:_SHOWN])
            faults.append(f"no_motor: {kind.pattern}: its columns are no motor's: {columns}")
    if unread == len(faults) > 0 and not motors:
        raise LogError("log_not_readable", source, f"no log of it can be read: {faults[0]}")
    asked.require_known(one.motor_id for one in motors)
    questions, unused = tuple(asked.open.values()), tuple(asked.unused)
    return Proposal(root, _apart(motors), questions, unused, tuple(faults))


def _kinds(files: Sequence[Path], root: Path) -> Iterator[_Kind]:
    alike: dict[tuple[Path, str], list[Path]] = {}
    for path in files:
        alike.setdefault((path.parent, VARYING.sub("\0", path.name)), []).append(path)
    for (folder, template), own in alike.items():
        below = folder.relative_to(root).as_posix()
        begin = "" if below == "." else f"{escape(below)}/"
        parts = [escape(part) for part in re.split("\0+", template)]
        others = [path.name for path in files if path.parent == folder and path not in own]
        # A pattern fits no file of another kind.
        name = "*".join(parts)
        if any(fnmatchcase(other, name) for other in others):
            name = "[0-9]*".join(parts)
        stem = re.sub(r"^[\0_. -]+|[\0_. -]+$", "", template.removesuffix(suffix_of(own[-1])))
        several = sum(one[0] == folder for one in alike) > 1
        label = stem if several or below == "." else folder.name
        yield _Kind(begin + name, tuple(own), label or folder.name)


# The motors of a table


@dataclass(frozen=True, slots=True)
class _Layout:
    """How motors lie in logs that are alike."""

    keys: Mapping[str, Any]  # of ``[logs]``
    columns: Sequence[Column]  # that may be channels
    marks: Marks
    quality: str = ""  # column of the rows' quality
    several: Mapping[str, Cells] = field(default_factory=dict)  # motors of rows, by column


def _motors(table: Table, kind: _Kind, asked: Asked) -> list[ProposedMotor]:
    """The motors of logs that are alike; none where their columns are not enough for one."""
    layout = _long(table) or _wide(table)
    several = layout.several
    column = next(iter(several), None)
    if len(several) > 1:
        text = f"{kind.name}: rows of several motors: which column has the motor's name?"
        column = asked.ask(f"{kind.name}.motor_column", text, several)
    rows: list[tuple[str, dict[str, Any]]] = [(kind.name, {})]
    if several:
        names = several.get(column or "", ())
        rows = [(name, {"motor_column": column, "motor_name": name}) for name in names]
    keys = {**layout.keys, "files": [kind.pattern]}
    found = [
        motor
        for name, own in rows
        for motor in _grouped(layout, keys | own, replace(kind, name=name), asked)
    ]
    dialect = asked.keys_of(table) if found or several else {}
    return [replace(one, logs={**dialect, **one.logs}) for one in found]


def _wide(table: Table) -> _Layout:
    """A row a moment, with a column a channel."""
    columns = [one for one in table.columns if one.kind in ("number", "nothing")]
    several = {one.name: own for one in table.columns if (own := _motors_beside(one, table))}
    return _Layout({}, columns, table.marks, several=several)


def _long(table: Table) -> _Layout | None:
    """A row a sample, with the channel's name in a column; None: it is not."""
    numbers = [one for one in table.columns if one.kind == "number"]
    named = [one for one in numbers if is_in(words_of(one.name), "column", "value")]
    values = numbers if len(numbers) == 1 else named
    texts = [one for one in table.columns if one.kind == "text"]
    units = [one.name for one in texts if is_in(words_of(one.name), "column", "unit")][:1]
    names = [one for one in texts if one.name not in units]
    if len(values) != 1 or not names:
        return None
    column = max(names, key=lambda one: len({meaning_of(cell).channel for cell in one.filled}))
    seen: dict[str, tuple[list[str], str]] = {}
    for name, cell, *unit in table.rows([column.name, values[0].name, *units]):
        cells, _ = seen.setdefault(name.strip(), ([], next(iter(unit), "")))
        if len(cells) < SAMPLES and cell not in MISSING_TOKENS:
            cells.append(cell)
    columns = [
        Column(name, tuple(cells), "number", unit, {"source": name})
        for name, (cells, unit) in seen.items()
        if name not in MISSING_TOKENS
    ]
    told = {meaning_of(one.name, one.unit).channel for one in columns} - {None}
    if len(told) < 2 - is_in(words_of(column.name)[-1:], "column", "channel"):
        return None
    good = {str(one).lower() for one in GOOD_QUALITY}
    qualities = [
        one.name
        for one in texts
        if is_quality_name(one.name) and good & {cell.lower() for cell in one.filled}
    ]
    others = [one.name for one in names if one is not column and one.name not in qualities]
    several = {one: own for one in others if (own := _motors_of_tags(table, one, column.name))}
    keys = {"layout": "long", "channel_column": column.name, "value_column": values[0].name}
    return _Layout(keys, columns, table.marks, next(iter(qualities), ""), several)


def _motors_of_tags(table: Table, motors: str, tags: str) -> Cells:
    """Words of a column each of which comes with a motor's channels in another; else none."""
    channels: dict[str, set[str]] = {}
    for cell, name in table.rows([motors, tags]):
        own = channels.setdefault(cell.strip(), set())
        own |= {channel for channel in [meaning_of(name).channel] if channel}
    fewest = min(map(len, channels.values()), default=0)
    return tuple(sorted(channels)) if len(channels) > 1 and fewest >= FEWEST_CHANNELS else ()


def _motors_beside(column: Column, table: Table) -> Cells:
    """Cells of a column that names the motor of each row; none where it does not.

    Its name says so, or rows of other cells repeat most of a cell's time stamps.
    """
    words = [word for word in words_of(column.name) if not is_in([word], "column", "number")]
    is_named = is_in(words[-1:], "column", "motor")
    if meaning_of(column.name, column.unit).channel or not (is_named or column.kind == "text"):
        return ()
    stamps: dict[str, set[Cells]] = {}
    for cell, *stamp in table.rows([column.name, *table.times]):
        if cell not in MISSING_TOKENS:
            stamps.setdefault(cell.strip(), set()).add(tuple(stamp))
    if not (is_named and column.kind == "text"):
        seen = Counter(stamp for own in stamps.values() for stamp in own)
        shared = (sum(seen[stamp] > 1 for stamp in own) / len(own) for own in stamps.values())
        if min(shared, default=0.0) <= _SHARED_BY_CHANCE:
            return ()
    return tuple(sorted(stamps)) if len(stamps) > 1 else ()


def is_quality_name(name: str) -> bool:
    """True if the last word of a name is that of a quality, as in "PT101.Q"."""
    words = words_of(name)
    return is_in(words[-1:], "column", "quality") or (words[-1:] == ("q",) and len(words) > 1)


# The channels of a motor


def _grouped(
    layout: _Layout, logs: Mapping[str, Any], kind: _Kind, asked: Asked
) -> Iterator[ProposedMotor]:
    """The motors whose columns, tags or fields there are."""
    by_name = {one.name: one for one in layout.columns}
    qualities = {
        base: by_name[name].keys["source"]
        for name in filter(is_quality_name, by_name)
        if (base := re.sub(r"[\W_]+[^\W_]+$", "", name)) in by_name and base != name
    }
    names = [name for name in by_name if by_name[name].keys["source"] not in qualities.values()]
    groups, left = groups_of(names, {name: by_name[name].unit for name in names})
    asked.unused |= dict.fromkeys(left if groups else ())
    for group in groups:
        motor = group.name or kind.name
        chooser = Chooser(group, by_name, layout.marks, motor, _plain(motor), asked)
        channels = dict(chooser.places(qualities, layout.quality))
        used = {one.name for one in channels.values()}
        asked.unused |= dict.fromkeys(name for name in group.signals if name not in used)
        yield ProposedMotor(group.name, chooser.motor_id, logs, channels, kind.files)


def _plain(name: str) -> str:
    """A name as an id may be."""
    return re.sub(r"[^A-Za-z0-9._-]+", "-", name).strip("-._")[:64] or "motor"


def _apart(motors: Sequence[ProposedMotor]) -> tuple[ProposedMotor, ...]:
    """The motors, each with an id of its own."""
    taken: set[str] = set()
    found = []
    for motor in motors:
        own, number = motor.motor_id, 2
        while own in taken:
            own, number = f"{motor.motor_id}-{number}", number + 1
        taken.add(own)
        found.append(replace(motor, motor_id=own))
    return tuple(found)
