"""Record of processed logs of a motor: the files that were read, and the outcome of each night.

It stands in the state file. A task gets its motor's record of processed logs with it, and returns
what has changed. It only saves work: without it all logs are read again and give the same tables.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import json
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import combinations
from operator import methodcaller
from pathlib import Path
from typing import Any, TypeVar

import polars as pl

from pipeline.clock import IN_FUTURE
from pipeline.config import Fleet, MotorSpec
from pipeline.config.hashes import DRAIN_DELAY, ROLLER
from pipeline.messages import counted
from pipeline.schema import NIGHTS, OK, TIMESTAMP
from pipeline.store.state import StateDatabase, read_state_file
from pipeline.workers.process import still_alive

Key = TypeVar("Key")
Value = TypeVar("Value")

# Note on a published night whose logs are archived.
GONE = "its logs are gone"
# Values of a stored row that are times, from their text.
OF_TIME: Mapping[Any, Callable[[str], dt.date]] = {
    pl.Date: dt.date.fromisoformat,
    TIMESTAMP: dt.datetime.fromisoformat,
}
_FIGURES = re.compile(r"\d[\d:]*")
# Read at a time for the hash of a file.
PIECE_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class FileRecord:
    """Record of a log file."""

    path: str
    size: int
    modified_ns: int
    sha256: str | None  # hash of the content; None where it could not be read
    read_with: str = ""  # hash of the settings of reading: dialect, channels, nights
    rows: int | None = None
    # first_us, last_us: first and last sample, UTC microseconds; None where unknown.
    first_us: int | None = None
    last_us: int | None = None
    # Labels of the nights in which it has samples, or which fail with it.
    nights: tuple[str, ...] = ()
    # status, error_code, message: ``ok``, ``failed``, or ``growing`` for a log that is changed
    # while it is read, and the reason; of an ``ok`` file the rows left out.
    status: str = "ok"
    error_code: str | None = None
    message: str | None = None
    # inode: of an object its tag as a number. changed_ns: time of a file's last change, also of its
    # name, which differs if another has taken its name and time; 0 of an object.
    inode: int = 0
    changed_ns: int = 0

    @property
    def state(self) -> tuple[int, int, int, int]:
        """Size, times and tag; while they stay, the content counts as unchanged."""
        return self.size, self.modified_ns, self.inode, self.changed_ns

    @property
    def is_ahead(self) -> bool:
        """True where stamps were refused as they lay in the future: they may have come by now."""
        return IN_FUTURE in (self.message or "")

    def is_as(self, before: FileRecord | None) -> bool:
        """Return True if a former record of the same state is of a log that could be read."""
        if before is None or before.is_ahead:
            return False
        return bool(before.sha256) and before.state == self.state


@dataclass(frozen=True, slots=True)
class NightRecord:
    """Outcome of a night."""

    status: str  # an outcome of the five
    # statistics_hash, figures_hash: hashes of the settings of its statistics, and of the figures
    # made from them; empty without any.
    statistics_hash: str = ""
    figures_hash: str = ""
    # Whether it identifies the scale of the rollers' curve; None without a fit, or such a curve.
    roller_identified: bool | None = None
    logs: tuple[str, ...] = ()  # hashes of the contents that it was made from, cut short
    # stays: why it stays as published although its logs or settings are others; empty otherwise.
    stays: str = ""
    refused: str = ""  # hashes of settings for which it could not be made anew
    # Columns of `nights` that the night itself fills, until they are published with its trends.
    row: Mapping[str, Any] | None = None


@dataclass(frozen=True, slots=True)
class ProcessedLogs:
    """Files and nights of a motor, and the settings of its last run."""

    # By path relative to the log root.
    files: Mapping[str, FileRecord] = field(default_factory=dict)
    nights: Mapping[dt.date, NightRecord] = field(default_factory=dict)  # by label
    # settings: as `settings_of`, with what was decided on the scale of the rollers; None before the
    # first run.
    settings: Mapping[str, Any] | None = None


@dataclass(frozen=True, slots=True)
class ProcessedChange:
    """What a run changes in a motor's record of processed logs; None for what goes."""

    files: Mapping[str, FileRecord | None] = field(default_factory=dict)
    nights: Mapping[dt.date, NightRecord | None] = field(default_factory=dict)
    settings: Mapping[str, Any] | None = None  # None where they stay

    @classmethod
    def between(cls, before: ProcessedLogs, after: ProcessedLogs) -> ProcessedChange:
        """Return the change between two records of processed logs."""
        return cls(
            _changed(before.files, after.files),
            _changed(before.nights, after.nights),
            None if after.settings == before.settings else after.settings,
        )


def _changed(before: Mapping[Key, Value], after: Mapping[Key, Value]) -> dict[Key, Value | None]:
    changed: dict[Key, Value | None] = {
        key: value for key, value in after.items() if before.get(key) != value
    }
    return changed | dict.fromkeys(before.keys() - after.keys())


