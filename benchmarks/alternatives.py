"""The grey box beside the watches that users would make: alarms on healthy and on worn motors.

All methods see the same nights (`benchmarks/machine_nights.py`), have the same baseline of 60
nights, and may alarm from its end on. The grey box is the project's own code from a night's blocks
to the states (`benchmarks/grey_box_nights.py`), as it is shipped. The limits of the others
(`benchmarks/charts.py`) are those with which healthy motors of seeds of their own, without seasons,
alarm as often as the grey box does on them.

`--only healthy,season` measures some parts anew; limits come first, as the others use them.
"""

from __future__ import annotations

import argparse
import datetime as dt
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.stats import beta
from threadpoolctl import threadpool_limits

from benchmarks.alarms import poisson_interval
from benchmarks.charts import charts
from benchmarks.grey_box_nights import FIRST, Rows, night_rows, standing, watched
from benchmarks.machine_nights import (
    AS_MODELLED,
    OTHERWISE,
    PATHS,
    RING,
    SLEEVE,
    TWO_SIDED,
    Course,
    Machine,
    Night,
    State,
    nights_of,
)
from benchmarks.model_verdict import VG46
from benchmarks.results_file import Part, description, store, stored, write_parts
from pipeline.arrays import Array
from pipeline.demo.noise import autoregression

BASELINE, CHANGE, YEAR = 60, 75, 365
RATE, MOTORS, CALIBRATED_ON = 0.1, 30, 100
GREY = "grey box"
METHODS = (
    GREY,
    "mean flow, Shewhart",
    "mean flow, EWMA",
    "regression, EWMA",
    "boosting, EWMA",
)
MACHINES = {"otherwise": OTHERWISE, "as modelled": AS_MODELLED, "two-sided": TWO_SIDED}
LIMITS = "limits"
SEED = 25
# Ambient temperature [K about its mean]: the year, and the weather with its memory.
SEASON_K, WEATHER_K, WEATHER_PHI = 12.0, 4.0, 0.7
# What oil and sensor take of it.
OIL_FOLLOWS, SENSOR_FOLLOWS = 0.6, 0.1


@dataclass(frozen=True)
class Cell:
    """Motors to which the same happens; `course` is by the number of the motor.

    Their nights are those of other cells before `change`, unless that is the baseline's end.
    """

    words: str
    course: Callable[[int], Course]
    nights: int
    is_wear: bool
    change: int = CHANGE
    motors: int = MOTORS


def since(place: int, nights: float) -> float:
    """Share of so many nights that have passed since the change, 0 to 1."""
    return float(np.clip((place - CHANGE) / nights, 0.0, 1.0)) if place >= CHANGE else 0.0


def ambient_k(number: int, winter_first: bool) -> Array:
    """Ambient temperature over a year from its coldest or its warmest day on, shape (365,) [K]."""
    white = np.random.default_rng([SEED, number, 9]).standard_normal(YEAR)
    year = SEASON_K * np.cos(2.0 * np.pi * np.arange(YEAR) / YEAR)
    found: Array = WEATHER_K * autoregression(white, WEATHER_PHI)
    return found - year if winter_first else found + year


def _season(number: int) -> Course:
    air = ambient_k(number, winter_first=True)
    return lambda place: State(warmer_k=OIL_FOLLOWS * float(air[place]))


def _sensor(number: int) -> Course:
    air = ambient_k(number, winter_first=False)
    return lambda place: State(reads_high_c=SENSOR_FOLLOWS * float(air[place]))


def _same(state: Callable[[int], State]) -> Callable[[int], Course]:
    return lambda _: state


def _step(**factors: float) -> Callable[[int], Course]:
    return _same(lambda place: State(paths=factors) if place >= CHANGE else State())


