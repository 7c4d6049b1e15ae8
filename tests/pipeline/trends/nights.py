"""Motors with nights of known truth: rows of the tables as fits would leave them, without a log.

Each night has its loss factors θ, estimates that scatter about them, and the statistics of samples
at a fixed set of conditions, whose flow is exactly that of θ.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from leakage import OperatingConditions, regressors
from leakage.estimation.block_statistics import factor
from pipeline.config import MotorSpec, load_fleet
from pipeline.config.motors import Event
from pipeline.config.nights import nights_between
from pipeline.demo import shipped_configs
from pipeline.night.rows import upper_triangle
from pipeline.schema import FITS, OPERATION, PARAMETERS, frame
from pipeline.store.encoding import write_table
from pipeline.store.tables import night_file
from pipeline.trends.nights.decisions import Decision
from pipeline.trends.nights.from_tables import rows_by_night
from pipeline.trends.nights.history import History, every_night
from pipeline.trends.nights.records import Layout
from pipeline.trends.stage import Part, neighbours_of, standing_of
from pipeline.trends.states.model import with_misfit
from pipeline.trends.states.standing import Standing
from tests.pipeline.simulated import motor_toml, write_configs

Array = NDArray[np.float64]
Row = dict[str, Any]

FIRST = dt.date(2026, 1, 2)
DAY = dt.timedelta(days=1)
OIL = "oil"
PATHS = ("piston_ring", "balance_piston", "balance_sleeve")
# Relative scatter of the estimates, as simulated nights of one to three hours have it.
SCATTER = {"piston_ring": 0.013, "balance_piston": 0.024, "balance_sleeve": 0.016, "C_f": 0.002}
CONDITIONS = tuple(product((20.0, 60.0, 120.0, 200.0, 280.0), (42.0, 50.0, 58.0), (10.0, 30.0, 90)))
HOURS = 12.0


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
    header = f'name = "Tests"\n[folders]\nlogs = "../logs"\noutput = "../out"\n{fleet}'
    types = {}
    if limits:
        shipped = (shipped_configs() / "motor_types" / "CB560.toml").read_text("utf-8")
        types["CB560"] = f"{shipped}\n{limits}"
    return write_configs(folder, {name: text}, types, fleet=header)


def step(n: int, at: int, size: float) -> Array:
    """A factor that steps from 1 by a relative size at a place."""
    return np.where(np.arange(n) >= at, 1.0 + size, 1.0)


def ramp(n: int, at: int, size: float) -> Array:
    """A factor that grows from 1 at a place by a relative size up to the last night."""
    return 1.0 + size * np.clip((np.arange(n) - at) / (n - 1 - at), 0.0, 1.0)


def named(spec: MotorSpec, name: str, circuit: str = "", events: Sequence[Event] = ()) -> MotorSpec:
    """The same motor under another name."""
    changes = {"motor_id": name, "oil_circuit": circuit, "events": tuple(events)}
    return replace(spec, file=spec.file.model_copy(update=changes))


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
    """A motor's nights of known truth.

    Parameters
    ----------
    spec
        The motor.
    n
        Nights.
    wear
        By path (and C_f), a factor on its coefficient in each night, shape (n,); by `OIL` one on
        all flows, those of the rollers among them, as thinner oil makes it.
    seed
        Of the estimates' scatter.
    noise
        Factor on that scatter.
    trade
        Correlation of the errors of pistons and sleeves: what one gains the other loses.
    changes
        By place, columns of `fits` that are otherwise.
    verdicts
        By place and parameter, another verdict than identified.
    absent
        Places of nights without any row.
    operation
        By column of `operation`, its values, shape (n,); nan for null.
    charge
        Charge over case pressure of each night [bar], shape (n,); None for none.
    """

    spec: MotorSpec
    n: int
    wear: Mapping[str, Array] = field(default_factory=dict)
    seed: int = 1
    noise: float = 1.0
    trade: float = 0.0
    changes: Mapping[int, Mapping[str, Any]] = field(default_factory=dict)
    verdicts: Mapping[tuple[int, str], str] = field(default_factory=dict)
    absent: frozenset[int] = frozenset()
    operation: Mapping[str, Array] = field(default_factory=dict)
    charge: Array | None = None

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

    @property
    def oil(self) -> Array:
        """Factor of all flows of each night, shape (n,)."""
        return self.wear.get(OIL, np.ones(self.n))

    def fitted(self) -> Array:
        """θ of each night as a fit has it, which takes the rollers' flow as known."""
        charge = None if self.charge is None else float(self.charge[0])
        triangle = _design(self.spec, self.spec.file.oil_on(FIRST), charge).triangle
        paths = triangle[:, : len(PATHS)]
        as_paths, *_ = np.linalg.lstsq(paths, triangle[:, -1])
        found = self.truth() * self.oil[:, None]
        found[:, : len(PATHS)] += (self.oil - 1.0)[:, None] * as_paths
        return found

    def estimates(self) -> Array:
        """θ as the nights' fits have it, shape (n, p + 1)."""
        generator = np.random.default_rng(self.seed)
        truth = self.fitted()
        scatter = np.array([SCATTER[name] for name in (*PATHS, "C_f")]) * self.noise
        drawn = generator.standard_normal(truth.shape)
        drawn[:, 2] = self.trade * drawn[:, 1] + np.sqrt(1.0 - self.trade**2) * drawn[:, 2]
        drawn *= scatter
        if self.mode != "estimated":
            drawn[:, -1] = 0.0
        return truth * (1.0 + drawn)

    def frames(self) -> dict[str, pl.DataFrame]:
        """Rows of `fits`, `parameters` and `operation`."""
        rows: dict[str, list[Row]] = {"fits": [], "parameters": [], "operation": []}
        truth, estimates = self.truth(), self.estimates()
        for place in range(self.n):
            if place not in self.absent:
                self._add(rows, place, truth[place], estimates[place])
        return {
            table.name: frame(table, rows[table.name]) for table in (FITS, PARAMETERS, OPERATION)
        }

    def _add(self, rows: dict[str, list[Row]], place: int, truth: Array, theta: Array) -> None:
        spec, label = self.spec, night_of(place)
        charge = None if self.charge is None else float(self.charge[place])
        design = _design(spec, spec.file.oil_on(label), charge)
        key = {"motor_id": spec.motor_id, "night": label}
        error = theta * np.array([SCATTER[name] for name in (*PATHS, "C_f")])
        if self.mode != "estimated":
            error[-1] = 0.0
        leakage = float(design.reference @ np.append(theta, 1.0) - theta[-1])
        contrast = np.append(design.reference[:-2], 0.0)
        half = 1.96 * float(np.sqrt(np.sum((contrast * error / 20.0) ** 2)))
        row: Row = key | {
            "motor_type": spec.file.motor_type,
            "flushing_mode": self.mode,
            "is_primary": True,
            "status": "ok",
            "n_training": 20_000,
            "sample_period_s": 0.2,
            "correlation_time_s": 1.0,
            "weight_inflation": 1.0,
            "interval_status": "ok",
            "n_interval_blocks": 33,
            "columns": list(design.columns),
            "coefficients": theta.tolist(),
            "coefficient_covariance_root": upper_triangle(np.diag(error / 20.0)),
            "night_factor": design.statistics(truth, float(self.oil[place])),
            "reference_leakage_l_per_min": leakage,
            "reference_leakage_lower": leakage - half,
            "reference_leakage_upper": leakage + half,
            "reference_verdict": "identified",
            "reference_pressure_bar": spec.settings.reference.pressure_bar,
            "reference_temperature_c": spec.settings.reference.temperature_c,
            "reference_speed_rpm": spec.settings.reference.speed_rpm,
            "own_pressure_bar": 136.0,
            "own_temperature_c": 50.0,
            "own_speed_rpm": 43.0,
            "model_hash": f"hash-{spec.file.oil_on(label)}",
            "mean_charge_over_case_bar": charge,
            "oil": spec.file.oil_on(label),
        }
        changed = self.changes.get(place, {})
        row |= changed
        rows["fits"].append(row)
        if row["status"] in ("ok", "insufficient_data"):
            rows["operation"].append(key | self._operated(place))
        if row["status"] != "ok":
            return
        names = [*(f"K_{path}" for path in PATHS), *(["C_f"] if self.mode != "none" else [])]
        for number, name in enumerate(names):
            verdict = self.verdicts.get((place, name), "identified")
            if name == "C_f" and self.mode == "fixed":
                verdict = "fixed"
            known = verdict == "identified"
            rows["parameters"].append(
                key
                | {
                    "flushing_mode": self.mode,
                    "parameter": name,
                    "value": float(theta[number]),
                    "unit": "m3",
                    "lower": float(theta[number] - 1.96 * error[number]) if known else None,
                    "upper": float(theta[number] + 1.96 * error[number]) if known else None,
                    "verdict": verdict,
                    "reason": None if known else f"{name} is {verdict}",
                }
            )

    def _operated(self, place: int) -> Row:
        row: Row = {
            "kept_hours": 2.0,
            "running_hours": HOURS,
            "running_hours_source": "share",
            "mean_temperature_c": 50.0,
            "share_reversed": 0.25,
            "pressure_histogram": [10] * 15 + [0] * 5,
            "temperature_histogram": [0] * 12 + [10] * 4 + [0] * 12,
            "speed_histogram": [10] * 10 + [0] * 5,
        }
        own = {name: float(values[place]) for name, values in self.operation.items()}
        return row | {name: None if np.isnan(value) else value for name, value in own.items()}


