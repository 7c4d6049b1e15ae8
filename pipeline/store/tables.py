"""Tables on disk: Parquet files of a month, or of a night, each replaced whole or not at all.

Rows of a night lie together in its month's file. A reader sees a file as it was or as it is: the
checksums of its pages are compared, and the run proves files by their SHA-256.
"""

from __future__ import annotations

import datetime as dt
from calendar import monthrange
from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import polars as pl

from pipeline.errors import StoreError, UsageError
from pipeline.schema import NIGHTLY_TABLES, Table
from pipeline.store.encoding import damaged, from_parquet

MONTH_PREFIX = "month="
# Ending of a damaged file that a run has put aside.
PUT_ASIDE = ".damaged"
ENDING = ".parquet"


def existing_tables(output: Path) -> Path:
    """Folder of all tables.

    Raises UsageError (``no_tables``) if there are none.
    """
    tables = output / "tables"
    if not tables.is_dir():
        raise UsageError("no_tables", f"there are no tables in {output}; run fit-fleet first")
    return tables


def table_folder(output: Path, table: Table) -> Path:
    """Folder of a table."""
    return output / "tables" / table.name


def whole_file(output: Path, table: Table) -> Path:
    """File of a table that is one file."""
    return table_folder(output, table) / f"{table.name}{ENDING}"


def label_of(table: Table, night: dt.date) -> str:
    """Name of the file that has a night: its own, YYYY-MM-DD, or that of its month, YYYY-MM."""
    return str(night) if table in NIGHTLY_TABLES else f"{night:%Y-%m}"


def labelled_file(output: Path, table: Table, label: str) -> Path:
    """File of a night, YYYY-MM-DD, or of a month, YYYY-MM."""
    return table_folder(output, table) / f"{MONTH_PREFIX}{label[:7]}" / f"{label}{ENDING}"


def night_file(output: Path, table: Table, night: dt.date) -> Path:
    """File that has a night."""
    return labelled_file(output, table, label_of(table, night))


def name_of(output: Path, path: Path) -> str:
    """Path of a file relative to the folder of the tables, as the state file names it."""
    return path.relative_to(output / "tables").as_posix()


def days_of(label: str) -> list[dt.date]:
    """Nights that a file's name says: one, or all of a month.

    Raises
    ------
    ValueError
        If it is neither.

    Examples
    --------
    >>> days_of("2026-02-03"), len(days_of("2026-02"))
    ([datetime.date(2026, 2, 3)], 28)
    """
    if len(label) == len("2026-02"):
        first = dt.date.fromisoformat(f"{label}-01")
        return [first.replace(day=one + 1) for one in range(monthrange(first.year, first.month)[1])]
    return [dt.date.fromisoformat(label)]


def is_label(text: str) -> bool:
    """True for the name of a file of a month or of a night."""
    try:
        days = days_of(text)
    except ValueError:
        return False
    return text in (str(days[0]), f"{days[0]:%Y-%m}")


def files_of(output: Path, table: Table, nights: Collection[dt.date] | None = None) -> list[Path]:
    """Files of a table in time order: all, or those that may have some nights.

    Files of other names are left out.

    Raises StoreError if a folder cannot be listed.
    """
    whole = whole_file(output, table)
    if whole.exists():
        return [whole]
    if nights is None:
        return [labelled_file(output, table, label) for label in _labels(output, table)]
    asked = {label for one in nights for label in (f"{one:%Y-%m}", str(one))}
    paths = (labelled_file(output, table, label) for label in sorted(asked))
    return [path for path in paths if path.exists()]


def _labels(output: Path, table: Table) -> list[str]:
    folder = table_folder(output, table)
    return sorted(
        label
        for month in _names_in(folder)
        for name in _names_in(folder / month)
        if is_label(label := name.removesuffix(ENDING))
        and (month, name) == (f"{MONTH_PREFIX}{label[:7]}", f"{label}{ENDING}")
    )


def nights_back(output: Path, table: Table) -> Iterator[dt.date]:
    """Nights of a table, the newest first; one with a file of its own may have no rows.

    Raises StoreError if a file is damaged.
    """
    for path in reversed(files_of(output, table)):
        if len(path.stem) > len("2026-02"):
            yield dt.date.fromisoformat(path.stem)
        else:
            yield from _nights_in(path, table, path.stat().st_mtime_ns)


@lru_cache(maxsize=512)
def _nights_in(path: Path, table: Table, _: int) -> tuple[dt.date, ...]:
    """Nights of a file that was last changed at a time; a process asks for each motor."""
    nights = read_table(path, table, columns=("night",))["night"]
    return tuple(nights.drop_nulls().unique().sort(descending=True))


def _names_in(folder: Path) -> list[str]:
    try:
        return [path.name for path in folder.iterdir()]
    except (FileNotFoundError, NotADirectoryError):
        return []
    except OSError as error:
        raise StoreError(
            "store_read", f"{folder.name} cannot be listed: {error.strerror}"
        ) from error


def read_table(
    path: Path,
    table: Table,
    nights: Collection[dt.date] | None = None,
    columns: Sequence[str] = (),
) -> pl.DataFrame:
    """Rows of a table file, or of some nights in it; columns that an older version lacks are null.

    Raises StoreError if the file is damaged (``store_read``), or of a newer version of the program
    (``store_newer``).
    """
    return _rows(path, table, columns, {} if nights is None else {"night": nights})


def read_rows(
    output: Path,
    table: Table,
    motor_ids: Sequence[str],
    columns: Sequence[str] = (),
    nights: Collection[dt.date] | None = None,
) -> pl.DataFrame:
    """The published rows of some motors in all files of a table, or of some nights (None: all).

    In time order. Columns, all if none are named, that an older file lacks are null.

    Raises StoreError if a file is damaged.
    """
    empty = pl.DataFrame(schema=table.schema).select(columns or pl.all())
    wanted: dict[str, Collection[Any]] = {"motor_id": motor_ids}
    if nights is not None:
        wanted["night"] = nights
    paths = files_of(output, table, nights) if all(wanted.values()) else []
    return pl.concat([empty, *(_rows(path, table, columns, wanted) for path in paths)])


def _rows(
    path: Path, table: Table, columns: Sequence[str], wanted: Mapping[str, Collection[Any]]
) -> pl.DataFrame:
    """Rows of a file with wanted values, some columns of them; raises as `read_table`."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise damaged(path, table, error) from error
    return from_parquet(path, table, content, columns, wanted)
