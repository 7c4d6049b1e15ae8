"""Is the program slower than it was? Ratios of processor times, in under a minute.

Each figure is a ratio of processor times of two things that are done in turns in one process with
one thread: a part of the program, and a yardstick on the same data. They are compared with those
of the last committed results, `benchmarks/results/guard.json`: 20 % more is a warning, 100 % more
a failure. They hold for one kind of machine: on another processor a yardstick alone may be twice
as fast. `python -m benchmarks guard --update` writes them anew.
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from leakage import Motor, OperatingConditions, leakage_l_per_min, regressors

RESULTS = Path(__file__).parent / "results" / "guard.json"
WARN, FAIL = 1.2, 2.0
MINUTES, RATE_HZ, DAY_MINUTES = 240.0, 10.0, 1440.0
ROUNDS = 5
# With threads of their own, a part and its yardstick would not be measured alike.
ONE_THREAD = dict.fromkeys(
    ("POLARS_MAX_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
)


@dataclass(frozen=True, slots=True)
class Case:
    """A part of the program and its yardstick, which is done so often that clocks can tell."""

    what: str
    part: Callable[[], object]
    yardstick: Callable[[], object]
    times: int = 1


def main(options: Sequence[str] = ()) -> int:
    """Measure and compare; 1 where a figure is more than twice what it was."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks guard")
    parser.add_argument("--update", action="store_true", help="write the committed results anew")
    update = parser.parse_args(list(options)).update
    command = [sys.executable, "-m", __name__]
    text = subprocess.check_output(command, text=True, env={**os.environ, **ONE_THREAD})
    found: dict[str, float] = json.loads(text.splitlines()[-1])
    if update or not RESULTS.exists():
        RESULTS.write_text(json.dumps(found, indent=1) + "\n", "utf-8")
    return told(found, json.loads(RESULTS.read_text("utf-8")))


def told(found: Mapping[str, float], before: Mapping[str, float]) -> int:
    """Say how figures compare with those before; 1 where one fails, else 0.

    Parameters
    ----------
    found, before
        Ratios by what they are of; one that was not there before is compared with nothing.
    """
    worst = 0.0
    for what, ratio in found.items():
        change = ratio / before.get(what, ratio)
        worst = max(worst, change)
        verdict = "FAILED" if change > FAIL else "warning" if change > WARN else "ok"
        sys.stdout.write(f"{verdict:8}{what}: {ratio:.2f}, {100 * (change - 1):+.0f} %\n")
    return int(worst > FAIL)


def measured() -> dict[str, float]:
    """All figures: medians over the rounds of each part, over those of its yardstick."""
    with tempfile.TemporaryDirectory() as folder:
        cases = _cases(Path(folder))
        taken: list[list[tuple[float, float]]] = [[] for _ in cases]
        # Once for what is loaded and kept at the first time.
        for case in cases:
            _round(case)
        for _ in range(ROUNDS):
            for case, seconds in zip(cases, taken, strict=True):
                seconds.append(_round(case))
    return {
        case.what: round(statistics.median(part / yard for part, yard in seconds), 3)
        for case, seconds in zip(cases, taken, strict=True)
    }


def _round(case: Case) -> tuple[float, float]:
    begin = time.process_time()
    case.part()
    middle = time.process_time()
    for _ in range(case.times):
        case.yardstick()
    return middle - begin, (time.process_time() - middle) / case.times


def _cases(folder: Path) -> list[Case]:
    """Parts of the program on a log of some hours, each with what it is measured by."""
    from benchmarks.day_fleets import MOTORS, NIGHT, log_of, make_fleet, write_day
    from benchmarks.log_readers import READERS
    from leakage.estimation.block_statistics import factors
    from leakage.estimation.proven_minimum import fit
    from pipeline.config import load_fleet
    from pipeline.config.nights import night
    from pipeline.ingest import read_log
    from pipeline.logs.files import slice_night
    from pipeline.night.fit_night import fit_night
    from pipeline.run.fleet import RunRequest, run_fleet
    from pipeline.run.motor_task import run_motor

    logging.disable()
    write_day(folder / "hours", MINUTES, RATE_HZ, *MOTORS)
    write_day(folder / "day", DAY_MINUTES, 1.0, "parquet")
    logs = {name: log_of(folder / "hours", name) for name in MOTORS}
    fleets = {
        name: load_fleet(make_fleet(folder / "hours", folder / name, name, 1)) for name in MOTORS
    }
    whole_day = RunRequest(load_fleet(make_fleet(folder / "day", folder / "whole", "parquet", 1)))
    (spec,) = fleets["parquet"].motors
    content = read_log(logs["parquet"], spec.file.logs, spec.file.channels)
    channels = slice_night([content], night(NIGHT, spec.settings.nights))
    rows = content.rows
    matrix = np.random.default_rng(1).normal(size=(rows, 6))
    borders = np.linspace(0, rows, 21).astype(np.int64)
    motor = spec.motor(NIGHT, "none")
    block = factors(_columns(motor, rows), np.array([0, rows]))[0]

    def qr(of: NDArray[np.float64] = matrix) -> object:
        return np.linalg.qr(of, mode="r")

    def day() -> object:
        staging = Path(tempfile.mkdtemp(dir=folder))
        return run_motor(whole_day.task(whole_day.specs[0], staging))

    def whole() -> object:
        fleet = fleets["parquet"]
        execution = fleet.execution.model_copy(update={"workers": 1, "backend": "sequential"})
        output = folder / "out" / str(time.monotonic_ns())
        return run_fleet(RunRequest(replace(fleet, output=output, execution=execution)))

    def reading(name: str) -> Callable[[], object]:
        (one,) = fleets[name].motors
        return lambda: read_log(logs[name], one.file.logs, one.file.channels)

    def fastest(reader: str, name: str) -> Callable[[], object]:
        read = READERS[reader]()
        return lambda: read(logs[name])

    def fitting() -> object:
        return fit_night(spec, night(NIGHT, spec.settings.nights), dict(channels))

    parquet, csv = fastest("pyarrow_parquet", "parquet"), fastest("pyarrow_csv", "csv")
    return [
        Case("motor-night, whole run / reading its Parquet", whole, parquet, 40),
        Case("motor-day at 1 Hz, read, clean and fit / QR of as many samples",
             day, lambda: qr(matrix[: round(60.0 * DAY_MINUTES)]), 10),
        Case("motor-night without reading / QR of as many samples", fitting, qr, 10),
        Case("Parquet, ours / PyArrow", reading("parquet"), parquet, 10),
        Case("CSV, ours / PyArrow", reading("csv"), csv, 2),
        Case("MCAP, ours / plain reader", reading("mcap"), fastest("plain_mcap", "mcap")),
        Case("statistics of blocks / QR of as many samples",
             lambda: factors(matrix, borders), qr, 3),
        Case("fit from statistics / QR of as many samples",
             lambda: fit(block, motor), qr, 3),
    ]  # fmt: skip


def _columns(motor: Motor, rows: int) -> NDArray[np.float64]:
    """Columns of a motor over made conditions, with a flow that its own paths explain."""
    rng = np.random.default_rng(2)
    conditions = OperatingConditions.from_bar(
        rng.uniform(20.0, 300.0, rows), rng.uniform(40.0, 60.0, rows), rng.uniform(3.0, 110.0, rows)
    )
    columns = regressors(motor, conditions)
    flow = leakage_l_per_min(motor, conditions) + rng.normal(0.0, 0.02, rows)
    return np.column_stack([columns, flow])


if __name__ == "__main__":
    sys.stdout.write(json.dumps(measured()) + "\n")
