"""What people said of a motor: acknowledged alarms, findings, and baselines that were reset.

A journal beside the tables, one line each, only ever appended to: unlike all else in the output it
cannot be made anew, so keep it with your backups.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import json
import logging
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from pipeline.errors import StoreError

log = logging.getLogger(__name__)

Kind = Literal["acknowledged", "finding", "baseline_reset"]
Finding = Literal["confirmed", "not_confirmed"]
KINDS, FINDINGS = get_args(Kind), get_args(Finding)


@dataclass(frozen=True, slots=True)
class Decision:
    """What somebody said.

    Attributes
    ----------
    motor_id, indicator
        Of what; an empty indicator means all of the motor's.
    time
        When it was said, UTC.
    kind
        An alarm acknowledged, the finding of an inspection, or a baseline reset.
    night
        The night that it refers to; of a reset the first night of the new baseline.
    finding
        Whether wear was found; None: nothing was looked at.
    note
        In words.
    """

    motor_id: str
    indicator: str
    time: dt.datetime
    kind: Kind
    night: dt.date
    finding: Finding | None = None
    note: str = ""


def journal_file(output: Path) -> Path:
    """Where the journal lies."""
    return output / "decisions.jsonl"


def record_decision(output: Path, decision: Decision) -> None:
    """Append a decision to the journal, and flush it to the disk.

    Raises
    ------
    StoreError
        If it cannot be written.
    """
    document = asdict(decision) | {
        "time": decision.time.isoformat(),
        "night": decision.night.isoformat(),
    }
    line = json.dumps({"sha256": _digest(document), **document}, sort_keys=True) + "\n"
    path = journal_file(output)
    try:
        output.mkdir(parents=True, exist_ok=True)
        whole = _append(path, line.encode())
    except OSError as error:
        raise StoreError("store_write", f"{path.name} cannot be written: {error}") from error
    if not whole:
        raise StoreError("store_write", f"{path.name} was written in part: the disk is full")


def _append(path: Path, line: bytes) -> bool:
    """One write to a file opened for appending: a run may be reading, others may be writing."""
    handle = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o644)
    try:
        size = os.fstat(handle).st_size
        # After a line that was cut off a new one begins.
        torn = size > 0 and os.pread(handle, 1, size - 1) != b"\n"
        line = b"\n" + line if torn else line
        written = os.write(handle, line)
        os.fsync(handle)
    finally:
        os.close(handle)
    return written == len(line)


def read_decisions(output: Path) -> tuple[Decision, ...]:
    """All decisions, the oldest first; a damaged line is left out, with a warning.

    Raises
    ------
    StoreError
        If there is a journal that cannot be read.
    """
    path = journal_file(output)
    try:
        lines = path.read_bytes().split(b"\n")
    except FileNotFoundError:
        return ()
    except OSError as error:
        raise StoreError("store_read", f"{path.name} cannot be read: {error.strerror}") from error
    found = []
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        decision = _decision(line)
        if decision is None:
            log.warning("%s, line %d is damaged and left out", path.name, number)
        else:
            found.append(decision)
    return tuple(sorted(found, key=lambda one: (one.time, one.motor_id, one.indicator)))


def _decision(line: bytes) -> Decision | None:
    try:
        document = json.loads(line)
        if document.pop("sha256") != _digest(document):
            return None
        document["time"] = dt.datetime.fromisoformat(document["time"])
        document["night"] = dt.date.fromisoformat(document["night"])
        return Decision(**document)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None


def _digest(document: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()[:16]
