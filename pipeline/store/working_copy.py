"""An output folder as the working copy of one in an object store.

There is no rename in an object store, so nothing there is ever changed: every file is an object
whose key holds the hash of its content, and one object, `current.json`, says which of them are the
output. A run works in its folder as always. At its end it puts what is new and then replaces
`current.json`, on condition that nobody has replaced it since the run began: so a run is published
as a whole or not at all. Nothing is ever listed, and only what is new is read.
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

log = logging.getLogger(__name__)

Item = TypeVar("Item")
Made = TypeVar("Made")

ROOT = "current.json"
# What of an output folder is published: not the lock, the staging folder, or a report.
FOLDERS = ("tables", "ledger", "manifest")
JOURNAL = "decisions.jsonl"
FILES = (JOURNAL, "outbox.json", "outbox.copy.json")
# Beside the output's own files: of what this folder is a copy.
RECORD = ".object-store.json"
# Objects that a newer run has replaced stay this long, for those who have just read `current.json`.
KEEP = dt.timedelta(days=7)
# Requests under way at a time.
REQUESTS = 16
# A file system may stamp a file a little earlier than it was written.
STAMP_NS = 1_000_000_000
MONTH = re.compile(r"(?<!\d)(\d{4}-\d{2})(?!\d)")


@dataclass(frozen=True, slots=True)
class Entry:
    """A file of the output: the key of its object, and the SHA-256 of its content."""

    key: str
    sha256: str


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The output as `current.json` says it is.

    Attributes
    ----------
    tag
        Of `current.json`; None where there is none.
    files
        By path below the output folder.
    parts
        Lists of those files by month, which are objects as well: only those of months that
        changed are written anew.
    superseded
        Objects that are not part of it any more, with the day since when.
    """

    tag: str | None = None
    files: Mapping[str, Entry] = field(default_factory=dict)
    parts: Mapping[str, Entry] = field(default_factory=dict)
    superseded: tuple[tuple[str, str], ...] = ()


@contextmanager
def working_copy(url: str, output: Path) -> Iterator[Callable[[str], bool]]:
    """Bring an output folder up to date with an object store, and publish what was changed in it.

    Parameters
    ----------
    url
        Such as s3://bucket/fleet; empty: the folder is all there is.
    output
        The folder, of which the caller holds the lock.

    Yields
    ------
    callable
        Brings a file back, by its path below the folder, as it is published; False: it is not.

    Raises
    ------
    StoreError
        If it cannot be brought up to date, or not be published: nothing of it is then.
        ``store_copy``: without a URL, the folder is the working copy of one.
    """
    if not url:
        _require_no_copy(output)
        yield lambda _: False
        return
    store = ObjectStore.at(url)
    snapshot = pull(store, output)
    # From here on the folder is no copy, whatever becomes of the run.
    _record(store, output, None)
    started_ns = time.time_ns() - STAMP_NS
    yield partial(_restore, store, output, snapshot)
    with interrupts_held():
        push(store, output, snapshot, started_ns)


def _restore(store: ObjectStore, output: Path, snapshot: Snapshot, path: str) -> bool:
    """Bring a file of a working copy back as it was published; False: it was not."""
    entry = snapshot.files.get(path)
    if entry is not None:
        put(output / path, _content(store, entry))
    return entry is not None


def _require_no_copy(output: Path) -> None:
    """What is changed in a working copy and not published would be taken for what is published."""
    record = output / RECORD
    if record.exists():
        raise StoreError(
            "store_copy",
            f"{output} is the working copy of an object store, to which this would publish "
            f"nothing: run with its folders.object_store and folders.output, choose another "
            f"output, or remove {record} to part from the store",
        )


def read_snapshot(store: ObjectStore) -> Snapshot:
    """What `current.json` says.

    Raises
    ------
    StoreError
        If it cannot be read, or is not what this program writes.
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
    """Content of an object, if it is what was published."""
    found = store.get(entry.key)
    if found is None or hashlib.sha256(found[0]).hexdigest() != entry.sha256:
        what = "is gone" if found is None else "is not what was published"
        raise StoreError(
            "store_read",
            f"{store.url}/{entry.key} {what}; restore it from the bucket's versions or a backup",
        )
    return found[0]


def in_turn(function: Callable[[Item], Made], items: Iterable[Item]) -> list[Made]:
    """A function of some items, several requests at a time."""
    with ThreadPoolExecutor(REQUESTS) as pool:
        return list(pool.map(function, items))


def pull(store: ObjectStore, output: Path) -> Snapshot:
    """Make a folder the copy of what is published; only what it has not yet is read.

    Raises
    ------
    StoreError
        ``store_copy``: the folder holds an output of its own, or is a copy of another.
    """
    snapshot = read_snapshot(store)
    here = _here(store, output, snapshot)
    if snapshot.tag is None:
        return snapshot
    _record(store, output, None)
    for path in sorted(here.keys() - snapshot.files.keys() - {JOURNAL}):
        remove(output / path)
    news = [path for path, entry in snapshot.files.items() if here.get(path) != entry.sha256]

    def bring(path: str) -> None:
        content = _content(store, snapshot.files[path])
        if path == JOURNAL:
            content = _joined(content, output / path)
        put(output / path, content, durable=False)

    in_turn(bring, news)
    _record(store, output, snapshot)
    return snapshot


def _here(store: ObjectStore, output: Path, snapshot: Snapshot) -> dict[str, str]:
    """SHA-256 of the files that the folder has; from its record, where a run had ended well."""
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


def _joined(content: bytes, path: Path) -> bytes:
    """The published journal with the lines that were said here since."""
    try:
        own = read(path).splitlines(keepends=True)
    except FileNotFoundError:
        return content
    known = set(content.splitlines(keepends=True))
    return content + b"".join(line for line in own if line not in known)


def _record(store: ObjectStore, output: Path, snapshot: Snapshot | None) -> None:
    """Remember of what the folder is a copy; None: of nothing certain, as it is being changed."""
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
    """Publish what is in a folder: its new files, then the lists that name them, `current.json`.

    Raises
    ------
    StoreError
        If it cannot be published; what is published is then what was.
    """
    _record(store, output, None)

    def land(path: str) -> tuple[str, Entry]:
        known = before.files.get(path)
        # The journal is written to by hand, between runs.
        if (
            known is not None
            and path != JOURNAL
            and (output / path).stat().st_mtime_ns < started_ns
        ):
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
    """A file's key, with the hash of its content before the ending."""
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
    gone = _keys(before) - _keys(Snapshot(None, files, parts))
    today = dt.datetime.now(dt.UTC).date().isoformat()
    superseded = (*before.superseded, *((key, today) for key in sorted(gone)))
    present = _keys(Snapshot(None, files, parts))
    superseded = tuple((key, day) for key, day in superseded if key not in present)
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
    """Keys of each table's files: what a query engine is to read."""
    tables: defaultdict[str, list[str]] = defaultdict(list)
    for path, entry in sorted(files.items()):
        if path.startswith("tables/") and path.endswith(".parquet"):
            tables[path.split("/")[1]].append(entry.key)
    return dict(tables)


def _clear(store: ObjectStore, snapshot: Snapshot) -> None:
    """Remove objects that have not been part of the output for long; that may fail."""
    last = (dt.datetime.now(dt.UTC) - KEEP).date().isoformat()
    old = [key for key, day in snapshot.superseded if day < last]
    try:
        store.remove(old)
    except StoreError as error:
        log.warning("%s; the next run tries again", error)
