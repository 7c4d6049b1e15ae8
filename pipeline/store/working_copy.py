"""An output folder that is published in an object store: pulled before a run, pushed after it.

An object store has no rename, so objects are never changed: the key of each holds the hash of its
content, and one object, `current.json`, lists those that are the output. A run puts what is new and
then replaces `current.json`, on condition that nobody has replaced it since the run began: it is
published as a whole or not at all. No listing is needed, and only new objects are read.

All raise StoreError if the store or the folder cannot be read or written.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import json
import logging
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from pipeline.errors import StoreError
from pipeline.store.atomic_files import put, remove, store_errors
from pipeline.store.locks import interrupts_held
from pipeline.store.object_store import ObjectStore
from pipeline.store.published import MANIFEST_FILE, digests_here, files_there, stamp_anew
from pipeline.store.state import (
    STATE_FILE,
    State,
    is_sound,
    make_ready,
    open_state,
    read_state_file,
)
from pipeline.store.tables import ENDING

log = logging.getLogger(__name__)

ROOT = "current.json"
# File of the folder that says of which store it is a copy.
RECORD = ".object-store.json"
# Replaced objects stay this long, for readers of an older `current.json`.
KEEP = dt.timedelta(days=7)
# Requests under way at a time.
REQUESTS = 16


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The published output, as `current.json` lists it."""

    tag: str | None = None  # of `current.json`; None where there is none
    files: Mapping[str, str] = field(default_factory=dict)  # SHA-256 by path below the output
    superseded: tuple[tuple[str, str], ...] = ()  # replaced objects, with the day since when


@contextmanager
def working_copy(url: str, output: Path) -> Iterator[None]:
    """Bring an output folder up to date with an object store, and publish its changes at the end.

    The caller holds the folder's lock. Without a URL nothing is published elsewhere.
    """
    if not url:
        yield
        return
    store = ObjectStore.at(url)
    snapshot = pull(store, output)
    yield
    with interrupts_held():
        push(store, output, snapshot)


def read_snapshot(store: ObjectStore) -> Snapshot:
    """The published output."""
    found = store.get(ROOT)
    if found is None:
        return Snapshot()
    content, tag = found
    try:
        document = json.loads(content)
        superseded = [(str(key), str(day)) for key, day in document["superseded"]]
        files = dict(document.get("files", {}))
        for key, digest in document.get("parts", {}).values():  # of an earlier version
            files |= json.loads(_content(store, key, digest))
            superseded.append((key, _today()))
        digests = {path: str(digest) for path, (_, digest) in files.items()}
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise StoreError("store_read", f"{store.url}/{ROOT} is damaged: {error}") from error
    return Snapshot(tag, digests, tuple(superseded))


def pull(store: ObjectStore, output: Path) -> Snapshot:
    """Make a folder the copy of the published output; only missing files are read.

    Raises StoreError: ``store_copy``: the folder holds an output of its own, or is a copy of
    another.
    """
    snapshot, record = read_snapshot(store), _record(store, output)
    if snapshot.tag is None:
        return snapshot
    published, had_state = snapshot.files, (output / STATE_FILE).exists()
    if not is_sound(output):
        make_ready(output)
    with read_state_file(output) as state:
        here, own_state = _digests(state), _hash(state.content())
    strange = sorted(path for path in here if here[path] != published.get(path))
    if record is None:
        # What was decided or looked at here is not in the store.
        is_own = had_state and published.get(STATE_FILE) != own_state
        _refuse_own(store, output, [*strange, STATE_FILE] if is_own else strange)
        record = {}
    pulled = (published.get(STATE_FILE), own_state)
    is_as_pulled = (record.get("published"), record.get("own")) == pulled
    _mark_as_copy(store, output)  # also if this is broken off
    for path in strange:
        if path not in published:
            remove(output / path)

    def content(path: str) -> bytes:
        return _content(store, key_of(path, published[path]), published[path])

    def bring(path: str) -> None:
        put(output / path, content(path), durable=False)

    others = published.keys() - {STATE_FILE}
    brought = [path for path in others if here.get(path) != published[path]]
    _in_turn(bring, brought)
    is_other = published.get(STATE_FILE, own_state) != own_state and not is_as_pulled
    if brought or is_other:
        with open_state(output) as state:
            if is_other:
                state.replace(content(STATE_FILE))
            stamp_anew(state, {path.removeprefix("tables/"): published[path] for path in others})
            own_state = _hash(state.content())
    _mark_as_copy(store, output, published.get(STATE_FILE), own_state)
    return snapshot


def _refuse_own(store: ObjectStore, output: Path, strange: Sequence[str]) -> None:
    """Refuse a folder that is no copy and holds files of its own."""
    if strange:
        raise StoreError(
            "store_copy",
            f"{output} holds files that are not those at {store.url}, such as {strange[0]}: "
            "choose an empty output",
        )


def push(store: ObjectStore, output: Path, before: Snapshot) -> Snapshot:
    """Publish a folder: what is new in it, then `current.json`; where that fails, all stays."""
    with read_state_file(output) as state:
        digests, own_state = _digests(state), state.content()
    digests[STATE_FILE] = _hash(own_state)
    keys = {path: key_of(path, digest) for path, digest in sorted(digests.items())}

    def upload(path: str) -> None:
        store.create(keys[path], own_state if path == STATE_FILE else _read(output / path))

    _in_turn(upload, [path for path in keys if before.files.get(path) != digests[path]])
    present = set(keys.values())
    gone = {key_of(*one) for one in before.files.items()} - present
    superseded = (
        *(one for one in before.superseded if one[0] not in present),
        *((key, _today()) for key in sorted(gone)),
    )
    tables: defaultdict[str, list[str]] = defaultdict(list)  # for query engines
    for path, key in keys.items():
        if path.startswith("tables/") and path.endswith(ENDING):
            tables[path.split("/")[1]].append(key)
    listed = {path: (key, digests[path]) for path, key in keys.items()}
    document = {"tables": tables, "files": listed, "superseded": superseded}
    tag = store.replace(ROOT, json.dumps(document, indent=0).encode(), before.tag)
    _mark_as_copy(store, output)
    after = Snapshot(tag, digests, superseded)
    _clear(store, after)
    return after


def _in_turn(request: Callable[[str], None], paths: Iterable[str]) -> None:
    """Send requests for some files, several at a time."""
    with ThreadPoolExecutor(REQUESTS) as pool:
        list(pool.map(request, paths))


def _content(store: ObjectStore, key: str, digest: str) -> bytes:
    """Content of an object, compared with its digest."""
    found = store.get(key)
    if found is None or _hash(found[0]) != digest:
        what = "is gone" if found is None else "is not what was published"
        raise StoreError(
            "store_read",
            f"{store.url}/{key} {what}; restore it from the bucket's versions or a backup",
        )
    return found[0]


def key_of(path: str, digest: str) -> str:
    """Key of a file's object: the hash of its content stands before the ending."""
    place = PurePosixPath(path)
    return f"files/{place.with_name(f'{place.stem}.{digest[:16]}{place.suffix}')}"


def _record(store: ObjectStore, output: Path) -> Mapping[str, str | None] | None:
    """What the folder says of which copy it is; None: of none; raises StoreError for another."""
    try:
        record: dict[str, str | None] = json.loads((output / RECORD).read_bytes())
        url = record["url"]
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise StoreError("store_read", f"{output / RECORD} cannot be read: {error}") from error
    if url != store.url:
        raise StoreError(
            "store_copy",
            f"{output} is the working copy of {url}, expected one of {store.url}: choose another "
            "output",
        )
    return record


def _mark_as_copy(
    store: ObjectStore, output: Path, published: str | None = None, own_state: str | None = None
) -> None:
    """Name the store of a folder, the state there, and the folder's own, which has other stamps."""
    record = {"url": store.url, "published": published, "own": own_state}
    put(output / RECORD, json.dumps(record).encode())


def _digests(state: State) -> dict[str, str]:
    """SHA-256 of the files that are published beside the state; those as noted are not read."""
    noted = {f"tables/{name}": sha256 for name, sha256 in digests_here(state).items()}
    paths = [f"tables/{name}" for name in files_there(state.output)]
    paths = [path for path in paths if (state.output / path).is_file()]
    if (state.output / MANIFEST_FILE).exists():
        paths.append(MANIFEST_FILE)
    return {path: noted.get(path) or _hash(_read(state.output / path)) for path in paths}


def _read(path: Path) -> bytes:
    with store_errors(path, "read"):
        return path.read_bytes()


def _hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _today() -> str:
    return dt.datetime.now(dt.UTC).date().isoformat()


def _clear(store: ObjectStore, snapshot: Snapshot) -> None:
    """Remove objects that were replaced long ago; a failure is only logged."""
    last = (dt.datetime.now(dt.UTC) - KEEP).date().isoformat()
    old = [key for key, day in snapshot.superseded if day < last]
    try:
        store.remove(old)
    except StoreError as error:
        log.warning("%s; the next run tries again", error)
