"""How long a fleet's first night takes, beside just reading its logs.

Whole processes from outside: `fit-fleet` on a fleet of which nothing is known yet, everything
included, beside two fresh processes that read the same files into columns with the fastest reader
there is, each half of them. Cases take turns, and a ratio is one of medians of one run; absolute
times are of the machine that it ran on. Logs come from the page cache on both sides.

The other parts were measured once and stay as they were stored (`speed.json`).
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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, replace
from functools import partial
from pathlib import Path

import polars as pl

from benchmarks.day_fleets import logs_of, make_fleet, write_day
from benchmarks.results_file import Part, description, store, stored, write_parts

READERS = {"parquet": "pyarrow_parquet", "csv": "pyarrow_csv", "mcap": "plain_mcap"}
GOALS = {"parquet": 9.0, "csv": 4.0, "mcap": 1.4}
DAY_MINUTES = 1440.0
HUNDRED = 100
ENVIRONMENT = {**os.environ, "POLARS_MAX_THREADS": "1", "OMP_NUM_THREADS": "1"}


@dataclass(frozen=True, slots=True)
class Cost:
    """What a command took."""

    # elapsed_s, processor_s: on the clock, and of all its processes together.
    elapsed_s: float
    processor_s: float

    @property
    def cells(self) -> tuple[str, str]:
        return f"{self.elapsed_s:.2f} s", f"{self.processor_s:.2f} s"


def main(options: Sequence[str] = ()) -> None:
    """Measure, and write `benchmarks/results/speed.md`."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks speed")
    parser.add_argument("--repeats", type=int, default=3)
    repeats = parser.parse_args(list(options)).repeats
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as folder:
        part = hundred(Path(folder), repeats)
    words = f"{part.text} Load before it began: {load:.1f}."
    store("speed", "hundred", asdict(replace(part, text=words)))
    parts = [Part(**one) for one in stored("speed").values()]
    write_parts("speed", "As fast as reading the logs", description(__doc__), parts)


def hundred(folder: Path, repeats: int) -> Part:
    """100 motors in each format, with one worker and with two, beside just reading."""
    rows = []
    for name, reader in READERS.items():
        # One format on the disk at a time.
        day = folder / "day"
        shutil.rmtree(day, ignore_errors=True)
        write_day(day, DAY_MINUTES, 10.0, name)
        config = make_fleet(day, folder / "fleet", name, HUNDRED)
        cases = {
            "one": partial(first_night, config, 1),
            "two": partial(first_night, config, 2),
            "read": partial(reading, reader, logs_of(config)),
        }
        costs = interleaved(cases, repeats)
        one, two, read = costs["one"], costs["two"], costs["read"]
        ratio, faster = two.elapsed_s / read.elapsed_s, one.elapsed_s / two.elapsed_s
        memory = f"{worker_peak_mib(config):.0f} MiB"
        rows += [
            [f"**{name}: two workers**", *two.cells, f"**{ratio:.1f}**", "", memory],
            [f"{name}: one worker", *one.cells, "", f"{faster:.2f}", ""],
            [f"{name}: reading, {reader.replace('_', ', ')}", *read.cells, "", "", ""],
        ]
    goals = ", ".join(f"{name} {goal:g}" for name, goal in GOALS.items())
    text = (
        f"{HUNDRED} motors × 24 h × 10 Hz, four channels, temperature at 1 Hz; each log the same "
        f"file; medians of {repeats} passes. Goals: run over reading at most {goals}; two workers "
        "1.9 times as fast as one."
    )
    header = "what | elapsed | processor | over reading | faster | largest worker"
    return Part("A hundred motors", text, header, rows)


def first_night(config: Path, jobs: int) -> Cost:
    """A run over a fleet of which nothing is known yet, with its output beside the config."""
    output = config.parent.parent / "out"
    shutil.rmtree(output, ignore_errors=True)
    command = [sys.executable, "-m", "pipeline.cli", "fit-fleet", str(config)]
    return elapsed([*command, "--output", str(output), "--jobs", str(jobs), "--json"])


def reading(reader: str, files: Sequence[Path]) -> Cost:
    """Two fresh processes, each of which reads half of the files, at the same time."""
    command = [sys.executable, "-m", "benchmarks.log_readers", reader]
    halves = [half for half in (files[::2], files[1::2]) if half]
    return elapsed(*([*command, *map(str, half)] for half in halves), environment=ENVIRONMENT)


def elapsed(*commands: Sequence[str], environment: Mapping[str, str] | None = None) -> Cost:
    """Commands at the same time."""
    used, begin = _children_s(), time.perf_counter()
    processes = [
        subprocess.Popen(one, stdout=subprocess.DEVNULL, env=environment) for one in commands
    ]
    if any(process.wait() for process in processes):
        raise RuntimeError(f"{commands[0]} failed")
    return Cost(time.perf_counter() - begin, _children_s() - used)


def _children_s() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def interleaved(cases: Mapping[str, Callable[[], Cost]], repeats: int) -> dict[str, Cost]:
    """Medians of several passes, in each of which every case has its turn."""
    passes = [{name: case() for name, case in cases.items()} for _ in range(repeats)]
    return {
        name: Cost(
            *map(statistics.median, zip(*(astuple(one[name]) for one in passes), strict=True))
        )
        for name in cases
    }


def worker_peak_mib(config: Path) -> float:
    """Peak memory of the largest worker of the last run over a fleet."""
    tables = config.parent.parent / "out" / "tables" / "motor_outcomes"
    outcomes = pl.concat(pl.read_parquet(path) for path in tables.rglob("*.parquet"))
    return float(outcomes["peak_memory_mib"].max() or 0.0)  # type: ignore[arg-type]
