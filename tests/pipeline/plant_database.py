"""A plant whose motor has its nights in a database."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from pipeline.errors import LogError
from pipeline.logs.landing import land_nights
from tests.pipeline.postgres_server import PostgresServer
from tests.pipeline.simulated import motor_toml
from tests.pipeline.workshop import DAY, Workshop

VARIABLE = "MOTOR_LEAKAGE_DATABASE"
FIRST = dt.date(2026, 1, 2)
# Of the three nights the third is over, as it ends at 06:00.
CLOCK = dt.datetime(2026, 1, 4, 8, tzinfo=dt.UTC)
NIGHTS = tuple(FIRST + n * DAY for n in range(3))
QUERY = "SELECT * FROM log WHERE time >= {start} AND time < {end}"
FILES = 'format = "parquet"\nfiles = ["M1/*.parquet"]\n'


def latest(clock: dt.datetime = CLOCK) -> int:
    return round((clock + DAY).timestamp()) * 1_000_000


def logs_toml(query: str = QUERY, logs: str = "", more: str = "") -> str:
    return (
        f'format = "sql"\n{logs}[logs.database]\nbegin = {FIRST}\nquery = """{query}"""\n'
        f"look_back_days = 1\n{more}"
    )


@dataclass(frozen=True, slots=True)
class Plant(Workshop):
    """A motor whose nights lie in the table `log`."""

    server: PostgresServer

    @classmethod
    def at(cls, folder: Path, server: PostgresServer, nights: int = 3) -> Plant:
        made = cls(folder, server)
        made.configure()
        for seed, label in enumerate(NIGHTS[:nights]):
            made.fill(label, seed)
        return made

    def configure(self, text: str | None = None) -> None:
        self.take(motor_toml("M1", "MINI").replace(FILES, text or logs_toml()))

    def fill(self, label: dt.date, seed: int) -> None:
        operation, values = self.night(label, seed)
        self.server.fill("log", table(operation.time_us, values))

    def land(self, clock: dt.datetime = CLOCK) -> dict[str, LogError]:
        return land_nights(self.spec, latest(clock))

    def files(self) -> dict[str, bytes]:
        return {one.name: one.read_bytes() for one in self.spec.log_root.glob("*.parquet")}

    def landed(self, label: dt.date) -> pa.Table:
        return pq.read_table(self.spec.log_root / f"{label}.parquet")


def table(time_us: Any, values: Mapping[str, Any]) -> pa.Table:
    return pa.table({"time": pa.array(time_us, pa.timestamp("us", "UTC")), **values})


def stamp(label: dt.date, after: dt.timedelta = dt.timedelta()) -> str:
    """A time in the middle of a night, or so long after it."""
    return f"TIMESTAMPTZ '{label} 00:00:00+00' + interval '{after.total_seconds()} s'"
