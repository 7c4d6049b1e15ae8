"""Tables of older versions of the program: which files they are, and how they become current.

Every table file carries its schema version. The program reads older ones as they are, with nulls
for columns that they had not; a query over files of both kinds may not. Migration writes them anew,
with the same rows and the columns of today, each file whole or not at all.
"""

from __future__ import annotations

import hashlib
import os
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from pipeline.errors import StoreError
from pipeline.manifest import listed_files, update_manifest
from pipeline.schema import SCHEMA_VERSION, TABLES, Table
from pipeline.store import VERSION_KEY, read_table, write_table


@dataclass(frozen=True, slots=True)
class OldFile:
    """A table file of an older version.

    Attributes
    ----------
    path, table, version
        The file, its table, and the schema version that wrote it; 0 where it does not say.
    """

    path: Path
    table: Table
    version: int


def old_table_files(output: Path) -> Iterator[OldFile]:
    """Table files of older versions, in order; only footers are read.

    Raises
    ------
    StoreError
        If a footer cannot be read (``store_read``), or a file is of a newer version
        (``store_newer``).
    """
    for table in TABLES:
        for path in sorted((output / "tables" / table.name).glob("**/*.parquet")):
            version = version_of(path)
            if version > SCHEMA_VERSION:
                raise StoreError(
                    "store_newer", f"{path.name} is of schema version {version}; update the program"
                )
            if version < SCHEMA_VERSION:
                yield OldFile(path, table, version)


def version_of(path: Path) -> int:
    """Schema version that a table file says; 0 where it says none.

    Raises
    ------
    StoreError
        ``store_read``.
    """
    try:
        metadata = pq.read_metadata(path).metadata or {}
        return int(metadata.get(VERSION_KEY.encode(), b"0"))
    except (OSError, ValueError, pa.ArrowException) as error:
        raise StoreError(
            "store_read", f"{path.name} of {path.parent.parent.name} is damaged: {error}"
        ) from error


def migrate(output: Path, staging: Path) -> Counter[int]:
    """Write all files of older versions anew; the caller holds the output's lock.

    Parameters
    ----------
    output
        Output folder.
    staging
        Folder on the same disk for files on their way.

    Returns
    -------
    Counter of int
        Files by the version that they were of.

    Raises
    ------
    StoreError
        If a file is damaged or of a newer version, or cannot be written; those before it are done.
    """
    done: Counter[int] = Counter()
    listed = listed_files(output)
    for old in list(old_table_files(output)):
        _rewrite(output, staging, old, listed)
        done[old.version] += 1
    return done


def _rewrite(output: Path, staging: Path, old: OldFile, listed: Mapping[str, str]) -> None:
    """Manifest first, then the file: repeated after a crash in between, both come out the same."""
    name = old.path.relative_to(output / "tables").as_posix()
    with old.path.open("rb") as stream:
        before = hashlib.file_digest(stream, "sha256").hexdigest()
    fresh = staging / name
    after = write_table(fresh, read_table(old.path, old.table))
    if listed.get(name, before) not in (before, after):
        raise StoreError(
            "store_read", f"{name} is not what was published; `check --tables` says what to do"
        )
    whole = old.path.parent.parent.name == "tables"
    month = "whole" if whole else old.path.parent.name.removeprefix("month=")
    update_manifest(output, month, old.path.stem, {name: after})
    try:
        fresh.replace(old.path)
        _flush(old.path.parent)
    except OSError as error:
        raise StoreError("store_write", f"{name} cannot be written: {error.strerror}") from error


def _flush(folder: Path) -> None:
    """Make a rename outlive a power cut."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
