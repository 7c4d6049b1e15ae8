"""A motor with known gaps, its nights, and what is read of a night's rows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from leakage import AnnularGap
from pipeline.config import MotorSpec
from pipeline.night.fit_night import NightOutcome, fit_night
from pipeline.night.rows import Rows
from pipeline.schema import OK
from tests.pipeline.simulated import NIGHT, Array, Operation, night_of, raw

# Gaps of the worked values (model.md, sections 3 and 4), in µm, each a little off the configured.
TRUTH = {"piston_ring": 1.05**3, "balance_piston": 0.93**3, "balance_sleeve": 1.02**3}


def true_coefficients(spec: MotorSpec, flushing: float = 0.0) -> dict[str, float]:
    motor = spec.motor(NIGHT, "none")
    factors = {
        path.name: path.configured_coefficient * TRUTH[path.name]
        for path in motor.paths
        if isinstance(path, AnnularGap)
    }
    return factors | {"flushing": flushing}


def simulate(spec: MotorSpec, operation: Operation, flushing: float = 0.0) -> dict[str, Array]:
    motor = spec.motor(NIGHT, "estimated")
    return operation.channels(operation.flow(motor, true_coefficients(spec, flushing)))


def fit(spec: MotorSpec, operation: Operation, values: Mapping[str, Any]) -> NightOutcome:
    return fit_night(spec, night_of(), raw(operation.time_us, values))


def fitted(
    spec: MotorSpec, operation: Operation, flow: Array, more: Mapping[str, Array] | None = None
) -> NightOutcome:
    """A night with this drain flow, which has a fit."""
    outcome = fit(spec, operation, operation.channels(flow) | dict(more or {}))
    assert outcome.status == OK, outcome.reason
    return outcome


def white(n: int, sd: float = 0.01, seed: int = 1) -> Array:
    return sd * np.random.default_rng(seed).standard_normal(n)


def configured_flow(spec: MotorSpec, operation: Operation) -> Array:
    """The drain flow of the motor as configured, without noise."""
    return operation.flow(spec.motor(NIGHT, "none"))


def values_of(rows: Rows, mode: str) -> dict[str, float]:
    return {
        row["parameter"]: row["value"]
        for row in rows["parameters"]
        if row["flushing_mode"] == mode and row["value"] is not None
    }


def parameters(outcome: NightOutcome) -> dict[str, dict[str, Any]]:
    return {row["parameter"]: row for row in outcome.rows["parameters"]}


def fit_of(rows: Rows, mode: str | None = None) -> dict[str, Any]:
    """Row of a fit, the primary one by default, with that of the night."""
    (found,) = (
        row for row in rows["fits"] if (row["flushing_mode"] == mode if mode else row["is_primary"])
    )
    return rows["nights"][0] | found


def refused_of(outcome: NightOutcome) -> dict[tuple[str, str], int]:
    """Refused samples by channel and reason."""
    return {(row["channel"], row["reason"]): row["n_refused"] for row in outcome.rows["quality"]}
