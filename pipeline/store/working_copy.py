"""An output folder as the working copy of one in an object store.

An object store has no rename, so objects are never changed: the key of each holds the hash of its
content, and one object, `current.json`, lists those that are the output. A run works in its folder.
At its end it puts the new objects and then replaces `current.json`, on condition that nobody has
replaced it since the run began: a run is published as a whole or not at all. No listing is needed,
and only new objects are read.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import json
import logging
import re
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from pipeline.errors import StoreError
from pipeline.store.atomic_files import TEMPORARY_PREFIX, put, read, remove
from pipeline.store.interrupts import interrupts_held
from pipeline.store.object_store import ObjectStore
from pipeline.store.state import STATE_FILE, replace_state

log = logging.getLogger(__name__)

Item = TypeVar("Item")
Made = TypeVar("Made")

ROOT = "current.json"
# Published parts of an output folder: not the lock, the staging folder, or a report.
FOLDERS = ("tables", "manifest")
FILES = (STATE_FILE,)
# File in a working copy that says of which store.
RECORD = ".object-store.json"
# Replaced objects stay this long, for readers of an older `current.json`.
KEEP = dt.timedelta(days=7)
# Requests under way at a time.
REQUESTS = 16
# Tolerance for the time stamps of a file system.
STAMP_NS = 1_000_000_000
MONTH = re.compile(r"(?<!\d)(\d{4}-\d{2})(?!\d)")


@dataclass(frozen=True, slots=True)
class Entry:
    """Key of a file's object, and SHA-256 of its content."""

    key: str
    sha256: str


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The published output, as `current.json` lists it."""

    tag: str | None = None  # of `current.json`; None where there is none
    files: Mapping[str, Entry] = field(default_factory=dict)  # by path below the output folder
    # Objects that list those files, by month: only lists of changed months are written anew.
    parts: Mapping[str, Entry] = field(default_factory=dict)
    superseded: tuple[tuple[str, str], ...] = ()  # replaced objects, with the day since when


@contextmanager
def working_copy(url: str, output: Path) -> Iterator[Callable[[str], bool]]:
    """Bring an output folder up to date with an object store, and publish its changes at the end.

    Parameters
    ----------
    url
        Such as s3://bucket/fleet; empty: nothing is published elsewhere.
    output
        The folder, of which the caller holds the lock.

    Yields
    ------
    callable
        Restores a file as published, by its path below the folder; False if it is not published.

    Raises
    ------
    StoreError
        If it cannot be brought up to date, or not be published as a whole. ``store_copy``: without
        a URL, the folder is a working copy.
    """
    if not url:
        _require_no_copy(output)
        yield lambda _: False
        return
    store = ObjectStore.at(url)
    snapshot = pull(store, output)
    # From here on the folder is no exact copy, even if the run is broken off.
    _record(store, output, None)
    started_ns = time.time_ns() - STAMP_NS
    yield partial(_restore, store, output, snapshot)
    with interrupts_held():
        push(store, output, snapshot, started_ns)


def _restore(store: ObjectStore, output: Path, snapshot: Snapshot, path: str) -> bool:
    """Restore a file as published; False if it is not published."""
    entry = snapshot.files.get(path)
    if entry is not None:
        put(output / path, _content(store, entry))
    return entry is not None


def _require_no_copy(output: Path) -> None:
    """Refuse a working copy: unpublished changes in it would be taken for published ones."""
    record = output / RECORD
    if record.exists():
        raise StoreError(
            "store_copy",
            f"{output} is the working copy of an object store, to which this would publish "
            f"nothing: run with its folders.object_store and folders.output, choose another "
            f"output, or remove {record} to part from the store",
        )


def read_snapshot(store: ObjectStore) -> Snapshot:
    """The published output.

    Raises StoreError if `current.json` cannot be read or is damaged.
    """
    found = store.get(ROOT)
    if found is None:
        return Snapshot()
    content, tag = found
    try:
        document = json.loads(content)
        parts = {name: Entry(*pair) for name, pair in document["parts"].items()}
        superseded = tuple((str(key), str(day)) for key, day in document["superseded"])
        lists = in_turn(lambda part: json.loads(_content(store, part)), parts.values())
        files = {path: Entry(*pair) for part in lists for path, pair in part.items()}
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise StoreError("store_read", f"{store.url}/{ROOT} is damaged: {error}") from error
    return Snapshot(tag, files, parts, superseded)


def _content(store: ObjectStore, entry: Entry) -> bytes:
    """Content of an object, compared with its digest."""
    found = store.get(entry.key)
    if found is None or hashlib.sha256(found[0]).hexdigest() != entry.sha256:
        what = "is gone" if found is None else "is not what was published"
        raise StoreError(
            "store_read",
            f"{store.url}/{entry.key} {what}; restore it from the bucket's versions or a backup",
        )
    return found[0]


def in_turn(function: Callable[[Item], Made], items: Iterable[Item]) -> list[Made]:
    """Apply a function to items, several requests at a time."""
    with ThreadPoolExecutor(REQUESTS) as pool:
        return list(pool.map(function, items))


def pull(store: ObjectStore, output: Path) -> Snapshot:
    """Make a folder the copy of the published output; only missing files are read.

    Raises StoreError: ``store_copy``: the folder holds an output of its own, or is a copy of
    another.
    """
    snapshot = read_snapshot(store)
    here = _here(store, output, snapshot)
    if snapshot.tag is None:
        return snapshot
    _record(store, output, None)
    for path in sorted(here.keys() - snapshot.files.keys() - {STATE_FILE}):
        remove(output / path)
    news = [path for path, entry in snapshot.files.items() if here.get(path) != entry.sha256]

    def bring(path: str) -> None:
        content = _content(store, snapshot.files[path])
        if path == STATE_FILE:
            replace_state(output, content)
        else:
            put(output / path, content, durable=False)

    in_turn(bring, news)
    _record(store, output, snapshot)
    return snapshot


def _here(store: ObjectStore, output: Path, snapshot: Snapshot) -> dict[str, str]:
    """SHA-256 of the folder's files; from its record if the last run ended well."""
    try:
        document = json.loads(read(output / RECORD))
    except FileNotFoundError:
        document = None
    except (OSError, ValueError) as error:
        raise StoreError("store_read", f"{output / RECORD} cannot be read: {error}") from error
    if document is not None and document["url"] != store.url:
        raise StoreError(
            "store_copy",
            f"{output} is the working copy of {document['url']}, expected one of {store.url}: "
            "choose another output",
        )
    if document is not None and document["files"] is not None:
        return {str(path): str(digest) for path, digest in document["files"].items()}
    here = {path: _digest(output / path) for path in _paths(output)}
    if document is None and snapshot.tag is not None:
        strange = [path for path, digest in here.items() if not _same(snapshot, path, digest)]
        if strange:
            raise StoreError(
                "store_copy",
                f"{output} holds files that are not those at {store.url}, such as "
                f"{strange[0]}: choose an empty output",
            )
    return here


