"""A workshop: a motor, or some, whose logs and config a test writes as it likes."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from polars.testing import assert_frame_equal

from pipeline.config import MotorSpec, load_fleet
from pipeline.logs.processed import read_processed
from pipeline.run.fleet import RunRequest, run_fleet
from pipeline.run.tasks import MotorOutcome, MotorTask
from pipeline.schema import NIGHT_TABLES, NIGHTS
from pipeline.store.state import read_state_file
from tests.pipeline.calling import rows
from tests.pipeline.simulated import FLEET, Operation, motor_toml, operate, write_configs, write_log

DAY = dt.timedelta(days=1)
MINUTES = 24.0
# The quickest motor there is: one gap, no search.
MINI = """
motor_type = "MINI"
[[path]]
name = "gap"
law = "annular_gap"
source = "invented"
count = 8
radius_mm = 35.0
length_mm = 4.0
deformation_pressure_bar = 120.0
gap_um = { value = 8.0, minimum = 1.0, maximum = 60.0 }
"""
QUICK = FLEET + '[execution]\nbackend = "sequential"\n'


@dataclass(frozen=True, slots=True)
class Workshop:
    """The motor M1, or some, with logs that a test writes as it likes."""

    folder: Path

    @classmethod
    def at(cls, folder: Path) -> Workshop:
        """A workshop with its config, and no logs yet."""
        made = cls(folder)
        made.configure()
        made.logs.mkdir(parents=True)
        return made

    @property
    def logs(self) -> Path:
        return self.folder / "logs" / "M1"

    @property
    def output(self) -> Path:
        return self.folder / "out"

    @property
    def fleet(self) -> Path:
        return self.folder / "configs" / "fleet.toml"

    def take(self, motor: str) -> Path:
        """Take a motor's file, of type MINI; returns the folder of its logs."""
        write_configs(self.folder, {"M1": motor}, {"MINI": MINI}, QUICK)
        self.logs.mkdir(parents=True, exist_ok=True)
        return self.logs

    def configure(
        self,
        files: str | None = None,
        more: str = "",
        fleet: str = QUICK,
        motors: Sequence[str] = ("M1",),
        limits: str = "",
    ) -> None:
        texts = {motor: motor_toml(motor, "MINI", files=files, more=more) for motor in motors}
        write_configs(self.folder, texts, {"MINI": MINI + limits}, fleet)

    def run(self, **request: Any) -> MotorOutcome:
        (outcome,) = run_fleet(RunRequest(load_fleet(self.fleet), **request)).outcomes
        return outcome

    @property
    def spec(self) -> MotorSpec:
        return load_fleet(self.fleet).motors[0]

    def task(self) -> MotorTask:
        spec, staging = self.spec, self.folder / "staging"
        staging.mkdir(exist_ok=True)
        with read_state_file(self.output) as state:
            return MotorTask(spec, self.output, staging, read_processed(state, spec.motor_id))

    def night(self, label: dt.date, seed: int = 1) -> tuple[Operation, dict[str, Any]]:
        """A night with a little noise, the same for the same seed."""
        operation = operate(label, MINUTES, seed)
        motor = self.spec.motor(label, "none")
        noise = np.random.default_rng(seed).normal(0.0, 0.01, len(operation.time_us))
        return operation, operation.channels(operation.flow(motor) + noise)

    def log(
        self, label: dt.date, name: str | None = None, seed: int = 1, motor: str = "M1"
    ) -> Path:
        operation, values = self.night(label, seed)
        path = self.folder / "logs" / motor / (name or f"{label}.parquet")
        write_log(path, operation.time_us, values)
        return path

    def rows(self, table: str) -> pl.DataFrame:
        return rows(self.output, table)

    def statuses(self) -> dict[dt.date, str]:
        return dict(self.rows("nights").select("night", "status").iter_rows())


def check_same_figures(first: Workshop, second: Workshop, *exempt: str) -> None:
    for table in (NIGHTS, *NIGHT_TABLES):
        if table.name not in exempt:
            assert_frame_equal(first.rows(table.name), second.rows(table.name), check_exact=True)


def part(values: Mapping[str, Any], rows: slice) -> dict[str, Any]:
    """Some rows of a log's channels."""
    return {name: value[rows] for name, value in values.items()}
