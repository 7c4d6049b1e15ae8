"""Rows of nights as the files of a table."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import polars as pl

from pipeline.schema import Table
from pipeline.store.encoding import write_table
from pipeline.store.manifest import manifest_file, manifest_key
from pipeline.store.tables import name_of, night_file


def write_nights(output: Path, table: Table, rows: pl.DataFrame) -> None:
    """Put rows into the files of their nights, in place of all that these nights have there.

    What a run has published there before proves another file: its manifest goes.
    """
    files: defaultdict[Path, list[pl.DataFrame]] = defaultdict(list)
    for (night,), part in rows.partition_by("night", as_dict=True).items():
        files[night_file(output, table, night)].append(part)
    for path, parts in files.items():
        new = pl.concat(parts)
        if path.exists():
            before = pl.read_parquet(path, hive_partitioning=False)
            kept = before.filter(~pl.col("night").is_in(new["night"].unique().implode()))
            new = pl.concat([kept, new], how="diagonal")
        write_table(path, new.sort(table.order))
        manifest_file(output, manifest_key(name_of(output, path))).unlink(missing_ok=True)