def _same(snapshot: Snapshot, path: str, digest: str) -> bool:
    return path in snapshot.files and snapshot.files[path].sha256 == digest


def _record(store: ObjectStore, output: Path, snapshot: Snapshot | None) -> None:
    """Record the snapshot of which the folder is a copy; None while it is being changed."""
    files = snapshot and {path: entry.sha256 for path, entry in snapshot.files.items()}
    put(output / RECORD, json.dumps({"url": store.url, "files": files}, indent=0).encode())


def _paths(output: Path) -> Iterator[str]:
    """Files of an output folder that are published, by path below it."""
    for folder in FOLDERS:
        for path in sorted((output / folder).rglob("*")):
            if path.is_file() and not path.name.startswith(TEMPORARY_PREFIX):
                yield path.relative_to(output).as_posix()
    yield from (name for name in FILES if (output / name).exists())


def _digest(path: Path) -> str:
    return hashlib.sha256(read(path)).hexdigest()


def push(store: ObjectStore, output: Path, before: Snapshot, started_ns: int = 0) -> Snapshot:
    """Publish a folder: its new files, then the lists of files, then `current.json`.

    Raises StoreError if it cannot be published; what was published before then stays.
    """
    _record(store, output, None)

    def land(path: str) -> tuple[str, Entry]:
        known = before.files.get(path)
        is_old = (output / path).stat().st_mtime_ns < started_ns
        if known is not None and is_old and path != STATE_FILE:  # people add to it between runs
            return path, known
        content = read(output / path)
        entry = _entry(f"files/{path}", content)
        if known != entry:
            store.create(entry.key, content)
        return path, entry

    files = dict(in_turn(land, _paths(output)))
    after = _replace_root(store, before, files)
    _record(store, output, after)
    _clear(store, after)
    return after


def _entry(path: str, content: bytes) -> Entry:
    """A file's key: the hash of its content stands before the ending."""
    digest = hashlib.sha256(content).hexdigest()
    stem, dot, ending = path.rpartition(".") if "." in path.rpartition("/")[2] else (path, "", "")
    return Entry(f"{stem}.{digest[:16]}{dot}{ending}", digest)


def _replace_root(store: ObjectStore, before: Snapshot, files: Mapping[str, Entry]) -> Snapshot:
    """Put the lists of files, and `current.json` last."""
    months: defaultdict[str, dict[str, Any]] = defaultdict(dict)
    for path, entry in sorted(files.items()):
        found = MONTH.search(path)
        months[found[1] if found else "whole"][path] = (entry.key, entry.sha256)
    parts = {}
    for month, listed in months.items():
        content = json.dumps(listed, indent=0).encode()
        parts[month] = _entry(f"lists/{month}.json", content)
        if before.parts.get(month) != parts[month]:
            store.create(parts[month].key, content)
    present = _keys(Snapshot(None, files, parts))
    today = dt.datetime.now(dt.UTC).date().isoformat()
    gone = ((key, today) for key in sorted(_keys(before) - present))
    superseded = (*(one for one in before.superseded if one[0] not in present), *gone)
    content = json.dumps(
        {
            "tables": _tables(files),
            "parts": {month: (one.key, one.sha256) for month, one in sorted(parts.items())},
            "superseded": superseded,
        },
        indent=0,
    ).encode()
    tag = store.replace(ROOT, content, before.tag)
    return Snapshot(tag, files, parts, superseded)


def _keys(snapshot: Snapshot) -> set[str]:
    return {one.key for one in (*snapshot.files.values(), *snapshot.parts.values())}


def _tables(files: Mapping[str, Entry]) -> dict[str, list[str]]:
    """Keys of each table's files, for query engines."""
    tables: defaultdict[str, list[str]] = defaultdict(list)
    for path, entry in sorted(files.items()):
        if path.startswith("tables/") and path.endswith(".parquet"):
            tables[path.split("/")[1]].append(entry.key)
    return dict(tables)


def _clear(store: ObjectStore, snapshot: Snapshot) -> None:
    """Remove objects that were replaced long ago; a failure is only logged."""
    last = (dt.datetime.now(dt.UTC) - KEEP).date().isoformat()
    old = [key for key, day in snapshot.superseded if day < last]
    try:
        store.remove(old)
    except StoreError as error:
        log.warning("%s; the next run tries again", error)
