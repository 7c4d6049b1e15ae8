"""Tables as CSV, for spreadsheets and other programs that do not read Parquet.

Text from logs and file names that looks like a formula is written so that a spreadsheet does not
run it.
"""

from __future__ import annotations

import datetime as dt
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import polars as pl

from pipeline.errors import UsageError
from pipeline.schema import TABLES, TIMESTAMP, Table
from pipeline.store.atomic_files import put, remove_leftovers
from pipeline.store.tables import existing_tables, files_of, read_table

BYTE_ORDER_MARK = "\ufeff"
TIME_FORMAT = "%Y-%m-%dT%H:%M:%S%.6fZ"

# Characters that begin a formula for Excel, LibreOffice or Google Sheets, full-width forms
# included: OWASP, "CSV Injection"; ASVS 5, requirement 1.2.10.
_FORMULA_START = "=+\\-@＝＋－＠"
_UNSAFE_START = rf"^([{_FORMULA_START}\t\r\n\x00])"


@dataclass(frozen=True, slots=True)
class CsvRequest:
    """What is exported, and how: by default all, in the dialect that most programs read."""

    tables: tuple[Table, ...] = TABLES  # in the order in which they are written
    motors: tuple[str, ...] = ()  # empty: all; tables without a motor are not affected
    # First and last night, or day (UTC) of what has a time instead; others are not affected.
    since: dt.date | None = None
    until: dt.date | None = None
    separator: str = ","
    decimal: str = "."
    byte_order_mark: bool = False

    def __post_init__(self) -> None:
        if self.separator == self.decimal:
            raise UsageError("csv_dialect", "--decimal , needs another --separator, such as ';'")


def tables_named(names: Sequence[str]) -> tuple[Table, ...]:
    """Return tables by their names; all of them where none is named.

    Raises UsageError (``unknown_table``) if there is no table of a name.
    """
    known = {table.name: table for table in TABLES}
    strangers = [name for name in names if name not in known]
    if strangers:
        raise UsageError(
            "unknown_table",
            f"--tables: no table {', '.join(strangers)}; there are {', '.join(known)}",
        )
    return tuple(known[name] for name in dict.fromkeys(names)) or TABLES


def export_csv(output: Path, folder: Path, request: CsvRequest) -> Iterator[tuple[Path, int]]:
    """Write each table as a CSV file, whole or not at all; yield the files, and their rows.

    Null is an empty cell, an empty text is quoted; times are ISO 8601 in UTC, lists JSON,
    numbers as short as they can be read back unchanged.

    Raises UsageError (``no_tables``, ``csv_folder``) if there are none yet, or the folder is the
    tables' own; StoreError if a table cannot be read or a file not be written.
    """
    tables = existing_tables(output)
    if folder.resolve().is_relative_to(tables.resolve()):
        raise UsageError("csv_folder", f"{folder} lies within the tables; name another folder")
    remove_leftovers(folder)
    for table in request.tables:
        yield _export_table(output, folder, table, request)


def _export_table(
    output: Path, folder: Path, table: Table, request: CsvRequest
) -> tuple[Path, int]:
    path, count = folder / f"{table.name}.csv", 0
    chosen, separator = _choose_rows(table, request), request.separator

    def write(file: BinaryIO) -> None:
        nonlocal count
        file.write((BYTE_ORDER_MARK if request.byte_order_mark else "").encode())
        file.write((separator.join(table.schema) + "\n").encode())
        for path in files_of(output, table):  # in turn: memory does not grow with the history
            rows = as_text(read_table(path, table).filter(chosen), separator)
            count += rows.height
            text = rows.write_csv(
                include_header=False, separator=separator, decimal_comma=request.decimal == ","
            )
            file.write(text.encode())

    put(path, write)
    return path, count


def _choose_rows(table: Table, request: CsvRequest) -> pl.Expr:
    """Return rows of the motors, and of the nights or else the days of the time in the key."""
    chosen = pl.lit(value=True)
    if request.motors and "motor_id" in table.schema:
        chosen &= pl.col("motor_id").is_in(request.motors)
    times = [pl.col(column).dt.date() for column in table.key if table.schema[column] == TIMESTAMP]
    for day in [pl.col("night")] if "night" in table.schema else times[:1]:
        if request.since is not None:
            chosen &= day >= request.since
        if request.until is not None:
            chosen &= day <= request.until
    return chosen


def as_text(rows: pl.DataFrame, separator: str = ",") -> pl.DataFrame:
    """Return rows as they go into CSV: times in ISO 8601, lists in JSON, text that stays text."""
    columns = []
    for name, kind in rows.schema.items():
        if kind == pl.String:
            columns.append(_harmless(pl.col(name), separator))
        elif kind == TIMESTAMP:
            columns.append(pl.col(name).dt.strftime(TIME_FORMAT))
        elif isinstance(kind, pl.List):
            texts = [None if value is None else _json(value) for value in rows[name].to_list()]
            columns.append(pl.lit(pl.Series(name, texts, dtype=pl.String)))
    return rows.with_columns(columns)


def _harmless(text: pl.Expr, separator: str) -> pl.Expr:
    # Also within a text, where a spreadsheet with another separator would begin a cell.
    others = ",;".replace(separator, "")
    within = rf"([{others}\t\r\n\x00])([{_FORMULA_START}])"
    return text.str.replace_all(within, "${1}'${2}").str.replace(_UNSAFE_START, "'${1}")


def _json(values: Sequence[object]) -> str:
    """Return a list as JSON, which has no number that is not finite: null stands for it."""
    finite = [
        None if isinstance(value, float) and not math.isfinite(value) else value for value in values
    ]
    return json.dumps(finite, ensure_ascii=False)