_LOG_COLUMNS = tuple(field.name for field in fields(FileRecord))
_NIGHT_COLUMNS = ("night", *(field.name for field in fields(NightRecord)))


def read_processed(state: StateDatabase, motor_id: str) -> ProcessedLogs:
    """Return a motor's record of processed logs."""
    settings = state.rows("SELECT settings FROM motors WHERE motor_id = ?", motor_id)
    if not settings:
        return ProcessedLogs()
    files, nights = dict[str, FileRecord](), dict[dt.date, NightRecord]()
    for row in _rows(state, "logs", _LOG_COLUMNS, motor_id):
        files[row["path"]] = FileRecord(**row | {"nights": tuple(row["nights"].split())})
    for row in _rows(state, "nights", _NIGHT_COLUMNS, motor_id):
        label, identified = dt.date.fromisoformat(row.pop("night")), row["roller_identified"]
        row["logs"] = tuple(row["logs"].split())
        row["roller_identified"] = None if identified is None else identified == 1
        row["row"] = row["row"] and _row_of(motor_id, label, row["row"])
        nights[label] = NightRecord(**row)
    return ProcessedLogs(files, nights, json.loads(settings[0][0]))


def _rows(
    state: StateDatabase, table: str, columns: Sequence[str], motor_id: str
) -> Iterator[dict[str, Any]]:
    query = f"SELECT {', '.join(columns)} FROM {table} WHERE motor_id = ?"
    for row in state.rows(query, motor_id):
        yield dict(zip(columns, row, strict=True))


def write_change(state: StateDatabase, motor_id: str, change: ProcessedChange) -> None:
    """Change a motor's record of processed logs; raises StoreError."""
    if change == ProcessedChange():
        return
    with state.transaction():
        state.write("INSERT OR IGNORE INTO motors VALUES (?, '{}')", motor_id)
        if change.settings is not None:
            text = json.dumps(change.settings, sort_keys=True)
            state.write("UPDATE motors SET settings = ? WHERE motor_id = ?", text, motor_id)
        for table, columns, changed in (
            ("logs", _LOG_COLUMNS, change.files),
            ("nights", _NIGHT_COLUMNS, change.nights),
        ):
            gone = [(motor_id, str(name)) for name, record in changed.items() if record is None]
            state.write_all(f"DELETE FROM {table} WHERE (motor_id, {columns[0]}) = (?, ?)", gone)
            places = ", ".join("?" * (1 + len(columns)))
            insert = f"INSERT OR REPLACE INTO {table} (motor_id, {', '.join(columns)})"
            present = {str(name): record for name, record in changed.items() if record is not None}
            rows = (
                (motor_id, key, *(_as_stored(getattr(record, name)) for name in columns[1:]))
                for key, record in present.items()
            )
            state.write_all(f"{insert} VALUES ({places})", rows)


def _as_stored(value: Any) -> Any:
    """Return a value of a record as its column has it."""
    if isinstance(value, Mapping):
        return json.dumps(value, default=methodcaller("isoformat"))
    return " ".join(value) if isinstance(value, tuple) else value


def _row_of(motor_id: str, night: dt.date, text: str) -> dict[str, Any]:
    """Return a night's own columns of `nights`, as they were before they were stored."""
    row: dict[str, Any] = json.loads(text) | {"motor_id": motor_id, "night": str(night)}
    for name, value in row.items():
        if value is not None and NIGHTS.schema[name] in OF_TIME:
            row[name] = OF_TIME[NIGHTS.schema[name]](value)
    return row


def unpublished_rows(state: StateDatabase, motor_id: str) -> dict[dt.date, dict[str, Any]]:
    """Return rows of a motor's nights, as far as these fill them, whose trends are to come."""
    rows = state.rows(
        "SELECT night, row FROM nights WHERE motor_id = ? AND row IS NOT NULL", motor_id
    )
    labels = ((dt.date.fromisoformat(label), text) for label, text in rows)
    return {label: _row_of(motor_id, label, text) for label, text in labels}


def note_published(state: StateDatabase, motor_id: str, last: dt.date) -> None:
    """Note that a motor's nights up to the last are in `nights`; raises StoreError."""
    change = "UPDATE nights SET row = NULL WHERE motor_id = ? AND night <= ? AND row IS NOT NULL"
    state.write(change, motor_id, str(last))


def as_published(spec: MotorSpec, settings: Mapping[str, Any] | None) -> MotorSpec:
    """Return a motor as its nights decided, by what its last run left beside its settings."""
    known = settings or {}
    is_free = bool(known.get(ROLLER, {}).get("is_free"))
    return spec.decided(known.get(DRAIN_DELAY), roller_is_free=is_free)


