"""Whole commands, measured from outside: elapsed time, processor time, memory of the parent."""

from __future__ import annotations

import os
import resource
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path

import polars as pl

ENVIRONMENT = {**os.environ, "POLARS_MAX_THREADS": "1", "OMP_NUM_THREADS": "1"}


@dataclass(frozen=True, slots=True)
class Cost:
    """What a command took."""

    # elapsed_s, processor_s: on the clock, and of all its processes together.
    elapsed_s: float
    processor_s: float
    parent_mib: float = 0.0  # peak memory of the parent process; 0 where nobody looked


def fit_command(config: Path, jobs: int) -> list[str]:
    """The whole of `fit-fleet`, with its output beside the config."""
    output = str(config.parent.parent / "out")
    command = [sys.executable, "-m", "pipeline.cli", "fit-fleet", str(config)]
    return [*command, "--output", output, "--jobs", str(jobs), "--json"]


def first_night(config: Path, jobs: int) -> Cost:
    """A run over a fleet of which nothing is known yet."""
    shutil.rmtree(config.parent.parent / "out", ignore_errors=True)
    return elapsed(fit_command(config, jobs), look=True)


def reading(reader: str, files: Sequence[Path]) -> Cost:
    """Two fresh processes, each of which reads half of the files, at the same time."""
    command = [sys.executable, "-m", "benchmarks.log_readers", reader]
    halves = [half for half in (files[::2], files[1::2]) if half]
    return elapsed(*([*command, *map(str, half)] for half in halves), environment=ENVIRONMENT)


def elapsed(
    *commands: Sequence[str], look: bool = False, environment: Mapping[str, str] | None = None
) -> Cost:
    """Commands at the same time; with `look` the memory of the first is looked at."""
    used, begin = _children_s(), time.perf_counter()
    processes = [
        subprocess.Popen(one, stdout=subprocess.DEVNULL, env=environment) for one in commands
    ]
    peak = _peak_mib_of(processes[0]) if look else 0.0
    if any(process.wait() for process in processes):
        raise RuntimeError(f"{commands[0]} failed")
    return Cost(time.perf_counter() - begin, _children_s() - used, peak)


def interleaved(cases: Mapping[str, Callable[[], Cost]], repeats: int) -> dict[str, Cost]:
    """Medians of several passes, in each of which every case has its turn."""
    found: dict[str, list[Cost]] = {name: [] for name in cases}
    for _ in range(repeats):
        for name, case in cases.items():
            found[name].append(case())
    return {
        name: Cost(*map(statistics.median, zip(*map(astuple, costs), strict=True)))
        for name, costs in found.items()
    }


def worker_peak_mib(config: Path) -> float:
    """Peak memory of the largest worker of the last run over a fleet."""
    tables = config.parent.parent / "out" / "tables" / "motor_outcomes"
    outcomes = pl.concat(pl.read_parquet(path) for path in tables.rglob("*.parquet"))
    return float(outcomes["peak_memory_mib"].max() or 0.0)  # type: ignore[arg-type]


def _children_s() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def _peak_mib_of(process: subprocess.Popen[bytes]) -> float:
    """Peak of the process itself, without its children, looked at until it ends."""
    peak_kib = 0
    while process.poll() is None:
        try:
            status = Path(f"/proc/{process.pid}/status").read_text("ascii")
        except (FileNotFoundError, ProcessLookupError):
            break
        lines = [line for line in status.splitlines() if line.startswith("VmHWM")]
        peak_kib = max([peak_kib, *(int(line.split()[1]) for line in lines)])
        time.sleep(0.02)
    return peak_kib / 1024
