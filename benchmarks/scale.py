"""Past one machine: throughput over Dask against worker processes, and what a scheduler costs.

Scheduler and workers are processes of this machine, so figures show overhead, not a network.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import psutil

from benchmarks.results_file import Part, write_parts
from pipeline.config import Execution, Fleet, load_fleet
from pipeline.demo import write_demo
from pipeline.engine import open_engine
from pipeline.fleet import RunRequest, run_fleet
from pipeline.worker_process import Loss

ROOT = Path(__file__).parent.parent
MIB = 1 << 20
# A task of the simulated fleet: sleeps, and stages about what a motor's night stages.
FLEET_TASKS = 10_000
TASK_S = 0.01
STAGED_BYTES = 20_000
EMPTY_TASKS = 2_000
YEAR = 365


@dataclass(frozen=True, slots=True)
class Night:
    """A simulated motor's night."""

    number: int
    seconds: float
    staged: int
    staging: Path


def sleep_and_stage(task: Night) -> int:
    """Takes its time and stages its bytes."""
    time.sleep(task.seconds)
    if task.staged:
        folder = task.staging / "fits"
        folder.mkdir(exist_ok=True)
        (folder / f"{task.number}.arrow").write_bytes(os.urandom(task.staged))
    return task.number


def main() -> None:
    """Measure and write `benchmarks/results/scale.md`."""
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_demo(folder / "demo", nights=6, minutes=60.0, workers=2)
        parts = [
            _throughput(folder),
            _overhead(folder),
            _large_fleet(folder),
            _year(folder),
            _sizes(folder),
        ]
    text = (
        f"Two cores; load of the machine before it began: {load:.1f}, after: "
        f"{os.getloadavg()[0]:.1f}. Above 2 the times are too long by about that factor over 2."
    )
    write_parts("scale", "Past one machine", text, parts)


@contextmanager
def _cluster(n_workers: int) -> Iterator[tuple[Execution, psutil.Process]]:
    """A scheduler and workers as processes of their own, and the way to them."""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "POLARS_MAX_THREADS": "1"}

    def start(*arguments: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-m", "dask", *arguments, "--no-dashboard"],
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE if arguments[0] == "scheduler" else subprocess.DEVNULL,
            text=True,
        )

    scheduler = start("scheduler", "--host", "127.0.0.1", "--port", "0")
    processes = [scheduler]
    try:
        assert scheduler.stderr is not None
        address = next(line.split()[-1] for line in scheduler.stderr if "Scheduler at:" in line)
        threading.Thread(target=scheduler.stderr.read, daemon=True).start()
        processes += [start("worker", address, "--nthreads", "1") for _ in range(n_workers)]
        from distributed import Client

        with Client(address, set_as_default=False) as client:
            client.wait_for_workers(n_workers)
        yield (
            Execution(backend="dask", scheduler=address, workers=n_workers),
            psutil.Process(scheduler.pid),
        )
    finally:
        for process in reversed(processes):
            process.terminate()
            process.wait()


@contextmanager
def _engine(backend: str, n_workers: int) -> Iterator[Execution]:
    if backend == "dask":
        with _cluster(n_workers) as (execution, _):
            yield execution
    else:
        yield Execution(backend="loky", workers=n_workers)


def _timed(function: Callable[[], object]) -> float:
    begin = time.perf_counter()
    function()
    return time.perf_counter() - begin


def _fit(fleet: Fleet, output: Path, execution: Execution, motors: tuple[str, ...] = ()) -> float:
    """Seconds for a whole run into an empty folder."""
    own = replace(fleet, execution=execution, output=output)
    return _timed(lambda: run_fleet(RunRequest(own, motors)))


def _throughput(folder: Path) -> Part:
    fleet = load_fleet(folder / "demo" / "configs" / "fleet.toml")
    nights = 6 * len(fleet.motors)
    rows = []
    for backend in ("loky", "dask"):
        for workers in (1, 2):
            with _engine(backend, workers) as execution:
                seconds = _fit(fleet, folder / f"{backend}-{workers}", execution)
            rows.append([backend, str(workers), f"{seconds:.1f} s", f"{nights / seconds:.1f}"])
    return Part(
        "Throughput",
        f"The demo fleet, {len(fleet.motors)} motors with 6 nights of 60 minutes each: a whole "
        "run, tables, trends and the start of the workers of loky included. One worker of loky is "
        "the run's own process.",
        ("Engine", "Workers", "Run", "Nights/s"),
        rows,
    )


def _tasks(n: int, seconds: float, staged: int, staging: Path) -> list[Night]:
    return [Night(number, seconds, staged, staging) for number in range(n)]


def _lost(task: Night, loss: Loss) -> int:
    raise RuntimeError(f"task {task.number} was lost: {loss.how}")


