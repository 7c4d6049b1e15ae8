"""Records of the pump rig.

Source: Silesian University of Technology, Appl. Sci. 2024, 14(16), 7183, files `*UT*.csv`: 1 Hz,
times in `Czas2`, label of the valve plate's state in `stan`.
"""

from __future__ import annotations

import datetime as dt
import re
from dataclasses import dataclass
from pathlib import Path

import polars as pl

from leakage import OperatingConditions

TIME = "Czas2"
STATE = "stan"
PRESSURE = "Pressure - output"
TEMPERATURE = "Temperature - leak line"
FLOW = "Flow - leak line"
COLUMNS = (TIME, STATE, PRESSURE, TEMPERATURE, FLOW)
WARM_C = 48.0
METER_READS_FROM = 1.7  # l/min, as in the config
SPEED_RPM = 1485.0


@dataclass(frozen=True, slots=True)
class Record:
    """Rows of one file in one state of the machine, in order of time."""

    name: str
    state: str
    rows: pl.DataFrame

    def warm(self) -> pl.DataFrame:
        """Rows from the first one at `WARM_C` to the last one."""
        warm = self.rows.with_row_index().filter(pl.col(TEMPERATURE) >= WARM_C)["index"]
        if warm.is_empty():
            return self.rows.clear()
        return self.rows[warm[0] : warm[-1] + 1]


def read_records(folder: Path) -> list[Record]:
    """All records of a folder, each in one state; gaps stay, as the program judges them itself."""
    files = sorted(path for path in folder.rglob("*UT*.csv*") if path.is_file())
    if not files:
        raise SystemExit(f"{folder}: no file *UT*.csv or *UT*.csv.gz")
    return [_record_of(file) for file in files]


def _record_of(file: Path) -> Record:
    rows = pl.read_csv(file, try_parse_dates=True)
    if missing := [name for name in COLUMNS if name not in rows.columns]:
        raise SystemExit(f"{file}: no column {', '.join(missing)}")
    rows = rows.select(COLUMNS).drop_nulls(TIME)
    if rows[STATE].n_unique() > 1 or not rows[TIME].is_sorted():
        raise SystemExit(f"{file}: several states, or a clock that goes back: cut it into files")
    return Record(re.sub(r"\W", "-", file.name.split(".")[0]), str(rows[STATE][0]), rows)


def conditions(rows: pl.DataFrame) -> OperatingConditions:
    """Operating conditions of a record's rows."""
    bar, celsius = (rows[name].cast(pl.Float64).to_numpy() for name in (PRESSURE, TEMPERATURE))
    return OperatingConditions.from_bar(bar, celsius, SPEED_RPM)


def windows(rows: pl.DataFrame, length: dt.timedelta, step: dt.timedelta) -> list[pl.DataFrame]:
    """Stretches of a length, one at each step."""
    if rows.is_empty() or (room := rows[TIME][-1] - rows[TIME][0] - length) < dt.timedelta():
        return []
    begins = [rows[TIME][0] + number * step for number in range(room // step + 1)]
    return [rows.filter(pl.col(TIME).is_between(t, t + length, closed="left")) for t in begins]