CELLS = {
    "healthy": Cell("nothing", _same(lambda _: State()), YEAR, False, BASELINE, 60),
    "season": Cell("season: oil ± 7 K, winter first", _season, 245, False, BASELINE),
    "sensor": Cell("temperature sensor takes 10 % of ambient", _sensor, 245, False, BASELINE),
    "duty": Cell("load halved", _same(lambda n: State(load=0.5 if n >= CHANGE else 1)), 135, False),
    "oil": Cell(
        "VG 46 for VG 68, undeclared",
        _same(lambda n: State(oil=VG46 if n >= CHANGE else None)),
        95,
        False,
    ),
    "shear": Cell(
        "oil thins by 10 % in 90 nights",
        _same(lambda n: State(viscosity=1.0 - 0.1 * since(n, 90))),
        195,
        False,
    ),
    "meter": Cell(
        "meter drifts by +6 % in 120 nights",
        _same(lambda n: State(gain=1.0 + 0.06 * since(n, 120))),
        225,
        False,
    ),
    "step10": Cell("all gaps' flow +10 % at once", _step(**dict.fromkeys(PATHS, 1.1)), 115, True),
    "step20": Cell("all gaps' flow +20 % at once", _step(**dict.fromkeys(PATHS, 1.2)), 115, True),
    "step30": Cell("all gaps' flow +30 % at once", _step(**dict.fromkeys(PATHS, 1.3)), 115, True),
    "ring": Cell(
        "ring gap +37 % in 120 nights",
        _same(lambda n: State(paths={RING: (1.0 + 0.37 * since(n, 120)) ** 3})),
        225,
        True,
    ),
    "sleeve": Cell(
        "sleeve gap +9 % in a year (+10 % of leakage)",
        _same(lambda n: State(paths={SLEEVE: (1.0 + 0.09 * since(n, YEAR)) ** 3})),
        CHANGE + 200,
        True,
    ),
    "break": Cell("a sleeve breaks: its flow × 3", _step(**{SLEEVE: 3.0}), 95, True),
}


def made_nights(
    machine: Machine, course: Course, seed: Sequence[int], nights: range
) -> tuple[list[Night], list[Rows]]:
    """Some nights of a motor, and the rows of their fits."""
    found = nights_of(machine, course, seed, nights)
    labels = (FIRST + dt.timedelta(days=place) for place in nights)
    return found, [night_rows(*one) for one in zip(found, labels, strict=True)]


@lru_cache(maxsize=2 * MOTORS)
def _before(name: str, number: int) -> tuple[list[Night], list[Rows]]:
    """Nights of a motor to which nothing has happened yet."""
    course = _same(lambda _: State())(number)
    return made_nights(MACHINES[name], course, (SEED, number), range(CHANGE))


def outcome(name: str, cell: Cell, number: int, limits: dict[str, float]) -> dict[str, Any]:
    """What each method says of a motor.

    The number of the night of its first alarm from the change on, 1 being that of the change, or
    None; and what the grey box names ten nights after its own.
    """
    nights, rows = _before(name, number) if cell.change == CHANGE else ([], [])
    more = made_nights(
        MACHINES[name], cell.course(number), (SEED, number), range(len(nights), cell.nights)
    )
    nights, rows = nights + more[0], rows + more[1]
    told = watched(standing(nights, rows), cell.change)
    raised = {GREY: told.raised} | {
        method: values > limits[method] for method, values in charts(nights, BASELINE).items()
    }
    found: dict[str, Any] = {}
    for method, alarms in raised.items():
        later = np.flatnonzero(alarms[cell.change :])
        found[method] = int(later[0]) + 1 if len(later) else None
    return found | {"named": list(told.named), "is_common": told.is_common}


def limits_of(name: str) -> dict[str, float]:
    """Limits with which the charts of healthy motors alarm at the rate."""
    course = CELLS["healthy"].course(0)
    highest: dict[str, list[Array]] = {}
    for number in range(CALIBRATED_ON):
        made = nights_of(MACHINES[name], course, (SEED + 1, number), range(YEAR))
        for method, values in charts(made, BASELINE).items():
            highest.setdefault(method, []).append(np.maximum.accumulate(values[BASELINE:]))
    return {method: _limit(np.array(paths)) for method, paths in highest.items()}


def first_alarms(firsts: Sequence[int | None], nights: int) -> tuple[int, float]:
    """How many motors alarmed, and the years until they did, or were watched."""
    exposed = sum(nights if one is None else one for one in firsts) / YEAR
    return sum(one is not None for one in firsts), exposed


def _limit(highest: Array) -> float:
    """Lowest limit whose first alarms come at most at the rate."""
    for limit in np.arange(1.0, 12.0, 0.02):
        above = highest > limit
        exposed = np.where(above.any(axis=1), above.argmax(axis=1) + 1, highest.shape[1])
        if above.any(axis=1).sum() <= RATE * exposed.sum() / YEAR:
            return round(float(limit), 2)
    return 12.0


