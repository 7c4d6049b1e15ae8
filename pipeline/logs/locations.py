"""Places of a motor's logs: a folder, or an object store.

Of an object store each log that is read is copied; a listing gives size, tag and last change of
every object: a known one is not opened.
"""

from __future__ import annotations

import re
import shutil
import tempfile
import weakref
from collections import OrderedDict
from collections.abc import Collection, Sequence
from fnmatch import fnmatchcase
from hashlib import sha256
from pathlib import Path

from pipeline.config import MotorSpec
from pipeline.errors import LogError
from pipeline.logs.files import change_of, failed, inspect_log, stat_log, unsettled
from pipeline.logs.finding import GLOB_CHARACTERS, find_logs, legible, without_match
from pipeline.logs.processed import FileRecord
from pipeline.store.object_store import ObjectChangedError, ObjectStore, StoredObject
from pipeline.workers.process import reading

# Copies that a task keeps at a time: those that it has in memory, and one more.
COPIES = 3


class FolderLogs:
    """Logs in a folder, by path relative to the log root; `absent` are named and not there.

    `latest_us` is as of `inspect_log`; files and patterns that are `silent` are not opened.
    """

    def __init__(
        self, spec: MotorSpec, latest_us: int | None = None, silent: Collection[str] = ()
    ) -> None:
        self._spec = spec
        self._latest_us = latest_us
        self._paths, self.absent = find_logs(spec, silent)
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
            return failed(record, error)
        new = inspect_log(record, path, before, self._spec, self._latest_us)
        why = unsettled(record, path, self._spec.file.logs.settle_s) or self.change_of(record)
        return new if why is None else failed(new, why)

    def _seen(self, name: str) -> FileRecord:
        """Return the record of a log that is not opened."""
        return stat_log(name, self.path(name))

    def path(self, name: str) -> Path:
        """Return a file with the content of a log; of one that is gone, where it was.

        Raises LogError: ``log_growing``: it is no more as it was when it was listed.
        """
        return self._paths.get(name, self._spec.log_root / name)

    def change_of(self, record: FileRecord) -> LogError | None:
        """Return the change of a log since it was looked at; None without one."""
        return change_of(record, self.path(record.path))

    def unmatched(self) -> tuple[str, ...]:
        """Return messages about globs that match no log."""
        patterns = [name for name in self._spec.file.logs.files if name not in self.names]
        return without_match(self._spec.log_root, patterns)


class StoredLogs(FolderLogs):
    """Logs in an object store, each copied to a scratch folder while it is read.

    Raises StoreError if they cannot be listed.
    """

    def __init__(self, spec: MotorSpec, latest_us: int | None = None) -> None:
        self._spec = spec
        self._latest_us = latest_us
        self._store = ObjectStore.at(spec.log_url)
        self._found, self.absent, self._unmatched = _matching(self._store, spec.file.logs.files)
        self.names = tuple(sorted(self._found))
        self._folder = Path(tempfile.mkdtemp(prefix="motor-leakage-logs-"))
        weakref.finalize(self, shutil.rmtree, self._folder, ignore_errors=True)
        self._copies: OrderedDict[str, Path] = OrderedDict()

    def _seen(self, name: str) -> FileRecord:
        found = self._found[name]
        tag = int.from_bytes(sha256(found.tag.encode()).digest()[:6], "big")
        modified_ns = round(found.modified.timestamp()) * 1_000_000_000
        return FileRecord(name, found.size, modified_ns, None, inode=tag)

    def path(self, name: str) -> Path:
        """As `FolderLogs`."""
        if name in self._copies:
            self._copies.move_to_end(name)
            return self._copies[name]
        folder = self._folder / sha256(name.encode()).hexdigest()[:16]
        # Readers go by a file's ending, and messages by its name.
        path = folder / Path(name).name
        found = self._found.get(name)
        if found is None:
            return path
        try:
            folder.mkdir(exist_ok=True)
            with reading(name), path.open("wb") as stream:
                self._store.fetch(found, stream)
        except ObjectChangedError as error:
            how = "it was replaced or removed meanwhile; the next run looks again"
            raise LogError("log_growing", path, how) from error
        self._copies[name] = path
        if len(self._copies) > COPIES:
            _, oldest = self._copies.popitem(last=False)
            oldest.unlink(missing_ok=True)
        return path

    def change_of(self, record: FileRecord) -> LogError | None:
        """None: a copy never changes, and what is put there meanwhile is news to the next run."""

    def unmatched(self) -> tuple[str, ...]:
        """As `FolderLogs`."""
        url = self._spec.log_url
        return tuple(f"no object matches {pattern} below {url}" for pattern in self._unmatched)


def _matching(
    store: ObjectStore, patterns: tuple[str, ...]
) -> tuple[dict[str, StoredObject], list[str], list[str]]:
    """Objects by key that patterns name; patterns of one that is absent; globs without a match.

    Only the folder that a pattern names before its first wildcard is listed.
    """
    found: dict[str, StoredObject] = {}
    absent: list[str] = []
    unmatched: list[str] = []
    for pattern in patterns:
        folder = re.split(r"[*?\[]", pattern)[0].rpartition("/")[0]
        here = {stored.key: stored for stored in store.list(folder)}
        parts = pattern.split("/")
        if pattern in here:
            matches = [pattern]
        else:
            matches = [key for key in here if _fits(key.split("/"), parts)]
        found |= {legible(key): here[key] for key in matches}
        if not matches:
            (unmatched if GLOB_CHARACTERS & set(pattern) else absent).append(pattern)
    return found, absent, unmatched


def _fits(parts: Sequence[str], pattern: Sequence[str]) -> bool:
    """Return whether a key fits a glob as `Path.glob` takes it: a star stays within a folder.

    Examples
    --------
    >>> [_fits(["M1", "old", "a.csv"], one.split("/")) for one in ("M1/*.csv", "**/a.csv")]
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
