"""Motors with nights of known truth: rows of the tables as a run would leave them, without a log.

Each night has blocks of samples at changing conditions, whose flow is that of the night's loss
factors θ but for an error of the night and one of each block, and a fit that found θ.
"""

from __future__ import annotations

import datetime as dt
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from leakage import OperatingConditions, regressors
from leakage.estimation.blocks import factor
from pipeline.config import MotorSpec, load_fleet
from pipeline.config.motors import Event
from pipeline.demo import shipped_configs
from pipeline.night.rows import night_row
from pipeline.run.fleet import RunRequest, RunResult, run_fleet
from pipeline.schema import BLOCKS, FITS, NIGHTS, PARAMETERS, Table, frame
from pipeline.store.tables import read_rows
from pipeline.trends.decisions import Decision
from tests.pipeline.simulated import FLEET, motor_toml, with_file, write_configs
from tests.pipeline.written import write_nights

Array = NDArray[np.float64]
Row = dict[str, Any]
Frames = dict[str, pl.DataFrame]

FIRST = dt.date(2026, 1, 2)
DAY = dt.timedelta(days=1)
# By this name a change of all flows, the rollers' among them, as thinner oil makes it.
OIL = "oil"
PATHS = ("piston_ring", "balance_piston", "balance_sleeve")
HOURS = 12.0
# Errors of a night's flow and of a block's, relative.
NIGHT_ERROR, BLOCK_ERROR = 0.003, 0.004
N_BLOCKS, SAMPLES, BLOCK_S = 12, 8, 240
QUICK = '[execution]\nbackend = "sequential"\n'


@lru_cache(maxsize=16)
def motor(name: str = "M1", more: str = "", fleet: str = "", limits: str = "") -> MotorSpec:
    """A CB560, with more lines for its file, for the fleet's, and for its type's."""
    with TemporaryDirectory() as folder:
        (spec,) = load_fleet(configure(Path(folder), name, more, fleet, limits)).motors
    return spec


def configure(
    folder: Path, name: str = "M1", more: str = "", fleet: str = "", limits: str = ""
) -> Path:
    """Write the config of a fleet of one motor; returns the fleet's file."""
    text = motor_toml(name, "CB560", more=more)
    types = {}
    if limits:
        shipped = (shipped_configs() / "motor_types" / "CB560.toml").read_text("utf-8")
        types["CB560"] = f"{shipped}\n{limits}"
    return write_configs(folder, {name: text}, types, FLEET + fleet)


def step(n: int, at: int, size: float) -> Array:
    """A factor that steps from 1 by a relative size at a place."""
    return np.where(np.arange(n) >= at, 1.0 + size, 1.0)


def ramp(n: int, at: int, size: float) -> Array:
    """A factor that grows from 1 at a place by a relative size up to the last night."""
    return 1.0 + size * np.clip((np.arange(n) - at) / (n - 1 - at), 0.0, 1.0)


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


@dataclass(frozen=True)
class Nights:
    """A motor's nights of known truth; by place, what is otherwise than in a healthy motor.

    `wear` has by path (and C_f; by `OIL` of all flows) a factor in each night, of shape (n,).
    """

    spec: MotorSpec
    n: int
    wear: Mapping[str, Array] = field(default_factory=dict)
    seed: int = 1
    noise: float = 1.0
    statuses: Mapping[int, str] = field(default_factory=dict)
    absent: frozenset[int] = frozenset()  # without any row

    @property
    def mode(self) -> str:
        return self.spec.file.flushing.mode

    def truth(self) -> Array:
        """θ of each night, shape (n, p + 1)."""
        made = self.spec.motor(FIRST, self.mode)
        values = [path.configured_coefficient for path in made.column_paths]
        values.append(made.constant.configured_coefficient if made.constant else 0.0)
        factors = [self.wear.get(name, np.ones(self.n)) for name in (*PATHS, "C_f")]
        return np.array(values) * np.array(factors).T

    @cached_property
    def frames(self) -> Frames:
        """Rows of `nights`, `fits`, `parameters` and `blocks`."""
        rows: dict[str, list[Row]] = {table.name: [] for table in TABLES}
        for place, theta in enumerate(self.truth()):
            if place not in self.absent:
                self._add(rows, place, theta)
        return {table.name: frame(table, rows[table.name]) for table in TABLES}

    def _add(self, rows: dict[str, list[Row]], place: int, theta: Array) -> None:
        label = night_of(place)
        key = {"motor_id": self.spec.motor_id, "night": label}
        leakage = float(self._reference @ np.append(theta[:-1], (0.0, 1.0)))
        status = self.statuses.get(place, "ok")
        fit: Row = key | {"flushing_mode": self.mode, "is_primary": True}
        if status != "ok":
            rows["nights"].append(night_row(self.spec, label, {}, status))
            rows["fits"].append(fit)
            return
        fits = {"training_fit_percent": 99.0, "validation_fit_percent": 98.0}
        rows["nights"].append(night_row(self.spec, label, fits | OPERATED, status))
        rows["fits"].append(
            fit
            | fits
            | {
                "fitted_leakage_l_per_min": leakage,
                "fitted_leakage_lower": 0.99 * leakage,
                "fitted_leakage_upper": 1.01 * leakage,
                "fitted_leakage_verdict": "identified",
                "coefficients": theta.tolist(),
            }
        )
        rows["blocks"] += [key | block for block in self._blocks(place, theta)]
        for name, value in zip(PATHS, theta, strict=False):
            interval = {"lower": 0.97 * value, "upper": 1.03 * value}
            rows["parameters"].append(
                key
                | {"flushing_mode": self.mode, "parameter": f"K_{name}", "value": float(value)}
                | {"unit": "m3", "verdict": "identified"}
                | interval
            )

    @cached_property
    def _reference(self) -> Array:
        """Columns at the reference conditions."""
        asked = self.spec.settings.reference
        at = OperatingConditions.from_bar(asked.pressure_bar, asked.temperature_c, asked.speed_rpm)
        row: Array = regressors(self.spec.motor(FIRST, self.mode), at)[0]
        return row

    def _hash(self, place: int) -> str:
        return f"hash-{self.spec.file.oil_on(night_of(place))}"

    def _blocks(self, place: int, theta: Array) -> list[Row]:
        label = night_of(place)
        generator = np.random.default_rng([self.seed, place])
        oil = self.wear.get(OIL, np.ones(self.n))[place]
        night = 1.0 + self.noise * NIGHT_ERROR * generator.standard_normal()
        begin = dt.datetime.combine(label - DAY, dt.time(8), dt.UTC)
        designs = _designs(self.spec, self.spec.file.oil_on(label))
        columns = list(self.spec.motor(label, self.mode).columns)
        rows = []
        for number, (triangle, means) in enumerate(designs):
            error = 1.0 + self.noise * BLOCK_ERROR * generator.standard_normal()
            leaks, flushed = np.append(theta[:-1], (0.0, 1.0)), triangle[:, -2] * theta[-1]
            whole = np.zeros((len(triangle) + 1,) * 2)
            whole[:-1, :-1] = triangle
            whole[:-1, -1] = oil * night * error * triangle @ leaks + flushed
            start = begin + dt.timedelta(seconds=number * BLOCK_S)
            rows.append(
                {
                    "block_start": start,
                    "block_end": start + dt.timedelta(seconds=BLOCK_S),
                    "part": "training",
                    "n": SAMPLES,
                    "factor_columns": columns,
                    "factor": whole[np.triu_indices(len(whole))].tolist(),
                    "model_hash": self._hash(place),
                    **means,
                }
            )
        return rows


