"""The watch over a motor's nights, beside simpler methods: measures cells, stores the outcomes.

`benchmarks/results/watch.json` has them, a cell a line; the tables of all go into
`benchmarks/results/watch.md` and the README.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from fnmatch import fnmatch
from itertools import groupby
from typing import Any

import joblib
import numpy as np

from benchmarks import RESULTS, made
from benchmarks.watch.cb560 import OTHERWISE
from benchmarks.watch.cells import BASELINE, NOTHING, RIG, YEAR, cells
from benchmarks.watch.outcomes import FRESH, TRIAL, Outcome, outcome
from benchmarks.watch.rig import folder
from benchmarks.watch.rivals import charts
from benchmarks.watch.simulator import history
from benchmarks.watch.tables import readme, tables
from leakage.watch import WatchSettings
from pipeline.arrays import Array
from validation.tables import show

LIMITS = "limits"
# False alarms a motor-year, the watch's own rate, and motors, by which the limits of the rivals are
# calibrated.
RATE, CALIBRATED_ON = WatchSettings().false_alarms_per_year, 100
CALIBRATION = 2536


def main(options: Sequence[str] = ()) -> None:
    """Measure all cells or some, and write their tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks watch")
    parser.add_argument("--only", default="*", help="cells whose name matches, or limits")
    parser.add_argument("--motors", type=int, help="at most so many of each cell")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--trial", action="store_true", help="seeds of trials; nothing is stored")
    asked = parser.parse_args(list(options))
    known = cells()
    tasks = [
        (key, number)
        for key, cell in known.items()
        if fnmatch(key, asked.only) and (cell.group != RIG or folder().exists())
        for number in range(min(asked.motors or cell.motors, cell.motors))
    ]
    if not tasks and not fnmatch(LIMITS, asked.only):
        parser.error(f"no cell has a name like {asked.only}; * stands for any words")
    run = joblib.Parallel(asked.jobs, return_as="generator")
    if fnmatch(LIMITS, asked.only) and not asked.trial:
        store(LIMITS, _limits(list(run(map(joblib.delayed(_highest), range(CALIBRATED_ON))))))
    of = {"base": TRIAL if asked.trial else FRESH, "limits": stored().get(LIMITS, {})}
    results = run(joblib.delayed(outcome)(known[key], number, **of) for key, number in tasks)
    outcomes: dict[str, list[Outcome]] = {}
    for key, motors in groupby(zip(tasks, results, strict=True), lambda pair: pair[0][0]):
        outcomes[key] = [motor for _, motor in motors]
        sys.stderr.write(f"{key}\n")
        if not asked.trial:
            store(key, outcomes[key])
    if asked.trial:
        show(tables(known, outcomes), None)
    else:
        show([made(), *tables(known, stored())], RESULTS / "watch.md")
        show([readme(known, stored())], RESULTS.parents[1] / "README.md")


def stored() -> dict[str, Any]:
    """Return all outcomes of runs so far, by cell."""
    file = RESULTS / "watch.json"
    cells: dict[str, Any] = json.loads(file.read_text("utf-8")) if file.exists() else {}
    return cells


def store(cell: str, outcomes: object) -> None:
    """Store the outcomes of a cell beside the others'."""
    cells = (stored() | {cell: outcomes}).items()
    lines = (f'"{key}": {json.dumps(of, ensure_ascii=False)}' for key, of in cells)
    (RESULTS / "watch.json").write_text("{\n" + ",\n".join(lines) + "\n}\n", "utf-8")


def _highest(number: int) -> dict[str, Array]:
    """Highest distance so far, by night and method, of a motor to which nothing happens."""
    nights = history(OTHERWISE, NOTHING.course, (CALIBRATION, number), YEAR).nights
    distances = charts(nights, BASELINE).items()
    return {method: np.maximum.accumulate(values[BASELINE:]) for method, values in distances}


def _limits(motors: Sequence[dict[str, Array]]) -> dict[str, float]:
    """Limits with which the charts of healthy motors begin to alarm at the rate."""
    return {method: _limit(np.array([motor[method] for motor in motors])) for method in motors[0]}


def _limit(highest: Array) -> float:
    """Lowest limit whose first alarms come at most at the rate."""
    for limit in np.arange(1.0, 12.0, 0.02):
        above = highest > limit
        exposed = np.where(above.any(axis=1), above.argmax(axis=1) + 1, highest.shape[1])
        if above.any(axis=1).sum() <= RATE * exposed.sum() / YEAR:
            return round(float(limit), 2)
    return 12.0
