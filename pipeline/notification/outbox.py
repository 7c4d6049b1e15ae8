"""The outbox: changes of state that wait for each receiver, and their delivery.

Rows come from the published tables alone, and each is known by its key and its content: a run may
be broken off anywhere, and a row that is made anew is delivered again only if it has changed. A
failed delivery waits, unchanged, for the next run; of one that was taken only the keys of its rows
stay. Rows of `intraday` are a topic of their own: an intraday check never waits for a run.

All raise StoreError if the state file cannot be read or written.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import json
import logging
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.clock import now
from pipeline.errors import StoreError
from pipeline.messages import counted
from pipeline.notification.delivery import SUMMARY, Delivery, Receiver, UndeliveredError
from pipeline.schema import ALARM_CONTENT, ALARMS, INTRADAY, Table
from pipeline.store.state import State, read_state_file
from pipeline.store.tables import read_table

log = logging.getLogger(__name__)

# Rows of one delivery at most.
MOST_CHANGES = 500
# Waits before a delivery is tried again in the same run [s].
PAUSES_S = (1.0, 4.0)
# After so many failed deliveries the rest waits for the next run.
MOST_FAILURES = 2
OF_RECEIVER = "WHERE topic = ? AND receiver = ?"
NOT_TAKEN_UP = (
    "SELECT files.name, files.sha256 FROM files LEFT JOIN taken_up"
    " ON files.name = taken_up.name AND topic = ? WHERE files.name LIKE ?"
    " AND files.sha256 NOT IN ('', coalesce(taken_up.sha256, '')) ORDER BY files.name"
)

Row = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Told:
    """Rows of a table that receivers are told: a topic of the outbox, by the table's name."""

    table: Table
    said: tuple[str, ...]  # columns with a row's content; others are its key or follow from it
    tells: Callable[[Row], bool]  # true for a row that is told


def is_notified(row: Row) -> bool:
    """False for a baseline that begins or is taken, unless that ends what was told before."""
    return not {row["from_state"], row["to_state"]} <= {"insufficient", "ok"}


TOLD_ALARMS = Told(ALARMS, ALARM_CONTENT, is_notified)
TOLD_INTRADAY = Told(INTRADAY, ("from_state", "to_state", "reason"), lambda _: True)


