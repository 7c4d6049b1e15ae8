"""Past one machine: throughput over Dask against worker processes, and what a scheduler costs.

Scheduler and workers are processes of this machine, so figures show overhead, not a network. The
load told of each part is that of the machine before it began; unless it was near 0, times are too
long.

`--only PART,PART` does some of the parts; what the others found in runs before stays
(`scale.json`).
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import psutil

from benchmarks.results_file import Part, in_folder, write_stored
from pipeline.config import Execution, Fleet, load_fleet
from pipeline.demo import write_demo
from pipeline.run.fleet import RunRequest, run_fleet
from pipeline.workers.engine import open_workers
from pipeline.workers.process import Loss

ROOT = Path(__file__).parent.parent
MIB = 1 << 20
# A task of the simulated fleet takes what a light night takes, and stages about as much.
FLEET_TASKS = 10_000
TASK_S = 0.1
STAGED_BYTES = 20_000
# They sleep: so many workers have room on two cores.
FLEET_WORKERS = 8
EMPTY_TASKS = 2_000
QUICK_TASKS = 4_000
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


def main(options: Sequence[str] = ()) -> None:
    """Measure and write `benchmarks/results/scale.md`."""
    makers = {name: partial(in_folder, make) for name, make in PARTS.items()}
    text = f"{os.cpu_count()} cores. {__doc__}"
    write_stored("scale", "Past one machine", text, makers, options)


def _demo(folder: Path, nights: int, minutes: float) -> Fleet:
    write_demo(folder / "demo", nights=nights, minutes=minutes, workers=2)
    return load_fleet(folder / "demo" / "configs" / "fleet.toml")


@contextmanager
def _cluster(n_workers: int) -> Iterator[tuple[Execution, list[psutil.Process]]]:
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
            [psutil.Process(process.pid) for process in processes],
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
    fleet = _demo(folder, 6, 60.0)
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
        "run, tables, trends and the start of the workers of loky included; over Dask workers are "
        "there.",
        "Engine | Workers | Run | Nights/s",
        rows,
    )


def _tasks(n: int, seconds: float, staged: int, staging: Path) -> list[Night]:
    return [Night(number, seconds, staged, staging) for number in range(n)]


def _lost(task: Night, loss: Loss) -> int:
    raise RuntimeError(f"task {task.number} was lost: {loss.how}")


def _run_tasks(execution: Execution, tasks: Sequence[Night]) -> float:
    """Seconds for tasks over an engine that is there already."""
    with open_workers(execution) as workers:
        # The first tasks find the workers and load the code.
        warm = [replace(task, seconds=0.0) for task in tasks[: 4 * execution.workers]]
        list(workers.run(sleep_and_stage, warm, _lost))
        return _timed(lambda: list(workers.run(sleep_and_stage, tasks, _lost)))


def _overhead(folder: Path) -> Part:
    rows = []
    for backend in ("loky", "dask"):
        with _engine(backend, 2) as execution:
            for n, staged in ((EMPTY_TASKS, 0), (QUICK_TASKS, STAGED_BYTES)):
                staging = folder / f"{backend}-{staged}"
                staging.mkdir()
                seconds = _run_tasks(execution, _tasks(n, 0.0, staged, staging))
                size = f"{staged // 1000} kB"
                each = f"{1000 * seconds / n:.2f} ms"
                rows.append([backend, size, each, f"{n / seconds:.0f}"])
    return Part(
        "Overhead of a task",
        f"{EMPTY_TASKS} tasks that do nothing, and {QUICK_TASKS} that only stage rows, two "
        "workers: what a motor costs beyond its work. Loky starts its workers in it.",
        "Engine | Stages | A task | Tasks/s",
        rows,
    )


@contextmanager
def _largest(processes: Callable[[], dict[str, list[psutil.Process]]]) -> Iterator[dict[str, int]]:
    """Largest resident memory of a process of each kind, looked at ten times a second [bytes]."""
    found: dict[str, int] = {}
    ended = threading.Event()

    def look() -> None:
        while True:
            for kind, members in processes().items():
                for process in members:
                    with suppress(psutil.Error):
                        found[kind] = max(found.get(kind, 0), process.memory_info().rss)
            if ended.wait(0.1):
                return

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
        with _cluster(FLEET_WORKERS) as (execution, (scheduler, *_)):
            bounded = execution.model_copy(update={"tasks_in_flight": in_flight})
            tasks = _tasks(FLEET_TASKS, TASK_S, STAGED_BYTES, staging)
            own = psutil.Process()
            before = own.memory_info().rss
            kinds = {"scheduler": [scheduler], "client": [own]}
            with _largest(lambda kinds=kinds: kinds) as largest:
                seconds = _run_tasks(bounded, tasks)
        rows.append(
            [
                str(in_flight),
                f"{seconds:.0f} s",
                f"{FLEET_TASKS / seconds:.0f}",
                f"{100 * FLEET_TASKS * TASK_S / FLEET_WORKERS / seconds:.0f} %",
                f"{largest['scheduler'] / MIB:.0f} MiB",
                f"{(largest['client'] - before) / MIB:.0f} MiB",
            ]
        )
    return Part(
        f"{FLEET_TASKS} motors through a scheduler",
        f"Simulated motors of {TASK_S:g} s that sleep and stage {STAGED_BYTES // 1000} kB each, "
        f"{FLEET_WORKERS} workers. Share of work: time that the workers slept of the time that "
        "they had.",
        "Tasks in flight | Run | Tasks/s | Share of work | Scheduler | Client, more",
        rows,
    )


def _worker_memory(folder: Path) -> Part:
    fleet = _demo(folder, 3, 60.0)
    with _cluster(1) as (execution, (_, nanny)):

        def kinds() -> dict[str, list[psutil.Process]]:
            found: dict[str, list[psutil.Process]] = {"nanny": [nanny]}
            with suppress(psutil.Error):
                for child in nanny.children(recursive=True):
                    found.setdefault(_kind(child), []).append(child)
            return found

        with _largest(kinds) as largest:
            _fit(fleet, folder / "out", execution)
    rows = [[kind, f"{largest[kind] / MIB:.0f} MiB"] for kind in KINDS if kind in largest]
    return Part(
        "Memory of a Dask worker",
        "Largest resident memory of each of its processes in a run over the demo, one worker. "
        "That of the worker grows with a night's readings.",
        "Process | Largest",
        rows,
    )


KINDS = ("nanny", "worker", "trackers of resources")


def _kind(process: psutil.Process) -> str:
    """What a child of a nanny is for."""
    words = " ".join(process.cmdline())
    return KINDS[2] if "resource_tracker" in words else KINDS[1]


def _sizes(folder: Path) -> Part:
    """Bytes of each table for a motor's night."""
    fleet = _demo(folder, 6, 60.0)
    _fit(fleet, folder / "out", Execution(backend="loky", workers=2))
    tables = folder / "out" / "tables"
    nights = 6 * len(fleet.motors)
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
        "Tables of the fleet of the first part, six motors a file. A day of 24 h has up to 96 "
        "blocks and 720 points of a night instead of the 30 and 720 here.",
        "Table | A motor's night | A motor's year",
        rows,
    )


PARTS: dict[str, Callable[[Path], Part]] = {
    "throughput": _throughput,
    "overhead": _overhead,
    "fleet": _large_fleet,
    "memory": _worker_memory,
    "sizes": _sizes,
}
