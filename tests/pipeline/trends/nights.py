"""A motor by its config, what is dated and decided of it, and stored blocks of one night."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from leakage import OperatingConditions, regressors
from leakage.estimation.blocks import factor
from pipeline.config import MotorSpec
from pipeline.config.motors import Event
from pipeline.demo import shipped_configs
from pipeline.schema import BLOCKS, frame
from pipeline.trends.decisions import Decision
from tests.pipeline.simulated import load_motor, motor_toml, with_file

Array = NDArray[np.float64]
Row = dict[str, Any]

FIRST = dt.date(2026, 1, 2)
DAY = dt.timedelta(days=1)
PATHS = ("piston_ring", "balance_piston", "balance_sleeve")
N_BLOCKS, SAMPLES, BLOCK_S = 12, 8, 240


@lru_cache(maxsize=16)
def motor(more: str = "", limits: str = "") -> MotorSpec:
    """The CB560 M1, with more lines for its file, and limits for its type."""
    shipped = (shipped_configs() / "motor_types" / "CB560.toml").read_text("utf-8")
    with TemporaryDirectory() as folder:
        types = {"CB560": f"{shipped}\n{limits}"}
        return load_motor(Path(folder), motor_toml("M1", "CB560", more=more), types)


def named(spec: MotorSpec, name: str, circuit: str = "", events: Sequence[Event] = ()) -> MotorSpec:
    """The same motor under another name."""
    return with_file(spec, motor_id=name, oil_circuit=circuit, events=tuple(events))


def night_of(place: int) -> dt.date:
    """Label of a night by its place."""
    return FIRST + place * DAY


def event(place: int, kind: str, **more: Any) -> Event:
    """A dated event."""
    return Event(date=night_of(place), kind=kind, **more)


def reset(place: int, indicator: str = "", note: str = "", motor_id: str = "M1") -> Decision:
    """A baseline that somebody has reset."""
    when = dt.datetime(2026, 6, 1, tzinfo=dt.UTC)
    return Decision(motor_id, indicator, when, "baseline_reset", night_of(place), None, note)


def block_rows(spec: MotorSpec) -> pl.DataFrame:
    """Blocks of the first night of a motor as configured, without noise; C_f is the stated flow."""
    mode = spec.file.flushing.mode
    made = spec.motor(FIRST, mode)
    flushing = made.constant.configured_coefficient if made.constant else 0.0
    theta = [path.configured_coefficient for path in made.column_paths]
    begin = dt.datetime.combine(FIRST - DAY, dt.time(8), dt.UTC)
    rows = []
    for number in range(N_BLOCKS):
        triangle, means = _design(made, number)
        whole = np.zeros((len(triangle) + 1,) * 2)
        whole[:-1, :-1] = triangle
        whole[:-1, -1] = triangle @ [*theta, flushing, 1.0]
        start = begin + number * dt.timedelta(seconds=BLOCK_S)
        rows.append(
            {
                "motor_id": spec.motor_id,
                "night": FIRST,
                "block_start": start,
                "block_end": start + dt.timedelta(seconds=BLOCK_S),
                "part": "training",
                "n": SAMPLES,
                "factor_columns": list(made.columns),
                "factor": whole[np.triu_indices(len(whole))].tolist(),
                "model_hash": "",
                **means,
            }
        )
    return frame(BLOCKS, rows)


def _design(made: Any, number: int) -> tuple[Array, Row]:
    share = number / (N_BLOCKS - 1)
    middle = 30.0 + 240.0 * ((3.0 * share) % 1.0)
    bar = middle + np.linspace(-10.0, 10.0, SAMPLES)
    celsius, rpm = 42.0 + 16.0 * share, 10.0 + 80.0 * ((7.0 * share) % 1.0)
    at = OperatingConditions.from_bar(bar, np.full(SAMPLES, celsius), np.full(SAMPLES, rpm))
    means: Row = {}
    for name, values in (("pressure_bar", bar), ("temperature_c", [celsius]), ("speed_rpm", [rpm])):
        means |= {f"mean_{name}": float(np.mean(values))}
        means |= {f"minimum_{name}": float(min(values)), f"maximum_{name}": float(max(values))}
    return factor(regressors(made, at)), means