def share_interval(count: int, n: int) -> tuple[float, float]:
    """Exact 95 % interval of a share (Clopper and Pearson)."""
    lower = float(beta.ppf(0.025, count, n - count + 1)) if count else 0.0
    return lower, float(beta.ppf(0.975, count + 1, n - count)) if count < n else 1.0


def parts(known: dict[str, Any]) -> Iterator[Part]:
    """Tables of what is stored."""
    for name in MACHINES:
        found = known.get(name, {})
        if LIMITS in found:
            yield _limits_part(name, found[LIMITS])
        cells = [one for one in CELLS if one in found]
        for is_wear in (False, True):
            chosen = [one for one in cells if CELLS[one].is_wear == is_wear]
            if chosen:
                yield _cells_part(name, {one: found[one] for one in chosen}, is_wear)


def _limits_part(name: str, limits: dict[str, float]) -> Part:
    row = [f"{limits[method]:.2f}" for method in METHODS[1:]]
    text = "In standard deviations of the baseline's nights."
    return Part(f"Machine {name}: limits", text, " | ".join(METHODS[1:]), [row])


def _cells_part(name: str, cells: dict[str, Any], is_wear: bool) -> Part:
    rows = []
    for one, motors in cells.items():
        cell, row = CELLS[one], [CELLS[one].words]
        for method in METHODS:
            firsts = [motor[method] for motor in motors]
            row.append((_delay if is_wear else _alarmed)(firsts, cell.nights - cell.change))
        rows.append([*row, _named(motors)])
    if is_wear:
        heading, text = "worn motors", "nights to the first alarm, median (90 % quantile)"
    else:
        heading, text = "motors without wear", "motors that alarmed (95 % interval, exact)"
    text = f"{text[0].upper()}{text[1:]}; {len(motors)} motors a row, in the nights that follow."
    header = " | ".join(("change", *METHODS, "named by the grey box"))
    return Part(f"Machine {name}: {heading}", text, header, rows)


def _alarmed(firsts: Sequence[int | None], nights: int) -> str:
    count, years = first_alarms(firsts, nights)
    if nights == YEAR - BASELINE:
        lower, upper = (end / years for end in poisson_interval(count))
        return f"{count}: {count / years:.2f} a year ({lower:.2f} to {upper:.2f})"
    lower, upper = share_interval(count, len(firsts))
    return f"{count} ({100 * lower:.0f}–{100 * upper:.0f} %)"


def _delay(firsts: Sequence[int | None], nights: int) -> str:
    known = [np.inf if one is None else one for one in firsts]
    ends = np.quantile(known, [0.5, 0.9], method="higher")
    words = [f"{one:.0f}" if np.isfinite(one) else f"> {nights}" for one in ends]
    told = sum(one is not None for one in firsts)
    return f"{words[0]} ({words[1]})" + ("" if told == len(firsts) else f", {told} told")


def _named(motors: Sequence[dict[str, Any]]) -> str:
    said: dict[str, int] = {}
    for one in motors:
        if one[GREY] is None:
            continue
        words = " and ".join(path.replace("_", " ") for path in one["named"])
        if one["is_common"]:
            words = f"{words} and all flows" if words else "all flows"
        said[words or "cannot tell"] = said.get(words or "cannot tell", 0) + 1
    return ", ".join(f"{words} {n}" for words, n in sorted(said.items(), key=lambda x: -x[1]))


def main(options: Sequence[str] = ()) -> None:
    """Measure all cells or some, and write `benchmarks/results/alternatives.md`."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks alternatives")
    parser.add_argument("--only", default=",".join((LIMITS, *CELLS)))
    parser.add_argument("--machine", default="otherwise")
    chosen = parser.parse_args(list(options))
    for name in chosen.machine.split(","):
        for one in chosen.only.split(","):
            found = stored("alternatives").get(name, {})
            with threadpool_limits(1):
                if one == LIMITS:
                    found[one] = limits_of(name)
                else:
                    limits = found[LIMITS]
                    found[one] = [
                        outcome(name, CELLS[one], number, limits)
                        for number in range(CELLS[one].motors)
                    ]
            store("alternatives", name, found)
            sys.stderr.write(f"{name}: {one}\n")
    title = "The grey box beside charts, a regression and gradient boosting"
    write_parts("alternatives", title, description(__doc__), list(parts(stored("alternatives"))))
