"""Log files of motors, found by the patterns of a config in a folder or an object store.

Of an object store each log that is read is copied; a listing has size, tag and last change of every
object. Of a Delta table, files of its newest version are logs: others lie beside them until a
clean-up (Delta transaction log protocol,
https://github.com/delta-io/delta/blob/master/PROTOCOL.md).
"""

from __future__ import annotations

import json
import os
import re
import shutil
import tempfile
import weakref
from bisect import bisect_left
from collections import OrderedDict, defaultdict
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from fnmatch import filter as fitting
from fnmatch import fnmatchcase
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from urllib.parse import unquote

import pyarrow as pa
import pyarrow.parquet as pq

from pipeline.config import Fleet, MotorSpec
from pipeline.errors import LogError, one_line
from pipeline.logs.files import change_of, failed_record, inspect_log, stat_log
from pipeline.logs.processed import FileRecord
from pipeline.messages import counted
from pipeline.store.object_store import ObjectChangedError, ObjectStore, StoredObject
from pipeline.workers.process import reading, still_alive

LONGEST_PATH = 4096
# Of logs; a packed log has another behind it.
SUFFIXES = (".csv", ".txt", ".tsv", ".parquet", ".mcap")
DELTA_LOG = "_delta_log"
# Logs without a motor that are named.
MOST_STRAYS = 8
# Copies that a task keeps at a time: those that it has in memory, and another.
COPIES = 3


GLOB_CHARACTERS = frozenset("*?[")


def find_logs(
    spec: MotorSpec, silent: Collection[str] = ()
) -> tuple[dict[str, Path], list[str], list[str]]:
    """Return a motor's log files by path below the log root, absent names, and unmatched globs.

    The `silent` files and patterns did not answer, and are not looked at. A pattern whose folder
    may not be entered stands among the files: as a log that cannot be read.
    """
    root = spec.log_root
    paths: set[Path] = set()
    refused: set[Path] = set()
    absent: list[str] = []
    unmatched: list[str] = []
    for pattern in spec.file.logs.files:
        named, is_glob = root / pattern, bool(GLOB_CHARACTERS & set(pattern))
        if pattern in silent:
            paths |= set() if is_glob else {named}
            continue
        try:
            with reading(pattern, is_asked=True):
                # A file may be called `a[1].csv`: a pattern that exists as a file is no glob.
                if named.exists():
                    paths.add(named)
                elif is_glob:
                    matches = set(_matching_files(root, pattern, silent))
                    paths |= matches
                    unmatched += [] if matches else [pattern]
                else:
                    absent.append(pattern)
        except PermissionError:
            refused.add(named)
    names: dict[str, Path] = {}
    for path in sorted(of_newest_version(paths, root) | refused):
        name = legible(path.as_posix().removeprefix(f"{root.as_posix()}/"))
        while name in names:  # Another file's name is what this is shown as.
            name += "'"
        names[name] = path
    return names, absent, unmatched


def _matching_files(root: Path, pattern: str, silent: Collection[str]) -> Iterator[Path]:
    for path, is_file in _matching(root, pattern):
        still_alive()
        if _is_hidden(path.relative_to(root).as_posix(), pattern):
            continue
        if is_file or not _is_folder(path, root, silent):
            yield path


def _is_hidden(name: str, pattern: str) -> bool:
    """Return True for what programs leave beside logs, unless a pattern names it.

    Examples
    --------
    >>> [_is_hidden(name, "**/*") for name in (".snapshot/a.csv", "M1/~$a.csv", "M1/a.csv")]
    [True, True, False]
    """
    is_named = "/." in f"/{pattern}" or "~$" in pattern
    return not is_named and ("/." in f"/{name}" or "/~$" in f"/{name}")


