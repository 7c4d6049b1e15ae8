"""What a night costs, however long the history is: night 365 beside night 2.

Two motors of the demo with Parquet logs. The nights before are short ones, really simulated and
really fitted; those that are measured hold the same samples each time, moved to their night. After
each run the logs that it has read are overwritten with zeros of the same size, time and file
number: a later run that read a byte of them would fail. Each measured run is made several times,
from a copy of the output as it was before, in a process of its own.

The goal: night 365 costs what night 2 costs within 20 % in log bytes read, bytes written and time
outside the trend stage; the trend stage is linear in history, and at most 1 ms a motor and 100
nights.
"""

from __future__ import annotations

import datetime as dt
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

import pipeline.run.fleet
import pipeline.run.publishing
from benchmarks.day_fleets import later
from benchmarks.results_file import Part, write_parts
from pipeline.config import load_fleet
from pipeline.demo import write_demo

MOTORS = ("CB400-02", "CB1120-01")
FIRST = dt.date(2025, 1, 2)
YEAR = 365
MEASURED = (2, 100, 200, 300, YEAR, 500, 600)
REPEATS = 5
# Short nights take turns: the same every night would be no history.
SHORT_NIGHTS, SHORT_MINUTES, SHORT_HZ = 8, 20.0, 1.0
LONG_MINUTES, LONG_HZ = 90.0, 5.0

Figures = dict[str, float]


def main() -> None:
    """Measure and write `benchmarks/results/night_cost.md`."""
    with tempfile.TemporaryDirectory() as folder:
        figures = measure(Path(folder))
    write_parts("night_cost", "The cost of a night", __doc__ or "", _parts(figures))


def measure(
    folder: Path, nights: Sequence[int] = MEASURED, repeats: int = REPEATS
) -> dict[int, Figures]:
    """Figures of the measured nights, medians over the repeats; by number of the night."""
    write_demo(folder / "short", nights=SHORT_NIGHTS, minutes=SHORT_MINUTES, rate_hz=SHORT_HZ)
    write_demo(folder / "long", nights=1, minutes=LONG_MINUTES, rate_hz=LONG_HZ)
    config = _own_fleet(folder)
    found: dict[int, Figures] = {}
    done = 0
    for number in nights:
        for short in range(done + 1, number):
            _deliver(folder, "short", (short - 1) % SHORT_NIGHTS, short)
        if number > done + 1:
            _run(config)
            _blank(folder / "demo" / "logs")
        _deliver(folder, "long", 0, number)
        output = folder / "out"
        runs = []
        for _ in range(repeats):
            # The program replaces files and changes none: a copy is the same files once more.
            shutil.copytree(output, folder / "before", copy_function=os.link)
            runs.append(_run(config))
            shutil.rmtree(output)
            (folder / "before").rename(output)
        _run(config)
        _blank(folder / "demo" / "logs")
        found[number] = {name: statistics.median(run[name] for run in runs) for name in runs[0]}
        done = number
    return found


def _own_fleet(folder: Path) -> Path:
    configs = folder / "configs"
    shutil.copytree(folder / "short" / "configs", configs)
    for path in (configs / "motors").glob("*.toml"):
        if path.stem not in MOTORS:
            path.unlink()
    return configs / "fleet.toml"


def _deliver(folder: Path, demo: str, source: int, number: int) -> None:
    """Put a night's logs of a demo where the fleet looks, moved to another night."""
    for motor_id in MOTORS:
        log = sorted((folder / demo / "demo" / "logs" / motor_id).glob("*.parquet"))[source]
        label = dt.date.fromisoformat(log.stem.removeprefix(f"{motor_id}_"))
        moved = FIRST + dt.timedelta(days=number - 1)
        target = folder / "demo" / "logs" / motor_id / f"{motor_id}_{moved}.parquet"
        target.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(later(pq.read_table(log), (moved - label).days), target)


def _blank(logs: Path) -> None:
    """Make every log unreadable to whoever looks into it, and the same to whoever does not."""
    for path in logs.rglob("*.parquet"):
        state = path.stat()
        with path.open("r+b") as stream:
            stream.write(bytes(state.st_size))
        os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns))


def _run(config: Path) -> Figures:
    """A run in a process of its own; its figures."""
    text = subprocess.check_output([sys.executable, "-m", __name__, str(config)], text=True)
    found: Figures = json.loads(text.splitlines()[-1])
    return found


def _bytes() -> tuple[float, float]:
    """Bytes that this process has read and written so far, of all files, by system calls."""
    lines = Path("/proc/self/io").read_text("ascii").splitlines()
    counts = dict(line.split(": ") for line in lines)
    return float(counts["rchar"]), float(counts["wchar"])


