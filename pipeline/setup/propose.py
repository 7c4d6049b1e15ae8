"""A fleet proposed from a plant's logs: its motors, their channels, and what has to be asked.

Nothing ambiguous is decided: it is a `Question`, whose answer is taken as it stands.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from itertools import chain, count
from pathlib import Path
from typing import Any

from pipeline.config.logs import Logs
from pipeline.errors import LogError
from pipeline.ingest import time_span
from pipeline.logs.finding import SUFFIXES, logs_below
from pipeline.setup.layouts import Kind, Seen, kinds_of
from pipeline.setup.names import groups_of
from pipeline.setup.questions import Asked, Chooser
from pipeline.setup.signals import columns_without_use, motors_of_rows, signals_of
from pipeline.setup.sniff import sniff
from pipeline.setup.tables import Column, Question, Table

LARGEST_LOG_BYTES = 200 << 20  # of one that is read to look into it
_SHOWN = 12


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
    errors: dict[Path, LogError] = {}

    @cache
    def table_of(path: Path) -> Table | None:
        try:
            return sniff(path)
        except LogError as error:
            errors[path] = error
        return None

    def columns_of(path: Path) -> object:
        table = table_of(path)
        return table and (table.logs["format"], table.times, [one.name for one in table.columns])

    seen = Seen(columns_of, lambda path: _span(path, table_of(path)), asked.ask)
    for kind in kinds_of(files, root, seen):
        table = table_of(kind.files[-1])
        if table is None:
            error = errors[kind.files[-1]]
            faults.append(f"{error.code}: {error.message}")
            unread += 1
            continue
        asked.log = kind.name
        found = _motors(table, kind, asked)
        motors += found
        if not found:
            columns = ", ".join(one.name for one in table.columns[:_SHOWN])
            faults.append(f"no_motor: {kind.patterns[0]}: its columns are no motor's: {columns}")
    if unread == len(faults) > 0 and not motors:
        raise LogError("log_not_readable", source, f"no log of it can be read: {faults[0]}")
    asked.require_known(one.motor_id for one in motors)
    questions, unused = tuple(asked.open.values()), tuple(asked.unused)
    return Proposal(root, tuple(_apart(motors)), questions, unused, tuple(faults))


def _span(path: Path, table: Table | None) -> tuple[int, int] | None:
    """Ends of a log as far as its dialect is known."""
    if table is None:
        return None
    with suppress(LogError, ValueError):
        return time_span(path, Logs.model_validate({**table.logs, "files": (path.name,)}), {})
    return None


# The motors of a table


def _motors(table: Table, kind: Kind, asked: Asked) -> list[ProposedMotor]:
    """The motors of logs that are alike; none where their columns are not enough for one."""
    signals = signals_of(table)
    tag = signals.logs.get("channel_column")
    several = {
        one.name: names for one in table.columns if (names := motors_of_rows(one, table, tag))
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
    if found:
        asked.unused |= dict.fromkeys(columns_without_use(table, signals, list(several)))
    dialect = asked.keys_of(signals) if found or several else {}
    files = {"files": list(kind.patterns)}
    return [replace(one, logs={**dialect, **files, **one.logs}) for one in found]


# The channels of a motor


def _grouped(
    table: Table, logs: Mapping[str, Any], kind: Kind, log: str, asked: Asked
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
