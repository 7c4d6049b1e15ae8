"""A fleet proposed from a plant's logs: its motors, their channels, and what has to be asked.

Names of files tell which are one motor's (`layouts`), the head of a log its dialect and columns
(`sniff`), words and units what a column may be (`names`, `signals`), readings which of several
(`questions`). Nothing ambiguous is decided: it is a `Question`, whose answer is taken as it stands.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import chain, count, islice
from pathlib import Path
from typing import Any

from pipeline.config import Channel
from pipeline.config.logs import Logs
from pipeline.errors import LogError
from pipeline.ingest import time_span
from pipeline.logs.files import NEAR_DAYS, days_off
from pipeline.logs.finding import SUFFIXES, logs_below, suffix_of
from pipeline.setup.layouts import Kind, kinds_of
from pipeline.setup.names import groups_of, is_in, meaning_of, unit_named, words_of
from pipeline.setup.questions import Asked, Chooser
from pipeline.setup.signals import (
    cells_of,
    columns_without_use,
    motors_of_rows,
    signals_of,
    unread_columns,
)
from pipeline.setup.sniff import sniff
from pipeline.setup.tables import Cells, Column, Question, Table, is_number

LARGEST_LOG_BYTES = 200 << 20  # of a log that is read to look into it
_SHOWN, _NAMES_COMPARED = 12, 12
_ROWS_COMPARED, _FEWEST_COMPARED = 100, 10


@dataclass(frozen=True, slots=True)
class ProposedMotor:
    """A motor as its logs tell it."""

    name: str  # in the log; empty where nothing there names it
    motor_id: str
    logs: Mapping[str, Any]  # keys of ``[logs]``; what is asked is there as assumed
    channels: Mapping[str, Column]  # in the config's units; without those that are asked
    files: tuple[Path, ...]


@dataclass(frozen=True, slots=True)
class Proposal:
    """A fleet to look at, with the questions that are open."""

    log_root: Path
    motors: tuple[ProposedMotor, ...]
    questions: tuple[Question, ...]
    unused: tuple[str, ...]  # names of columns and tags that are no channel's
    faults: tuple[str, ...]  # logs that cannot be read
    unneeded: tuple[str, ...] = ()  # answers to what is not asked now


def propose(
    source: Path,
    answers: Mapping[str, str],
    root: Path | None = None,
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> Proposal:
    """Propose a fleet from a log, or a folder of logs; patterns of files are below `root`.

    `progress` is called with how many logs are done, and how many there are.
    Raises LogError if there is no log, or none can be read, and UsageError (``answer``) for an
    answer that cannot be.
    """
    if not source.exists():
        raise LogError("log_missing", source, "there is no such file or folder")
    files = sorted(logs_below(source)) if source.is_dir() else [source.resolve()]
    if not files:
        raise LogError("log_empty", source, _why_no_log(source))
    root = root or (source.resolve() if source.is_dir() else source.resolve().parent)
    table_of = cache(partial(_sniff, time=answers.get("time", "")))
    asked = Asked(answers)
    motors, faults, n_done = list[ProposedMotor](), list[str](), 0
    kinds = kinds_of(
        files,
        root,
        lambda path: _in_common(table_of(path)),
        lambda path: _span(path, table_of(path)),
        asked.ask,
    )
    for kind in _without_copies(kinds, table_of, asked):
        tables = map(table_of, reversed(kind.files))
        table = next((table for table in tables if not _is_empty(table)), table_of(kind.files[-1]))
        n_done += len(kind.files)
        progress(n_done, len(files))
        if isinstance(table, LogError):
            faults.append(f"{table.code}: {table.message}")
            continue
        asked.log = kind.name
        table = _with_zone_of(table, table_of(kind.files[0]))
        proposed = _motors(_dated_by_names(table, kind), kind, asked)
        motors += proposed
        faults += [f"log_type: {kind.patterns[0]}: {fault}" for fault in table.faults]
        if not proposed:
            faults.append(f"no_motor: {kind.patterns[0]}: {_why_no_motor(table)}")
    if faults and all(fault.startswith("log_") for fault in faults) and not motors:
        raise LogError("log_not_readable", source, f"no log of it can be read: {faults[0]}")
    asked.require_known(motor.motor_id for motor in motors)
    questions, unused = tuple(asked.open.values()), tuple(asked.unused)
    unneeded = tuple(asked.unneeded)
    return Proposal(root, tuple(_apart(motors)), questions, unused, tuple(faults), unneeded)


def _sniff(path: Path, time: str) -> Table | LogError:
    """Return a log as it is sniffed, or why it cannot be."""
    try:
        return sniff(path, time)
    except LogError as error:
        return error


def _is_empty(table: Table | LogError) -> bool:
    """Return True for a log that says nothing of its kind, such as that of a day that begins."""
    return isinstance(table, LogError) and table.code in ("log_empty", "log_truncated")


def _with_zone_of(table: Table, first: Table | LogError) -> Table:
    """Return table with the question of the zone, if the first log names none and newest does."""
    if isinstance(first, LogError) or any(asked.key == "time_zone" for asked in table.questions):
        return table
    asked_first = tuple(asked for asked in first.questions if asked.key == "time_zone")
    logs = {**table.logs, "time_zone": "UTC"} if asked_first else table.logs
    return replace(table, logs=logs, questions=(*table.questions, *asked_first))


def _in_common(table: Table | LogError) -> object:
    """Return what logs of a motor have in common; None where a log cannot be read."""
    if isinstance(table, LogError):
        return None
    return table.logs["format"], table.times, [column.name for column in table.columns]


def _without_copies(
    kinds: Sequence[Kind], table_of: Callable[[Path], Table | LogError], asked: Asked
) -> list[Kind]:
    """Return the kinds without those of which the rows are another's, and the name but for a word.

    Which of both is a motor's is asked, also of those of one name in two formats; a name of its own
    is a motor's own.
    """
    first_with, first_named, copies = dict[int, str](), dict[str, str](), set[str]()
    for kind in kinds:
        table, pattern = table_of(kind.files[-1]), kind.patterns[0]
        if isinstance(table, LogError):
            continue
        names = [*table.times, *(column.name for column in table.columns)]
        rows = list(islice(table.rows(names), _ROWS_COMPARED))
        owners = Counter(first_with.setdefault(hash(row), pattern) for row in rows)
        other, n_alike = next(iter(owners.most_common(1)), (pattern, 0))
        # Of motors that stand still all cells may be alike.
        varies = len({row[len(table.times) :] for row in rows}) >= _FEWEST_COMPARED
        is_named_so = _words(other) < _words(pattern) or _words(pattern) < _words(other)
        namesake = first_named.setdefault(pattern.removesuffix(suffix_of(Path(pattern))), pattern)
        is_copy = is_named_so and varies and 2 * n_alike > len(rows)
        if is_copy or namesake != pattern:
            other, what = (other, "rows") if is_copy else (namesake, "name")
            text = f"{other} and {pattern} have the same {what}: which is a motor's?"
            choices = (other, pattern, "both")
            answer = asked.ask(f"motors of {pattern}", text, choices)
            copies |= {choice for choice in choices[:2] if answer in choices[:2]} - {str(answer)}
    return [kind for kind in kinds if kind.patterns[0] not in copies]


def _words(pattern: str) -> set[str]:
    """Return the words of a pattern of logs, such as a folder's or a motor's."""
    return set(re.findall(r"[a-z]+\d*", pattern.rpartition(".")[0].lower()))


def _why_no_log(folder: Path) -> str:
    """Return what is in a folder without a log."""
    names = sorted(path.name for path in folder.rglob("*") if path.is_file())
    there = f"; there is {', '.join(names[:3])}" if names else ""
    packed = any(
        Path(name).suffix in (".zstd", ".zst", ".gz", ".tgz", ".zip", ".bz2", ".xz")
        for name in names
    )
    how = "; name delimited text .csv and Parquet .parquet, and export others as such"
    how = (
        ": unpack it (packed are read .csv.gz and .csv.zst alone)" if packed else how * bool(names)
    )
    return f"there is no log ({', '.join(SUFFIXES)}) in it{there}{how}"


def _why_no_motor(table: Table) -> str:
    """Return why nothing of a log is a motor's."""
    for column in table.columns:
        cell = next(iter(column.filled), "")
        parts = cell.split(maxsplit=1)
        if (
            column.kind == "text"
            and len(parts) == 2
            and is_number(parts[0])
            and unit_named(parts[1])
        ):
            return (
                f"its cells carry units ({column.name}: {cell!r}), which no number has: have it "
                "exported without them, the unit in the header"
            )
    columns = ", ".join(column.name for column in table.columns[:_SHOWN])
    signals = [column for column in table.columns if column.kind == "number"]
    if any(is_in(words_of(column.name), "column", "statistic") for column in table.columns):
        columns += "; minima, maxima and deviations are no readings"
    is_value = [is_in(words_of(own.name), "column", "value") for own in table.columns]
    if columns and (all(is_value) or any(meaning_of(c.name, c.unit).channel for c in signals)):
        columns += '; of channels in files of their own write layout = "file_per_channel" by hand'
    return "; ".join((f"its columns are no motor's: {columns}", *unread_columns(table)[:_SHOWN]))


