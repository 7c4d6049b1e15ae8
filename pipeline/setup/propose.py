"""A fleet proposed from a plant's logs: its motors, their channels, and what has to be asked.

Nothing ambiguous is decided: it is a `Question`, whose answer is taken as it stands.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from glob import escape
from itertools import chain, count
from pathlib import Path
from typing import Any

from pipeline.config.channels import GOOD_QUALITY
from pipeline.config.logs import MISSING_TOKENS
from pipeline.errors import LogError
from pipeline.logs.finding import SUFFIXES, logs_below, suffix_of
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
    return Proposal(root, tuple(_apart(motors)), questions, unused, tuple(faults))


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


def _motors(table: Table, kind: _Kind, asked: Asked) -> list[ProposedMotor]:
    """The motors of logs that are alike; none where their columns are not enough for one."""
    signals = _of_tags(table) or _of_columns(table)
    tag = signals.logs.get("channel_column")
    moments = [*table.times, tag] if tag else table.times
    several = {
        one.name: own
        for one in table.columns
        if one.name != tag and (own := _motors_of_rows(one, moments, table, has_tags=bool(tag)))
    }
    column = next(iter(several), None)
    if len(several) > 1:
        text = f"{kind.name}: rows of several motors: which column has the motor's name?"
        column = asked.ask(f"{kind.name}.motor_column", text, several)
    rows: list[tuple[str, dict[str, Any]]] = [(kind.name, {})]
    if several:
        names = several.get(column or "", ())
        rows = [(name, {"motor_column": column, "motor_name": name}) for name in names]
    found = [motor for name, own in rows for motor in _grouped(signals, own, kind, name, asked)]
    dialect = asked.keys_of(signals) if found or several else {}
    files = {"files": [kind.pattern]}
    return [replace(one, logs={**dialect, **files, **one.logs}) for one in found]


def _of_columns(table: Table) -> Table:
    """The columns that may be channels of a log with a row a moment."""
    sources = {one.name: one.keys["source"] for one in table.columns}
    qualities = {
        base: sources[name]
        for name in filter(is_quality_name, sources)
        if (base := re.sub(r"[\W_]+[^\W_]+$", "", name)) in sources and base != name
    }
    columns = (
        replace(one, keys={**one.keys, "quality_source": qualities[one.name]})
        if one.name in qualities
        else one
        for one in table.columns
        if one.kind in ("number", "nothing") and one.keys["source"] not in qualities.values()
    )
    return replace(table, columns=tuple(columns))


def _of_tags(table: Table) -> Table | None:
    """The channels of a log with a row a sample and their names in a column; None: it is not."""
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
    good = {str(one).lower() for one in GOOD_QUALITY}
    qualities = [
        one.name
        for one in names
        if is_quality_name(one.name) and good & {cell.lower() for cell in one.filled}
    ]
    keys = {"quality_source": qualities[0]} if qualities else {}
    columns = [
        Column(name, tuple(cells), "number", unit, {"source": name, **keys})
        for name, (cells, unit) in seen.items()
        if name not in MISSING_TOKENS
    ]
    told = {meaning_of(one.name, one.unit).channel for one in columns} - {None}
    if len(told) < 2 - is_in(words_of(column.name)[-1:], "column", "channel"):
        return None
    own = {"layout": "long", "channel_column": column.name, "value_column": values[0].name}
    return replace(table, logs={**table.logs, **own}, columns=tuple(columns))


def _motors_of_rows(
    column: Column, moments: Sequence[str], table: Table, *, has_tags: bool
) -> Cells:
    """Cells of a column that names the motor of each row; none where it does not.

    Its name says so, or rows of other cells repeat most of a cell's moments, a stamp or a stamp of
    a tag, which is the last of them. Of tags, each cell comes with a motor's: others name gauges.
    """
    words = [word for word in words_of(column.name) if not is_in([word], "column", "number")]
    is_named = is_in(words[-1:], "column", "motor")
    if meaning_of(column.name, column.unit).channel or not (is_named or column.kind == "text"):
        return ()
    seen_with: dict[str, set[Cells]] = {}
    for cell, *moment in table.rows([column.name, *moments]):
        if cell not in MISSING_TOKENS:
            seen_with.setdefault(cell.strip(), set()).add(tuple(moment))
    if has_tags:
        tags = ({moment[-1] for moment in own} for own in seen_with.values())
        channels = ({meaning_of(name).channel for name in own} - {None} for own in tags)
        if min(map(len, channels), default=0) < FEWEST_CHANNELS:
            return ()
    if not (is_named and column.kind == "text"):
        seen = Counter(moment for own in seen_with.values() for moment in own)
        shared = (sum(seen[one] > 1 for one in own) / len(own) for own in seen_with.values())
        if min(shared, default=0.0) <= _SHARED_BY_CHANCE:
            return ()
    return tuple(sorted(seen_with)) if len(seen_with) > 1 else ()


def is_quality_name(name: str) -> bool:
    """True if the last word of a name is that of a quality, as in "PT101.Q"."""
    words = words_of(name)
    return is_in(words[-1:], "column", "quality") or (words[-1:] == ("q",) and len(words) > 1)


# The channels of a motor


def _grouped(
    table: Table, logs: Mapping[str, Any], kind: _Kind, log: str, asked: Asked
) -> Iterator[ProposedMotor]:
    """The motors whose columns, tags or fields there are; `log` names what none of them does."""
    by_name = {one.name: one for one in table.columns}
    groups, left = groups_of(list(by_name), {name: one.unit for name, one in by_name.items()})
    asked.unused |= dict.fromkeys(left if groups else ())
    for group in groups:
        motor = group.name or log
        chooser = Chooser(group, by_name, table.marks, motor, _plain(motor), asked)
        channels = dict(chooser.places())
        used = {one.name for one in channels.values()}
        asked.unused |= dict.fromkeys(name for name in group.signals if name not in used)
        yield ProposedMotor(group.name, chooser.motor_id, logs, channels, kind.files)


def _plain(name: str) -> str:
    """A name as an id may be."""
    return re.sub(r"[^A-Za-z0-9._-]+", "-", name).strip("-._")[:64] or "motor"


def _apart(motors: Sequence[ProposedMotor]) -> Iterator[ProposedMotor]:
    """The motors, each with an id of its own."""
    taken: set[str] = set()
    for motor in motors:
        others = (f"{motor.motor_id}-{number}" for number in count(2))
        own = next(one for one in chain([motor.motor_id], others) if one not in taken)
        taken.add(own)
        yield replace(motor, motor_id=own)
