"""Whole commands, measured from outside: elapsed time, processor time, memory of the parent."""

from __future__ import annotations

import compileall
import ctypes
import os
import resource
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import polars as pl

IN_ACCESS = 1
ROOT = Path(__file__).parents[1]
ENVIRONMENT = {**os.environ, "POLARS_MAX_THREADS": "1", "OMP_NUM_THREADS": "1"}


def compile_sources() -> None:
    """Compile the program's modules, as an installer does: no measured process has to."""
    for package in ("leakage", "pipeline", "benchmarks"):
        compileall.compile_dir(ROOT / package, quiet=2)


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


def first_night(config: Path, jobs: int, *, look_at_parent: bool = False) -> Cost:
    """A run over a fleet of which nothing is known yet."""
    shutil.rmtree(config.parent.parent / "out", ignore_errors=True)
    used = _children_s()
    begin = time.perf_counter()
    process = subprocess.Popen(fit_command(config, jobs), stdout=subprocess.DEVNULL)
    peak = _peak_mib_of(process) if look_at_parent else 0.0
    if process.wait():
        raise RuntimeError(f"fit-fleet ended with {process.returncode}")
    return Cost(time.perf_counter() - begin, _children_s() - used, parent_mib=peak)


def reading(reader: str, files: Sequence[Path]) -> Cost:
    """Two fresh processes, each of which reads half of the files, at the same time."""
    command = [sys.executable, "-m", "benchmarks.log_readers", reader]
    used = _children_s()
    begin = time.perf_counter()
    both = [
        subprocess.Popen([*command, *map(str, half)], env=ENVIRONMENT)
        for half in (files[::2], files[1::2])
        if half
    ]
    for process in both:
        if process.wait():
            raise RuntimeError(f"{reader} ended with {process.returncode}")
    return Cost(time.perf_counter() - begin, _children_s() - used)


def interleaved(cases: Mapping[str, Callable[[], Cost]], repeats: int) -> dict[str, Cost]:
    """Medians of several passes, in each of which every case has its turn."""
    found: dict[str, list[Cost]] = {name: [] for name in cases}
    for _ in range(repeats):
        for name, case in cases.items():
            found[name].append(case())
    return {name: median(costs) for name, costs in found.items()}


def median(costs: Sequence[Cost]) -> Cost:
    """Median of each figure by itself."""
    return Cost(
        *(
            statistics.median(getattr(cost, name) for cost in costs)
            for name in ("elapsed_s", "processor_s", "parent_mib")
        )
    )


def elapsed(command: Sequence[str]) -> Cost:
    """Any command."""
    used = _children_s()
    begin = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return Cost(time.perf_counter() - begin, _children_s() - used)


def until_first_byte(config: Path) -> Cost:
    """From the start of `fit-fleet` until it reads the first byte of a log (Linux: inotify)."""
    shutil.rmtree(config.parent.parent / "out", ignore_errors=True)
    library = ctypes.CDLL(None)
    watch = library.inotify_init()
    for path in (config.parent.parent / "demo" / "logs").glob("*/*"):
        library.inotify_add_watch(watch, os.fsencode(path), IN_ACCESS)
    begin = time.perf_counter()
    process = subprocess.Popen(fit_command(config, 2), stdout=subprocess.DEVNULL)
    os.read(watch, 4096)
    taken = time.perf_counter() - begin
    os.close(watch)
    process.wait()
    return Cost(taken, 0.0)


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