def _matching(root: Path, pattern: str) -> Iterator[tuple[Path, bool]]:
    """Yield paths that a glob names, as `Path.glob`, and if each is known to be a file.

    A folder of many motors is listed once.
    """
    place, _, last = pattern.rpartition("/")
    folder = root / place
    if GLOB_CHARACTERS & set(place) or "**" in last:
        yield from ((path, False) for path in root.glob(pattern))
        return
    try:
        names, files = _names_as_of(folder, folder.stat().st_mtime_ns)
    except PermissionError:
        raise
    except OSError:
        return
    beginning = re.split(r"[*?\[]", last)[0]
    first, end = (bisect_left(names, beginning + more) for more in ("", "\U0010ffff"))
    yield from ((folder / name, name in files) for name in fitting(names[first:end], last))


@lru_cache(maxsize=64)
def _names_as_of(folder: Path, _: int) -> tuple[list[str], set[str]]:
    """Return names in a folder last changed at a time, sorted, and which are files."""
    with os.scandir(folder) as listing:
        entries = list(listing)
    files = {entry.name for entry in entries if entry.is_file(follow_symlinks=False)}
    return sorted(entry.name for entry in entries), files


def _is_folder(path: Path, root: Path, silent: Collection[str]) -> bool:
    """Return True for a folder; a path that did not answer is taken for a file."""
    if not path.is_symlink():
        return path.is_dir()
    name = legible(path.relative_to(root).as_posix())
    # A link may lead to a mount that hangs.
    with reading(name, is_asked=True):
        return name not in silent and path.is_dir()


def require_answer(name: str, path: Path) -> None:
    """Open a log that is about to be read: if that hangs, the log is named."""
    with reading(name, is_asked=True), suppress(OSError):  # which its reader tells
        if path.is_file():
            with path.open("rb", buffering=0) as log:
                log.read(1)


def suffix_of(path: Path) -> str:
    """Return ending of a log's name, that of a packed log with what it packs: ".csv.gz"."""
    packed = path.suffix.lower() in (".gz", ".zst")
    return "".join(path.suffixes[-2:]) if packed else path.suffix


def logs_below(folder: Path, known: Collection[Path] = ()) -> Iterator[Path]:
    """Yield files of a folder that are logs by their names, without those that are known."""
    root = folder.resolve()
    for place, _, names in os.walk(root):
        if Path(place).name == DELTA_LOG:
            continue
        paths = [path for name in names if (path := Path(place, name)) not in known]
        logs = [path for path in paths if suffix_of(path).lower().startswith(SUFFIXES)]
        logs = [path for path in logs if not _is_hidden(path.relative_to(root).as_posix(), "*")]
        live = of_newest_version(logs, root)
        yield from (path for path in logs if path in live and path.is_file())


def unclaimed_logs(fleet: Fleet) -> tuple[str, ...]:
    """Return logs in the folder of the logs that no motor claims, by their path in it."""
    if fleet.log_url:
        return ()
    claimed = {path for spec in fleet.motors for path in find_logs(spec)[0].values()}
    others = list(logs_below(fleet.log_root, claimed))
    if not others:
        return ()
    # Links may lead to the same file.
    real, own = {path.resolve() for path in claimed}, fleet.output.resolve()
    return tuple(
        sorted(
            path.relative_to(fleet.log_root).as_posix()
            for path in others
            if path.resolve() not in real and not path.resolve().is_relative_to(own)
        )
    )


def strays_text(strays: Sequence[str]) -> str:
    """Return logs that no motor claims, in words; empty for none."""
    named = ", ".join(strays[:MOST_STRAYS]) + ", …" * (len(strays) > MOST_STRAYS)
    match = "matches" if len(strays) == 1 else "match"
    return f"{counted(len(strays), 'file')} {match} no motor: {named}" if strays else ""


def legible(text: str) -> str:
    """Return text for tables, terminals and pages: characters that do not print become escapes."""
    return one_line(text, LONGEST_PATH)


