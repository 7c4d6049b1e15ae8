"""The outbox: rows of `alarms` that wait for each receiver, and the keys of those queued so far.

Rows come from the published table alone, and each is known by its key and its content: a run may be
broken off anywhere, and a row that is made anew is delivered again only if it has changed. A failed
delivery waits, unchanged, for the next run; of one that was taken only the keys of its rows stay.
Rows of `looks` are a topic of their own: a look never waits for a run.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import json
import logging
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.errors import StoreError
from pipeline.messages import counted
from pipeline.schema import ALARM_CONTENT, ALARMS, LOOKS, Table
from pipeline.store.state import State, read_state_file
from pipeline.store.tables import read_table
from pipeline.telling.delivery import Receiver

log = logging.getLogger(__name__)

# Rows of one delivery at most.
MOST_CHANGES = 500
# Kind of a delivery with the state of every motor.
SUMMARY = "summary"

Change = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Told:
    """Rows of a table that receivers are told: a topic of the outbox, by the table's name."""

    table: Table
    said: tuple[str, ...]  # columns with a row's content; others are its key or follow from it
    states: frozenset[str] = frozenset()  # states into or out of which a row is told; empty: all

    @property
    def topic(self) -> str:
        """Name of the topic."""
        return self.table.name

    def tells(self, row: Mapping[str, Any]) -> bool:
        """True for a row that is told."""
        return not self.states or not self.states.isdisjoint((row["from_state"], row["to_state"]))


TOLD_ALARMS = Told(ALARMS, ALARM_CONTENT)
TOLD_LOOKS = Told(LOOKS, ("from_state", "to_state", "reason", "verdict"), frozenset({"look_now"}))


@dataclass(frozen=True, slots=True)
class Waiting:
    """A delivery that waits: its id, since when (UTC), its rows, and its kind if not changes."""

    id: str
    since: dt.datetime
    changes: Sequence[Change]
    kind: str = ""


@dataclass(frozen=True, slots=True)
class Backlog:
    """Undelivered rows of a receiver; `since` and `fault` are None without any."""

    receiver: str
    told_since: dt.datetime
    undelivered: int
    since: dt.datetime | None
    fault: str | None

    @property
    def words(self) -> str:
        """The undelivered rows in words."""
        why = f"; last try: {self.fault}" if self.fault else ""
        return (
            f"not delivered to {self.receiver}: {counted(self.undelivered, 'change')} of state, "
            f"since {self.since:%Y-%m-%d %H:%M} UTC{why}; the next run tries again"
        )


def open_outbox(state: State, names: Sequence[str], fleet: str, told: Told = TOLD_ALARMS) -> None:
    """Give the receivers of a config their queues, before a run publishes anything.

    Rows that the run before has published and not taken up go to the receivers of that time. A new
    receiver gets none of them; the queue of one that the config names no more is dropped.

    Raises StoreError if the outbox cannot be read or written.
    """
    before = _receivers(state, told)
    if not names and not before:
        return
    with state.transaction():
        _take_up(state, before, fleet, told)
        for name in sorted(set(before) - set(names)):
            if n := sum(len(one.changes) for one in waiting(state, name, told)):
                words = "alarms: there is no %s any more; not delivered: %s"
                log.warning(words, name, counted(n, "change"))
            where = "WHERE topic = ? AND receiver = ?"
            state.write(f"DELETE FROM queues {where}", told.topic, name)
        ((n,),) = state.rows("SELECT count(*) FROM queued WHERE topic = ?", told.topic)
        for name in sorted(set(names) - set(before)):
            if n:
                log.warning(
                    "alarms: the %s is told from now on; the %d rows of `%s` so far are not sent",
                    name,
                    n,
                    told.topic,
                )
            state.write(
                "INSERT INTO queues (topic, receiver, told_since) VALUES (?, ?, ?)",
                told.topic,
                name,
                dt.datetime.now(dt.UTC).isoformat(),
            )


def take_up(state: State, fleet: str, told: Told = TOLD_ALARMS) -> None:
    """Put new rows into all queues.

    Raises StoreError if the outbox cannot be read or written.
    """
    receivers = _receivers(state, told)
    if receivers:
        with state.transaction():
            _take_up(state, receivers, fleet, told)


def _receivers(state: State, told: Told) -> list[str]:
    rows = state.rows("SELECT receiver FROM queues WHERE topic = ? ORDER BY receiver", told.topic)
    return [name for (name,) in rows]


def waiting(state: State, name: str, told: Told = TOLD_ALARMS) -> list[Waiting]:
    """Deliveries that a receiver has not taken, in order.

    Raises StoreError if the outbox cannot be read.
    """
    rows = state.rows(
        "SELECT id, since, changes, kind FROM outbox WHERE topic = ? AND receiver = ?"
        " ORDER BY place",
        told.topic,
        name,
    )
    return [
        Waiting(key, dt.datetime.fromisoformat(since), json.loads(changes), kind)
        for key, since, changes, kind in rows
    ]


def _queue(state: State, name: str, told: Told, one: Waiting) -> None:
    state.write(
        "INSERT INTO outbox (topic, receiver, id, since, kind, changes) VALUES (?, ?, ?, ?, ?, ?)",
        *(told.topic, name, one.id, one.since.isoformat(), one.kind, json.dumps(one.changes)),
    )