TABLES = (NIGHTS, FITS, PARAMETERS, BLOCKS)
OPERATED: Row = {
    "last_sample": dt.datetime(2026, 1, 1, 20, tzinfo=dt.UTC),
    "logged_hours": HOURS,
    "running_hours": HOURS,
    "mean_temperature_c": 50.0,
}


_DESIGNS: dict[object, list[tuple[Array, Row]]] = {}


def _designs(spec: MotorSpec, oil: str) -> list[tuple[Array, Row]]:
    """Factor of the columns of each block of a night, and the means of its conditions."""
    key = (spec.file.motor_type, oil, spec.file.flushing.mode)
    if key not in _DESIGNS:
        label = next(
            FIRST + n * DAY for n in range(800) if spec.file.oil_on(FIRST + n * DAY) == oil
        )
        made = spec.motor(label, spec.file.flushing.mode)
        _DESIGNS[key] = [_design(made, number) for number in range(N_BLOCKS)]
    return _DESIGNS[key]


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


def published_trends(output: Path, table: Table, motor_id: str = "M1") -> pl.DataFrame:
    """A motor's published rows of a table."""
    return read_rows(output, table, [motor_id]).drop("run_id").sort(table.key)


def run(config: Path, **asked: Any) -> RunResult:
    """A run on a fleet without logs: it makes the trends of what is published."""
    return run_fleet(RunRequest(load_fleet(config), **asked))


def fleet_of(
    folder: Path,
    *motors: Nights,
    fleet: str = "",
    more: Mapping[str, str] | None = None,
    until: int = 10_000,
) -> tuple[Path, Path]:
    """Publish the nights of some motors before a place, with their config; its file, the output."""
    folders = '[folders]\nlogs = "../logs"\noutput = "../out"\n'
    header = f'name = "Tests"\nlive = false\n{folders}{QUICK}{fleet}'
    files = {}
    for motor in motors:
        file = motor.spec.file
        text = motor_toml(file.motor_id, file.motor_type, more=(more or {}).get(file.motor_id, ""))
        files[file.motor_id] = f'oil_circuit = "{file.oil_circuit}"\n{text}'
    config = write_configs(folder, files, {}, fleet=header)
    publish(folder / "out", *(part_of(motor.frames, 0, until) for motor in motors))
    return config, folder / "out"


def publish(output: Path, *motors: Mapping[str, pl.DataFrame]) -> None:
    """Write rows of motors as the tables of an output folder, in place of those of its nights."""
    for table in TABLES:
        write_nights(output, table, pl.concat([motor[table.name] for motor in motors]))


def part_of(frames: Frames, first: int, end: int) -> Frames:
    """Rows of the nights between two places."""
    here = pl.col("night").is_between(night_of(first), night_of(end), closed="left")
    return {name: frame.filter(here) for name, frame in frames.items()}


def copy_of(folder: Path, place: Path) -> tuple[Path, Path]:
    """A copy of a fleet: its config and its output."""
    shutil.copytree(folder, place)
    return place / "configs" / "fleet.toml", place / "out"