def of_newest_version(paths: Iterable[Path], root: Path) -> set[Path]:
    """Return the paths without those that a Delta table at or above them has removed."""
    folders: defaultdict[Path, list[Path]] = defaultdict(list)
    for path in paths:
        folders[path.parent].append(path)
    live = set[Path]()
    for folder, own in folders.items():
        table = _table_above(folder, root)
        if table is not None:
            names = _live(table, (table / DELTA_LOG).stat().st_mtime_ns)
            own = [path for path in own if path.relative_to(table).as_posix() in names]
        live.update(own)
    return live


def _table_above(folder: Path, root: Path) -> Path | None:
    """Return the folder of the Delta table that a folder is or lies in; None: it is of none."""
    for place in (folder, *folder.parents):
        if (place / DELTA_LOG).is_dir():
            return place
        if place == root:
            break
    return None


@lru_cache(maxsize=64)
def _live(table: Path, _: int) -> frozenset[str]:
    """Return the files of a table's newest version, by path in it, as of a change of its log."""
    log, live, since = table / DELTA_LOG, set[str](), -1
    checkpoints = sorted(log.glob("*.checkpoint*.parquet"))
    if checkpoints:
        since = _version(checkpoints[-1])
        for path in (checkpoint for checkpoint in checkpoints if _version(checkpoint) == since):
            live |= _added(path)
    for path in sorted(log.glob("*.json")):
        if _version(path) <= since:
            continue
        for line in path.read_text("utf-8").splitlines():
            action = json.loads(line)
            live -= {unquote(action["remove"]["path"])} if "remove" in action else set()
            live |= {unquote(action["add"]["path"])} if "add" in action else set()
    return frozenset(live)


def _added(checkpoint: Path) -> set[str]:
    actions = pq.read_table(checkpoint, columns=["add"])["add"].combine_chunks()
    paths: pa.Array = actions.field("path")
    return {unquote(path) for path in paths.to_pylist() if path is not None}


def _version(path: Path) -> int:
    number = path.name.partition(".")[0]
    return int(number) if number.isdigit() else -1


# Places


class FolderLogs:
    """Logs in a folder, by path relative to the log root; `absent` are named and not there.

    `latest_us` is as of `inspect_log`; files and patterns that are `silent` are not opened.
    """

    def __init__(
        self, spec: MotorSpec, latest_us: int | None = None, silent: Collection[str] = ()
    ) -> None:
        self._spec = spec
        self._latest_us = latest_us
        self._paths, self.absent, self._unmatched = find_logs(spec, silent)
        self.names = tuple(self._paths)

    def stat_log(self, name: str, before: FileRecord | None) -> FileRecord:
        """Return the record of a log, as `inspect_log`."""
        record = self._seen(name)
        if record.status == "failed":
            return record
        if before is not None and record.is_as(before):
            return before  # which is not opened
        try:
            path = self.path(name)
        except LogError as error:
            return failed_record(record, error)
        new = inspect_log(record, path, before, self._spec, self._latest_us)
        why = self.change_of(record)
        return new if why is None else failed_record(new, why)

    def _seen(self, name: str) -> FileRecord:
        """Return the record of a log that is not opened."""
        return stat_log(name, self.path(name))

    def path(self, name: str) -> Path:
        """Return the path, as `FolderLogs`.

        Raises LogError: ``log_growing``: it is no more as it was when it was listed.
        """
        return self._paths.get(name, self._spec.log_root / name)

    def change_of(self, record: FileRecord) -> LogError | None:
        """Return None: a copy never changes and what is put there later is news to the next run."""
        return change_of(record, self.path(record.path))

    def unmatched(self) -> tuple[str, ...]:
        """Return messages about globs that match no log."""
        place = self._spec.log_url or self._spec.log_root
        return tuple(
            f"no file matches {pattern} below {place}"
            + " ([1] stands for 1: a name with a bracket is written [[]1])" * ("[" in pattern)
            for pattern in self._unmatched
        )


