"""CSV and Parquet logs: seconds to parse a CSV beside three parsers, and the memory of a long day.

The CSV is in the plain dialect: an ISO 8601 stamp in UTC and four channels. The others parse the
same file with its time stamps to columns; ours gives the channels in their units as well. They are
run in turn, round after round, in one process, with the threads that each takes by itself; the
ratios are medians of those within a round. The memory is that of a process that does nothing but
read a day of four channels at 100 Hz.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import duckdb
import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.csv as arrow_csv

from benchmarks.results_file import write_results
from pipeline.config.motors import Channel, Channels, Logs
from pipeline.ingest import read_log

ROWS = 1_000_000
DAY_ROWS = 24 * 3600 * 100
ROUNDS = 25
CHANNELS: Channels = {
    "pressure_difference": Channel(source="pressure_difference", unit="bar"),
    "oil_temperature": Channel(source="oil_temperature", unit="degC"),
    "speed": Channel(source="speed", unit="rpm"),
    "leakage_flow": Channel(source="leakage_flow", unit="l/min"),
}


def main() -> None:
    """Measure and write `benchmarks/results/table_reading.md`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        write(path, ROWS)
        rows = _speed(path)
        for name in ("day.csv", "day.parquet"):
            write(Path(folder) / name, DAY_ROWS)
            command = [sys.executable, "-m", __name__, str(Path(folder) / name)]
            peak = int(subprocess.check_output(command)) / 1024
            what = f"{name}, {DAY_ROWS} rows, peak of the process"
            rows.append([what, f"{peak:.0f} MiB", "", "", ""])
    header = ("what", "elapsed", "processor", "ours takes, elapsed", "ours takes, processor")
    write_results("table_reading", "CSV and Parquet: time and memory", header, rows)


def write(path: Path, rows: int) -> None:
    """Four channels at 100 Hz."""
    rng = np.random.default_rng(1)
    first = np.datetime64("2025-03-01T06:00:00.000", "ms")
    digits = {"pressure_difference": 2, "oil_temperature": 1, "speed": 2, "leakage_flow": 4}
    values = {name: rng.normal(50.0, 5.0, rows).round(kept) for name, kept in digits.items()}
    frame = pl.DataFrame({"time": first + 10 * np.arange(rows), **values})
    if path.suffix == ".parquet":
        frame.with_columns(pl.col("time").dt.replace_time_zone("UTC")).write_parquet(path)
        return
    frame.with_columns(pl.col("time").dt.strftime("%Y-%m-%dT%H:%M:%S%.3fZ")).write_csv(path)


def _speed(path: Path) -> list[list[str]]:
    parsers: dict[str, Callable[[Path], object]] = {
        "ours": _ours,
        "PyArrow": _pyarrow,
        "DuckDB": _duckdb,
        "Polars": _polars,
    }
    elapsed: dict[str, list[float]] = {name: [] for name in parsers}
    processor: dict[str, list[float]] = {name: [] for name in parsers}
    for _ in range(ROUNDS):
        for name, parse in parsers.items():
            begin, used = time.perf_counter(), time.process_time()
            parse(path)
            elapsed[name].append(time.perf_counter() - begin)
            processor[name].append(time.process_time() - used)
    return [
        [
            f"CSV, {ROWS} rows, {name}",
            *(f"{statistics.median(taken[name]):.3f} s" for taken in (elapsed, processor)),
            *(f"{_ratio(taken['ours'], taken[name]):.2f}" for taken in (elapsed, processor)),
        ]
        for name in parsers
    ]


def _ratio(ours: list[float], others: list[float]) -> float:
    return statistics.median(one / other for one, other in zip(ours, others, strict=True))


def _logs(log_format: str) -> Logs:
    return Logs(format=log_format, files=("*",))


def _ours(path: Path) -> object:
    return read_log(path, _logs("csv"), CHANNELS)


def _pyarrow(path: Path) -> object:
    types = {"time": pa.timestamp("us", "UTC"), **dict.fromkeys(CHANNELS, pa.float64())}
    return arrow_csv.read_csv(path, convert_options=arrow_csv.ConvertOptions(column_types=types))


def _duckdb(path: Path) -> object:
    columns = {"time": "TIMESTAMPTZ", **dict.fromkeys(CHANNELS, "DOUBLE")}
    return duckdb.read_csv(str(path), header=True, columns=columns).fetchnumpy()


def _polars(path: Path) -> object:
    frame = pl.read_csv(path, schema_overrides=dict.fromkeys(CHANNELS, pl.Float64))
    stamp = pl.col("time").str.to_datetime("%Y-%m-%dT%H:%M:%S%.fZ", time_unit="us")
    return frame.with_columns(stamp)


if __name__ == "__main__":
    log = Path(sys.argv[1])
    read_log(log, _logs("csv" if log.suffix == ".csv" else "parquet"), CHANNELS)
    # Not `ru_maxrss`: it begins with the peak of the process that started this one.
    status = Path("/proc/self/status").read_text("ascii")
    sys.stdout.write(status.split("VmHWM:")[1].split()[0])
