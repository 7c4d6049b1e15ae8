"""The one builder of fleets: motors that wear as stated, their logs and config, and the truth."""

from __future__ import annotations

import datetime as dt
import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from polars import DataFrame

from leakage import OperatingConditions, leakage_l_per_min
from pipeline.config import MotorSpec, load_fleet
from pipeline.demo import shipped_configs
from pipeline.demo.fleet import (
    PISTON,
    RING,
    SLEEVE,
    DemoMotor,
    DemoNight,
    Plan,
    Recording,
    record_night,
    truth_document,
)
from pipeline.demo.fleet import Wear as DemoWear
from pipeline.demo.writing import write_log
from tests.scenarios.command import Result, examined, run_command

Row = dict[str, Any]

FIRST = dt.date(2026, 1, 2)
DAY = dt.timedelta(days=1)
GAPS = (RING, PISTON, SLEEVE)
NO_PLAN = Plan(0, 0.0, 1.0, 1, FIRST)
# By channel, its unit and further keys; the simulation writes in steps of the resolution.
CHANNELS = {
    "pressure_difference": ("bar", "resolution = 0.1\n"),
    "oil_temperature": ("degC", "resolution = 0.1\n"),
    "speed": ("rpm", "resolution = 0.1\n"),
    "leakage_flow": ("l/min", "sensor_maximum = 16.0\nresolution = 0.02\n"),
}
SEQUENTIAL = '[execution]\nbackend = "sequential"\n'


@dataclass(frozen=True, slots=True)
class Wear(DemoWear):
    """Gaps that grow up to a last night; behind it they are as made (a repair)."""

    last_night: int = 10**6
    is_step: bool = True
    repaired_on: int = 10**6

    def growth(self, path: str, number: int) -> float:
        """Relative growth of a path's gap height by a night, counted from 1."""
        if path not in self.paths or not self.first_night <= number < self.repaired_on:
            return 0.0
        nights = self.last_night - self.first_night + 1
        share = 1.0 if self.is_step else min((number - self.first_night + 1) / nights, 1.0)
        return self.gap_growth * share


def step(*paths: str, at: int, gap: float, repaired_on: int = 10**6) -> Wear:
    """Gaps that are larger by a share from a night on; all gaps where none is named."""
    words = f"a step of {gap:+.0%} at night {at}"
    return Wear(words, paths or GAPS, at, gap, repaired_on=repaired_on)


def ramp(*paths: str, begin: int, end: int, gap: float) -> Wear:
    """Gaps that grow evenly from a night on, by a share until the last."""
    words = f"{gap:+.0%} from night {begin} to {end}"
    return Wear(words, paths or GAPS, begin, gap, last_night=end, is_step=False)


@dataclass(frozen=True, slots=True)
class Simulated:
    """A motor, what happens to it, and how it is logged."""

    motor_id: str = "M1"
    wear: Wear = Wear("none", (), 1, 0.0)
    format: str = "parquet"
    motor_type: str = "CB400"
    circuit: str = ""
    flushing: float = 0.0  # of the true motor [l/min]
    # Readings from a night on, by channel: (first night, factor, offset), as a meter that drifts.
    misread: Mapping[str, tuple[int, float, float]] = field(default_factory=dict)
    # Rows by which the drain flow is logged late from a night on: (first night, rows).
    late_flow: tuple[int, int] | None = None
    # Share of the drain flow that is missing at the start, and goes within minutes: cold oil.
    cold_share: float = 0.0
    # Another oil than the config says from a night on: (first night, name).
    unstated_oil: tuple[int, str] | None = None
    lines: str = ""  # further lines of its file: [[events]], [flushing], …
    operation: Mapping[str, Any] = field(default_factory=dict)  # of the demo's motor: pressure_bar


