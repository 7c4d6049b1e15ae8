"""A night whose samples are all kept, so that its errors can be computed by hand."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from leakage import OperatingConditions, regressors
from pipeline.config import MotorSpec
from pipeline.night.fit_night import NightOutcome
from tests.pipeline.night.noise_free import fit_of
from tests.pipeline.simulated import NIGHT, Array, load_motor, motor_toml, operate

Row = dict[str, Any]
LONG = operate(minutes=120.0)
N = len(LONG.time_us)
AT = OperatingConditions.from_bar(LONG.pressure_bar, LONG.temperature_c, LONG.speed_rpm)
# Every sample is kept, so that errors can be computed by hand.
KEEP_ALL = "[override.cleaning]\nhampel_threshold = 1000.0\nfrozen_after_s = 1e6\n"


def motor(folder: Path, more: str = "") -> MotorSpec:
    return load_motor(folder, motor_toml("M1", more=more + KEEP_ALL))


def rows_of(outcome: NightOutcome, table: str, part: str, test: str, smoothed: bool) -> list[Row]:
    """Rows of a test, whiteness or independence of an input."""
    return [
        row
        for row in outcome.rows[table]
        if (row["part"], row["smoothed"]) == (part, smoothed)
        and test in (row["input"], row["test"])
    ]


def lags(outcome: NightOutcome, part: str, test: str, smoothed: bool = False) -> dict[int, Row]:
    rows = rows_of(outcome, "residual_tests", part, test, smoothed)
    return {row["lag"]: row for row in rows}


class ByHand(NamedTuple):
    """Errors of a fit, and which samples train and validate."""

    error: Array
    training: slice
    validation: slice


def unchanged(values: Array) -> Array:
    return values


def by_hand(
    spec: MotorSpec,
    flow: Array,
    outcome: NightOutcome,
    *,
    inputs: Callable[[Array], Array] = unchanged,
    output: Callable[[Array], Array] = unchanged,
) -> ByHand:
    """Errors of least squares on the training samples, smoothed as said; none may be missing."""
    row = fit_of(outcome.rows)
    assert row["n_training"] + row["n_validation"] == N - 120  # a block of guard between them
    training = slice(0, row["n_training"])
    columns = regressors(spec.motor(NIGHT, "none"), AT)
    free, known = columns[:, :-2], columns[:, -1]  # without flushing C_f is 0
    scale = np.linalg.norm(free, axis=0)
    smooth = np.column_stack([inputs(column) for column in free.T]) / scale
    target = output(flow) - inputs(known)
    theta = np.linalg.lstsq(smooth[training], target[training])[0] / scale
    return ByHand(flow - known - free @ theta, training, slice(N - row["n_validation"], N))
