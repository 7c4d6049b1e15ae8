"""Rows of the table `watch`, from what is judged of each night."""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Sequence
from typing import Any

from leakage.watch import Change, Estimate
from pipeline.trends.rows.watch_rows import WatchRow
from pipeline.trends.sentences import advice, sentence
from pipeline.trends.states.judged import JudgedNight


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
            row |= _estimate("tonight_change", verdict.tonight)
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
