"""Sources of a motor's logs: a folder, a database, or an object store.

The nights of a database are files of a folder once they are landed. Of an object store each log
that is read is copied; a listing gives size, tag and last change of every object: a known one is
not opened.
"""

from __future__ import annotations

import os
import re
import tempfile
import weakref
from collections import OrderedDict
from collections.abc import Collection, Mapping
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Protocol

from pipeline.config import MotorSpec
from pipeline.errors import LogError
from pipeline.logs.files import FindEnds, change_of, failed, find_logs, growing, inspect_log
from pipeline.logs.finding import GLOB_CHARACTERS, legible, without_match
from pipeline.logs.landing import land_nights
from pipeline.logs.ledger import FileRecord
from pipeline.store.atomic_files import remove_all, scratch
from pipeline.store.object_store import ObjectChangedError, ObjectStore, StoredObject
from pipeline.workers.process import reading

# Copies that a task keeps at a time: those that it has in memory, and one more.
COPIES = 3


class LogSource(Protocol):
    """A motor's logs, by path relative to the log root."""

    names: tuple[str, ...]  # those that there are, sorted
    absent: list[str]  # those that are named in the config and absent

    def look_at(
        self, name: str, before: FileRecord | None, ends: FindEnds | None = None
    ) -> FileRecord:
        """The record of a log, as `inspect_log`; an unchanged one is not opened."""

    def path(self, name: str) -> Path:
        """A file with its content.

        Raises LogError: ``log_growing``: it is no more as it was when the source was made.
        """

    def change_of(self, record: FileRecord) -> LogError | None:
        """The change of a log since it was looked at; None without one."""

    def unmatched(self) -> tuple[str, ...]:
        """Messages about globs that match no log."""


class FolderLogs:
    """Logs in a folder.

    Parameters
    ----------
    spec, latest_us
        The motor, and its logs' latest time, as `inspect_log` takes them.
    silent
        Files and patterns that are not looked at, as of `find_logs`.
    """

    def __init__(
        self, spec: MotorSpec, latest_us: int | None = None, silent: Collection[str] = ()
    ) -> None:
        self._spec = spec
        self._latest_us = latest_us
        self._paths, self.absent = find_logs(spec, silent)
        self.names = tuple(self._paths)

    def look_at(
        self, name: str, before: FileRecord | None, ends: FindEnds | None = None
    ) -> FileRecord:
        """As `LogSource`."""
        return inspect_log(name, self._paths[name], before, self._spec, self._latest_us, ends)

    def path(self, name: str) -> Path:
        """As `LogSource`; of one that is gone, where it was."""
        return self._paths.get(name, self._spec.log_root / name)

    def change_of(self, record: FileRecord) -> LogError | None:
        """As `LogSource`."""
        return change_of(record, self.path(record.path))

    def unmatched(self) -> tuple[str, ...]:
        """As `LogSource`."""
        return without_match(self._spec.log_root, self._spec.file.logs.files)


class DatabaseLogs(FolderLogs):
    """Nights of a database, landed as files.

    Parameters
    ----------
    spec, latest_us, silent
        As of `FolderLogs`.
    ask
        False for what another task of the run has asked for.

    Raises
    ------
    StoreError
        ``store_write``: a night cannot be written.
    """

    def __init__(
        self,
        spec: MotorSpec,
        latest_us: int | None = None,
        silent: Collection[str] = (),
        *,
        ask: bool = True,
    ) -> None:
        self._faults = land_nights(spec, latest_us, silent) if ask else {}
        super().__init__(spec, latest_us, silent)
        self.names = tuple(sorted({*self.names, *self._faults}))

    def look_at(
        self, name: str, before: FileRecord | None, ends: FindEnds | None = None
    ) -> FileRecord:
        """As `LogSource`; of a night without an answer, its error."""
        if name in self._faults:
            return failed(FileRecord(name, 0, 0, None), self._faults[name])
        return super().look_at(name, before, ends)

    def unmatched(self) -> tuple[str, ...]:
        """Nothing: a database may have no rows yet."""
        return ()


