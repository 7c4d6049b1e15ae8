"""A motor of a test's own, from its logs to its tables, as quick as one can be."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass
from pathlib import Path

import polars as pl
from polars.testing import assert_frame_equal

from pipeline.config import load_fleet
from pipeline.fleet import RunRequest, run_fleet
from pipeline.motor_task import MotorOutcome
from pipeline.schema import NIGHT_TABLES
from tests.pipeline.simulated import FLEET, write_configs

DAY = dt.timedelta(days=1)
# One gap, no search.
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
QUICK = FLEET + '[estimation]\nstarting_points = 0\n[execution]\nbackend = "sequential"\n'


@dataclass(frozen=True)
class Workshop:
    """A fleet of the motor M1, whose logs a test writes as it likes."""

    folder: Path

    @property
    def logs(self) -> Path:
        return self.folder / "logs" / "M1"

    @property
    def fleet(self) -> Path:
        return self.folder / "configs" / "fleet.toml"

    def configure(self, motor: str) -> Path:
        """Take a motor's file, of type MINI; returns the folder of its logs."""
        write_configs(self.folder, {"M1": motor}, {"MINI": MINI}, QUICK)
        self.logs.mkdir(parents=True, exist_ok=True)
        return self.logs

    def run(self, since: dt.date | None = None, until: dt.date | None = None) -> MotorOutcome:
        (outcome,) = run_fleet(RunRequest(load_fleet(self.fleet), (), since, until)).outcomes
        return outcome

    def rows(self, table: str) -> pl.DataFrame:
        """All of a table; empty, without columns, where there is none."""
        files = sorted((self.folder / "out" / "tables" / table).rglob("*.parquet"))
        found = [pl.read_parquet(path, hive_partitioning=False) for path in files]
        return pl.concat(found).drop("run_id") if found else pl.DataFrame()

    def statuses(self) -> dict[dt.date, str]:
        return dict(self.rows("fits").select("night", "status").iter_rows())


def check_same_figures(one: Workshop, other: Workshop, *exempt: str) -> None:
    for table in NIGHT_TABLES:
        if table.name not in exempt:
            assert_frame_equal(one.rows(table.name), other.rows(table.name), check_exact=True)
