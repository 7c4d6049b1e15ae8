"""Tables of older versions of the program: which files they are, and how they become current.

Every table file carries its schema version. The program reads older ones as they are, with nulls
for columns that they had not; a query over files of both kinds may not. Migration writes them anew,
with the same rows and the columns of today, each file whole or not at all.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from pipeline.errors import StoreError
from pipeline.schema import SCHEMA_VERSION, TABLES, Table
from pipeline.store.manifest import WHOLE, Manifest, announce, read_manifest, update_manifest
from pipeline.store.tables import VERSION_KEY, encode_table, prepare_file, read_table


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


def migrate(output: Path) -> Counter[int]:
    """Write all files of older versions anew; the caller holds the output's lock.

    Parameters
    ----------
    output
        Output folder.

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
    for old in list(old_table_files(output)):
        _rewrite(output, old)
        done[old.version] += 1
    return done


def _rewrite(output: Path, old: OldFile) -> None:
    name = old.path.relative_to(output / "tables").as_posix()
    whole = old.path.parent.parent.name == "tables"
    month = WHOLE if whole else old.path.parent.name.removeprefix("month=")
    manifest = read_manifest(output, month, old.path.stem) or Manifest()
    accepted = manifest.accepted(name)
    rows = read_table(old.path, old.table)
    file = prepare_file(old.path, encode_table(old.path.name, rows))
    if accepted and file.before not in accepted:
        file.drop()
        raise StoreError(
            "store_read", f"{name} is not what was published; `check --tables` says what to do"
        )
    try:
        announce(output, month, old.path.stem, {name: (file.before, file.after)})
        file.land()
    except BaseException:
        file.drop()
        raise
    update_manifest(output, month, old.path.stem, {name: file.after})
