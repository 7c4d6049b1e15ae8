"""Staged rows become tables: night by night, each file whole, its manifest last."""

from __future__ import annotations

import datetime as dt
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import polars as pl

from pipeline.manifest import update_manifest
from pipeline.schema import Table, frame
from pipeline.store import (
    Published,
    StagedRows,
    publish_night,
    publish_run_table,
    table_folder,
    write_table,
)

# What is still to be done with all rows of a night, given the motors whose rows are new.
Finish = Callable[[pl.DataFrame, Sequence[str]], pl.DataFrame]
# Manifest of the tables that are one file.
WHOLE = "whole"


@dataclass(slots=True)
class Publisher:
    """Publishes what the tasks of a run have staged.

    Parameters
    ----------
    output, staging
        Output folder, and the run's folder of staged rows.
    run_id
        Goes into every row.

    Attributes
    ----------
    lost
        Nights of which a file was damaged, with the motors whose rows are new: those of the others
        have to be made anew.
    """

    output: Path
    staging: Path
    run_id: str
    lost: dict[dt.date, set[str]] = field(default_factory=dict)

    def nights(
        self,
        tables: Iterable[Table],
        motor_ids: Sequence[str],
        finish: Mapping[str, Finish] | None = None,
    ) -> None:
        """Publish the staged rows of some motors.

        Parameters
        ----------
        tables
            Which tables.
        motor_ids
            Whose rows.
        finish
            By table, what is still to be done with a night's rows.

        Raises
        ------
        StoreError
            If a file cannot be written.
        """
        done: defaultdict[dt.date, list[Published]] = defaultdict(list)
        for table in tables:
            staged = self.staged(table, motor_ids)
            last = (finish or {}).get(table.name, _as_they_are)
            for night in sorted({night for rows in staged.values() for night in rows.nights}):
                done[night].append(self._night(table, night, staged, last))
        for night, files in sorted(done.items()):
            self._record(f"{night:%Y-%m}", night.isoformat(), files)

    def staged(self, table: Table, motor_ids: Sequence[str]) -> dict[str, StagedRows]:
        """The staged rows of a table by motor; a motor that has none is left out."""
        folder = self.staging / table.name
        paths = {motor_id: folder / f"{motor_id}.arrow" for motor_id in motor_ids}
        return {motor_id: StagedRows(path) for motor_id, path in paths.items() if path.exists()}

    def _night(
        self, table: Table, night: dt.date, staged: Mapping[str, StagedRows], finish: Finish
    ) -> Published:
        new = {
            motor_id: found
            for motor_id, rows in staged.items()
            if (found := rows.rows(night)) is not None
        }
        published = publish_night(
            self.output, table, night, new, self.run_id, lambda rows: finish(rows, list(new))
        )
        if published.lost_rows:
            self.lost.setdefault(night, set()).update(new)
        return published

    def whole(self, table: Table, rows: pl.DataFrame) -> None:
        """Publish a table that is one file.

        Raises
        ------
        StoreError
            If it cannot be written.
        """
        path = table_folder(self.output, table) / f"{table.name}.parquet"
        published = Published(path, write_table(path, rows), lost_rows=False)
        self._record(WHOLE, table.name, [published])

    def of_run(
        self, started: dt.datetime, rows: Mapping[Table, Sequence[Mapping[str, Any]]]
    ) -> None:
        """Publish the tables that have a file a run.

        Raises
        ------
        StoreError
            If one cannot be written.
        """
        files = [
            publish_run_table(self.output, table, started, frame(table, some))
            for table, some in rows.items()
        ]
        self._record(f"{started:%Y-%m}", files[0].path.stem, files)

    def _record(self, month: str, name: str, files: Sequence[Published]) -> None:
        root = self.output / "tables"
        digests = {one.path.relative_to(root).as_posix(): one.sha256 for one in files}
        update_manifest(self.output, month, name, digests)


def _as_they_are(rows: pl.DataFrame, _: Sequence[str]) -> pl.DataFrame:
    return rows
