"""A row of the table `watch`: what is reported of a motor in a night."""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

from pipeline.trends.sentences import advice, sentence

if TYPE_CHECKING:
    from leakage.watch import Change, Estimate
    from pipeline.trends.states.judged import JudgedNight

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


def watch_row(night: JudgedNight, quiet_since: dt.date | None, drifts: Sequence[str]) -> WatchRow:
    """The row of a night."""
    watched, change = night.watched, night.change
    row: dict[str, Any] = {
        "motor_id": night.spec.motor_id,
        "night": watched.night,
        "state": night.state,
        "sentence": sentence(night, quiet_since, drifts),
        "advice": advice(night, drifts),
        "model_verdict": night.model_verdict,
        "n_blocks": watched.n_blocks,
        **_leakages(night),
    }
    if change is not None:
        row |= _of_change(night, change)
    if (baseline := watched.baseline) is not None:
        row |= {
            "baseline_start": baseline.start,
            "baseline_end": baseline.end,
            "own_pressure_bar": baseline.own.pressure_bar,
            "own_temperature_c": baseline.own.temperature_c,
            "own_speed_rpm": baseline.own.speed_rpm,
        }
    if (verdict := watched.verdict) is not None:
        row |= {
            "evidence": verdict.evidence if math.isfinite(verdict.evidence) else None,
            "evidence_limit": verdict.limit,
            "lack_of_fit": verdict.lack_of_fit,
            "smallest_change": verdict.smallest,
            **_estimate("present_change", verdict.present),
        }
        if watched.n_blocks:
            row |= {"duty_distance": verdict.distance}
            row |= _estimate("tonight_change", verdict.newest_night)
    return WatchRow(**row)


def _of_change(night: JudgedNight, change: Change) -> dict[str, Any]:
    several = sorted(change.candidates.items(), key=lambda one: -one[1])
    row = {
        "cause": change.cause,
        "cause_probability": change.probability,
        "candidates": "; ".join(f"{name} {probability:.2f}" for name, probability in several),
        "since": dt.date.fromordinal(change.since),
        "since_lower": dt.date.fromordinal(change.since_lower),
        "since_upper": dt.date.fromordinal(change.since_upper),
        "told_on": dt.date.fromordinal(change.told_on),
        "goes_on": change.goes_on,
        "likely_iso_vg": change.grade,
        **_estimate("change", change.size),
    }
    gap = night.gap_growth
    return row if gap is None else row | _estimate("gap_growth", gap)


def _leakages(night: JudgedNight) -> dict[str, Any]:
    """Leakages of a night with blocks, at the reference and at the motor's own conditions."""
    row: dict[str, Any] = {}
    if not night.watched.n_blocks:
        return row
    own = None if isinstance(night.watched.own, str) else night.watched.own
    for name, found in (("reference", night.reference), ("own", own)):
        if found is not None:
            row[f"{name}_leakage_l_per_min"] = found.value
            row |= {f"{name}_leakage_lower": found.lower, f"{name}_leakage_upper": found.upper}
    return row


def _estimate(name: str, found: Estimate) -> dict[str, Any]:
    return {name: found.value, f"{name}_lower": found.lower, f"{name}_upper": found.upper}
