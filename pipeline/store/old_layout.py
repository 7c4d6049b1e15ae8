"""Outputs of versions up to 0.9: taken over once.

Each month of a small table becomes one file, and what stood in manifests, ledgers, the journal and
the outbox goes into the state file. May go in 2028, with its test.
"""

from __future__ import annotations

import hashlib
import json
import logging
import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from shutil import rmtree
from typing import Any

import polars as pl

from pipeline.errors import LockedError, StoreError
from pipeline.schema import LOOKS, NIGHTLY_TABLES, TABLES, WHOLE_TABLES, Table
from pipeline.store.atomic_files import move, remove
from pipeline.store.locks import locked
from pipeline.store.published import TABLE_OF, note
from pipeline.store.state import State
from pipeline.store.tables import (
    ENDING,
    MONTH_PREFIX,
    PUT_ASIDE,
    damaged,
    from_parquet,
    labelled_file,
    name_of,
    table_folder,
    write_table,
)

log = logging.getLogger(__name__)

# Lets the nights of table files be made anew, by the files' names.
Forget = Callable[[list[str]], object]
OLD_FOLDERS = ("manifest", "ledger", "history")
OUTBOX = ("outbox.json", "outbox.copy.json")
OLD_FILES = ("decisions.jsonl", "decisions.damaged", *OUTBOX)
DECISION = ("motor_id", "indicator", "time", "kind", "night", "finding", "note", "worn", "sound")
# SHA-256 that a file may have, by its name.
Listed = Mapping[str, tuple[str | None, ...]]
# Of a night, of a day of looks, and of a run.
OLD_NAME = re.compile(r"(looks-)?\d{4}-\d{2}-\d{2}|\d{8}T\d{12}Z")
MONTHLY = tuple(one for one in TABLES if one not in (*NIGHTLY_TABLES, *WHOLE_TABLES))


def take_over(state: State, forget: Forget, take_stock: Callable[[], object]) -> None:
    """Take an output of an older version over; the caller holds the lock.

    `take_stock` lists the files that stay as they are, and prove themselves.

    Where that is broken off, or a look is under way, the next run goes on; until then a query may
    see rows twice.

    Raises StoreError if a file cannot be written, or is of a newer version of the program.
    """
    output = state.output
    old = _old_files(output)
    if not old and not any((output / name).exists() for name in (*OLD_FOLDERS, *OLD_FILES)):
        return
    if not state.meta("taken over"):
        log.warning("the output is of an older version, and is taken over")
        _take_records(state)
    manifests = sorted((output / "manifest").glob("*/*.json"))
    listed = {name: some for path in manifests for name, some in _listed(path)}
    looks = {month: old.pop((month, name)) for month, name in list(old) if name == LOOKS.name}
    for (month, name), files in sorted(old.items()):
        _take_month(state, TABLE_OF[name], month, files, listed, forget)
    take_stock()
    try:
        with locked(output / "look"):
            _take_looks(state)
            for month, files in sorted(looks.items()):
                _take_month(state, LOOKS, month, files, listed, forget)
    except LockedError as error:
        log.warning("%s; the next run takes the looks over", error)
        return
    for folder in OLD_FOLDERS:
        rmtree(output / folder, ignore_errors=True)
    for name in OLD_FILES:
        remove(output / name)


def _listed(path: Path) -> Iterator[tuple[str, tuple[str | None, ...]]]:
    """Files of an old manifest, and what each may be."""
    document = _document(path)
    yield from ((name, (digest,)) for name, digest in document.get("files", {}).items())
    yield from ((name, tuple(some)) for name, some in document.get("coming", {}).items())


def _document(path: Path) -> dict[str, Any]:
    """What stands in an old file with a seal of its own; empty where that does not hold."""
    try:
        document: dict[str, Any] = json.loads(path.read_bytes())
        seal = document.pop("sha256")
        digest = hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return {}
    return document if seal in (digest, digest[:16]) else {}


def _take_records(state: State) -> None:
    """Take over ledgers, records of trends, what people said, and what was told."""
    output = state.output
    with state.transaction():
        for folder in sorted((output / "ledger").glob("*/")):
            _take_ledger(state, folder)
        for line in _lines(output / "decisions.jsonl"):
            _insert(state, "decisions", {name: line[name] for name in DECISION if name in line})
        _take_outbox(state, "alarms", output)
        state.set_meta("taken over", "yes")


def _take_looks(state: State) -> None:
    """Take over the state of looks, and what of them was told; the caller holds their lock."""
    folder = state.output / "look"
    if not state.meta("looks taken over"):
        with state.transaction():
            _take_outbox(state, "looks", folder)
            for path in sorted(folder.glob("*/state.json")):
                if look := _document(path):
                    row = {"motor_id": path.parent.name, "state": json.dumps(look)}
                    _insert(state, "looks", row)
            state.set_meta("looks taken over", "yes")
    for path in folder.glob("*/"):
        rmtree(path, ignore_errors=True)
    for name in OUTBOX:
        remove(folder / name)


