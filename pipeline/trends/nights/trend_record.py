"""Record of a motor's published trends: their nights, and a hash of their settings."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from pipeline.config import MotorSpec
from pipeline.config.hashes import config_hash, hash_of
from pipeline.store.state import StateDatabase
from pipeline.trends.nights.decisions import Decision

# Raise it when the code makes other trends of the same tables: all of them are then made anew.
TRENDS_VERSION = 14


@dataclass(frozen=True, slots=True)
class Record:
    """A motor's published trends."""

    trend_hash: str  # hash of their settings
    last_night: dt.date  # the last night
    # First night whose trends are out of date, as its rows were made anew; None without one.
    redo_from: dt.date | None = None


def trend_hash(spec: MotorSpec, decisions: Sequence[Decision]) -> str:
    """Return hash of all settings that shape a motor's trends: its own config and decisions.

    Those of its circuit's other motors are no reason to make its trends anew.
    """
    resets = [
        (decision.night.isoformat(), decision.indicator, decision.note)
        for decision in decisions
        if decision.kind == "baseline_reset"
    ]
    return hash_of({"version": TRENDS_VERSION, "config": config_hash(spec), "resets": resets})


def read_records(state: StateDatabase) -> dict[str, Record]:
    """Return records of the trends of all motors, by motor."""
    rows = state.rows("SELECT motor_id, trend_hash, last_night, redo_from FROM trends")
    return {
        motor_id: Record(
            trend_hash,
            dt.date.fromisoformat(last_night),
            None if redo_from is None else dt.date.fromisoformat(redo_from),
        )
        for motor_id, trend_hash, last_night, redo_from in rows
    }


def read_checkpoint(state: StateDatabase, motor_id: str) -> bytes | None:
    """Return a motor's checkpoint, which saves its watch being made anew; None without any."""
    rows = state.rows("SELECT checkpoint FROM trends WHERE motor_id = ?", motor_id)
    return rows[0][0] if rows else None


def write_record(
    state: StateDatabase, motor_id: str, record: Record, checkpoint: bytes | None = None
) -> None:
    """Write the record of a motor's trends, and its checkpoint; raises StoreError."""
    state.write(
        "INSERT OR REPLACE INTO trends VALUES (?, ?, ?, ?, ?)",
        motor_id,
        record.trend_hash,
        str(record.last_night),
        None if record.redo_from is None else str(record.redo_from),
        checkpoint,
    )


def note_touched(state: StateDatabase, touched: Iterable[tuple[str, dt.date]]) -> None:
    """Mark motors' trends from a night on as out of date, before their rows change.

    If the run is broken off before its trends, the next one makes them."""
    state.write_all(
        "UPDATE trends SET redo_from = min(coalesce(redo_from, ?2), ?2)"
        " WHERE motor_id = ?1 AND last_night >= ?2",
        [(motor_id, str(night)) for motor_id, night in touched],
    )