class StoredLogs(FolderLogs):
    """Logs in an object store, each copied to a scratch folder while it is read."""

    def __init__(self, spec: MotorSpec, latest_us: int | None = None) -> None:
        self._spec = spec
        self._latest_us = latest_us
        self._store = ObjectStore.at(spec.log_url)
        self._objects, self.absent, self._unmatched = _matching_objects(
            self._store, spec.file.logs.files
        )
        self.names = tuple(sorted(self._objects))
        self._folder = Path(tempfile.mkdtemp(prefix="motor-leakage-logs-"))
        weakref.finalize(self, shutil.rmtree, self._folder, ignore_errors=True)
        self._copies: OrderedDict[str, Path] = OrderedDict()

    def _seen(self, name: str) -> FileRecord:
        stored = self._objects[name]
        tag = int.from_bytes(sha256(stored.tag.encode()).digest()[:6], "big")
        modified_ns = round(stored.modified.timestamp()) * 1_000_000_000
        return FileRecord(name, stored.size, modified_ns, None, inode=tag)

    def path(self, name: str) -> Path:
        """Return the path, as `FolderLogs`."""
        if name in self._copies:
            self._copies.move_to_end(name)
            return self._copies[name]
        folder = self._folder / sha256(name.encode()).hexdigest()[:16]
        # Readers go by a file's ending, and messages by its name.
        path = folder / Path(name).name
        stored = self._objects.get(name)
        if stored is None:
            return path
        try:
            folder.mkdir(exist_ok=True)
            with reading(name), path.open("wb") as stream:
                self._store.fetch(stored, stream)
        except ObjectChangedError as error:
            how = "it was replaced or removed meanwhile; the next run looks again"
            raise LogError("log_growing", path, how) from error
        self._copies[name] = path
        if len(self._copies) > COPIES:
            _, oldest = self._copies.popitem(last=False)
            oldest.unlink(missing_ok=True)
        return path

    def change_of(self, record: FileRecord) -> LogError | None:
        """Return None: a copy never changes and what is put there later is news to the next run."""


def _matching_objects(
    store: ObjectStore, patterns: tuple[str, ...]
) -> tuple[dict[str, StoredObject], list[str], list[str]]:
    """Return objects by key that patterns name; patterns without object; globs without a match.

    Only the folder that a pattern names before its first wildcard is listed.
    """
    objects: dict[str, StoredObject] = {}
    absent: list[str] = []
    unmatched: list[str] = []
    for pattern in patterns:
        folder = re.split(r"[*?\[]", pattern)[0].rpartition("/")[0]
        here = {stored.key: stored for stored in store.list(folder)}
        parts = pattern.split("/")
        if pattern in here:
            matches = [pattern]
        else:
            shown = (key for key in here if not _is_hidden(key, pattern))
            matches = [key for key in shown if _fits(key.split("/"), parts)]
        objects |= {legible(key): here[key] for key in matches}
        if not matches:
            (unmatched if GLOB_CHARACTERS & set(pattern) else absent).append(pattern)
    return objects, absent, unmatched


def _fits(parts: Sequence[str], pattern: Sequence[str]) -> bool:
    """Return whether a key fits a glob as `Path.glob` takes it: a star stays within a folder.

    Examples
    --------
    >>> [_fits(["M1", "old", "a.csv"], path.split("/")) for path in ("M1/*.csv", "**/a.csv")]
    [False, True]
    """
    if not pattern:
        return not parts
    if pattern[0] == "**":
        return _fits(parts, pattern[1:]) or (bool(parts) and _fits(parts[1:], pattern))
    return bool(parts) and fnmatchcase(parts[0], pattern[0]) and _fits(parts[1:], pattern[1:])


def logs_of(
    spec: MotorSpec, latest_us: int | None = None, silent: Collection[str] = ()
) -> FolderLogs:
    """Return a motor's logs at the place in its config."""
    return StoredLogs(spec, latest_us) if spec.log_url else FolderLogs(spec, latest_us, silent)
