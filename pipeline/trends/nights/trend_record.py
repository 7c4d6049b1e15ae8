"""Record of a motor's published trends: their nights, and a hash of their settings."""

from __future__ import annotations

import datetime as dt
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from pipeline.config import MotorSpec
from pipeline.config.hashes import config_hash, hash_of
from pipeline.store.sealed import put_sealed, read_if_whole, unseal
from pipeline.trends.nights.decisions import Decision

# Raise it when the code makes other trends of the same tables: all of them are then made anew.
TRENDS_VERSION = 7


@dataclass(frozen=True, slots=True)
class Record:
    """A motor's published trends."""

    trend_hash: str  # hash of their settings
    last_night: dt.date  # the last night
    # First night whose trends are out of date, as its rows were made anew; None without one.
    redo_from: dt.date | None = None
    # Rules that made them, by name; None in a record of an older version.
    rules: Mapping[str, int | str] | None = None


def trend_hash(spec: MotorSpec, decisions: Sequence[Decision]) -> str:
    """Hash of all settings that shape a motor's trends: its own config and decisions.

    Those of its circuit's other motors are no reason to make its trends anew.
    """
    return hash_of(
        {
            "version": TRENDS_VERSION,
            "config": config_hash(spec),
            "resets": resets_of(decisions),
        }
    )


def resets_of(decisions: Sequence[Decision]) -> list[tuple[str, str, str]]:
    """Baselines that people have reset, for a hash."""
    return [
        (one.night.isoformat(), one.indicator, one.note)
        for one in decisions
        if one.kind == "baseline_reset"
    ]


def record_file(output: Path, motor_id: str) -> Path:
    """File of the record."""
    return output / "ledger" / motor_id / "trends"


def kept_folder(output: Path) -> Path:
    """Folder with what is kept of all motors, so that the watch need not be made anew."""
    return output / "history"


def kept_file(output: Path, motor_id: str) -> Path:
    """File of a motor; beside it may be those of older versions."""
    return kept_folder(output) / motor_id / "watch"


def read_record(output: Path, motor_id: str) -> Record | None:
    """The record of a motor's trends; None without one, or if it is damaged."""
    document = read_if_whole(record_file(output, motor_id), unseal)
    if document is None:
        return None
    try:
        last, redo = (document[name] for name in ("last_night", "redo_from"))
        return Record(
            str(document["trend_hash"]),
            dt.date.fromisoformat(last),
            None if redo is None else dt.date.fromisoformat(redo),
            None if (rules := document.get("rules")) is None else dict(rules),
        )
    except (ValueError, KeyError, TypeError, AttributeError):
        return None


def write_record(output: Path, motor_id: str, record: Record) -> None:
    """Write the record of a motor's trends; raises as `put_sealed`."""
    put_sealed(record_file(output, motor_id), asdict(record))


def note_touched(output: Path, motor_id: str, night: dt.date) -> None:
    """Mark a motor's trends from a night on as out of date, before its rows change.

    If the run is broken off before its trends, the next one makes them.

    Raises StoreError if it cannot be written.
    """
    record = read_record(output, motor_id)
    if record is not None and night <= record.last_night:
        earlier = [one for one in (night, record.redo_from) if one is not None]
        write_record(output, motor_id, replace(record, redo_from=min(earlier)))


def forget_records(output: Path, keep: Collection[str]) -> None:
    """Let the next run make the trends of all motors but some anew.

    Raises StoreError if a record cannot be written.
    """
    for folder in (output / "ledger").glob("*"):
        record = read_record(output, folder.name)
        if folder.name not in keep and record is not None:
            write_record(output, folder.name, replace(record, trend_hash=""))