@dataclass(frozen=True, slots=True)
class Truth:
    """What is true of a fleet's motors, from its `truth.json` and its config."""

    document: Mapping[str, Any]
    specs: Mapping[str, MotorSpec]

    def worn(self, motor: str) -> tuple[str, ...]:
        """Leakage paths that wear."""
        return tuple(self.document["motors"][motor]["worn_paths"])

    def gap_change_percent(self, motor: str, path: str, row: Mapping[str, Any]) -> float:
        """True change of a gap on the night of a row since the row's baseline."""
        nights = self._nights(motor)
        before = np.mean([nights[night]["K_m3"][path] for night in _baseline(row)])
        return 100.0 * float((nights[row["night"]]["K_m3"][path] / before) ** (1 / 3) - 1.0)

    def flow(self, motor: str, night: dt.date, conditions: OperatingConditions) -> float:
        """True mean drain flow of a night's motor at some conditions, flushing included."""
        model, nights = self.specs[motor].motor(night, "none"), self._nights(motor)
        coefficients = {path.name: path.configured_coefficient for path in model.paths}
        coefficients |= nights[night]["K_m3"]
        leakage = leakage_l_per_min(model, conditions, coefficients)
        return float(leakage.mean()) + float(nights[night]["C_f_l_per_min"])

    def _nights(self, motor: str) -> dict[dt.date, Any]:
        nights = self.document["motors"][motor]["nights"]
        return {dt.date.fromisoformat(label): truth for label, truth in nights.items()}


def _baseline(row: Mapping[str, Any]) -> list[dt.date]:
    """Nights of a row's baseline."""
    n = (row["baseline_end"] - row["baseline_start"]).days + 1
    return [row["baseline_start"] + DAY * number for number in range(n)]


def table(output: Path, name: str) -> DataFrame:
    """A published table, as a reader has it; without rows where nothing is published of it."""
    files = sorted((output / "tables" / name).rglob("*.parquet"))
    rows = pl.read_parquet(files, hive_partitioning=False) if files else DataFrame()
    return rows.sort("motor_id", "night") if files and name == "nights" else rows


