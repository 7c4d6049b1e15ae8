"""Published rows of a motor's nights, read month by month: for a fit without a log, and for a night
of whose logs less is there now, which replaces nothing.
"""

from __future__ import annotations

import datetime as dt
import logging
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import polars as pl

from pipeline.errors import StoreError
from pipeline.night.refit import FROM_TABLES, PublishedNight
from pipeline.night.rows import Row
from pipeline.night.stored_blocks import BLOCK_COLUMNS
from pipeline.run.night_plan import NO_LOG
from pipeline.schema import BLOCKS, NIGHTS, OF_NIGHT, Table
from pipeline.store.published import TABLE_OF
from pipeline.store.tables import days_of, read_rows

log = logging.getLogger(__name__)

RowsByTable = Mapping[str, Sequence[Row]]

# Refused by these, a row of a log is none of its samples.
NO_SAMPLES = ("missing", "duplicate_time")
# First and last sample that are kept may differ by so much: rules at the ends decide on them, too.
CLOSE = dt.timedelta(minutes=1)


class StoredNights:
    """The published nights of a motor; `unpublished` has own rows of nights without trends yet."""

    def __init__(self, output: Path, motor_id: str, unpublished: Mapping[dt.date, Row]) -> None:
        self._output = output
        self._motor_id = motor_id
        self._unpublished = unpublished
        self._month = ""
        self._nights: dict[str, dict[dt.date, pl.DataFrame]] = {}

    def rows(self, label: dt.date, tables: Iterable[Table]) -> dict[str, list[Row]]:
        """Return rows of a night by table."""
        return {table.name: self._rows(table, label) for table in tables}

    def night(self, label: dt.date) -> PublishedNight:
        """Return rows of a night."""
        rows = self.rows(label, map(TABLE_OF.__getitem__, FROM_TABLES))
        return PublishedNight(label, rows, self._of_night(BLOCKS, label))

    def _rows(self, table: Table, label: dt.date) -> list[Row]:
        """Rows of the motor in a night; none where its month's files are absent or damaged."""
        if table is NIGHTS and label in self._unpublished:
            return [dict(self._unpublished[label])]
        rows = self._of_night(table, label)
        return [] if rows is None else rows.to_dicts()

    def _of_night(self, table: Table, label: dt.date) -> pl.DataFrame | None:
        month = f"{label:%Y-%m}"
        if month != self._month:
            self._nights, self._month = {}, month
        if table.name not in self._nights:
            self._nights[table.name] = self._read(table, month)
        return self._nights[table.name].get(label)

    def _read(self, table: Table, month: str) -> dict[dt.date, pl.DataFrame]:
        every = tuple(name for name in table.schema if name != "run_id")
        columns = {BLOCKS: BLOCK_COLUMNS, NIGHTS: OF_NIGHT}.get(table, every)
        try:
            rows = read_rows(self._output, table, [self._motor_id], columns, days_of(month))
        except StoreError as error:
            log.warning("%s; no night of %s is made from it", error, month)
            return {}
        nights = rows.sort(table.key).partition_by("night", as_dict=True, maintain_order=True)
        return {key[0]: part for key, part in nights.items()}


def samples_of(quality: Iterable[Row]) -> int:
    """Return the number of different samples of all channels, by a night's rows of `quality`."""
    logged: dict[str, int] = {}
    absent = 0
    for row in quality:
        if row["channel"] != "time_base":
            # A rule on pairs of samples looks at fewer.
            logged[row["channel"]] = max(logged.get(row["channel"], 0), row["n_samples"])
            absent += row["n_refused"] if row["reason"] in NO_SAMPLES else 0
    return sum(logged.values()) - absent


def why_less(made: RowsByTable, published: RowsByTable) -> str | None:
    """Return why a night is made of less than its published rows, in words; None: it is not."""
    now, before = (samples_of(rows.get("quality", ())) for rows in (made, published))
    if now < before:
        return f"its logs hold {now} samples now, and held {before}" if now else NO_LOG
    (new,), (old,) = made["nights"], published["nights"]
    for name, at, sign in (("first_sample", "begin", -1), ("last_sample", "end", 1)):
        if old[name] is None:
            continue
        if new[name] is None:
            return "no sample of its logs is kept"
        if sign * (old[name] - new[name]) > CLOSE:
            return f"its logs {at} at {new[name]:%H:%M} UTC now, and at {old[name]:%H:%M} before"
    return None
