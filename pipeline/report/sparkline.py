"""A small picture of a motor's leakage over the nights, as SVG paths."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Array
from pipeline.report.history import MotorHistory
from pipeline.thinning import keep_extremes

WIDTH, HEIGHT, MARGIN = 120.0, 28.0, 2.5
POINTS = 90
# The picture is at least this share of the median high each way, so that noise looks like noise.
LEAST_REACH = 0.15
# Days without a value over which no line is drawn.
LONGEST_GAP = 7


@dataclass(frozen=True, slots=True)
class Sparkline:
    """A course as SVG paths in a box of `WIDTH` by `HEIGHT`."""

    line: str  # broken where nights have no value
    baseline: str  # level of the newest baseline; empty without one
    last: tuple[float, float]  # place of the newest value
    # smallest, largest: of the values, l/min.
    smallest: float
    largest: float


def sparkline(motor: MotorHistory, span: tuple[dt.date, dt.date]) -> Sparkline | None:
    """A motor's leakage at its own conditions; None without a value.

    `span` are the nights at the edges of the picture, the same for all motors of a fleet.
    """
    known = np.flatnonzero(motor.leakage.is_known)
    if not len(known):
        return None
    value = motor.leakage.value[known]
    first, newest = (np.datetime64(one) for one in span)
    days = (motor.stamps[known] - first).astype(float)
    kept = keep_extremes([value], POINTS)
    median = float(np.median(value))
    reach = max(float(np.abs(value - median).max()), LEAST_REACH * abs(median), 1e-9)

    def height(flow: Array) -> Array:
        inside: Array = np.clip((flow - median) / reach, -1.0, 1.0)
        return HEIGHT / 2 - inside * (HEIGHT / 2 - MARGIN)

    length = max(float((newest - first).astype(float)), 1.0)
    x = MARGIN + days[kept] / length * (WIDTH - 2 * MARGIN)
    y = height(value[kept])
    longest = max(LONGEST_GAP, 3 * length / POINTS)
    breaks = np.concatenate([[True], np.diff(days[kept]) > longest])
    level = motor.level[np.isfinite(motor.level)]
    return Sparkline(
        line="".join(
            f"{'M' if new else 'L'}{a:.1f} {b:.1f}"
            for a, b, new in zip(x.tolist(), y.tolist(), breaks.tolist(), strict=True)
        ),
        baseline=f"M{MARGIN:g} {height(level)[-1]:.1f}H{WIDTH - MARGIN:g}" if len(level) else "",
        last=(round(float(x[-1]), 1), round(float(y[-1]), 1)),
        smallest=float(value.min()),
        largest=float(value.max()),
    )
