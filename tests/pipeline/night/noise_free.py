"""A motor with known gaps, and its nights without noise."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from leakage import AnnularGap
from pipeline.config import MotorSpec
from pipeline.night.fit_night import NightOutcome, fit_night
from pipeline.night.rows import Rows
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


def fit(
    spec: MotorSpec,
    operation: Operation,
    values: Mapping[str, Any],
    previous: Mapping[str, tuple[float, ...]] | None = None,
) -> NightOutcome:
    return fit_night(spec, night_of(), raw(operation.time_us, values), previous or {})


def values_of(rows: Rows, mode: str) -> dict[str, float]:
    return {
        row["parameter"]: row["value"]
        for row in rows["parameters"]
        if row["flushing_mode"] == mode and row["value"] is not None
    }


def fit_of(rows: Rows, mode: str | None = None) -> dict[str, Any]:
    (found,) = (
        row for row in rows["fits"] if (row["flushing_mode"] == mode if mode else row["is_primary"])
    )
    return found


def noisy(values: Mapping[str, Array]) -> dict[str, Array]:
    """The same with noise on the drain flow."""
    flow = values["leakage_flow"]
    return {**values, "leakage_flow": flow + np.random.default_rng(3).normal(0.0, 0.02, len(flow))}
