"""A row of the table `watch`: what is told of a motor in a night."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

# Causes that are no path of the motor's own; `flushing` is one that is estimated.
NO_PATHS = frozenset(
    {
        *("all_gaps", "all_flows", "oil_grade", "temperature_sensor", "temperature_effect"),
        *("flushing", "known", "zero", "back_as_before", "odd_nights", "tank", "cannot_be_told"),
    }
)


@dataclass(frozen=True, slots=True)
class WatchRow:
    """Columns of `watch`, as `columns.csv` describes them; None where one is null."""

    motor_id: str
    night: dt.date
    state: str
    sentence: str
    advice: str
    evidence: float | None = None
    evidence_limit: float | None = None
    lack_of_fit: float | None = None
    model_verdict: str | None = None
    cause: str | None = None
    cause_probability: float | None = None
    candidates: str | None = None
    change: float | None = None
    change_lower: float | None = None
    change_upper: float | None = None
    tonight_change: float | None = None
    tonight_change_lower: float | None = None
    tonight_change_upper: float | None = None
    present_change: float | None = None
    present_change_lower: float | None = None
    present_change_upper: float | None = None
    gap_growth: float | None = None
    gap_growth_lower: float | None = None
    gap_growth_upper: float | None = None
    reference_leakage_l_per_min: float | None = None
    reference_leakage_lower: float | None = None
    reference_leakage_upper: float | None = None
    own_leakage_l_per_min: float | None = None
    own_leakage_lower: float | None = None
    own_leakage_upper: float | None = None
    own_pressure_bar: float | None = None
    own_temperature_c: float | None = None
    own_speed_rpm: float | None = None
    since: dt.date | None = None
    since_lower: dt.date | None = None
    since_upper: dt.date | None = None
    told_on: dt.date | None = None
    goes_on: bool | None = None
    smallest_change: float | None = None
    duty_distance: float | None = None
    likely_iso_vg: int | None = None
    baseline_start: dt.date | None = None
    baseline_end: dt.date | None = None
    n_blocks: int = 0

    @classmethod
    def of(cls, row: Mapping[str, Any]) -> WatchRow:
        """The row of the table's columns, whatever else there is beside them."""
        return cls(**{name: row[name] for name in WATCH_COLUMNS if name in row})

    @property
    def path(self) -> str | None:
        """The path that the cause names; None where it names none."""
        return None if self.cause in NO_PATHS else self.cause

    @property
    def row(self) -> dict[str, Any]:
        """Its columns by name."""
        return {name: getattr(self, name) for name in WATCH_COLUMNS}


WATCH_COLUMNS = tuple(one.name for one in fields(WatchRow))