@dataclass(frozen=True, slots=True)
class Waiting:
    """A delivery that waits: its id, its rows, and its kind if not changes."""

    id: str
    changes: Sequence[Row]
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
    """
    with state.transaction():
        take_up(state, fleet, told)
        before = _receivers(state, told)
        for name in before - set(names):
            if n := sum(len(one.changes) for one in waiting(state, name, told)):
                words = "alarms: there is no %s any more; not delivered: %s"
                log.warning(words, name, counted(n, "change"))
            state.write(f"DELETE FROM queues {OF_RECEIVER}", told.table.name, name)
        for name in set(names) - before:
            state.write(
                "INSERT INTO queues (topic, receiver, told_since) VALUES (?, ?, ?)",
                *(told.table.name, name, now().isoformat()),
            )


def take_up(
    state: State, fleet: str, told: Told = TOLD_ALARMS, silent: Collection[str] = ()
) -> None:
    """Put the new rows of the files that were published since into all queues.

    Rows with `silent` ids are known from now on, and nobody is told them.
    """
    with state.transaction():
        changes: list[Row] = []
        for name, sha256 in state.rows(NOT_TAKEN_UP, told.table.name, f"{told.table.name}/%"):
            try:
                rows = read_table(state.output / "tables" / name, told.table)
            except StoreError as error:
                log.warning("alarms: %s; its rows wait until it is whole", error)
                continue
            # JSON has no NaN.
            changes += _new_among(state, rows.fill_nan(None).to_dicts(), told, silent)
            done = "INSERT OR REPLACE INTO taken_up VALUES (?, ?, ?)"
            state.write(done, told.table.name, name, sha256)
        for receiver in _receivers(state, told):
            for first in range(0, len(changes), MOST_CHANGES):
                some = changes[first : first + MOST_CHANGES]
                key = _digest([fleet, receiver, *(one["change_id"] for one in some)])
                _queue(state, receiver, told, Waiting(f"msg_{key}", some))


def add_summary(
    state: State, name: str, fleet: str, due: dt.date, rows: Callable[[], Iterable[Row]]
) -> None:
    """Queue a summary for a receiver, once for each date that it is due on."""
    mine = ALARMS.name, name
    last = state.rows(f"SELECT summarised FROM queues {OF_RECEIVER}", *mine)
    if not last or last[0][0] >= due.isoformat():
        return
    key = _digest([fleet, name, SUMMARY, due.isoformat()])
    summary = Waiting(f"msg_{key}", list(rows()), SUMMARY)
    with state.transaction():
        _queue(state, name, TOLD_ALARMS, summary)
        state.write(f"UPDATE queues SET summarised = ? {OF_RECEIVER}", due.isoformat(), *mine)


def waiting(state: State, name: str, told: Told = TOLD_ALARMS) -> list[Waiting]:
    """Deliveries that a receiver has not taken, in order."""
    query = f"SELECT id, changes, kind FROM outbox {OF_RECEIVER} ORDER BY place"
    rows = state.rows(query, told.table.name, name)
    return [Waiting(key, json.loads(changes), kind) for key, changes, kind in rows]


def deliver(
    state: State, receivers: Sequence[Receiver], fleet: str, told: Told = TOLD_ALARMS
) -> tuple[str, ...]:
    """Deliver what waits in the outbox, where each delivery is noted at once; faults, as text.

    A dead receiver costs a run little, and a delivery that one never takes does not hold up others.
    After a StoreError deliveries may be repeated.
    """
    faults = []
    for receiver in receivers:
        fault, failures = "", 0
        for one in waiting(state, receiver.name, told):
            try:
                _hand_over(receiver, one, fleet, told, () if failures else PAUSES_S)
            except UndeliveredError as error:
                fault, failures = error.why, failures + 1
                _note(state, receiver.name, one, fault, told)
                if error.hung or failures == MOST_FAILURES:
                    break
            else:
                _note(state, receiver.name, one, "", told)
        if fault:
            faults.append(f"{receiver.label}: {fault}; the next run tries again")
    return tuple(faults)


def backlogs(output: Path, receivers: Sequence[Receiver]) -> tuple[Backlog, ...]:
    """Undelivered rows of each receiver."""
    if not receivers:
        return ()
    query = (
        "SELECT told_since, fault, coalesce(sum(json_array_length(changes)), 0), min(since)"
        f" FROM queues LEFT JOIN outbox USING (topic, receiver) {OF_RECEIVER} GROUP BY receiver"
    )
    moment = dt.datetime.fromisoformat
    with read_state_file(output) as state:
        return tuple(
            Backlog(one.label, moment(told_since), n, since and moment(since), fault or None)
            for one in receivers
            for told_since, fault, n, since in state.rows(query, ALARMS.name, one.name)
        )


def _receivers(state: State, told: Told) -> set[str]:
    rows = state.rows("SELECT receiver FROM queues WHERE topic = ?", told.table.name)
    return {name for (name,) in rows}


def _queue(state: State, name: str, told: Told, one: Waiting) -> None:
    insert = "INSERT INTO outbox (topic, receiver, id, since, kind, changes)"
    values = told.table.name, name, one.id, now().isoformat(), one.kind
    changes = json.dumps(one.changes, default=str)
    state.write(f"{insert} VALUES (?, ?, ?, ?, ?, ?)", *values, changes)


def _hand_over(
    receiver: Receiver, one: Waiting, fleet: str, told: Told, pauses: Sequence[float]
) -> None:
    """Have a receiver take a delivery, and try again after each pause; raises UndeliveredError."""
    kind = one.kind or told.table.name
    document = {"id": one.id, "type": kind, "fleet": fleet, "changes": one.changes}
    delivery = Delivery(one.id, json.dumps(document, sort_keys=True).encode())
    for seconds in pauses:
        try:
            return receiver.take(delivery)
        except UndeliveredError as error:
            if error.hung:
                raise
        time.sleep(seconds)
    return receiver.take(delivery)


def _note(state: State, name: str, one: Waiting, fault: str, told: Told) -> None:
    """A receiver has taken a delivery, or not: then it goes to the end of its queue."""
    mine = told.table.name, name
    last = "UPDATE outbox SET place = (SELECT max(place) + 1 FROM outbox)"
    change = last if fault else "DELETE FROM outbox"
    with state.transaction():
        state.write(f"{change} {OF_RECEIVER} AND id = ?", *mine, one.id)
        state.write(f"UPDATE queues SET fault = ? {OF_RECEIVER}", fault, *mine)


def _new_among(
    state: State, rows: Iterable[Row], told: Told, silent: Collection[str]
) -> Iterator[Row]:
    """Rows that say something that was not queued before; from now on they are known."""
    for row in filter(told.tells, rows):
        key = _digest([str(row[name]) for name in told.table.key])
        said = _digest([row[name] for name in told.said])
        where = "WHERE topic = ? AND key = ?"
        known = state.rows(f"SELECT said, times FROM queued {where}", told.table.name, key)
        if known and known[0][0] == said:
            continue
        # Counted: a row that changes back is delivered again.
        times = known[0][1] + 1 if known else 0
        state.write(
            "INSERT OR REPLACE INTO queued VALUES (?, ?, ?, ?)", told.table.name, key, said, times
        )
        if row.get("id") not in silent:
            what = "changed" if known else "new"
            yield {"change_id": f"{key}-{said}-{times}", "change": what, **row}


def _digest(parts: object) -> str:
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:16]