@dataclass(frozen=True)
class _Design:
    """Names of the columns, their triangular factor, and the columns at reference conditions."""

    columns: tuple[str, ...]
    triangle: Array
    reference: Array

    def statistics(self, theta: Array, oil: float = 1.0) -> list[float]:
        """Triangular factor of the samples of a night, whose flow is exactly that of θ and oil."""
        whole = np.zeros((len(theta) + 2, len(theta) + 2))
        whole[:-1, :-1] = self.triangle
        whole[:-1, -1] = oil * self.triangle @ np.append(theta, 1.0)
        return upper_triangle(whole)


_DESIGNS: dict[object, _Design] = {}


def _design(spec: MotorSpec, oil: str, charge: float | None) -> _Design:
    """Columns of the samples' conditions, and of the reference conditions."""
    reference = spec.settings.reference
    key = (spec.file.motor_type, oil, charge, reference.model_dump_json(), spec.file.flushing.mode)
    if key not in _DESIGNS:
        label = next(
            night
            for night in nights_between(FIRST, FIRST + 800 * DAY)
            if spec.file.oil_on(night) == oil
        )
        made = spec.motor(label, spec.file.flushing.mode)
        columns = np.array(CONDITIONS).T
        _DESIGNS[key] = _Design(
            made.columns,
            factor(regressors(made, OperatingConditions.from_bar(*columns, charge))),
            regressors(
                made,
                OperatingConditions.from_bar(
                    reference.pressure_bar, reference.temperature_c, reference.speed_rpm, charge
                ),
            )[0],
        )
    return _DESIGNS[key]


