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
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks import RESULTS
from leakage import OperatingConditions, leakage_l_per_min, regressors

COMMITTED = RESULTS / "guard.json"
WARN, FAIL = 1.2, 2.0
MINUTES, RATE_HZ, DAY_MINUTES = 240.0, 10.0, 1440.0
ROUNDS = 5
# With threads of their own, a part and its yardstick would not be measured alike.
ONE_THREAD = dict.fromkeys(
    ("POLARS_MAX_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
)


class Case(NamedTuple):
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
    ratios: dict[str, float] = json.loads(text.splitlines()[-1])
    if update or not COMMITTED.exists():
        COMMITTED.write_text(json.dumps(ratios, indent=1) + "\n", "utf-8")
    return compare(ratios, json.loads(COMMITTED.read_text("utf-8")))


def compare(ratios: Mapping[str, float], before: Mapping[str, float]) -> int:
    """Print how ratios compare with those before; return 1 where any fails, else 0.

    Parameters
    ----------
    ratios, before
        By what they are of; a ratio that was not there before is compared with nothing.
    """
    worst = 0.0
    for what, ratio in ratios.items():
        change = ratio / before.get(what, ratio)
        worst = max(worst, change)
        verdict = "FAILED" if change > FAIL else "warning" if change > WARN else "ok"
        sys.stdout.write(f"{verdict:8}{what}: {ratio:.2f}, {100 * (change - 1):+.0f} %\n")
    return int(worst > FAIL)


def measured() -> dict[str, float]:
    """All figures: medians over the rounds of each part, over those of its yardstick."""
    with tempfile.TemporaryDirectory() as folder:
        cases = _cases(Path(folder))
        # The first round is for what is loaded and cached at the first time.
        rounds = [[_ratio(case) for case in cases] for _ in range(ROUNDS + 1)][1:]
    ratios = zip(*rounds, strict=True)
    return {
        case.what: round(statistics.median(of), 3) for case, of in zip(cases, ratios, strict=True)
    }


def _ratio(case: Case) -> float:
    begin = time.process_time()
    case.part()
    middle = time.process_time()
    for _ in range(case.times):
        case.yardstick()
    return case.times * (middle - begin) / (time.process_time() - middle)


def _cases(folder: Path) -> list[Case]:
    """Parts of the program on a log of some hours or a day, each with what it is measured by."""
    from benchmarks.day_fleets import MOTORS, NIGHT, logs_of, make_fleet
    from benchmarks.log_readers import READERS
    from leakage.estimation.blocks import factors
    from leakage.estimation.proven_minimum import fit
    from pipeline.config import load_fleet
    from pipeline.config.nights import night
    from pipeline.ingest import read_log
    from pipeline.logs.files import slice_night
    from pipeline.night.fit_night import fit_night
    from pipeline.run.fleet import RunRequest, run_fleet
    from pipeline.run.motor_task import run_motor

    logging.disable()
    configs = {name: make_fleet(folder / name, name, 1, MINUTES, RATE_HZ) for name in MOTORS}
    logs = {name: logs_of(config)[0] for name, config in configs.items()}
    fleets = {name: load_fleet(config) for name, config in configs.items()}
    of_day = make_fleet(folder / "day", "parquet", 1, DAY_MINUTES, 1.0)
    a_day = RunRequest(load_fleet(of_day))
    (spec,) = fleets["parquet"].motors
    content = read_log(logs["parquet"], spec.file.logs, spec.file.channels)
    channels = slice_night([content], night(NIGHT, spec.settings.nights), {})
    rows = content.rows
    rng = np.random.default_rng(1)
    matrix, borders = rng.normal(size=(rows, 6)), np.linspace(0, rows, 21).astype(np.int64)
    # A flow that the motor's own paths explain, and their columns.
    ranges = ((20.0, 300.0), (40.0, 60.0), (3.0, 110.0))
    made = OperatingConditions.from_bar(*(rng.uniform(*span, rows) for span in ranges))
    motor = spec.motor(NIGHT, "none")
    flow = leakage_l_per_min(motor, made) + rng.normal(0.0, 0.02, rows)
    columns = np.column_stack([regressors(motor, made), flow])
    block = factors(columns, np.array([0, rows]))[0]

    def whole() -> object:
        fleet = fleets["parquet"]
        execution = fleet.execution.model_copy(update={"workers": 1, "backend": "sequential"})
        output = Path(tempfile.mkdtemp(dir=folder))
        return run_fleet(RunRequest(replace(fleet, output=output, execution=execution)))

    def day() -> object:
        (task,) = a_day.tasks(Path(tempfile.mkdtemp(dir=folder)))
        return run_motor(task)

    def reading(name: str) -> Callable[[], object]:
        (motor,) = fleets[name].motors
        return lambda: read_log(logs[name], motor.file.logs, motor.file.channels)

    def fastest(name: str) -> Callable[[], object]:
        return lambda: READERS[name](logs[name])

    def fitting() -> object:
        return fit_night(spec, night(NIGHT, spec.settings.nights), dict(channels))

    def qr(n: int = rows) -> object:
        return np.linalg.qr(matrix[:n], mode="r")

    parquet, day_rows = fastest("parquet"), round(60.0 * DAY_MINUTES)
    return [
        Case("motor-night, whole run / reading its Parquet", whole, parquet, 40),
        Case("motor-day at 1 Hz, read, clean and fit / QR of as many samples",
             day, lambda: qr(day_rows), 10),
        Case("motor-night without reading / QR of as many samples", fitting, qr, 10),
        Case("Parquet, ours / PyArrow", reading("parquet"), parquet, 10),
        Case("CSV, ours / PyArrow", reading("csv"), fastest("csv"), 2),
        Case("MCAP, ours / plain reader", reading("mcap"), fastest("mcap")),
        Case("statistics of blocks / QR of as many samples",
             lambda: factors(matrix, borders), qr, 3),
        Case("fit from statistics / QR of as many samples", lambda: fit(block, motor), qr, 3),
    ]  # fmt: skip


if __name__ == "__main__":
    sys.stdout.write(json.dumps(measured()) + "\n")
