"""State of a motor's looks: how far its logs were read and judged, and what was told."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from pipeline.clock import utc
from pipeline.schema import LOOKS
from pipeline.store.state import State, read_state_file
from pipeline.store.tables import read_rows
from pipeline.trends.rows.motor_states import LookStatus

BLIND, NOT_READY = "blind", "not_ready"


@dataclass(frozen=True, slots=True)
class FileSeen:
    """A log file as it was read last."""

    # size, modified_ns, inode: while they stay, it has nothing new.
    size: int
    modified_ns: int
    inode: int
    newest_us: int = 0  # newest sample [µs since 1970]; 0 without one
    # position, columns, digest: of a growing file, from where reading goes on, as of `Place`, and
    # what stands at its begin and before that.
    position: int = 0
    columns: tuple[str, ...] = ()
    digest: str = ""

    def is_same(self, other: FileSeen) -> bool:
        """True if a file was not written to in between."""
        known = (self.size, self.modified_ns, self.inode)
        return known == (other.size, other.modified_ns, other.inode)


@dataclass(frozen=True, slots=True)
class Rise:
    """A sudden rise that was told."""

    # began_us, told_us: begin of the blocks that show it, end of the last [µs since 1970].
    began_us: int
    told_us: int
    # change, half_width: rise over the nights before, and the half-width of its 95 % interval.
    change: float
    half_width: float
    level: float  # change of those nights from the baseline


@dataclass(frozen=True, slots=True)
class LookState:
    """State after a look."""

    # state, since_us, reason: one of four, since when [µs since 1970; 0: never], and why.
    state: str = NOT_READY
    since_us: int = 0
    reason: str = "no look yet"
    # Log files as they were read, by path relative to the log root.
    files: Mapping[str, FileSeen] = field(default_factory=dict)
    next_us: int = 0  # begin of the next block; 0 before the first look
    newest_us: int = 0  # newest sample that was read; 0 without one
    # block_end_us, warm_from_us: end of the last block with kept samples, and from when on the
    # motor is warm.
    block_end_us: int = 0
    warm_from_us: int = 0
    judged_us: int = 0  # end of the last block that was judged
    cause: str = ""  # why the latest samples were not judged
    # Warm blocks of the night so far: begin [µs since 1970], conditions, means of the columns.
    blocks: tuple[tuple[float, ...], ...] = ()
    latest: float = 0.0  # rise of the latest judged blocks over the nights before
    rise: Rise | None = None  # the rise that is told; None where none is
    waiting: tuple[Rise, ...] = ()  # rises that no night has confirmed or withdrawn yet


_STATE = TypeAdapter(LookState)


def read_states(state: State) -> dict[str, LookState]:
    """States of the looks of all motors that were looked at, by motor; one that is strange is left.

    Raises StoreError if they cannot be read.
    """
    found = {}
    for motor_id, text in state.rows("SELECT motor_id, state FROM looks"):
        with suppress(ValidationError):
            found[motor_id] = _STATE.validate_python(json.loads(text))
    return found


def write_state(state: State, motor_id: str, now: LookState) -> None:
    """Keep the state of a motor's looks; raises StoreError."""
    state.write("INSERT OR REPLACE INTO looks VALUES (?, ?)", motor_id, json.dumps(asdict(now)))


def look_statuses(output: Path, motor_ids: Iterable[str]) -> dict[str, LookStatus]:
    """Standings of some motors that were looked at, by motor.

    Raises StoreError if they cannot be read.
    """
    with read_state_file(output) as state:
        states = read_states(state)
    looked = [one for one in motor_ids if states.get(one, LookState()) != LookState()]
    rows = read_rows(output, LOOKS, looked, ("motor_id", "verdict")).iter_rows()
    verdicts = Counter((motor_id, verdict) for motor_id, verdict in rows)
    found = {}
    for motor_id in looked:
        one = states[motor_id]
        since = utc(one.since_us) if one.since_us else None
        scores = (verdicts[motor_id, name] for name in ("told", "confirmed", "withdrawn"))
        found[motor_id] = LookStatus(one.state, since, one.reason, *scores)
    return found