def _take_ledger(state: State, folder: Path) -> None:
    """Take over the ledger of a motor; the months without damage, as of it was before."""
    motor_id, settings = folder.name, _document(folder / "settings")
    _insert(state, "motors", {"motor_id": motor_id, "settings": json.dumps(settings)})
    for path in sorted(folder.glob("*.json")):
        month = _document(path)
        for record in month.get("files", {}).values():
            nights = {"nights": " ".join(record["nights"]), "changed_ns": 0}
            _insert(state, "logs", {"motor_id": motor_id, **record, **nights})
        for night, record in month.get("nights", {}).items():
            model = {"model": json.dumps(record["model"])}
            _insert(state, "nights", {"motor_id": motor_id, "night": night, **record, **model})
    if trends := _document(folder / "trends"):
        rules = {"rules": json.dumps(trends["rules"])} if trends.get("rules") else {}
        _insert(state, "trends", {"motor_id": motor_id, **trends, **rules})


def _take_outbox(state: State, topic: str, folder: Path) -> None:
    """Take over what waits for receivers, and the keys of what was queued."""
    documents = (_document(folder / name) for name in OUTBOX)
    document = next(filter(None, documents), {})
    for key, said, times in (one.split("-") for one in document.get("known", ())):
        _insert(state, "queued", {"topic": topic, "key": key, "said": said, "times": int(times)})
    for receiver, queue in document.get("queues", {}).items():
        mine = {"topic": topic, "receiver": receiver}
        kept = {name: queue.get(name, "") for name in ("told_since", "fault", "summarised")}
        _insert(state, "queues", mine | kept)
        for one in queue["waiting"]:
            what = {"kind": one.get("kind", ""), "changes": json.dumps(one["changes"])}
            _insert(state, "outbox", mine | what | {name: one[name] for name in ("id", "since")})


def _lines(path: Path) -> Iterator[dict[str, Any]]:
    """Lines of an old journal."""
    content = path.read_bytes() if path.exists() else b""
    for line in content.splitlines():
        with suppress(ValueError):
            yield json.loads(line)


def _insert(state: State, table: str, row: Mapping[str, Any]) -> None:
    names, places = ", ".join(row), ", ".join("?" * len(row))
    state.write(f"INSERT OR REPLACE INTO {table} ({names}) VALUES ({places})", *row.values())


def _old_files(output: Path) -> dict[tuple[str, str], list[Path]]:
    """Files that are not a month's, in order, by month and table."""
    found: defaultdict[tuple[str, str], list[Path]] = defaultdict(list)
    for table in MONTHLY:
        for path in sorted(table_folder(output, table).glob(f"{MONTH_PREFIX}*/*{ENDING}")):
            if OLD_NAME.fullmatch(path.stem):
                found[path.parent.name.removeprefix(MONTH_PREFIX), table.name].append(path)
    return found


def _take_month(
    state: State, table: Table, month: str, sources: list[Path], listed: Listed, forget: Forget
) -> None:
    """Make one file of those of a month's nights; lost ones are forgotten, to be made anew."""
    output, place = state.output, labelled_file(state.output, table, month)
    name = name_of(output, place)
    lost: set[str] = set()
    # One that is there and was not listed has all of them: this was broken off.
    if name in listed or not place.exists():
        folder = name.removesuffix(f"{month}{ENDING}")
        lost = {one for one in listed if one.startswith(folder)} - {name}
        lost -= {name_of(output, path) for path in sources}
    parts, damaged_files = [], []
    for path in (place, *sources):
        try:
            parts.append(_rows(output, path, table, listed))
        except StoreError as error:
            if error.code != "store_read":
                raise
            log.warning("%s; its nights are made anew", error)
            damaged_files.append(path)
    forget(sorted(lost.union(name_of(output, path) for path in damaged_files)))
    for path in damaged_files:
        move(path, path.with_suffix(PUT_ASIDE))
    rows = pl.concat(parts).unique(table.key, keep="last", maintain_order=True)
    note(state, {name: write_table(place, rows.sort(table.order))})
    for path in sources:
        remove(path)


def _rows(output: Path, path: Path, table: Table, listed: Listed) -> pl.DataFrame:
    """Rows of a file that is what its manifest says; none if there is no file."""
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        return pl.DataFrame(schema=table.schema)
    except OSError as error:
        raise damaged(path, table, error) from error
    accepted = listed.get(name_of(output, path))
    if accepted and hashlib.sha256(content).hexdigest() not in accepted:
        raise damaged(path, table, "it is not what its manifest says")
    return from_parquet(path, table, content)