@dataclass(frozen=True, slots=True)
class ScenarioFleet:
    """A fleet in a folder: `configs/`, logs, `out/`."""

    folder: Path
    motors: Mapping[str, Simulated] = field(default_factory=dict)
    plan: Plan = NO_PLAN
    logs: str = "logs"
    output_name: str = "out"

    @property
    def config(self) -> Path:
        """The fleet file."""
        return self.folder / "configs" / "fleet.toml"

    @property
    def output(self) -> Path:
        """The output folder."""
        return self.folder / self.output_name

    def run(self, command: str, *arguments: object, **how: Any) -> Result:
        """Run a command on the fleet: its words, the config, then further arguments."""
        how = {"folder": self.folder} | how
        return run_command(*command.split(), self.config, *arguments, **how)

    def fitted(self, *options: str) -> ScenarioFleet:
        """The same, after its first nightly run."""
        done = self.run("fit-fleet", *options)
        assert done.code == 0, done.err
        return self

    def copy(self, folder: Path) -> ScenarioFleet:
        """A copy to change at will."""
        shutil.copytree(self.folder, folder, dirs_exist_ok=True)
        return replace(self, folder=folder)

    def table(self, name: str) -> DataFrame:
        """A published table, by the names of the design."""
        examined()
        return table(self.output, name)

    def nights(self, motor: str) -> list[Row]:
        """Rows of `nights` of a motor, in order."""
        return self.table("nights").filter(pl.col("motor_id") == motor).to_dicts()

    def newest(self, motor: str) -> Row:
        """The row of `latest` of a motor."""
        (row,) = self.table("latest").filter(pl.col("motor_id") == motor).to_dicts()
        return row

    def truth(self) -> Truth:
        """What was simulated."""
        path = self.folder / self.logs / ".." / "truth.json"
        specs = {spec.motor_id: spec for spec in load_fleet(self.config).motors}
        return Truth(json.loads(path.read_text("utf-8")), specs)

    def true_change_percent(self, row: Mapping[str, Any]) -> float:
        """True change of the leakage on the night of a row, at its baseline's conditions."""
        truth, motor, baseline = self.truth(), row["motor_id"], _baseline(row)
        samples = self.table("predictions").filter(
            (pl.col("motor_id") == motor) & pl.col("night").is_in(baseline)
        )
        inputs = ("pressure_difference_bar", "oil_temperature_c", "speed_rpm")
        conditions = OperatingConditions.from_bar(*(samples[name].to_numpy() for name in inputs))
        nights = truth.document["motors"][motor]["nights"]

        def leakage(night: dt.date) -> float:
            flushed = nights[night.isoformat()]["C_f_l_per_min"]
            return float(truth.flow(motor, night, conditions)) - float(flushed)

        before = float(np.mean([leakage(night) for night in baseline]))
        return 100.0 * (leakage(row["night"]) / before - 1.0)

    def label(self, number: int) -> dt.date:
        """Date of a night, counted from 1."""
        return self.plan.first_night + DAY * (number - 1)

    def log(self, motor: str, number: int) -> Path:
        """Log of a night."""
        name = f"{motor}_{self.label(number)}.{self.motors[motor].format}"
        return self.folder / self.logs / motor / name

    def change(self, file: str, before: str, after: str) -> None:
        """Change a text of a config file, which is in it."""
        path = self.config.parent / file
        text = path.read_text("utf-8")
        assert before in text, (file, before)
        path.write_text(text.replace(before, after), "utf-8")

    def append(self, file: str, text: str) -> None:
        """Add lines to the end of a config file."""
        path = self.config.parent / file
        path.write_text(f"{path.read_text('utf-8')}\n{text}\n", "utf-8")

    def write_night(
        self,
        motor: str,
        number: int,
        *,
        until: float | None = None,
        rise: float = 0.0,
        rise_at: float = 0.0,
    ) -> Path:
        """Write a night's log, up to a minute of it: again and again, it grows.

        The drain flow is higher by a share from a minute of it on.
        """
        simulated, night = self.motors[motor], self._night(motor, number)
        recording = _misread(record_night(night), simulated, number)
        minute = (recording.time_us - recording.time_us[0]) / 60e6
        values = dict(recording.values)
        flow = values["leakage_flow"]
        maximum = night.spec.file.channels["leakage_flow"].sensor_maximum
        risen = np.minimum(flow * (1.0 + rise * (minute >= rise_at)), maximum or np.inf)
        values["leakage_flow"] = np.where(np.isnan(flow), flow, np.round(risen, 6))
        shown = minute < (until or np.inf)
        recording = Recording(
            recording.time_us[shown],
            {name: value[shown] for name, value in values.items()},
            {name: delay[shown] for name, delay in recording.own_delay_us.items()},
        )
        path = self.log(motor, number)
        path.parent.mkdir(parents=True, exist_ok=True)
        _write(path, recording, night)
        return path

    def _night(self, motor: str, number: int) -> DemoNight:
        simulated = self.motors[motor]
        spec = next(spec for spec in load_fleet(self.config).motors if spec.motor_id == motor)
        return _demo_night(simulated, spec, self.plan, number)


def make_fleet(
    folder: Path,
    *motors: Simulated,
    nights: int = 20,
    minutes: float = 40.0,
    rate_hz: float = 1.0,
    seed: int = 1,
    first_night: dt.date = FIRST,
    settings: str = "",
    **motor: Any,
) -> ScenarioFleet:
    """Make a fleet's config, logs and `truth.json` below a folder.

    `motors`, or one motor M1 with the fields of `Simulated` given by name. `settings`: further
    lines of the fleet file. Nothing is fitted yet (`fitted()`), and the program never reads the
    truth.
    """
    simulated = {one.motor_id: one for one in motors or (Simulated(**motor),)}
    plan = Plan(nights, minutes, rate_hz, seed, first_night)
    fleet = ScenarioFleet(folder, simulated, plan)
    _write_configs(fleet, settings)
    specs = {spec.motor_id: spec for spec in load_fleet(fleet.config).motors}
    made = []
    for name, one in simulated.items():
        (folder / "logs" / name).mkdir(parents=True)
        for number in range(1, nights + 1):
            night = _demo_night(one, specs[name], plan, number)
            recording = _misread(record_night(night), one, number)
            write_log(fleet.log(name, number), recording, night.spec.file)
            made.append(night)
    document = truth_document(plan, made)
    (folder / "truth.json").write_text(json.dumps(document), "utf-8")
    return fleet


