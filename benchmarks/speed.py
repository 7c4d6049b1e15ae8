"""How long a fleet's first night takes, beside just reading its logs.

Whole processes from outside, with logs from the page cache; `benchmarks/results/speed.md` says how.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import polars as pl

from benchmarks import RESULTS, made
from benchmarks.day_fleets import MOTORS, logs_of, make_fleet
from validation.tables import Row, Table, show

HUNDRED, DAY_MINUTES, RATE_HZ = 100, 1440.0, 10.0
ONE_THREAD = {"POLARS_MAX_THREADS": "1", "OMP_NUM_THREADS": "1"}  # of processes that just read


def main(options: Sequence[str] = ()) -> None:
    """Measure, and put the table of a hundred motors into its page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks speed")
    parser.add_argument("--passes", type=int, default=3)
    passes = parser.parse_args(list(options)).passes
    how = made(passes=str(passes))
    with tempfile.TemporaryDirectory() as folder:
        # One format on the disk at a time.
        rows = [row for name in MOTORS for row in _hundred(Path(folder), name, passes)]
    show([how, Table("a hundred motors", rows)], RESULTS / "speed.md")


def _hundred(folder: Path, name: str, passes: int) -> list[Row]:
    """Motors in a format with one worker and with two, beside just reading, in turns."""
    config = make_fleet(folder / "fleet", name, HUNDRED, DAY_MINUTES, RATE_HZ)
    output, logs = folder / "out", list(map(str, logs_of(config)))
    fit = ["pipeline.cli", "fit-fleet", str(config), "--output", str(output), "--jobs"]
    read = ["benchmarks.log_readers", name]
    cases = {
        "reading": ([*read, *logs[::2]], [*read, *logs[1::2]]),
        "one worker": ([*fit, "1"],),
        "two workers": ([*fit, "2"],),
    }
    costs: dict[str, list[tuple[float, float]]] = {case: [] for case in cases}
    for _ in range(passes):
        for case, commands in cases.items():
            shutil.rmtree(output, ignore_errors=True)
            costs[case].append(_cost(commands, {} if "worker" in case else ONE_THREAD))
    medians = {case: [*map(statistics.median, zip(*of, strict=True))] for case, of in costs.items()}
    reading, alone, two = (elapsed for elapsed, _ in medians.values())
    tables = (output / "tables" / "run_motors").rglob("*.parquet")
    outcomes = pl.concat(map(pl.read_parquet, tables))
    ratios = {"over reading": f"{two / reading:.1f}", "faster": f"{alone / two:.2f}"}
    of_two = {**ratios, "largest worker": f"{outcomes['peak_memory_mib'].to_numpy().max():.0f} MiB"}
    return [
        {
            "logs": name,
            "what": case,
            "elapsed": f"{elapsed:.2f} s",
            "processor": f"{processor:.2f} s",
            **(of_two if case == "two workers" else dict.fromkeys(of_two, "")),
        }
        for case, (elapsed, processor) in medians.items()
    ]


def _cost(commands: Sequence[Sequence[str]], environment: Mapping[str, str]) -> tuple[float, float]:
    """Seconds of modules run at the same time: on the clock, and of all processes together."""
    used, begin = _children_s(), time.perf_counter()
    processes = [
        subprocess.Popen(
            [sys.executable, "-m", *command],
            stdout=subprocess.DEVNULL,
            env={**os.environ, **environment},
        )
        for command in commands
    ]
    if any(process.wait() for process in processes):
        raise RuntimeError(f"{commands[0]} failed")
    return time.perf_counter() - begin, _children_s() - used


def _children_s() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime
