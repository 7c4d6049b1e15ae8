"""What all of a motor's nights say of one: columns of its row of `nights`."""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

from pipeline.schema import NIGHTS
from pipeline.trends.sentences import WAIT, advice, sentence

if TYPE_CHECKING:
    from leakage.watch import Change, Estimate
    from pipeline.trends.nights.history import History
    from pipeline.trends.states.night_state import NightState

Row = dict[str, Any]

# A night is short that has less than this share of the short ones of the last nights before.
SHORT, NIGHTS_COMPARED, FEWEST_COMPARED = 0.8, 14, 5


# What is said of a motor, and stays in force in a night of which no trends are made.
CARRIED = (
    *(column.name for column in NIGHTS.columns if column.group in ("state", "baseline")),
    *("sentence", "advice"),
)
NO_TRENDS: Row = {"state": "insufficient", "sentence": "no trends yet", "advice": WAIT}


def in_state_before(row: Row, published: pl.DataFrame) -> Row:
    """A night's own row in the state of its motor, given the rows published so far, in order."""
    before = published.filter(pl.col("night") <= row["night"]).select(CARRIED)
    return row | (before.row(-1, named=True) if before.height else NO_TRENDS)


def state_columns(
    night: NightState,
    quiet_since: dt.date | None,
    drifts: Sequence[str],
    notices: Sequence[str],
) -> Row:
    """Return leakages, their change, the state with its words, and the baseline of a night."""
    change, verdict, baseline = night.change, night.verdict, night.baseline
    row: Row = {
        "state": night.state,
        "sentence": sentence(night, quiet_since, [*drifts, *notices]),
        "advice": advice(night, drifts),
        "alarm_level_percent": night.spec.settings.alarms.alarm_percent,
        **_leakages(night),
    }
    if change is not None:
        row |= _of_change(night, change)
    if baseline is not None:
        row |= {
            "baseline_start": baseline.start,
            "baseline_end": baseline.end,
            "own_pressure_bar": baseline.own.pressure_bar,
            "own_temperature_c": baseline.own.temperature_c,
            "own_speed_rpm": baseline.own.speed_rpm,
        }
    if verdict is not None:
        row |= {
            "evidence": verdict.evidence if math.isfinite(verdict.evidence) else None,
            "evidence_limit": verdict.limit,
            "model_error_percent": 100.0 * verdict.lack_of_fit,
            "detection_limit_percent": verdict.smallest and 100.0 * verdict.smallest,
            **_percent("mean_change", verdict.present),
        }
        if night.n_blocks:
            row |= _percent("leakage_change", verdict.newest_night)
    return row


def _of_change(night: NightState, change: Change) -> Row:
    candidates = sorted(change.candidates.items(), key=lambda item: -item[1])
    row: Row = {
        "cause": change.cause,
        "cause_probability": change.probability or None,
        "candidates": [{"cause": name, "probability": p} for name, p in candidates],
        "onset": dt.date.fromordinal(change.since),
        "onset_earliest": dt.date.fromordinal(change.since_lower),
        "onset_latest": dt.date.fromordinal(change.since_upper),
        "detected_on": dt.date.fromordinal(change.detected_on),
        "still_rising": change.continues,
        "likely_iso_vg": change.grade,
    }
    if night.gap_growth is not None:
        row |= _percent("gap_change", night.gap_growth)
    if night.circuit is not None:
        row |= _percent("circuit_change", night.circuit.of_circuit)
        row |= _percent("own_part", night.circuit.own)
    return row


def _leakages(night: NightState) -> Row:
    """Return leakages at the motor's own and at the reference conditions, or why one is missing."""
    if not night.n_blocks:
        return {"leakage_reason": night.why_no_blocks}
    row: Row = {}
    for name, leakage in (
        ("reference_leakage", night.reference or night.reference_leakage),
        ("own_leakage", night.own_leakage),
    ):
        if isinstance(leakage, str):
            row["leakage_reason"] = leakage
        else:
            row |= {f"{name}_l_per_min": leakage.value}
            row |= {f"{name}_lower": leakage.lower, f"{name}_upper": leakage.upper}
    return row


def _percent(name: str, size: Estimate) -> Row:
    """Return a relative figure with its interval."""
    return {
        f"{name}_percent": 100.0 * size.value,
        f"{name}_lower": 100.0 * size.lower,
        f"{name}_upper": 100.0 * size.upper,
    }


def log_note(history: History, place: int, messages: Sequence[str], oil: str) -> str | None:
    """What the log of a night lacks, and the oil as measured; None where nothing is to be said."""
    hours = history.records["logged_hours"]
    before = hours[max(place - NIGHTS_COMPARED, 0) : place]
    before = np.sort(before[np.isfinite(before)])
    parts = [*messages, *filter(None, [oil])]
    # Nights before that are short, too, one in five, are no measure.
    if len(before) >= FEWEST_COMPARED and hours[place] < SHORT * before[len(before) // 5]:
        usual = float(np.median(before))
        parts.insert(0, f"{hours[place]:.1f} h of log, {usual:.1f} h in the nights before")
    return "; ".join(parts) or None
