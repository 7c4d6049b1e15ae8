"""Dates to a limit: how often the sets hold, how many end, and how wide they are."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks.results_file import write_results
from leakage.course.time_to_limit import TimeToLimit, time_to_limit
from pipeline.arrays import Array
from pipeline.demo.noise import autoregression

Generator = np.random.Generator
# Position of a share of the life, and the share of the limit's rise that is reached there.
Course = Callable[[Array, Generator], Array]

LIVES = 200
NIGHTS = (60, 120, 365)
SCATTER = (0.01, 0.02)
PHIS = (0.0, 0.3, 0.6)
LIMIT = 1.3
GAP_GROWTH = np.cbrt(LIMIT) - 1.0
# Of what is left of a life, in units of what was seen.
LEFT = (0.1, 3.0)
JUMPS_A_LIFE = 8.0
# Hours of a night, and from the middle of what was seen on where the duty changes.
HOURS, LATER_HOURS = 8.0, 4.0
HORIZON = 10.0


def _of_gap(growth: Array) -> Array:
    """K from the share of the growth of its gap."""
    k: Array = (1.0 + GAP_GROWTH * growth) ** 3
    return k


def _gap(t: Array, _: Generator) -> Array:
    return _of_gap(t)


def _linear(t: Array, _: Generator) -> Array:
    return 1.0 + (LIMIT - 1.0) * t


def _accelerating(t: Array, generator: Generator) -> Array:
    c = generator.uniform(2.0, 5.0)
    return _linear(np.expm1(c * t) / np.expm1(c), generator)


def _running_in(t: Array, generator: Generator) -> Array:
    """A fast part that fades, and a slow one that goes on."""
    c, share = generator.uniform(2.0, 8.0), generator.uniform(0.3, 0.7)
    course = -share * np.expm1(-c * t) + (1.0 - share) * t
    return _linear(course / (-share * np.expm1(-c) + 1.0 - share), generator)


def _late(t: Array, generator: Generator) -> Array:
    """Nothing at first, then a straight line."""
    begin = generator.uniform(0.05, 0.5)
    return _linear(np.maximum(t - begin, 0.0) / (1.0 - begin), generator)


COURSES: dict[str, Course] = {
    "constant growth of the gap": _gap,
    "linear K": _linear,
    "linear K, half the duty from the middle on": _linear,
    "accelerating": _accelerating,
    "running-in": _running_in,
    "nothing, then linear": _late,
}
STEPS = "steps"


@dataclass(frozen=True, slots=True)
class Life:
    """K of a motor up to tonight, the running hours, and the hours left until its limit."""

    k: Array
    hours: Array
    left: float


def life(course: str, n: int, generator: Generator) -> Life:
    """A life of which n nights were seen."""
    hours = np.full(n, HOURS)
    if "duty" in course:
        hours[n // 2 :] = LATER_HOURS
    position = np.cumsum(hours) - hours[0]
    seen = float(position[-1])
    if course == STEPS:
        return _life_by_steps(position, generator)
    whole = seen * (1.0 + np.exp(generator.uniform(*np.log(LEFT))))
    return Life(COURSES[course](position / whole, generator), position, whole - seen)


def _life_by_steps(position: Array, generator: Generator) -> Life:
    """A gap that grows by jumps of exponential sizes at random times, and not in between."""
    seen = float(position[-1])
    while True:
        whole = seen * (1.0 + np.exp(generator.uniform(*np.log(LEFT))))
        at = np.cumsum(generator.exponential(whole / JUMPS_A_LIFE, 200))
        growth = np.append(0.0, np.cumsum(generator.exponential(1.0 / JUMPS_A_LIFE, 200)))
        left = float(at[int(np.argmax(growth[1:] >= 1.0))]) - seen
        if LEFT[0] * seen <= left <= LEFT[1] * seen:
            return Life(_of_gap(growth[np.searchsorted(at, position)]), position, left)


def main() -> None:
    """Measure and write `benchmarks/results/dates.md`."""
    write_results(
        "dates",
        "Dates to a limit by course of the wear",
        (
            "course | nights | no trend told, % | set holds, % (worst cell) | a range, % | "
            "range holds, % | width of the range over what is left | earliest time over what is "
            "left"
        ),
        [[course, str(n), *_cells(course, n)] for course in (*COURSES, STEPS) for n in NIGHTS],
    )


def _cells(course: str, n: int) -> Iterator[str]:
    """Figures of a course seen for some nights, over all scatters and memories."""
    cells = [_found(course, n, sd, phi) for sd in SCATTER for phi in PHIS]
    told = [[(of, found) for of, found in cell if found.status != "no_trend"] for cell in cells]
    flat = [one for cell in told for one in cell]
    ranges = [one for one in flat if one[1].status == "finite"]
    worst = min(_held(cell) for cell in told)
    yield f"{100.0 * (1.0 - len(flat) / sum(map(len, cells))):.1f}"
    yield f"{_held(flat):.1f} ({worst:.1f})"
    yield f"{100.0 * len(ranges) / sum(map(len, cells)):.0f}"
    yield f"{_held(ranges):.0f}" if len(ranges) >= 20 else "–"
    widths = [((one.upper or 0.0) - (one.lower or 0.0)) / of.left for of, one in ranges]
    yield f"{np.median(widths):.2f}" if len(ranges) >= 20 else "–"
    yield f"{np.median([(one.lower or 0.0) / of.left for of, one in flat]):.2f}"


def _found(course: str, n: int, sd: float, phi: float) -> list[tuple[Life, TimeToLimit]]:
    place = [*COURSES, STEPS].index(course)
    generator = np.random.default_rng([7, place, n, int(1000 * sd), int(10 * phi)])
    noise = autoregression(generator.standard_normal((n, LIVES)), phi)
    found = []
    for scatter in noise.T:
        one = life(course, n, generator)
        values = one.k * (1.0 + sd * scatter)
        horizon = HORIZON * float(one.hours[-1])
        found.append((one, time_to_limit(np.arange(n), one.hours, values, LIMIT, horizon)))
    return found


def _held(found: list[tuple[Life, TimeToLimit]]) -> float:
    """Share of sets that hold the truth, in %; a limit said to be crossed is never right here."""
    held = [
        one.status != "already_crossed"
        and (one.lower or 0.0) <= of.left <= (np.inf if one.upper is None else one.upper)
        for of, one in found
    ]
    return 100.0 * float(np.mean(held)) if held else np.nan