class StoredLogs:
    """Logs in an object store, each copied to a scratch folder while it is read.

    Parameters
    ----------
    spec, latest_us
        As of `FolderLogs`.

    Raises
    ------
    StoreError
        If they cannot be listed.
    """

    def __init__(self, spec: MotorSpec, latest_us: int | None = None) -> None:
        self._spec = spec
        self._latest_us = latest_us
        self._store = ObjectStore.at(spec.log_url)
        self._found, self.absent, self._unmatched = _matching(self._store, spec.file.logs.files)
        self.names = tuple(sorted(self._found))
        self._folder = Path(tempfile.mkdtemp(prefix="motor-leakage-logs-"))
        weakref.finalize(self, remove_all, self._folder)
        self._copies: OrderedDict[str, Path] = OrderedDict()

    def look_at(
        self, name: str, before: FileRecord | None, ends: FindEnds | None = None
    ) -> FileRecord:
        """As `LogSource`."""
        found = self._found[name]
        if before is not None and before.sha256 and _is_known(before, found):
            return before
        try:
            path = self.path(name)
        except LogError as error:
            became = failed if error.code == "log_missing" else growing
            return became(_record(name, found), error)
        record = inspect_log(name, path, None, self._spec, self._latest_us, ends)
        record = replace(
            record, modified_ns=_modified_ns(found), inode=_number(found.tag), changed_ns=0
        )
        if before is not None and before.sha256 == record.sha256 and record.sha256:
            return replace(before, modified_ns=record.modified_ns, inode=record.inode)
        return record

    def path(self, name: str) -> Path:
        """As `LogSource`."""
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
            with reading(name), scratch(path) as stream:
                self._store.fetch(found, stream)
        except ObjectChangedError as error:
            if self._store.tag_of(found.key) is None:
                how = "it was removed after it had been listed"
                raise LogError("log_missing", Path(name), how) from error
            raise _changed(path) from error
        os.utime(path, ns=(_modified_ns(found), _modified_ns(found)))
        self._copies[name] = path
        if len(self._copies) > COPIES:
            _, oldest = self._copies.popitem(last=False)
            oldest.unlink(missing_ok=True)
        return path

    def change_of(self, record: FileRecord) -> LogError | None:
        """As `LogSource`: a copy never changes, so the object is asked for its tag."""
        found = self._found.get(record.path)
        if found is None or self._store.tag_of(found.key) in (found.tag, None):
            return None
        return _changed(Path(record.path))

    def unmatched(self) -> tuple[str, ...]:
        """As `LogSource`."""
        url = self._spec.log_url
        return tuple(f"no object matches {pattern} below {url}" for pattern in self._unmatched)


def _changed(path: Path) -> LogError:
    return LogError("log_growing", path, "it was replaced while it was read; the next run reads it")


def _record(name: str, found: StoredObject) -> FileRecord:
    return FileRecord(name, found.size, _modified_ns(found), None, inode=_number(found.tag))


def _is_known(record: FileRecord, found: StoredObject) -> bool:
    known = (record.size, record.modified_ns, record.inode)
    return known == (found.size, _modified_ns(found), _number(found.tag))


def _modified_ns(found: StoredObject) -> int:
    return round(found.modified.timestamp()) * 1_000_000_000


def _number(tag: str) -> int:
    """An object's tag as a number, where a file has that of its inode."""
    return int.from_bytes(sha256(tag.encode()).digest()[:6], "big")


def _matching(
    store: ObjectStore, patterns: tuple[str, ...]
) -> tuple[dict[str, StoredObject], list[str], list[str]]:
    """Objects by key that patterns name; patterns of one that is absent; globs without a match.

    Only the folder that a pattern names before its first wildcard is listed.
    """
    found: dict[str, StoredObject] = {}
    absent: list[str] = []
    unmatched: list[str] = []
    listed: dict[str, Mapping[str, StoredObject]] = {}
    for pattern in patterns:
        plain = re.split(r"[*?\[]", pattern)[0]
        folder = plain.rpartition("/")[0]
        if folder not in listed:
            listed[folder] = {one.key: one for one in store.list(folder)}
        here = listed[folder]
        if pattern in here:
            found[legible(pattern)] = here[pattern]
        elif GLOB_CHARACTERS & set(pattern):
            fits = _as_path_glob(pattern)
            matches = {legible(key): one for key, one in here.items() if fits.fullmatch(key)}
            found |= matches
            if not matches:
                unmatched.append(pattern)
        else:
            absent.append(pattern)
    return found, absent, unmatched


def _as_path_glob(pattern: str) -> re.Pattern[str]:
    """A glob as `Path.glob` takes it: a star stays within a folder, two of them do not.

    Examples
    --------
    >>> bool(_as_path_glob("M1/*.csv").fullmatch("M1/a.csv"))
    True
    >>> bool(_as_path_glob("M1/*.csv").fullmatch("M1/old/a.csv"))
    False
    >>> bool(_as_path_glob("**/a.csv").fullmatch("M1/old/a.csv"))
    True
    """
    parts = []
    for part in pattern.split("/"):
        if part == "**":
            parts.append("(?:[^/]+/)*")
        else:
            parts.append(_translated(part) + "/")
    return re.compile("".join(parts).removesuffix("/"))


def _translated(part: str) -> str:
    """One name of a glob as a regular expression."""
    wild = {"*": "[^/]*", "?": "[^/]"}
    found = []
    for token in re.findall(r"\[!?[^\]]+\]|.", part, re.DOTALL):
        if len(token) > 1:
            found.append(token.replace("[!", "[^", 1))
        else:
            found.append(wild.get(token) or re.escape(token))
    return "".join(found)


def logs_of(
    spec: MotorSpec,
    latest_us: int | None = None,
    silent: Collection[str] = (),
    *,
    ask: bool = True,
) -> LogSource:
    """A motor's logs at the place in its config; a database is asked only if that is wanted."""
    if spec.file.logs.database is not None:
        return DatabaseLogs(spec, latest_us, silent, ask=ask)
    return StoredLogs(spec, latest_us) if spec.log_url else FolderLogs(spec, latest_us, silent)
