"""What is remembered of a motor's trends: which nights are published, and what shaped them."""

from __future__ import annotations

import datetime as dt
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pipeline.config import MotorSpec
from pipeline.decisions import Decision
from pipeline.landing import remove
from pipeline.night_statistics import hash_of
from pipeline.sealed import put_sealed, read_sealed, unseal
from pipeline.settings_hashes import config_hash

# Raise it when the code makes other trends of the same tables: all of them are then made anew.
TRENDS_VERSION = 3


@dataclass(frozen=True, slots=True)
class Record:
    """What is published of a motor's trends.

    Attributes
    ----------
    trend_hash
        Hash of all that shaped them beyond the tables.
    last_night
        The last night.
    redo_from
        First night whose trends are out of date, as its rows were made anew; None: none is.
    """

    trend_hash: str
    last_night: dt.date
    redo_from: dt.date | None = None


def trend_hash(circuit: Sequence[MotorSpec], spec: MotorSpec, decisions: Sequence[Decision]) -> str:
    """Hash of all that shapes a motor's trends beyond its tables: its circuit's motors, too."""
    motors = {one.motor_id for one in circuit}
    return hash_of(
        {
            "version": TRENDS_VERSION,
            "motor": spec.motor_id,
            "circuit": {one.motor_id: config_hash(one) for one in circuit},
            "resets": resets_of(decisions, motors),
        }
    )


def resets_of(
    decisions: Sequence[Decision], motor_ids: Collection[str]
) -> list[tuple[str, str, str, str]]:
    """Baselines of some motors that people have reset, as they go into a hash."""
    return [
        (one.motor_id, one.night.isoformat(), one.indicator, one.note)
        for one in decisions
        if one.kind == "baseline_reset" and one.motor_id in motor_ids
    ]


def record_file(output: Path, motor_id: str) -> Path:
    """Where it lies."""
    return output / "ledger" / motor_id / "trends"


def read_record(output: Path, motor_id: str) -> Record | None:
    """What is remembered of a motor's trends; None where nothing is, or it is damaged."""
    document = read_sealed(record_file(output, motor_id), unseal)
    if document is None:
        return None
    try:
        last, redo = (document[name] for name in ("last_night", "redo_from"))
        return Record(
            str(document["trend_hash"]),
            dt.date.fromisoformat(last),
            None if redo is None else dt.date.fromisoformat(redo),
        )
    except (ValueError, KeyError, TypeError, AttributeError):
        return None


def write_record(output: Path, motor_id: str, record: Record) -> None:
    """Remember which trends of a motor are published.

    Raises
    ------
    StoreError
        If it cannot be written.
    """
    nights = {name: _text(getattr(record, name)) for name in ("last_night", "redo_from")}
    put_sealed(record_file(output, motor_id), {"trend_hash": record.trend_hash, **nights})


def _text(night: dt.date | None) -> str | None:
    return None if night is None else night.isoformat()


def note_touched(output: Path, motor_id: str, night: dt.date) -> None:
    """Remember that a motor's trends from a night on are out of date, before its rows change.

    A run that ends between its nights and its trends leaves them to the next one.

    Raises
    ------
    StoreError
        If it cannot be written.
    """
    record = read_record(output, motor_id)
    if record is not None and night <= record.last_night:
        earlier = [one for one in (night, record.redo_from) if one is not None]
        write_record(output, motor_id, replace(record, redo_from=min(earlier)))


def forget_records(output: Path, keep: Collection[str]) -> None:
    """Let the next run make the trends of all motors but some anew.

    Raises
    ------
    StoreError
        If a record cannot be removed.
    """
    for folder in (output / "ledger").glob("*"):
        if folder.name not in keep:
            remove(record_file(output, folder.name))
