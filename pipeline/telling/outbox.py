"""The outbox: rows of `alarms` that wait for each receiver, and those already taken up.

Rows come from the published table alone, and each is known by its key and its content: a run may be
broken off anywhere, and a row that is made anew is delivered again only if it has changed. A failed
delivery waits, unchanged, for the next run. The outbox is two sealed files with the same content;
one of them is enough. Rows of `looks` have one of their own: a look never waits for a run.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import json
import logging
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from pipeline.errors import StoreError
from pipeline.messages import counted
from pipeline.schema import ALARM_CONTENT, ALARMS, LOOKS, Table
from pipeline.store.sealed import DamagedError, put_sealed, read_sealed, unseal
from pipeline.store.tables import month_stamps, read_table, table_folder
from pipeline.telling.delivery import Receiver

log = logging.getLogger(__name__)

OUTBOX_FILES = ("outbox.json", "outbox.copy.json")
# Rows of one delivery at most.
MOST_CHANGES = 500
# Kind of a delivery with the state of every motor.
SUMMARY = "summary"

Change = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Told:
    """Rows of a table that receivers are told."""

    table: Table
    said: tuple[str, ...]  # columns with a row's content; others are its key or follow from it
    folder: str = ""  # folder of its outbox, below the output
    states: frozenset[str] = frozenset()  # states into or out of which a row is told; empty: all

    def tells(self, row: Mapping[str, Any]) -> bool:
        """True for a row that is told."""
        return not self.states or not self.states.isdisjoint((row["from_state"], row["to_state"]))


TOLD_ALARMS = Told(ALARMS, ALARM_CONTENT)
TOLD_LOOKS = Told(
    LOOKS, ("from_state", "to_state", "reason", "verdict"), "look", frozenset({"look_now"})
)


@dataclass(frozen=True, slots=True)
class Waiting:
    """A delivery that waits: its id, since when (UTC), its rows, and its kind if not changes."""

    id: str
    since: dt.datetime
    changes: tuple[Change, ...]
    kind: str = ""


@dataclass(frozen=True, slots=True)
class Queue:
    """Queue of a receiver."""

    # Time at which the config first named it (UTC); rows published before are not sent.
    told_since: dt.datetime
    waiting: tuple[Waiting, ...] = ()  # deliveries that it has not taken
    fault: str = ""  # the last fault; empty if all was taken
    summarised: str = ""  # date of the last summary, ISO; empty before the first


@dataclass(frozen=True, slots=True)
class Outbox:
    """All queues, and the rows of `alarms` that were taken up."""

    queues: Mapping[str, Queue] = field(default_factory=dict)  # by the receiver's name
    # By a hash of a row's key, a hash of its content and how often that has changed.
    known: Mapping[str, str] = field(default_factory=dict)
    # `month_stamps` of the time at which rows were taken up.
    stamps: Mapping[str, int] = field(default_factory=dict)


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


def read_outbox(output: Path) -> Outbox | None:
    """The outbox, from the first file that is whole; None without one.

    Raises StoreError if a file cannot be read, and none is whole.
    """
    unreadable: StoreError | None = None
    for name in OUTBOX_FILES:
        try:
            found = read_outbox_file(output / name)
        except DamagedError as error:
            log.warning("%s", error)
        except StoreError as error:
            unreadable = error
        else:
            if found is not None:
                return found
    if unreadable is not None:
        raise unreadable
    return None


def read_outbox_file(path: Path) -> Outbox | None:
    """The outbox in one of its files; None without a file; raises as `read_sealed`."""
    document = read_sealed(path, unseal)
    try:
        return (
            None
            if document is None
            else Outbox(
                {name: _queue(one) for name, one in document["queues"].items()},
                dict(one.split("-", 1) for one in document["known"]),
                document["stamps"],
            )
        )
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise DamagedError("store_read", f"{path.name} is damaged") from error


def _queue(document: Mapping[str, Any]) -> Queue:
    waiting = tuple(
        Waiting(
            one["id"],
            dt.datetime.fromisoformat(one["since"]),
            tuple(one["changes"]),
            one.get("kind", ""),
        )
        for one in document["waiting"]
    )
    told_since = dt.datetime.fromisoformat(document["told_since"])
    return Queue(told_since, waiting, document["fault"], document.get("summarised", ""))


def write_outbox(output: Path, outbox: Outbox) -> None:
    """Write both files; raises as `put_sealed`."""
    document = asdict(outbox) | {"known": sorted(map("-".join, outbox.known.items()))}
    for name in OUTBOX_FILES:
        put_sealed(output / name, document)


def open_outbox(output: Path, names: Sequence[str], fleet: str, told: Told = TOLD_ALARMS) -> None:
    """Give the receivers of a config their queues, before a run publishes anything.

    Rows that the run before has published and not taken up go to the receivers of that time. A new
    receiver gets none of them; the queue of one that the config names no more is dropped.

    Raises StoreError if the outbox cannot be read or written.
    """
    before = read_outbox(output / told.folder)
    if not names and (before is None or not before.queues):
        return
    outbox = taken_up(before or Outbox(), output, fleet, told)
    for name in sorted(outbox.queues.keys() - set(names)):
        if n := sum(len(one.changes) for one in outbox.queues[name].waiting):
            words = "alarms: there is no %s any more; not delivered: %s"
            log.warning(words, name, counted(n, "change"))
    for name in sorted(set(names) - outbox.queues.keys()):
        if outbox.known:
            log.warning(
                "alarms: the %s is told from now on; the %d rows of `%s` so far are not sent",
                name,
                len(outbox.known),
                told.table.name,
            )
    now = dt.datetime.now(dt.UTC)
    queues = {name: outbox.queues.get(name, Queue(now)) for name in names}
    write_outbox(output / told.folder, replace(outbox, queues=queues))


def take_up(output: Path, fleet: str, told: Told = TOLD_ALARMS) -> None:
    """Put new rows into all queues.

    Raises StoreError if the outbox cannot be read or written.
    """
    before = read_outbox(output / told.folder)
    if before is not None and before.queues:
        after = taken_up(before, output, fleet, told)
        if after != before:
            write_outbox(output / told.folder, after)


def add_summary(
    output: Path, name: str, fleet: str, due: dt.date, rows: Callable[[], Iterable[Change]]
) -> None:
    """Queue a summary for a receiver, once for each date that it is due on.

    Raises StoreError if the outbox, or what the rows are made from, cannot be read or written.
    """
    outbox = read_outbox(output)
    queue = None if outbox is None else outbox.queues.get(name)
    if outbox is None or queue is None or queue.summarised >= due.isoformat():
        return
    key = f"msg_{_digest([fleet, name, SUMMARY, due.isoformat()])}"
    summary = Waiting(key, dt.datetime.now(dt.UTC), tuple(rows()), SUMMARY)
    queue = replace(queue, waiting=(*queue.waiting, summary), summarised=due.isoformat())
    write_outbox(output, replace(outbox, queues={**outbox.queues, name: queue}))


def taken_up(outbox: Outbox, output: Path, fleet: str, told: Told = TOLD_ALARMS) -> Outbox:
    """The outbox with new rows of the months that were written to since."""
    stamps = month_stamps(output, told.table)
    known, changes, since = dict(outbox.known), list[Change](), 0
    for month, stamp in sorted(stamps.items()):
        if outbox.stamps.get(month) == stamp:
            continue
        rows, whole = _rows_of(output, month, told)
        if not whole:
            del stamps[month]
        for row in rows:
            key = _digest([str(row[name]) for name in told.table.key])
            said = _digest([row[name] for name in told.said])
            before, _, times = known.get(key, "-").partition("-")
            if before != said:
                # Counted: a row that changes back is delivered again.
                known[key] = f"{said}-{int(times) + 1 if before else 0}"
                if row.get("is_silent"):
                    continue
                what = "rules" if row.get("rules") else "changed" if before else "new"
                changes.append({"id": f"{key}-{known[key]}", "change": what, **_plain(row)})
                since = max(since, stamp)
    when = dt.datetime.fromtimestamp(since / 1e9, dt.UTC)
    queues = {
        name: replace(queue, waiting=(*queue.waiting, *_deliveries(fleet, name, when, changes)))
        for name, queue in outbox.queues.items()
    }
    return Outbox(queues, known, stamps)


def _rows_of(output: Path, month: str, told: Told) -> tuple[list[dict[str, Any]], bool]:
    """Rows of a month's files that are whole, and True if all are."""
    rows, whole = list[dict[str, Any]](), True
    for path in sorted((table_folder(output, told.table) / f"month={month}").glob("*.parquet")):
        try:
            rows += filter(told.tells, read_table(path, told.table).to_dicts())
        except StoreError as error:
            log.warning("alarms: %s; its rows wait until it is whole", error)
            whole = False
    return rows, whole


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


def is_waiting(output: Path) -> bool:
    """True if a delivery waits.

    Raises StoreError if the outbox cannot be read.
    """
    outbox = read_outbox(output)
    return outbox is not None and any(queue.waiting for queue in outbox.queues.values())


def backlogs(output: Path, receivers: Sequence[Receiver], fleet: str) -> tuple[Backlog, ...]:
    """Undelivered rows of each receiver, those included that no run has taken up yet.

    Raises StoreError if the outbox cannot be read.
    """
    outbox = read_outbox(output)
    if outbox is None or not receivers:
        return ()
    queues = taken_up(outbox, output, fleet).queues
    return tuple(
        Backlog(
            receiver.label,
            queue.told_since,
            sum(len(one.changes) for one in queue.waiting),
            min((one.since for one in queue.waiting), default=None),
            queue.fault or None,
        )
        for receiver in receivers
        if (queue := queues.get(receiver.name)) is not None
    )