def _now() -> tuple[float, float, float, float]:
    return (time.perf_counter(), time.process_time(), *_bytes())


def _run_here(config: Path) -> Figures:
    """Run the fleet in this process; what it cost, in the trend stage and outside of it."""
    spent = [0.0, 0.0, 0.0, 0.0]
    stage = pipeline.run.fleet.publish_trends
    made: Callable[..., Any] = pipeline.run.publishing.run_trends
    making = [0.0]

    def timed_stage(*arguments: Any) -> Any:
        begin = _now()
        result = stage(*arguments)
        for place, (before, after) in enumerate(zip(begin, _now(), strict=True)):
            spent[place] += after - before
        return result

    def timed_task(task: Any) -> Any:
        begin = time.process_time()
        result = made(task)
        making[0] += time.process_time() - begin
        return result

    pipeline.run.fleet.publish_trends = timed_stage
    pipeline.run.publishing.run_trends = timed_task
    fleet = load_fleet(config)
    execution = fleet.execution.model_copy(update={"workers": 1, "backend": "sequential"})
    request = pipeline.run.fleet.RunRequest(pipeline.run.fleet.replace(fleet, execution=execution))
    begin = _now()
    result = pipeline.run.fleet.run_fleet(request)
    whole = [after - before for before, after in zip(begin, _now(), strict=True)]
    if result.failed:
        raise RuntimeError(f"motors failed: {[one.message for one in result.failed]}")
    outside = [all_of_it - trends for all_of_it, trends in zip(whole, spent, strict=True)]
    names = ("elapsed_s", "processor_s", "bytes_read", "bytes_written")
    new = sorted((fleet.log_root).rglob("*.parquet"), key=lambda path: path.name[-18:])[-2:]
    return {
        "files_read": result.files["read"],
        "log_bytes": sum(path.stat().st_size for path in new) if result.files["read"] else 0,
        **dict(zip(names, outside, strict=True)),
        **{f"trend_{name}": value for name, value in zip(names, spent, strict=True)},
        "trend_tasks_s": making[0],
        "nights": result.n_nights,
    }


def _parts(figures: dict[int, Figures]) -> list[Part]:
    first, last = min(figures), YEAR
    outside = ("files_read", "log_bytes", "bytes_read", "bytes_written", "processor_s", "elapsed_s")
    words = {
        "files_read": "log files read",
        "log_bytes": "bytes of these logs",
        "bytes_read": "bytes read, of all files",
        "bytes_written": "bytes written",
        "processor_s": "processor time",
        "elapsed_s": "elapsed time",
        "trend_processor_s": "processor time",
        "trend_tasks_s": "of it, without publishing",
        "trend_elapsed_s": "elapsed time",
        "trend_bytes_read": "bytes read",
        "trend_bytes_written": "bytes written",
    }
    trends = [name for name in words if name.startswith("trend_")]
    nights = (f"night {number}" for number in figures)
    header = " | ".join(("what", *nights, f"{last} / {first}"))

    def rows(names: Sequence[str]) -> list[list[str]]:
        return [
            [
                words[name],
                *(_shown(name, one[name]) for one in figures.values()),
                f"{figures[last][name] / (figures[first][name] or 1.0):.2f}",
            ]
            for name in names
        ]

    # Three short nights make a figure, and sixty figures a whole baseline: till then, and for as
    # long as there is none, less is computed. The course is that of the nights after.
    later = [number for number in sorted(figures) if number >= YEAR]
    taken_ms = [1000 * figures[number]["trend_tasks_s"] / len(MOTORS) for number in later]
    line = statistics.linear_regression([number / 100 for number in later], taken_ms)
    return [
        Part(
            "Outside the trend stage", "Goal: the last column within 1.20.", header, rows(outside)
        ),
        Part(
            "The trend stage",
            f"A line through nights {later[0]} to {later[-1]}, when all baselines are whole: "
            f"{line.slope:.2f} ms of processor time a motor and 100 nights of history, with "
            f"{len(MOTORS)} motors, beside {line.intercept:.2f} ms (goal: linear, at most 1 ms).",
            header,
            rows(trends),
        ),
    ]


def _shown(name: str, value: float) -> str:
    if name.endswith("_s"):
        return f"{value:.3f} s"
    return f"{value:.0f}" if value < 1e4 else f"{value / 1024:.0f} KiB"


if __name__ == "__main__":
    sys.stdout.write(json.dumps(_run_here(Path(sys.argv[1]))) + "\n")
