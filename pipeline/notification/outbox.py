"""The receivers of a config, which rows of a table each has been sent, and the sending of others.

A row of the published tables is known by its key and its content. It is marked as delivered, for
each receiver, once that has taken it: wherever a run is broken off, the next sends it, at least
once, and a row that is made anew is sent again only if it says something else. Rows of `intraday`
are a topic of their own: an intraday check never waits for a run.

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
from itertools import groupby
from pathlib import Path
from typing import Any

from pipeline.clock import now
from pipeline.config import Alarms
from pipeline.errors import StoreError
from pipeline.messages import counted
from pipeline.notification.delivery import SUMMARY, Command, Delivery, Receiver, UndeliveredError
from pipeline.schema import ALARM_CONTENT, ALARMS, INTRADAY, Table
from pipeline.store.state import StateDatabase, read_state_file
from pipeline.store.tables import files_of, read_table

log = logging.getLogger(__name__)

# Rows of a delivery at most.
MOST_CHANGES = 500
# Waits before a delivery is tried again in the same run [s].
PAUSES_S = (1.0, 4.0)
# After so many failed deliveries the rest waits for the next run.
MOST_FAILURES = 2
OF_RECEIVER = "WHERE topic = ? AND receiver = ?"

Row = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Topic:
    """Rows of a table that receivers are sent."""

    table: Table
    content: tuple[str, ...]  # columns with what a row says; others are its key or follow from it
    is_notified: Callable[[Row], bool]  # true for a row that is sent


def is_notified(row: Row) -> bool:
    """Return False for a baseline that begins or is taken, unless it ends what was sent before."""
    return not {row["from_state"], row["to_state"]} <= {"insufficient", "ok"}


OF_ALARMS = Topic(ALARMS, ALARM_CONTENT, is_notified)
OF_INTRADAY = Topic(INTRADAY, ("from_state", "to_state", "reason"), lambda _: True)


@dataclass(frozen=True, slots=True)
class Backlog:
    """Undelivered rows of a receiver; `since` and `fault` are None without any."""

    receiver: str
    notified_since: dt.datetime
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


def receivers_of(settings: Alarms) -> tuple[Receiver, ...]:
    """Return all that `[alarms]` names; none by default."""
    receivers: list[Receiver] = []
    if settings.command:
        receivers.append(Command(settings.command))
    if settings.webhook_url or settings.email.to:
        # Whose libraries take their time.
        from pipeline.notification.delivery import Mail, WebHook

        if settings.webhook_url:
            of_hook = settings.webhook_url, settings.webhook_headers, settings.webhook_secret
            receivers.append(WebHook(*of_hook))
        if settings.email.to:
            receivers.append(Mail(settings.email))
    return tuple(receivers)


def open_outbox(state: StateDatabase, names: Sequence[str], topic: Topic = OF_ALARMS) -> None:
    """Know the receivers of a config, before a run publishes anything.

    What is published already is no news to a new receiver; a receiver that the config names
    no more is forgotten.
    """
    of = topic.table.name
    with state.transaction():
        known = {name for (name,) in state.rows("SELECT receiver FROM queues WHERE topic = ?", of)}
        for name in known.difference(names):
            state.write(f"DELETE FROM queues {OF_RECEIVER}", of, name)
        for name in set(names) - known:
            insert = "INSERT INTO queues (topic, receiver, notified_since) VALUES (?, ?, ?)"
            state.write(insert, of, name, now().isoformat())
            _note_new(state, name, topic, _published_rows(state.output, topic), since="")


def pass_over(state: StateDatabase, ids: Collection[str]) -> None:
    """Let rows of `alarms` that are being published be sent to nobody, by their `id`."""
    if ids:
        rows = _published_rows(state.output, OF_ALARMS)
        silent = {key: row for key, row in rows.items() if row["id"] in ids}
        for (name,) in state.rows("SELECT receiver FROM queues WHERE topic = ?", ALARMS.name):
            _note_new(state, name, OF_ALARMS, silent, since="")


def rename_motor(state: StateDatabase, old: str, new: str) -> None:
    """Know a motor's rows by its new name, as which they are published: what waits still does."""
    for topic in (OF_ALARMS, OF_INTRADAY):
        keys = []
        for key, row in _published_rows(state.output, topic).items():
            if row["motor_id"] == new:
                # An `id` begins with the motor's name.
                names = {"motor_id": old, "id": old + row.get("id", "").removeprefix(new)}
                keys.append((key, topic.table.name, _key(topic, {**row, **names})))
        state.write_all("UPDATE OR REPLACE notices SET key = ? WHERE topic = ? AND key = ?", keys)


def deliver(
    state: StateDatabase, receivers: Sequence[Receiver], fleet: str, topic: Topic = OF_ALARMS
) -> tuple[str, ...]:
    """Deliver what no receiver has taken yet, each delivery noted at once; faults, as text.

    A dead receiver costs a run little, and a delivery that it never takes does not hold up others
    for long. After a StoreError deliveries may be repeated.
    """
    faults = []
    rows = _published_rows(state.output, topic) if receivers else {}
    for receiver in receivers:
        mine = topic.table.name, receiver.name
        _note_new(state, receiver.name, topic, rows, since=now().isoformat())
        fault, failures = "", 0
        for changes in _waiting(state, receiver.name, topic, rows):
            delivery = _delivery(receiver, topic.table.name, fleet, changes)
            outcome = "since = ''"
            try:
                _hand_over(receiver, delivery, () if failures else PAUSES_S)
            except UndeliveredError as error:
                outcome, fault = "tries = tries + 1", error.why
                failures = MOST_FAILURES if error.hung else failures + 1
            keys = [(*mine, change["change_id"].partition("-")[0]) for change in changes]
            state.write_all(f"UPDATE notices SET {outcome} {OF_RECEIVER} AND key = ?", keys)
            if failures == MOST_FAILURES:
                break
        state.write(f"UPDATE queues SET fault = ? {OF_RECEIVER}", fault, *mine)
        if fault:
            faults.append(f"{receiver.label}: {fault}; the next run tries again")
    return tuple(faults)