def _dated_by_names(table: Table, kind: Kind) -> Table:
    """Return the table with the form of its stamps in which these agree with the dates in names."""
    if table.logs.get("time") == "log_time":
        # A recorder that imported a log has its own time beside that of the samples.
        by_sample = replace(table, logs={**table.logs, "time": "publish_time"})
        is_odd = not _agrees(kind.files[-1], table) and _agrees(kind.files[-1], by_sample)
        return by_sample if is_odd else table
    form = str(table.logs.get("time_format", ""))
    question = next((asked for asked in table.questions if asked.key == "time_format"), None)
    day, month = form.find("%d"), form.find("%m")
    if min(day, month) < 0 or (question and not question.choices):
        return table
    swapped = form.replace("%d", "\0").replace("%m", "%d").replace("\0", "%m")
    looked_at = kind.files[:: max(1, len(kind.files) // _NAMES_COMPARED)]
    agree = {
        candidate: sum(
            _agrees(path, replace(table, logs={**table.logs, "time_format": candidate}))
            for path in looked_at
        )
        for candidate in (form, swapped)
    }
    left = tuple(asked for asked in table.questions if asked.key != "time_format")
    if agree[form] == agree[swapped]:
        is_odd = 0 < agree[form] < len(looked_at) and question is None
        text = "its logs are dated by either, as their names say: which is it?"
        odd = Question("time_format", text, (form, swapped))
        return replace(table, questions=(*left, odd)) if is_odd else table
    best = max(agree, key=lambda candidate: agree[candidate])
    return replace(table, logs={**table.logs, "time_format": best}, questions=left)


def _agrees(path: Path, table: Table) -> bool:
    """Return True if the stamps of a log are near a date in its name."""
    span = _span(path, table)
    off = None if span is None else days_off("/".join(path.parts[-4:]), *span)
    return off is not None and off <= NEAR_DAYS


def _span(path: Path, table: Table | LogError) -> tuple[int, int] | None:
    """Return ends of a log as far as its dialect is known."""
    if isinstance(table, LogError) or not table.columns:
        return None
    with suppress(LogError, ValueError):
        logs = Logs.model_validate({**table.logs, "files": (path.name,)})
        # Of a message's own time, a single topic will do.
        keys = {"unit": "rpm", **table.columns[0].keys} if logs.format == "mcap" else {}
        channels: Any = {"speed": Channel.model_validate(keys)} if keys else {}
        return time_span(path, logs, channels)
    return None


# The motors of a table


def _motors(table: Table, kind: Kind, asked: Asked) -> list[ProposedMotor]:
    """Return the motors of logs that are alike; none where their columns are not enough for any."""
    signals = signals_of(table)
    tag = signals.logs.get("channel_column")
    several = {
        candidate.name: names
        for candidate in table.columns
        if (names := motors_of_rows(candidate, table, tag))
    }
    column = next(iter(several), None)
    if len(several) > 1:
        text = f"{kind.name}: rows of several motors: which column has the motor's name?"
        column = asked.ask(f"{kind.name}.motor_column", text, several)
    rows: list[tuple[str, dict[str, Any]]] = [(kind.name, {})]
    if several:
        names = several.get(column or "", ())
        readings = _of_readings(names)
        rows = [
            (name if readings == names else kind.name, {"motor_rows": [column, name]})
            for name in readings
        ]
    signals = replace(signals, left_out=unread_columns(table))
    motors = [motor for name, own in rows for motor in _group(signals, own, kind, name, asked)]
    if motors:
        unused = columns_without_use(table, signals, list(several))
        asked.unused |= dict.fromkeys((*unused, *table.other_times))
    dialect = asked.keys_of(signals) if motors or several else {}
    files = {"files": list(kind.patterns)}
    return [replace(motor, logs={**dialect, **files, **motor.logs}) for motor in motors]


def _of_readings(names: Cells) -> Cells:
    """Return of names of statistics, such as "avg" and "max", that of readings; others as given."""
    words = {name: words_of(name) for name in names}
    if not all(own == ("raw",) or is_in(own, "column", "statistic") for own in words.values()):
        return names
    means = [name for name in names if not is_in(words[name], "other", "none")]
    return tuple(sorted(means, key=lambda name: words[name] != ("raw",)))[:1]


# The channels of a motor


def _group(
    table: Table, logs: Mapping[str, Any], kind: Kind, log: str, asked: Asked
) -> Iterator[ProposedMotor]:
    """Yield motors whose columns, tags or fields there are; `log` names what none of them does."""
    by_name = {column.name: column for column in table.columns}
    further = cells_of(table)
    groups, left = groups_of(list(by_name), {name: column.unit for name, column in by_name.items()})
    asked.unused |= dict.fromkeys(left if groups else ())
    for group in groups:
        motor = group.name or log
        shared = left if group.name else ()
        motor_id = _plain(motor)
        chooser = Chooser(
            *(group, by_name, table.marks, motor, motor_id, asked, further, shared, table.left_out)
        )
        channels = dict(chooser.places())
        used = {channel.name for channel in channels.values()}
        asked.unused |= dict.fromkeys(name for name in group.signals if name not in used)
        yield ProposedMotor(group.name, chooser.motor_id, logs, channels, kind.files)


def _plain(name: str) -> str:
    """Return a name as an id may be."""
    return re.sub(r"[^A-Za-z0-9._-]+", "-", name).strip("-._")[:64] or "motor"


def _apart(motors: Sequence[ProposedMotor]) -> Iterator[ProposedMotor]:
    """Yield the motors, each with an id of its own."""
    taken: set[str] = set()
    for motor in motors:
        others = (f"{motor.motor_id}-{number}" for number in count(2))
        own = next(
            motor_id for motor_id in chain([motor.motor_id], others) if motor_id not in taken
        )
        taken.add(own)
        yield replace(motor, motor_id=own)
