"""Measures cells, keeps what was found, writes the tables."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from fnmatch import fnmatch
from functools import cache, partial
from multiprocessing import get_context

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.results_file import description, show_parts, store, stored, write_parts
from benchmarks.watch.cb560 import OTHERWISE
from benchmarks.watch.cells import BASELINE, NOTHING, RIG, YEAR, Cell, cells
from benchmarks.watch.outcomes import FRESH, TRIAL, Outcome, outcome
from benchmarks.watch.rig import folder
from benchmarks.watch.rivals import charts
from benchmarks.watch.simulator import history
from benchmarks.watch.tables import parts, readme
from pipeline.arrays import Array

NAME, LIMITS = "watch", "limits"
TITLE = "The watch, beside charts, a regression and gradient boosting"
# False alarms a motor-year, and motors, with which the limits of the rivals are calibrated.
RATE, CALIBRATED_ON = 0.1, 100
CALIBRATION = 2536

all_cells = cache(cells)


def main(options: Sequence[str] = ()) -> None:
    """Measure all cells or some, and write `benchmarks/results/watch.md`."""
    parser = argparse.ArgumentParser(prog=f"python -m benchmarks {NAME}")
    parser.add_argument("--only", default="*", help="cells whose name matches, or limits")
    parser.add_argument("--motors", type=int, help="at most so many of each cell")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--trial", action="store_true", help="seeds of trials; nothing is kept")
    parser.add_argument("--list", action="store_true", help="show the cells alone")
    parser.add_argument("--readme", action="store_true", help="print the README's table alone")
    asked = parser.parse_args(list(options))
    chosen = [cell for key, cell in all_cells().items() if fnmatch(key, asked.only)]
    if asked.list:
        sys.stdout.writelines(f"{cell.key} ({cell.motors})\n" for cell in chosen)
        return
    if asked.readme:
        sys.stdout.write("\n".join(readme(all_cells(), stored(NAME))))
        return
    if not folder().exists():
        sys.stderr.write(f"{RIG}: left out, there is no {folder()}\n")
        chosen = [cell for cell in chosen if cell.group != RIG]
    fork = get_context("fork")
    with ProcessPoolExecutor(asked.jobs, fork, threadpool_limits, (1,)) as pool:
        if fnmatch(LIMITS, asked.only) and not asked.trial:
            store(NAME, LIMITS, _limits(list(pool.map(_highest, range(CALIBRATED_ON)))))
        found = _measured(pool, chosen, asked)
    if asked.trial:
        show_parts(list(parts(all_cells(), found)))
    else:
        text = description(sys.modules["benchmarks.watch"].__doc__)
        write_parts(NAME, TITLE, text, list(parts(all_cells(), stored(NAME))))


def _measured(
    pool: ProcessPoolExecutor, chosen: Sequence[Cell], asked: argparse.Namespace
) -> dict[str, list[Outcome]]:
    """Outcomes of all motors of some cells; kept cell by cell, unless on trial."""
    limits = stored(NAME).get(LIMITS, {})
    work = partial(_outcome, base=TRIAL if asked.trial else FRESH, limits=limits)
    numbers = {cell.key: min(asked.motors or cell.motors, cell.motors) for cell in chosen}
    tasks = [(key, number) for key, motors in numbers.items() for number in range(motors)]
    results = pool.map(work, *zip(*tasks, strict=True)) if tasks else iter(())
    found: dict[str, list[Outcome]] = {}
    for key, motors in numbers.items():
        begin = time.perf_counter()
        found[key] = [next(results) for _ in range(motors)]
        sys.stderr.write(f"{key}: {time.perf_counter() - begin:.0f} s\n")
        if not asked.trial:
            store(NAME, key, found[key])
    return found


def _outcome(key: str, number: int, base: int, limits: dict[str, float]) -> Outcome:
    return outcome(all_cells()[key], number, base, limits)


def _highest(number: int) -> dict[str, Array]:
    """Highest distance so far, by night and method, of a motor to which nothing happens."""
    nights = history(OTHERWISE, NOTHING.course, YEAR, (CALIBRATION, number)).nights
    found = charts(nights, BASELINE).items()
    return {method: np.maximum.accumulate(values[BASELINE:]) for method, values in found}


def _limits(motors: Sequence[dict[str, Array]]) -> dict[str, float]:
    """Limits with which the charts of healthy motors begin to alarm at the rate."""
    return {method: _limit(np.array([one[method] for one in motors])) for method in motors[0]}


def _limit(highest: Array) -> float:
    """Lowest limit whose first alarms come at most at the rate."""
    for limit in np.arange(1.0, 12.0, 0.02):
        above = highest > limit
        exposed = np.where(above.any(axis=1), above.argmax(axis=1) + 1, highest.shape[1])
        if above.any(axis=1).sum() <= RATE * exposed.sum() / YEAR:
            return round(float(limit), 2)
    return 12.0