def _write_configs(fleet: ScenarioFleet, settings: str) -> None:
    configs = fleet.folder / "configs"
    for name in ("motor_types", "oils"):
        shutil.copytree(shipped_configs() / name, configs / name)
    (configs / "motors").mkdir()
    folders = '[folders]\nlogs = "../logs"\noutput = "../out"\n'
    text = f'name = "Scenario"\nlive = false\n{folders}{SEQUENTIAL}'
    fleet.config.write_text(f"{text}{settings}\n", "utf-8")
    for motor in fleet.motors.values():
        path = configs / "motors" / f"{motor.motor_id}.toml"
        path.write_text(_motor_file(motor), "utf-8")


def _motor_file(motor: Simulated) -> str:
    circuit = f'oil_circuit = "{motor.circuit}"\n' if motor.circuit else ""
    time = "log_time" if motor.format == "mcap" else "time"
    channels = "".join(
        f'[channels.{name}]\nsource = "{name}"\nunit = "{unit}"\n{more}'
        for name, (unit, more) in CHANNELS.items()
    )
    return (
        f'motor_id = "{motor.motor_id}"\nmotor_type = "{motor.motor_type}"\noil = "vg68"\n{circuit}'
        f'[logs]\nformat = "{motor.format}"\ntime = "{time}"\n'
        f'files = ["{motor.motor_id}/*.{motor.format}"]\n{channels}{motor.lines}\n'
    )


def _demo_night(motor: Simulated, spec: MotorSpec, plan: Plan, number: int) -> DemoNight:
    demo = DemoMotor(
        motor.motor_id,
        {},
        motor.wear,
        flushing_l_per_min=motor.flushing,
        **{"pressure_bar": (15.0, 280.0), **motor.operation},
    )
    if motor.unstated_oil and number >= motor.unstated_oil[0]:
        file = spec.file.model_copy(update={"oil": motor.unstated_oil[1], "events": ()})
        spec = replace(spec, file=file)
    return DemoNight(demo, spec, plan, number)


def _misread(recording: Recording, motor: Simulated, number: int) -> Recording:
    """The recording as sensors log it that read wrong."""
    values = dict(recording.values)
    for channel, (first, factor, offset) in motor.misread.items():
        if number >= first:
            values[channel] = np.round(values[channel] * factor + offset, 6)
    if motor.cold_share:
        minutes = (recording.time_us - recording.time_us[0]) / 60e6
        cold = 1.0 - motor.cold_share * np.exp(-minutes / 12.0)
        values["leakage_flow"] = np.round(values["leakage_flow"] * cold, 6)
    if motor.late_flow and number >= motor.late_flow[0]:
        values["leakage_flow"] = np.roll(values["leakage_flow"], motor.late_flow[1])
    return replace(recording, values=values)


def _write(path: Path, recording: Recording, night: DemoNight) -> None:
    """Write a log; a text that goes on with what is there is appended, as a logger does."""
    if night.spec.file.logs.format != "csv" or not path.exists():
        write_log(path, recording, night.spec.file)
        return
    whole = path.with_name(f".{path.name}.whole")
    write_log(whole, recording, night.spec.file)
    content, before = whole.read_bytes(), path.read_bytes()
    whole.unlink()
    if content.startswith(before):
        with path.open("ab") as file:
            file.write(content[len(before) :])
    else:
        path.write_bytes(content)
