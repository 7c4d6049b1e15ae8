"""Published table files compared with their manifests: altered, missing, or listed nowhere.

A run checks that every published file exists. It reads the files that are due, and those that were
written to after they were published.
"""

from __future__ import annotations

import hashlib
import os
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import polars as pl

from pipeline.errors import StoreError
from pipeline.messages import counted
from pipeline.schema import NIGHT_TABLES, TABLES, TREND_TABLES, Table
from pipeline.store.atomic_files import TEMPORARY_PREFIX, read
from pipeline.store.encoding import DAMAGE, as_parquet, opened, row_groups
from pipeline.store.manifest import (
    MONTH_PREFIX,
    WHOLE,
    Manifest,
    manifest_file,
    manifest_key,
    manifest_keys,
    read_manifest,
)
from pipeline.store.tables import ENDING, PUT_ASIDE, damaged, days_of, require_known

AGAIN = "a run makes it anew"
TABLE_OF = {table.name: table for table in TABLES}
OF_MOTORS = {table.name for table in NIGHT_TABLES}
OF_TRENDS = {table.name for table in TREND_TABLES}


class Proof(Enum):
    """Evidence for a file that no manifest lists.

    `WHOLE`: encoding its rows again gives the same bytes, the footer too. `PAGES`: only the
    checksums of its pages hold, as another version of PyArrow or Polars wrote it.
    """

    WHOLE = "whole"
    PAGES = "pages"


def prove(path: Path, table: Table) -> tuple[str, Proof]:
    """SHA-256 of a table file that no manifest lists, and its proof.

    Raises StoreError if it is damaged, of a newer version of the program, or has rows of other
    nights.
    """
    try:
        content = read(path)
        with opened(content) as file:
            version = require_known(path, table, file)
            rows = pl.concat(row_groups(file), rechunk=True)
        is_of_nights = path.parent.name.startswith(MONTH_PREFIX) and "night" in rows.columns
        nights = set(rows["night"].drop_nulls()) if is_of_nights else set()
        if nights and nights - set(days_of(path.stem)):
            raise ValueError("it has rows of other nights")
        same = as_parquet(rows, version) == content
    except DAMAGE as error:
        raise damaged(path, table, error) from error
    return hashlib.sha256(content).hexdigest(), Proof.WHOLE if same else Proof.PAGES


@dataclass(frozen=True, slots=True)
class TableFault:
    """A damaged, missing or unknown file."""

    path: str  # relative to the folder of the tables; of another file, to the output folder
    # ``table_altered``, ``table_missing``, ``table_unreadable``, ``table_unlisted``, ``rows_lost``,
    # ``manifest_missing``, ``manifest_damaged``, ``ledger_damaged``, ``history_damaged``,
    # ``journal_damaged`` or ``outbox_damaged``.
    code: str
    message: str  # the fault, and a remedy

    def __str__(self) -> str:
        return f"{self.code}: {self.path}: {self.message}"


@dataclass(frozen=True, slots=True)
class Comparison:
    """Result of comparing published files with their manifests."""

    # Files that differ, are absent or cannot be read, and manifests that are damaged.
    faults: tuple[TableFault, ...]
    proven: tuple[str, ...]  # manifests whose files are whole though one was written to since


def compare_published(
    output: Path,
    keys: Iterable[str] | None = None,
    is_due: Callable[[str], bool] = lambda _: True,
) -> Comparison:
    """Compare the files of some manifests, all by default: those due, missing or written to since.

    `is_due` tells by the name of a file.
    """
    faults: list[TableFault] = []
    proven: list[str] = []
    for key in manifest_keys(output) if keys is None else keys:
        manifest = read_manifest(output, key)
        if manifest is None:
            path = manifest_file(output, key)
            if path.exists():
                message = "the manifest is damaged; a run makes it anew from the files"
                name = path.relative_to(output).as_posix()
                faults.append(TableFault(name, "manifest_damaged", message))
            continue
        later = _written_since(output, key, manifest)
        names = later | {name for name in manifest.names if is_due(name)}
        found = [fault for name in sorted(names) if (fault := fault_of(output, name)) is not None]
        faults += found
        if later and not found:
            proven.append(key)
    return Comparison(tuple(faults), tuple(proven))


