"""Nights of a year as files of nights and of months: number of files, and seconds to read them.

The rows are those of a night of the demo's six motors, copied to 300 motors and 365 nights with
other figures each night, in three tables. All files are in the system's cache.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import duckdb
import numpy as np
import polars as pl

from benchmarks.results_file import write_results
from pipeline.config import load_fleet
from pipeline.demo import write_demo
from pipeline.run.fleet import RunRequest, run_fleet
from pipeline.schema import FITS, OPERATION, TRENDS, Table
from pipeline.store.encoding import encode_table
from pipeline.store.manifest import manifest_keys, update_manifest
from pipeline.store.months import join_months, last_month_over
from pipeline.store.tables import night_file, read_rows
from pipeline.store.verification import compare_published
from pipeline.trends.rows.latest_states import latest_states

MOTORS, NIGHTS = 300, 365
FIRST = dt.date(2025, 1, 1)
LAST = FIRST + dt.timedelta(days=NIGHTS - 1)
TABLES = (FITS, OPERATION, TRENDS)
ROUNDS = 3


def main() -> None:
    """Measure and write `benchmarks/results/month_files.md`."""
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "out"
        templates = _fitted_night(Path(folder))
        for number in range(NIGHTS):
            _write_night(output, templates, number)
        before = _measured(output)
        staging = output / "staging"
        staging.mkdir()
        joining = _seconds(lambda: join_months(output, staging, last_month_over(LAST, 14)), 1)
        after = _measured(output)
    rows = [[name, before[name], after[name]] for name in before]
    rows.append(["joining eleven months, once", "", joining])
    title = f"Files of nights and of months: {MOTORS} motors, {NIGHTS} nights, {len(TABLES)} tables"
    write_results("month_files", title, "what | a file a night | closed months joined", rows)


def _fitted_night(folder: Path) -> Mapping[Table, pl.DataFrame]:
    """The rows of one motor and night of the demo, by table."""
    demo = folder / "demo"
    write_demo(demo, nights=2, minutes=120.0, workers=2)
    fleet = load_fleet(demo / "configs" / "fleet.toml")
    chosen = fleet.motors[-1].motor_id
    output = folder / "fitted"
    run_fleet(RunRequest(replace(fleet, output=output), motors=(chosen,)))
    last = max((output / "tables" / "fits").rglob("*.parquet")).stem
    night = dt.date.fromisoformat(last)
    return {table: pl.read_parquet(night_file(output, table, night)) for table in TABLES}


def _write_night(output: Path, templates: Mapping[Table, pl.DataFrame], number: int) -> None:
    night = FIRST + dt.timedelta(days=number)
    ids = pl.Series("motor_id", [f"M{motor:03}" for motor in range(MOTORS)])
    rng = np.random.default_rng(number)
    listed: dict[str, str | None] = {}
    for table in TABLES:
        rows = templates[table].drop("motor_id").join(ids.to_frame(), how="cross")
        moved = [
            pl.col(name) * factor
            for (name, kind), factor in zip(
                table.schema.items(), rng.normal(1.0, 0.01, len(table.schema)), strict=True
            )
            if kind == pl.Float64 and name not in table.key
        ]
        rows = rows.with_columns(pl.lit(night).alias("night"), *moved)
        content = encode_table(table.name, rows.select(table.schema.keys()).sort(table.key))
        path = night_file(output, table, night)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
        digest = hashlib.sha256(content).hexdigest()
        listed[path.relative_to(output / "tables").as_posix()] = digest
    update_manifest(output, f"{night:%Y-%m}", str(night), listed)


def _measured(output: Path) -> dict[str, str]:
    files = list((output / "tables").rglob("*.parquet"))
    trends = f"{output}/tables/trends/**/*.parquet"
    fits = f"{output}/tables/fits/**/*.parquet"
    one = [f"M{MOTORS // 2:03}"]
    motors = [f"M{motor:03}" for motor in range(MOTORS)]

    def duck(query: str, pattern: str) -> object:
        with duckdb.connect() as connection:
            return connection.execute(query, [pattern]).fetchall()

    def scan(pattern: str) -> pl.LazyFrame:
        return pl.scan_parquet(pattern, hive_partitioning=False)

    course = (
        "SELECT night, value FROM read_parquet(?, union_by_name = true) WHERE motor_id = 'M150'"
    )
    return {
        "files in tables/": str(len(files)),
        "MiB": f"{sum(path.stat().st_size for path in files) / 2**20:.0f}",
        "DuckDB: fits, number of rows": _seconds(
            lambda: duck("SELECT count(*), max(night) FROM read_parquet(?)", fits)
        ),
        "DuckDB: trends of a motor": _seconds(lambda: duck(course, trends)),
        "Polars: fits, number of rows": _seconds(
            lambda: scan(fits).select(pl.len(), pl.col("night").max()).collect()
        ),
        "Polars: trends of a motor": _seconds(
            lambda: scan(trends).filter(motor_id=one[0]).select("night", "value").collect()
        ),
        "ours: fits of a motor, checked": _seconds(lambda: read_rows(output, FITS, one)),
        "ours: state of all motors (`latest`)": _seconds(lambda: latest_states(output, motors), 1),
        "ours: every published file exists": _seconds(
            lambda: compare_published(output, manifest_keys(output), lambda _: False)
        ),
    }


def _seconds(do: Callable[[], object], rounds: int = ROUNDS) -> str:
    taken = []
    for _ in range(rounds):
        begin = time.perf_counter()
        do()
        taken.append(time.perf_counter() - begin)
    return f"{min(taken):.2f} s"
