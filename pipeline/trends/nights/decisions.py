"""Decisions of people on a motor: acknowledged alarms, findings, and baselines that were reset.

A journal beside the tables, a sealed line each, only ever appended to: unlike all else in the
output it cannot be made anew, so keep it with your backups.
"""

from __future__ import annotations

import datetime as dt
import logging
from collections.abc import Collection
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal, get_args

from pipeline.errors import StoreError
from pipeline.store.atomic_files import read
from pipeline.store.journals import append, blank
from pipeline.store.sealed import seal, unseal

log = logging.getLogger(__name__)

Kind = Literal["acknowledged", "finding", "baseline_reset"]
Finding = Literal["confirmed", "not_confirmed"]
KINDS, FINDINGS = get_args(Kind), get_args(Finding)
# What alarms, decisions and baselines are of.
LEAKAGE = "leakage"
PRESSURE_ZERO, FLOW_ZERO = SENSORS = ("pressure_zero", "flow_zero")


@dataclass(frozen=True, slots=True)
class Decision:
    """A decision."""

    # motor_id, indicator: an empty indicator means all of the motor's.
    motor_id: str
    indicator: str
    time: dt.datetime  # of the decision, UTC
    kind: Kind  # an alarm acknowledged, the finding of an inspection, or a baseline reset
    # The night that it refers to: of a reset the first night of the new baseline, of a finding on
    # parts the day on which the motor was opened.
    night: dt.date
    finding: Finding | None = None  # result of an inspection; None without one
    note: str = ""  # in words
    # worn, sound: parts that an inspection found so, separated by commas; None without any.
    worn: str | None = None
    sound: str | None = None

    @property
    def worn_parts(self) -> tuple[str, ...]:
        """Parts that were found worn."""
        return tuple(self.worn.split(", ")) if self.worn else ()

    @property
    def sound_parts(self) -> tuple[str, ...]:
        """Parts that were found sound."""
        return tuple(self.sound.split(", ")) if self.sound else ()


def journal_file(output: Path) -> Path:
    """File of the journal."""
    return output / "decisions.jsonl"


def record_decision(output: Path, decision: Decision) -> None:
    """Append a decision to the journal, flushed and read back.

    Raises StoreError if it cannot be written.
    """
    append(journal_file(output), _line(decision))


def read_decisions(output: Path) -> tuple[Decision, ...]:
    """All decisions, the oldest first; a damaged line is left out, with a warning.

    Raises StoreError if there is a journal that cannot be read.
    """
    found = []
    for number, one in _lines(output).items():
        if one is None:
            log.warning("%s, line %d is damaged and left out", journal_file(output).name, number)
        else:
            found.append(one)
    return tuple(sorted(found, key=lambda one: (one.time, one.motor_id, one.indicator)))


def damaged_lines(output: Path) -> tuple[int, ...]:
    """Numbers of the lines of the journal that are damaged.

    Raises StoreError if there is a journal that cannot be read.
    """
    return tuple(number for number, one in _lines(output).items() if one is None)


def put_back(output: Path, known: Collection[Decision]) -> int:
    """Append known decisions that a damaged or missing journal lacks; returns their number.

    0 if the journal is whole: people may have removed lines. Raises StoreError if it cannot be
    read or written.
    """
    present = _lines(output).values()
    if present and None not in present:
        return 0
    lost = [one for one in known if one not in present]
    if lost:
        # In one call: a journal that was gone is put back as a whole or is damaged.
        append(journal_file(output), b"".join(map(_line, lost)))
    return len(lost)


def take_out_damaged_lines(output: Path) -> None:
    """Move the damaged lines of the journal into a file beside it.

    Raises StoreError if that fails; a line is then in one of the files, or in both.
    """
    path = journal_file(output)

    def damaged(content: bytes) -> list[tuple[int, int]]:
        spans, begin = [], 0
        for line in content.split(b"\n"):
            if line.strip() and _decision(line) is None:
                spans.append((begin, begin + len(line)))
            begin += len(line) + 1
        taken = b"".join(content[begin:end] + b"\n" for begin, end in spans)
        if taken:
            append(path.with_suffix(".damaged"), taken)
        return spans

    blank(path, damaged)


def _lines(output: Path) -> dict[int, Decision | None]:
    path = journal_file(output)
    try:
        lines = read(path).split(b"\n")
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise StoreError("store_read", f"{path.name} cannot be read: {error.strerror}") from error
    return {n: _decision(line) for n, line in enumerate(lines, start=1) if line.strip()}


def _line(decision: Decision) -> bytes:
    return seal(asdict(decision)) + b"\n"


def _decision(line: bytes) -> Decision | None:
    document = unseal(line)
    try:
        if document is None:
            return None
        document["time"] = dt.datetime.fromisoformat(document["time"])
        document["night"] = dt.date.fromisoformat(document["night"])
        return Decision(**document)
    except (ValueError, KeyError, TypeError):
        return None