def paired_as_published(fleet: Fleet, output: Path) -> Fleet:
    """Return a fleet whose drain flows are paired as those that an output has."""
    with read_state_file(output) as state:
        settings = read_settings(state)
    motors = (as_published(spec, settings.get(spec.motor_id)).stated for spec in fleet.motors)
    return replace(fleet, motors=tuple(motors))


def read_settings(state: StateDatabase) -> dict[str, dict[str, Any]]:
    """Return settings of each motor's last run, by motor."""
    return {
        motor_id: json.loads(text)
        for motor_id, text in state.rows("SELECT motor_id, settings FROM motors")
    }


def read_stays(
    state: StateDatabase, motor_ids: Collection[str]
) -> tuple[dict[str, dict[dt.date, str]], Counter[str]]:
    """Return why nights stay as published, by motor; and how many others have no log any more."""
    waiting: dict[str, dict[dt.date, str]] = {motor_id: {} for motor_id in motor_ids}
    gone = Counter[str]()
    rows = state.rows("SELECT motor_id, night, stays FROM nights WHERE stays != '' ORDER BY night")
    for motor_id, night, why in rows:
        if why == GONE:
            gone[motor_id] += 1
        else:
            waiting.setdefault(motor_id, {})[dt.date.fromisoformat(night)] = why
    return waiting, gone


def stay_lines(stays: Mapping[dt.date, str]) -> Iterator[str]:
    """Yield nights that stay as published, in a line a reason; of figures those of the first."""
    reasons: dict[str, dict[dt.date, str]] = {}
    for label, why in stays.items():
        reasons.setdefault(_FIGURES.sub("", why), {})[label] = why
    for whys in reasons.values():
        first = min(whys)
        span = f"{first}" if len(whys) == 1 else f"{first} to {max(whys)}"
        such_as = f" ({first})" if len({*whys.values()}) > 1 else ""
        yield f"as published {counted(len(whys), 'night')}, {span}: {whys[first]}{such_as}"


def same_logs(state: StateDatabase) -> Iterator[str]:
    """Yield motors whose fitted nights are read alike from the same contents: one has another's."""
    readers = state.rows(
        "SELECT group_concat(DISTINCT motor_id) FROM logs GROUP BY sha256, read_with"
        " HAVING count(DISTINCT motor_id) > 1"
    )
    pairs = {pair for (ids,) in readers for pair in combinations(sorted(ids.split(",")), 2)}
    for first, second in sorted(pairs):
        # A log of one channel, such as a tank's thermometer, may be of several motors.
        ((n, begin, end),) = state.rows(
            "SELECT count(*), min(night), max(night) FROM nights a JOIN nights b USING (night)"
            " WHERE (a.motor_id, b.motor_id) = (?1, ?2) AND a.status = ?3 AND b.status = ?3"
            " AND a.logs != '' AND b.logs != ''"
            " AND (instr(a.logs, b.logs) OR instr(b.logs, a.logs))",
            *(first, second, OK),
        )
        if n:
            yield (
                f"{first} and {second}: {counted(n, 'night')}, {begin} to {end}, were made from "
                "the same logs: put each motor's own into place, or correct logs.files"
            )


def forget_nights(
    state: StateDatabase, nights: Collection[dt.date], refit: Collection[dt.date] = ()
) -> dict[str, set[dt.date]]:
    """Let the next run make nights anew whose tables were lost.

    Nights with a fit are kept: their log may be gone. Those of `refit` may be fitted from their
    statistics. Returns, by motor, those of the nights with a fit.

    Raises StoreError if the state cannot be written.
    """
    fitted: dict[str, set[dt.date]] = {}
    motor_ids = [motor_id for (motor_id,) in state.rows("SELECT motor_id FROM motors")]
    with state.transaction():
        for night in nights:
            label = night.isoformat()
            for motor_id in motor_ids:
                where, values = "WHERE (motor_id, night) = (?, ?)", (motor_id, label)
                state.write(
                    "DELETE FROM logs WHERE motor_id = ? AND nights LIKE ?", motor_id, f"%{label}%"
                )
                state.write(f"DELETE FROM nights {where} AND status != ?", *values, OK)
                if state.rows(f"SELECT 1 FROM nights {where}", *values):
                    fitted.setdefault(motor_id, set()).add(night)
                if night in refit:
                    state.write(f"UPDATE nights SET figures_hash = '' {where}", *values)
    return fitted


def content_hash(path: Path) -> str:
    """Return SHA-256 of a file's content.

    Raises OSError if the file cannot be read.
    """
    digest, piece = hashlib.sha256(), bytearray(PIECE_BYTES)
    with path.open("rb", buffering=0) as stream:
        while size := stream.readinto(piece):
            digest.update(memoryview(piece)[:size])
            still_alive()
    return digest.hexdigest()
