"""Records of the pump rig: read, checked, and cut where they are no longer one record.

Source: Silesian University of Technology, Appl. Sci. 2024, 14(16), 7183, files `*UT*.csv`: 1 Hz,
times in `Czas2`, label of the valve plate's state in `stan`.
"""

from __future__ import annotations

import datetime as dt
import re
from dataclasses import dataclass
from pathlib import Path

import polars as pl

TIME = "Czas2"
STATE = "stan"
PRESSURE = "Pressure - output"
TEMPERATURE = "Temperature - leak line"
FLOW = "Flow - leak line"
COLUMNS = (TIME, STATE, PRESSURE, TEMPERATURE, FLOW)
GAP = dt.timedelta(seconds=5)  # cleaning.gap_sample_periods at 1 Hz
WARM_C = 48.0


@dataclass(frozen=True, slots=True)
class Record:
    """Rows of one file in one state of the machine, in order of time; notes say what is unusual."""

    name: str
    state: str
    rows: pl.DataFrame
    notes: tuple[str, ...]

    def warm(self) -> pl.DataFrame:
        """Rows from the first one at `WARM_C` to the last one."""
        warm = self.rows.with_row_index().filter(pl.col(TEMPERATURE) >= WARM_C)["index"]
        if warm.is_empty():
            return self.rows.clear()
        return self.rows[warm[0] : warm[-1] + 1]


def read_records(folder: Path) -> list[Record]:
    """All records of a folder, each in one state.

    A new record begins where the state changes or the clock goes back: two states are never
    averaged. Gaps stay, as the program judges them itself; each is noted.
    """
    files = sorted(path for path in folder.rglob("*UT*.csv*") if path.is_file())
    if not files:
        raise SystemExit(f"{folder}: no file *UT*.csv or *UT*.csv.gz")
    return [record for file in files for record in _records_of(file)]


def _records_of(file: Path) -> list[Record]:
    rows = pl.read_csv(file, try_parse_dates=True)
    if missing := [name for name in COLUMNS if name not in rows.columns]:
        raise SystemExit(f"{file}: no column {', '.join(missing)}")
    rows = rows.select(COLUMNS).drop_nulls(TIME)
    new_state = pl.col(STATE).ne_missing(pl.col(STATE).shift()).fill_null(value=False)
    reset = (pl.col(TIME).diff() < pl.duration()).fill_null(value=False)
    begins = (new_state | reset) & (pl.int_range(pl.len()) > 0)
    parts = rows.with_columns(begins.cum_sum().alias("part")).partition_by("part")
    name = re.sub(r"\W", "-", file.name.split(".")[0])
    changes = [f"state {part[STATE][0]} from {part[TIME][0]:%F %T}" for part in parts]
    several = (f"{file.name}: {'; '.join(changes)}; judged apart",) if len(parts) > 1 else ()
    return [
        Record(
            f"{name}-{number}" if several else name,
            str(part[STATE][0]),
            part.drop("part"),
            several + _gaps(part),
        )
        for number, part in enumerate(parts, start=1)
    ]


def _gaps(rows: pl.DataFrame) -> tuple[str, ...]:
    steps = rows.select(TIME, step=pl.col(TIME).diff()).filter(pl.col("step") > GAP)
    return tuple(
        f"gap of {step.total_seconds():.0f} s to {time:%F %T}" for time, step in steps.rows()
    )


def windows(rows: pl.DataFrame, length: dt.timedelta, step: dt.timedelta) -> list[pl.DataFrame]:
    """Stretches of a length, one at each step."""
    if rows.is_empty() or (room := rows[TIME][-1] - rows[TIME][0] - length) < dt.timedelta():
        return []
    begins = [rows[TIME][0] + number * step for number in range(room // step + 1)]
    return [rows.filter(pl.col(TIME).is_between(t, t + length, closed="left")) for t in begins]
