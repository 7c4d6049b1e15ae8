"""Published nights of made-up motors: as many as a test likes, without a log or a fit."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from leakage.block_statistics import factor
from pipeline.config import load_fleet
from pipeline.fleet import RunRequest, RunResult, run_fleet
from pipeline.schema import FITS, OPERATION, PARAMETERS, Table, frame
from pipeline.store import night_file, read_rows, write_table
from tests.pipeline.simulated import motor_toml, write_configs
from tests.pipeline.workshop import MINI, QUICK

Array = NDArray[np.float64]

FIRST = dt.date(2026, 1, 2)
K = 7.5e-14
# Flow of the gap per unit of K, at the reference conditions and on the mean [l/min / m³].
FLOW = 1.4 / K
SCATTER = 0.01


def label(number: int) -> dt.date:
    return FIRST + dt.timedelta(days=number)


@dataclass(frozen=True)
class Nights:
    """A fleet whose tables a test writes.

    Attributes
    ----------
    folder
        Where configs and tables lie.
    circuits
        Oil circuit by motor.
    """

    folder: Path
    circuits: dict[str, str] = field(default_factory=lambda: {"M1": ""})
    fleet_settings: str = QUICK

    @property
    def output(self) -> Path:
        return self.folder / "out"

    def configure(self, more: str = "") -> None:
        motors = {
            motor: motor_toml(motor, "MINI", more=more).replace(
                'oil = "vg68"', f'oil = "vg68"\noil_circuit = "{circuit}"'
            )
            for motor, circuit in self.circuits.items()
        }
        write_configs(self.folder, motors, {"MINI": MINI}, self.fleet_settings)
        (self.folder / "logs").mkdir(exist_ok=True)

    def write(self, courses: dict[str, Array], first: int = 0, **more: Any) -> None:
        """Publish nights: each motor's K relative to that of a new one; nan for no fit."""
        for place in range(len(next(iter(courses.values())))):
            night = label(first + place)
            fits: list[dict[str, Any]] = []
            parameters: list[dict[str, Any]] = []
            operation: list[dict[str, Any]] = []
            for motor, course in courses.items():
                ratio = float(course[place])
                if np.isnan(ratio):
                    fits.append(unfitted(motor, night))
                    continue
                fits.append(fitted(motor, night, ratio) | more)
                parameters.append(estimated(motor, night, ratio))
                operation.append(operated(motor, night))
            for table, rows in ((FITS, fits), (PARAMETERS, parameters), (OPERATION, operation)):
                self._put(table, night, rows)

    def _put(self, table: Table, night: dt.date, rows: Sequence[dict[str, Any]]) -> None:
        path = night_file(self.output, table, night)
        if rows:
            write_table(path, frame(table, [{"run_id": "test", **row} for row in rows]))
        elif path.exists():
            path.unlink()

    def run(self) -> RunResult:
        return run_fleet(RunRequest(load_fleet(self.folder / "configs" / "fleet.toml")))

    def rows(self, table: Table, motor: str = "M1") -> pl.DataFrame:
        return read_rows(self.output, table, [motor]).drop("run_id").sort(table.key)


def courses(n: int, seed: int = 1, scatter: float = SCATTER) -> Array:
    """A healthy motor's K over n nights, relative."""
    course: Array = 1.0 + scatter * np.random.default_rng(seed).standard_normal(n)
    return course


def fitted(motor: str, night: dt.date, ratio: float) -> dict[str, Any]:
    k = K * ratio
    flow = FLOW * np.linspace(0.5, 1.5, 50)
    z = np.column_stack([flow, np.ones(50), np.zeros(50), k * flow])
    leakage, half = k * FLOW, 0.01 * k * FLOW
    return {
        "motor_id": motor,
        "motor_type": "MINI",
        "night": night,
        "flushing_mode": "none",
        "is_primary": True,
        "status": "ok",
        "columns": ["gap", "one", "known", "measured"],
        "coefficients": [k, 0.0],
        "coefficient_covariance": [(0.005 * k) ** 2, 0.0, 0.0],
        "night_factor": factor(z)[np.triu_indices(4)].tolist(),
        "n_kept": 50,
        "n_interval_blocks": 50,
        "interval_status": "ok",
        "reference_leakage_l_per_min": leakage,
        "reference_leakage_lower": leakage - half,
        "reference_leakage_upper": leakage + half,
        "reference_verdict": "identified",
        "reference_pressure_bar": 200.0,
        "reference_temperature_c": 50.0,
        "reference_speed_rpm": 30.0,
        "own_pressure_bar": 110.0,
        "own_temperature_c": 47.0,
        "own_speed_rpm": 25.0,
        "model_hash": "same",
        "oil": "vg68",
    }


def unfitted(motor: str, night: dt.date) -> dict[str, Any]:
    return {
        "motor_id": motor,
        "motor_type": "MINI",
        "night": night,
        "flushing_mode": "none",
        "is_primary": True,
        "status": "stood_still",
        "reason": "the motor stood still all night",
        "oil": "vg68",
    }


def estimated(motor: str, night: dt.date, ratio: float) -> dict[str, Any]:
    return {
        "motor_id": motor,
        "night": night,
        "flushing_mode": "none",
        "parameter": "K_gap",
        "value": K * ratio,
        "unit": "m3",
        "lower": 0.99 * K * ratio,
        "upper": 1.01 * K * ratio,
        "verdict": "identified",
    }


def operated(motor: str, night: dt.date) -> dict[str, Any]:
    def histogram(size: int) -> list[int]:
        return [10] * size

    return {
        "motor_id": motor,
        "night": night,
        "running_hours": 20.0,
        "running_hours_source": "share",
        "mean_temperature_c": 47.0,
        "share_reversed": 0.0,
        "pressure_histogram": histogram(20),
        "temperature_histogram": histogram(28),
        "speed_histogram": histogram(15),
        "n_halts": 3,
        "pressure_zero_bar": 0.0,
        "pressure_zero_standard_error_bar": 0.05,
        "flow_zero_l_per_min": 0.0,
        "flow_zero_standard_error_l_per_min": 0.001,
    }
