"""A night whose samples are all kept, so that its errors can be computed by hand."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from leakage import OperatingConditions, regressors
from pipeline.config import MotorSpec
from pipeline.night.fit_night import NightOutcome, fit_night
from pipeline.schema.fits import OK
from tests.pipeline.simulated import NIGHT, Operation, load_motor, motor_toml, night_of, raw

Array = NDArray[np.float64]
Row = dict[str, Any]
MINUTES = 120.0
N = 7200
# Every sample is kept, so that errors can be computed by hand.
KEEP_ALL = "[override.cleaning]\nhampel_threshold = 1000.0\nfrozen_after_s = 1e6\n"


def motor(folder: Path, more: str = "") -> MotorSpec:
    return load_motor(folder, motor_toml("M1", more=more + KEEP_ALL))


def white(seed: int = 1, sd: float = 0.01, n: int = N) -> Array:
    return sd * np.random.default_rng(seed).standard_normal(n)


def true_flow(spec: MotorSpec, operation: Operation) -> Array:
    return operation.flow(spec.motor(NIGHT, "none"))


def fitted(
    spec: MotorSpec,
    operation: Operation,
    flow: Array,
    previous: Mapping[str, tuple[float, ...]] | None = None,
) -> NightOutcome:
    channels = raw(operation.time_us, operation.channels(flow))
    outcome = fit_night(spec, night_of(), channels, previous or {})
    assert outcome.status == OK, outcome.reason
    return outcome


def primary(outcome: NightOutcome) -> Row:
    return next(row for row in outcome.rows["fits"] if row["is_primary"])


def lags(outcome: NightOutcome, part: str, test: str, smoothed: bool = False) -> dict[int, Row]:
    return {
        row["lag"]: row
        for row in outcome.rows["residual_tests"]
        if (row["part"], row["smoothed"]) == (part, smoothed)
        and test in (row["input"], row["test"])
    }


class ByHand(NamedTuple):
    """Errors of a fit, and which samples train and validate."""

    error: Array
    training: slice
    validation: slice


def unchanged(values: Array) -> Array:
    return values


def by_hand(
    spec: MotorSpec,
    operation: Operation,
    flow: Array,
    outcome: NightOutcome,
    *,
    inputs: Callable[[Array], Array] = unchanged,
    output: Callable[[Array], Array] = unchanged,
) -> ByHand:
    """Errors of least squares on the training samples, smoothed as said; none may be missing."""
    at = OperatingConditions.from_bar(
        operation.pressure_bar, operation.temperature_c, operation.speed_rpm
    )
    row = primary(outcome)
    assert row["n_training"] + row["n_validation"] == N - 120  # a block of guard between them
    training = slice(0, row["n_training"])
    columns = regressors(spec.motor(NIGHT, "none"), at)
    free, known = columns[:, :-2], columns[:, -1]  # without flushing C_f is 0
    scale = np.linalg.norm(free, axis=0)
    smooth = np.column_stack([inputs(column) for column in free.T]) / scale
    target = output(flow) - inputs(known)
    theta = np.linalg.lstsq(smooth[training], target[training])[0] / scale
    return ByHand(
        flow - known - free @ theta,
        training,
        slice(N - row["n_validation"], N),
    )