def history(nights: Nights, until: int | None = None, tonight: int | None = None) -> History:
    """The nights as trends see them, all of them or up to a place."""
    return histories(nights, until=until, tonight=tonight)[nights.spec.motor_id]


def histories(
    *motors: Nights, until: int | None = None, tonight: int | None = None
) -> dict[str, History]:
    """Several motors' nights, each up to its last row where no night is given."""
    frames = [one.frames() for one in motors]
    whole = {name: pl.concat([one[name] for one in frames]) for name in frames[0]}
    if until is not None:
        whole = {
            name: rows.filter(pl.col("night") <= night_of(until)) for name, rows in whole.items()
        }
    specs = [one.spec for one in motors]
    layouts = {one.motor_id: Layout.of(one, FIRST) for one in specs}
    by_motor = rows_by_night(specs, layouts, whole["fits"], whole["parameters"], whole["operation"])
    last = None if tonight is None else night_of(tonight)
    filled = {
        motor_id: every_night(one, last or one.nights[-1]) for motor_id, one in by_motor.items()
    }
    return {motor_id: one for motor_id, one in filled.items() if one is not None}


def standings(
    found: Mapping[str, History],
    decisions: Sequence[Decision] = (),
    change: Callable[[History], History] = lambda one: one,
) -> dict[str, Standing]:
    """Standings of the motors of one oil circuit, or of one motor alone."""
    said = {name: tuple(d for d in decisions if d.motor_id == name) for name in found}
    parts = {
        name: Part.of(with_misfit(change(replace(one, decisions=said[name])), dt.date.min))
        for name, one in found.items()
    }
    peers, circuit = neighbours_of(parts)
    return {name: standing_of(part, peers.get(name), circuit) for name, part in parts.items()}


def standing(nights: Nights, *decisions: Decision, tonight: int | None = None) -> Standing:
    """Standing of a motor on its own."""
    name = nights.spec.motor_id
    return standings(histories(nights, tonight=tonight), decisions)[name]


def publish(output: Path, frames: Mapping[str, pl.DataFrame]) -> None:
    """Write rows as the tables of an output folder; nights that are there are replaced."""
    for table in (FITS, PARAMETERS, OPERATION):
        for (night,), part in frames[table.name].partition_by("night", as_dict=True).items():
            write_table(night_file(output, table, night), part.sort(table.key))