def _run_tasks(execution: Execution, tasks: Sequence[Night]) -> float:
    """Seconds for tasks over an engine that is there already."""
    with open_engine(execution) as run_tasks:
        # The first tasks find the workers and load the code.
        warm = [replace(task, seconds=0.0) for task in tasks[: 4 * execution.workers]]
        list(run_tasks(sleep_and_stage, warm, _lost))

        def drain() -> None:
            for _ in run_tasks(sleep_and_stage, tasks, _lost):
                pass

        return _timed(drain)


def _overhead(folder: Path) -> Part:
    rows = []
    for backend in ("loky", "dask"):
        with _engine(backend, 2) as execution:
            seconds = _run_tasks(execution, _tasks(EMPTY_TASKS, 0.0, 0, folder))
        each = 1000 * seconds / EMPTY_TASKS
        rows.append([backend, f"{each:.2f} ms", f"{EMPTY_TASKS / seconds:.0f}"])
    return Part(
        "Overhead of a task",
        f"{EMPTY_TASKS} tasks that do nothing, two workers: what a motor costs beyond its work.",
        ("Engine", "A task", "Tasks/s"),
        rows,
    )


@contextmanager
def _largest(process: psutil.Process) -> Iterator[list[int]]:
    """Largest resident memory of a process while it is looked at, ten times a second [bytes]."""
    found, ended = [process.memory_info().rss], threading.Event()

    def look() -> None:
        while not ended.wait(0.1):
            found[0] = max(found[0], process.memory_info().rss)

    thread = threading.Thread(target=look)
    thread.start()
    try:
        yield found
    finally:
        ended.set()
        thread.join()


def _large_fleet(folder: Path) -> Part:
    staging = folder / "staging"
    staging.mkdir()
    rows = []
    for in_flight in (256, FLEET_TASKS):
        with _cluster(2) as (execution, scheduler):
            bounded = execution.model_copy(update={"tasks_in_flight": in_flight})
            tasks = _tasks(FLEET_TASKS, TASK_S, STAGED_BYTES, staging)
            own = psutil.Process()
            before = own.memory_info().rss
            with _largest(scheduler) as there, _largest(own) as here:
                seconds = _run_tasks(bounded, tasks)
        rows.append(
            [
                str(in_flight),
                f"{seconds:.0f} s",
                f"{FLEET_TASKS / seconds:.0f}",
                f"{100 * FLEET_TASKS * TASK_S / 2 / seconds:.0f} %",
                f"{there[0] / MIB:.0f} MiB",
                f"{(here[0] - before) / MIB:.0f} MiB",
            ]
        )
    return Part(
        f"{FLEET_TASKS} motors through a scheduler",
        f"Simulated motors of {TASK_S:g} s (a tenth of the 0.1 s that a light night takes, so that "
        f"the scheduler is what is measured) that stage {STAGED_BYTES // 1000} kB each, two "
        "workers. Share of work: time that the workers slept of the time that they had.",
        ("Tasks in flight", "Run", "Tasks/s", "Share of work", "Scheduler", "Client, more"),
        rows,
    )


def _year(folder: Path) -> Part:
    write_demo(folder / "year", nights=YEAR, minutes=20.0, workers=2)
    fleet = load_fleet(folder / "year" / "configs" / "fleet.toml")
    motor = fleet.motors[0].motor_id
    rows = []
    whole: float | None = None
    for backend, workers, nights_a_part in (
        ("loky", 2, 0),
        ("loky", 2, 14),
        ("dask", 2, 14),
        ("dask", 2, 4),
    ):
        with _engine(backend, workers) as execution:
            how = execution.model_copy(update={"nights_a_part": nights_a_part})
            output = folder / f"year-{backend}-{nights_a_part}"
            seconds = _fit(fleet, output, how, (motor,))
        whole = whole or seconds
        rows.append(
            [
                backend,
                str(workers),
                str(nights_a_part) if nights_a_part else "not split",
                f"{seconds:.0f} s",
                f"{whole / seconds:.2f}",
            ]
        )
    return Part(
        "The first back-fill of a motor",
        f"One motor of the demo, {YEAR} nights of 20 minutes, logs and all.",
        ("Engine", "Workers", "Nights a part", "Run", "Faster by"),
        rows,
    )


def _sizes(folder: Path) -> Part:
    """Bytes of each table for a motor's night, from the tables of the first part."""
    tables = folder / "loky-1" / "tables"
    nights = 36
    rows = []
    total = 0
    for table in sorted(tables.iterdir()):
        size = sum(path.stat().st_size for path in table.rglob("*.parquet"))
        if table.name in ("runs", "motor_outcomes", "data_dictionary"):
            continue
        total += size
        each = size / nights
        rows.append([table.name, f"{each / 1000:.1f} kB", f"{each * YEAR / 1e6:.2f} MB"])
    rows.append(["all", f"{total / nights / 1000:.1f} kB", f"{total / nights * YEAR / 1e6:.1f} MB"])
    return Part(
        "What a motor stores",
        "Tables of the first part, six motors a file. A day of 24 h has up to 96 blocks and 720 "
        "points of a night instead of the 30 and 720 here.",
        ("Table", "A motor's night", "A motor's year"),
        rows,
    )