def was_taken(state: State, name: str, one: Waiting, told: Told = TOLD_ALARMS) -> None:
    """A receiver has taken a delivery: its rows are known by their keys alone."""
    with state.transaction():
        where, values = "WHERE topic = ? AND receiver = ?", (told.topic, name)
        state.write(f"DELETE FROM outbox {where} AND id = ?", *values, one.id)
        if not state.rows(f"SELECT 1 FROM outbox {where} LIMIT 1", *values):
            state.write(f"UPDATE queues SET fault = '' {where}", *values)


def was_refused(
    state: State, name: str, one: Waiting, fault: str, told: Told = TOLD_ALARMS
) -> None:
    """A receiver has not taken a delivery, which goes to the end of its queue."""
    with state.transaction():
        where, values = "WHERE topic = ? AND receiver = ?", (told.topic, name)
        last = "(SELECT max(place) + 1 FROM outbox)"
        state.write(f"UPDATE outbox SET place = {last} {where} AND id = ?", *values, one.id)
        state.write(f"UPDATE queues SET fault = ? {where}", fault, *values)


def add_summary(
    state: State, name: str, fleet: str, due: dt.date, rows: Callable[[], Iterable[Change]]
) -> None:
    """Queue a summary for a receiver, once for each date that it is due on.

    Raises StoreError if the outbox, or what the rows are made from, cannot be read or written.
    """
    where, values = "WHERE topic = ? AND receiver = ?", (TOLD_ALARMS.topic, name)
    last = state.rows(f"SELECT summarised FROM queues {where}", *values)
    if not last or last[0][0] >= due.isoformat():
        return
    key = f"msg_{_digest([fleet, name, SUMMARY, due.isoformat()])}"
    summary = Waiting(key, dt.datetime.now(dt.UTC), list(rows()), SUMMARY)
    with state.transaction():
        _queue(state, name, TOLD_ALARMS, summary)
        state.write(f"UPDATE queues SET summarised = ? {where}", due.isoformat(), *values)


def _take_up(state: State, receivers: Sequence[str], fleet: str, told: Told) -> None:
    """Queue the new rows of the files that were published since, in a transaction."""
    taken = dict(state.rows("SELECT name, sha256 FROM taken_up WHERE topic = ?", told.topic))
    changes: list[Change] = []
    for name, sha256 in state.rows(
        "SELECT name, sha256 FROM files WHERE name LIKE ? AND sha256 != '' ORDER BY name",
        f"{told.table.name}/%",
    ):
        if taken.get(name) == sha256:
            continue
        try:
            rows = read_table(state.output / "tables" / name, told.table).to_dicts()
        except StoreError as error:
            log.warning("alarms: %s; its rows wait until it is whole", error)
            continue
        changes += _new_among(state, filter(told.tells, rows), told)
        state.write("INSERT OR REPLACE INTO taken_up VALUES (?, ?, ?)", told.topic, name, sha256)
    now = dt.datetime.now(dt.UTC)
    for name in receivers:
        for one in _deliveries(fleet, name, now, changes):
            _queue(state, name, told, one)


def _new_among(state: State, rows: Iterable[Mapping[str, Any]], told: Told) -> Iterator[Change]:
    """Rows that say something that was not queued before; from now on they are known."""
    for row in rows:
        key = _digest([str(row[name]) for name in told.table.key])
        said = _digest([row[name] for name in told.said])
        where = "WHERE topic = ? AND key = ?"
        known = state.rows(f"SELECT said, times FROM queued {where}", told.topic, key)
        if known and known[0][0] == said:
            continue
        # Counted: a row that changes back is delivered again.
        times = known[0][1] + 1 if known else 0
        state.write(
            "INSERT OR REPLACE INTO queued VALUES (?, ?, ?, ?)", told.topic, key, said, times
        )
        if not row.get("is_silent"):
            what = "rules" if row.get("rules") else "changed" if known else "new"
            yield {"id": f"{key}-{said}-{times}", "change": what, **_plain(row)}


def _digest(parts: object) -> str:
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:16]


def _plain(row: Mapping[str, Any]) -> Change:
    """A row with values of JSON."""
    return {
        name: value if value is None or isinstance(value, int | str) else _plain_value(value)
        for name, value in row.items()
    }


def _plain_value(value: object) -> float | str | None:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return str(value)


def _deliveries(
    fleet: str, name: str, since: dt.datetime, changes: Sequence[Change]
) -> Iterator[Waiting]:
    by_rules = [one for one in changes if one["change"] == "rules"]
    others = [one for one in changes if one["change"] != "rules"]
    for kind in (by_rules, others):
        for first in range(0, len(kind), MOST_CHANGES):
            some = tuple(kind[first : first + MOST_CHANGES])
            parts = [fleet, name, *(one["id"] for one in some)]
            yield Waiting(f"msg_{_digest(parts)}", since, some)


def backlogs(output: Path, receivers: Sequence[Receiver]) -> tuple[Backlog, ...]:
    """Undelivered rows of each receiver.

    Raises StoreError if the outbox cannot be read.
    """
    if not receivers:
        return ()
    found = []
    with read_state_file(output) as state:
        rows = state.rows(
            "SELECT receiver, told_since, fault FROM queues WHERE topic = ?", TOLD_ALARMS.topic
        )
        queues = {name: more for name, *more in rows}
        for receiver in receivers:
            if receiver.name in queues:
                told_since, fault = queues[receiver.name]
                left = waiting(state, receiver.name)
                found.append(
                    Backlog(
                        receiver.label,
                        dt.datetime.fromisoformat(told_since),
                        sum(len(one.changes) for one in left),
                        min((one.since for one in left), default=None),
                        fault or None,
                    )
                )
    return tuple(found)
