"""Small pictures of a motor's nights, as SVG paths: its leakage, and each night's outcome."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Array
from pipeline.report.history import Course
from pipeline.thinning import keep_extremes

WIDTH, HEIGHT, MARGIN = 150.0, 30.0, 2.5
POINTS = 90
# The picture is at least this share of the median high each way, so that noise looks like noise.
LEAST_REACH = 0.15
# Height of a night's bar by its outcome, and of the whole strip.
STRIP_HEIGHTS = {
    "ok": 10,
    "stood_still": 4,
    "insufficient_data": 7,
    "failed": 10,
    "no_new_data": 2,
}
STRIP_HEIGHT, BAR, STEP = 10, 3, 4


@dataclass(frozen=True, slots=True)
class Sparkline:
    """A course as SVG paths in a box of `WIDTH` by `HEIGHT`."""

    # line, band: the values, broken where nights have none, and their intervals.
    line: str
    band: str
    baseline: str  # level of the baseline; empty without one
    last: tuple[float, float]  # place of the newest value
    # smallest, largest: of the values.
    smallest: float
    largest: float


def sparkline(
    days: NDArray[np.int64],
    course: Course,
    ends: tuple[int, int],
    baseline: float | None = None,
) -> Sparkline | None:
    """A course over the nights as a small picture; None without a value.

    `days` is the place of each night in time, `ends` the days at the edges of the picture, the same
    for all motors of a fleet, `baseline` a level to draw across it.
    """
    known = np.flatnonzero(course.is_known)
    if not len(known):
        return None
    value = course.value[known]
    median = float(np.median(value))
    reach = max(float(np.abs(value - median).max()), LEAST_REACH * abs(median), 1e-9)
    first, newest = ends
    span = max(newest - first, 1)

    def x(day: Array) -> Array:
        return MARGIN + (day - first) / span * (WIDTH - 2 * MARGIN)

    def y(flow: Array) -> Array:
        inside: Array = np.clip((flow - median) / reach, -1.0, 1.0)
        return HEIGHT / 2 - inside * (HEIGHT / 2 - MARGIN)

    kept = keep_extremes([value], POINTS)
    drawn = known[kept]
    # Beyond a week without a value the line is not drawn.
    breaks = np.concatenate([[True], np.diff(days[drawn]) > max(7, 3 * span / POINTS)])
    at = x(days[drawn].astype(float))
    level = "" if baseline is None else f"M{MARGIN:g} {float(y(np.array(baseline))):.1f}"
    return Sparkline(
        line=_line(at, y(value[kept]), breaks),
        band=_band(at, y(course.lower[drawn]), y(course.upper[drawn]), breaks),
        baseline=f"{level}H{WIDTH - MARGIN:g}" if level else "",
        last=(round(float(at[-1]), 1), round(float(y(value[-1:])[0]), 1)),
        smallest=float(value.min()),
        largest=float(value.max()),
    )


def _line(x: Array, y: Array, breaks: NDArray[np.bool_]) -> str:
    return "".join(
        f"{'M' if new else 'L'}{a:.1f} {b:.1f}"
        for a, b, new in zip(x.tolist(), y.tolist(), breaks.tolist(), strict=True)
    )


def _band(x: Array, low: Array, high: Array, breaks: NDArray[np.bool_]) -> str:
    """One closed outline a stretch of neighbours that all have an interval."""
    known = np.isfinite(low) & np.isfinite(high)
    begins = np.flatnonzero(known & (breaks | ~np.roll(known, 1)))
    outlines = []
    for begin in begins.tolist():
        end = begin + 1
        while end < len(x) and known[end] and not breaks[end]:
            end += 1
        if end - begin > 1:
            there = zip(x[begin:end].tolist(), high[begin:end].tolist(), strict=True)
            back = zip(x[begin:end][::-1].tolist(), low[begin:end][::-1].tolist(), strict=True)
            points = "L".join(f"{a:.1f} {b:.1f}" for a, b in (*there, *back))
            outlines.append(f"M{points}Z")
    return "".join(outlines)


def strip(statuses: Sequence[str | None]) -> dict[str, str]:
    """One SVG path by outcome, a bar a night; a night without a row has none."""
    paths: dict[str, str] = {}
    for place, status in enumerate(statuses):
        if status is None:
            continue
        height = STRIP_HEIGHTS.get(status, STRIP_HEIGHT)
        bar = f"M{place * STEP} {STRIP_HEIGHT - height}h{BAR}v{height}h-{BAR}z"
        paths[status] = paths.get(status, "") + bar
    return paths