def _written_since(output: Path, key: str, manifest: Manifest) -> set[str]:
    """Files that were written to after their manifest, or are missing."""
    published_ns = _written_ns(manifest_file(output, key))
    tables = os.fspath(output / "tables")
    return {
        name
        for name in manifest.names
        if (written := _written_ns(f"{tables}/{name}")) is None
        or published_ns is None
        or written > published_ns
    }


def _written_ns(path: Path | str) -> int | None:
    try:
        return os.stat(path).st_mtime_ns  # noqa: PTH116 - thousands of them in every run
    except OSError:
        return None


def fault_of(output: Path, name: str) -> TableFault | None:
    """The fault of a table file, by its manifest; None without one.

    A fault is looked at twice: a run may have published the file in between, or a read have failed.
    """
    fault = None
    for _ in range(2):
        manifest = read_manifest(output, manifest_key(name)) or Manifest()
        fault = _compare(output, name, manifest.accepted(name))
        if fault is None:
            break
    return fault


def _compare(output: Path, name: str, accepted: tuple[str | None, ...]) -> TableFault | None:
    if not accepted:
        return None
    try:
        found = hashlib.sha256(read(output / "tables" / name)).hexdigest()
    except (FileNotFoundError, NotADirectoryError):
        if None in accepted:
            return None
        return TableFault(name, "table_missing", f"the file is gone; {_again(name)}")
    except OSError as error:
        message = f"it cannot be read: {error.strerror}; correct its permissions, or the disk"
        return TableFault(name, "table_unreadable", message)
    if found not in accepted:
        return TableFault(name, "table_altered", f"it is not what was published; {_again(name)}")
    return None


def _again(name: str) -> str:
    """The words for a file that is damaged or gone: who makes it anew."""
    if name.split("/")[0] in OF_MOTORS:
        return f"{AGAIN} where the logs of that night are there"
    if name.split("/")[0] in OF_TRENDS or manifest_key(name) == WHOLE:
        return AGAIN
    return "it told of a run, and nothing makes it anew"


def unlisted_files(output: Path) -> dict[str, list[str]]:
    """Table files that no manifest lists, or a damaged one, by the manifest that should."""
    # Files first, then manifests: a run announces a file before it puts it there.
    found: defaultdict[str, set[str]] = defaultdict(set)
    tables = os.fspath(output / "tables")
    for folder, _, files in os.walk(tables):
        below = folder[len(tables) + 1 :]
        for file in files:
            if not file.startswith(TEMPORARY_PREFIX):
                name = f"{below}/{file}" if below else file
                found[manifest_key(name)].add(name)
    unlisted = {}
    for key, names in sorted(found.items()):
        manifest = read_manifest(output, key) or Manifest()
        if left := names - manifest.names:
            unlisted[key] = sorted(left)
    return unlisted


def proofs_of(output: Path, names: Sequence[str]) -> dict[str, tuple[str, Proof]]:
    """SHA-256 and proof of those table files that prove themselves.

    Raises StoreError (``store_newer``).
    """
    found = {}
    for name in names:
        table = TABLE_OF.get(name.split("/")[0])
        if table is None or not name.endswith(ENDING):
            continue
        try:
            found[name] = prove(output / "tables" / name, table)
        except StoreError as error:
            if error.code == "store_newer":
                raise
    return found


def verify_unlisted(output: Path) -> Iterator[TableFault]:
    """Table files that no manifest lists, and manifests that are missing."""
    for key, names in unlisted_files(output).items():
        strangers = set(names)
        if read_manifest(output, key) is None:
            proofs = proofs_of(output, names)
            strangers -= proofs.keys()
            path = manifest_file(output, key)
            if proofs and not path.exists():
                message = (
                    f"there is no manifest of {counted(len(proofs), 'file')}; a run makes it anew"
                )
                name = path.relative_to(output).as_posix()
                yield TableFault(name, "manifest_missing", message)
        for name in sorted(strangers):
            yield TableFault(name, "table_unlisted", _why_unlisted(name))


def _why_unlisted(name: str) -> str:
    if name.endswith(PUT_ASIDE):
        return "it was damaged and put aside; `check --tables --mend` removes it"
    return "the file is in no manifest: it was not published by a run; delete it"