def deliver_summary(
    state: StateDatabase,
    receiver: Receiver,
    fleet: str,
    due: dt.date,
    rows: Callable[[], Iterable[Row]],
) -> None:
    """Deliver a summary, once for each date that it is due on; raises UndeliveredError."""
    mine = ALARMS.name, receiver.name
    last = state.rows(f"SELECT summarised FROM queues {OF_RECEIVER}", *mine)
    if last and last[0][0] < due.isoformat():
        _hand_over(receiver, _delivery(receiver, SUMMARY, fleet, list(rows()), due), ())
        state.write(f"UPDATE queues SET summarised = ? {OF_RECEIVER}", due.isoformat(), *mine)


def backlogs(output: Path, receivers: Sequence[Receiver]) -> tuple[Backlog, ...]:
    """Return undelivered rows of each receiver."""
    if not receivers:
        return ()
    query = (
        "SELECT notified_since, fault, count(since), min(since)"
        " FROM queues LEFT JOIN (SELECT * FROM notices WHERE since != '') USING (topic, receiver)"
        f" {OF_RECEIVER} GROUP BY receiver"
    )
    moment = dt.datetime.fromisoformat
    with read_state_file(output) as state:
        return tuple(
            Backlog(receiver.label, moment(begin), n, since and moment(since), fault or None)
            for receiver in receivers
            for begin, fault, n, since in state.rows(query, ALARMS.name, receiver.name)
        )


def _published_rows(output: Path, topic: Topic) -> dict[str, Row]:
    """Return published rows sent, by a hash of their key; those of a damaged file are missing."""
    rows: list[Row] = []
    for path in files_of(output, topic.table):
        try:
            # JSON has no NaN.
            rows += read_table(path, topic.table).fill_nan(None).to_dicts()
        except StoreError as error:
            log.warning("alarms: %s; its rows wait until it is whole", error)
    return {_key(topic, row): row for row in rows if topic.is_notified(row)}


def _key(topic: Topic, row: Row) -> str:
    return _digest([str(row[name]) for name in topic.table.key])


def _note_new(
    state: StateDatabase, name: str, topic: Topic, rows: Mapping[str, Row], *, since: str
) -> None:
    """Note rows that say what the receiver was not sent before; they wait since then, if at all.

    What waits goes on waiting, whatever it says now.
    """
    mine = topic.table.name, name
    query = f"SELECT key, said, times, since FROM notices {OF_RECEIVER}"
    known = {key: notice for key, *notice in state.rows(query, *mine)}
    new = []
    for key, row in rows.items():
        words = _digest([row[name] for name in topic.content])
        # Counted: a row that changes back is sent again.
        before, times, waits = known.get(key, ("", -1, ""))
        if words != before:
            new.append((*mine, key, words, times + 1, waits or since))
    state.write_all("INSERT OR REPLACE INTO notices VALUES (?, ?, ?, ?, ?, ?, 0)", new)


def _waiting(
    state: StateDatabase, name: str, topic: Topic, rows: Mapping[str, Row]
) -> Iterator[Sequence[Row]]:
    """Yield rows of each delivery to a receiver: together as they came, failed last."""
    notices = state.rows(
        f"SELECT tries, since, key, said, times FROM notices {OF_RECEIVER} AND since != ''",
        *(topic.table.name, name),
    )
    places = {key: place for place, key in enumerate(rows)}
    there = [notice for notice in notices if notice[2] in places]
    there.sort(key=lambda notice: (*notice[:2], places[notice[2]]))
    for _, together in groupby(there, key=lambda notice: notice[:2]):
        changes = [
            {
                "change_id": f"{key}-{digest}-{times}",
                "change": "changed" if times else "new",
                **rows[key],
            }
            for _, _, key, digest, times in together
        ]
        for first in range(0, len(changes), MOST_CHANGES):
            yield changes[first : first + MOST_CHANGES]


def _delivery(
    receiver: Receiver, kind: str, fleet: str, changes: Sequence[Row], due: dt.date | None = None
) -> Delivery:
    """Return delivery of some rows, or of a summary due; its id depends on them alone."""
    parts = [kind, str(due)] if due else [change["change_id"] for change in changes]
    key = f"msg_{_digest([fleet, receiver.name, *parts])}"
    document = {"id": key, "type": kind, "fleet": fleet, "changes": changes}
    return Delivery(key, json.dumps(document, sort_keys=True, default=str).encode())


def _hand_over(receiver: Receiver, delivery: Delivery, pauses: Sequence[float]) -> None:
    """Have a receiver take a delivery, and try again after each pause; raises UndeliveredError."""
    for seconds in pauses:
        try:
            return receiver.take(delivery)
        except UndeliveredError as error:
            if error.hung:
                raise
        time.sleep(seconds)
    return receiver.take(delivery)


def _digest(parts: object) -> str:
    return hashlib.sha256(json.dumps(parts, default=str).encode()).hexdigest()[:16]
