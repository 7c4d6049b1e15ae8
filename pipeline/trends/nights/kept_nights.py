"""Records of a motor's nights as a run has read and filtered them, kept for the next one.

One compressed file a motor and month beside the tables. It only saves work: a night is read again
where a file is not the one that it was read from, and without any of it the same trends come out.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeAlias

import lz4.frame
import numpy as np
import polars as pl
import scipy
from numpy.typing import NDArray

from pipeline.config import MotorSpec
from pipeline.config.hashes import hash_of, own_version
from pipeline.schema import ALARMS, BLOCK_STATISTICS, FITS, OPERATION, PARAMETERS, Table
from pipeline.store.atomic_files import put
from pipeline.store.sealed import read_if_whole
from pipeline.store.tables import month_stamps, night_stamps
from pipeline.trends.nights.decisions import Decision
from pipeline.trends.nights.records import Layout, Records, record_digest, record_type
from pipeline.trends.nights.trend_record import trend_hash

# Tables that a record is made from.
READ = (FITS, PARAMETERS, OPERATION)
LOOKED_AT = (*READ, BLOCK_STATISTICS, ALARMS)
# A folder that was changed so shortly before may be changed again without a later time on it: the
# coarsest file systems count two seconds.
SETTLED_NS = 10_000_000_000
NO_FOLDER, NOT_SETTLED = 0, -1
SUFFIX, DIGEST_SIZE = ".lz4", 32
# A line of JSON, and the bytes of arrays.
Kept: TypeAlias = tuple[dict[str, Any], list[bytes]]
# Fields of a month in the line.
IN_HEAD = ("folders", "files", "blocks", "alarms", "states", "until")


@dataclass(frozen=True, slots=True)
class KeptMonth:
    """Kept records of a motor's nights of a month; nights are YYYY-MM-DD."""

    # Time of the last change of each table's folder; all of this holds until one changes.
    folders: Sequence[int]
    files: Mapping[str, str]  # stamps of the files of `READ`, of each night with fits of any motor
    # Stamp of the file of `block_statistics`, of each night without a fit.
    blocks: Mapping[str, str]
    # Stamp of the file of `alarms`, of each night with changes of state of any motor.
    alarms: Mapping[str, str]
    # Changes of state of the motor itself: indicator and new state, by night.
    states: Mapping[str, Sequence[Sequence[str]]]
    records: Records  # records, by night
    until: str | None = None  # first night that is not filtered yet; None if all are

    def encoded(self, key: str) -> bytes:
        """Its file's content."""
        head = {"key": key} | {name: getattr(self, name) for name in IN_HEAD}
        return encoded(head, self.records)

    @classmethod
    def of(cls, kept: Kept, key: str, layout: Layout) -> KeptMonth | None:
        """A month from its file's content; None where it was made by other settings."""
        head, (records,) = kept
        if head["key"] != key:
            return None
        fields = {name: head[name] for name in IN_HEAD}
        return cls(records=np.frombuffer(records, record_type(layout)), **fields)


def encoded(head: Mapping[str, Any], *arrays: NDArray[Any]) -> bytes:
    """A kept file's content: a digest, and compressed a line of JSON and the bytes of arrays."""
    parts = [one.tobytes() for one in arrays]
    line = json.dumps({**head, "sizes": [len(part) for part in parts]}, sort_keys=True)
    packed: bytes = lz4.frame.compress(line.encode() + b"\n" + b"".join(parts))
    return hashlib.sha256(packed).digest() + packed


def decoded(content: bytes) -> Kept | None:
    """What `encoded` was given, the arrays as bytes; None where it is not as it was written."""
    digest, packed = content[:DIGEST_SIZE], content[DIGEST_SIZE:]
    if hashlib.sha256(packed).digest() != digest:
        return None
    line, arrays = lz4.frame.decompress(packed).split(b"\n", 1)
    head = json.loads(line)
    ends = np.cumsum([0, *head["sizes"]]).tolist()
    return head, [arrays[begin:end] for begin, end in pairwise(ends)]


def kept_folder(output: Path) -> Path:
    """Folder with the kept files of all motors."""
    return output / "history"


def key_of(spec: MotorSpec, layout: Layout, decisions: Sequence[Decision]) -> str:
    """Hash of all that shapes what is kept of a motor beyond the tables."""
    return hash_of(
        {
            "trends": trend_hash(spec, decisions),
            "program": own_version(),
            "libraries": (np.__version__, scipy.__version__, pl.__version__),
            "records": record_digest(layout),
        }
    )


def read_months(output: Path, motor_id: str, key: str, layout: Layout) -> dict[str, KeptMonth]:
    """Kept records of a motor by month, if whole and made with the same key."""
    found = {}
    for path in sorted((kept_folder(output) / motor_id).glob(f"*{SUFFIX}")):
        kept = read_if_whole(path, decoded)
        month = None if kept is None else KeptMonth.of(kept, key, layout)
        if month is not None:
            found[path.stem] = month
    return found


def write_month(output: Path, motor_id: str, month: str, key: str, kept: KeptMonth) -> None:
    """Keep what is known of a motor's month.

    Raises StoreError if it cannot be written.
    """
    path = kept_folder(output) / motor_id / f"{month}{SUFFIX}"
    put(path, kept.encoded(key), durable=False)


@dataclass(slots=True)
class TableFolders:
    """The folders of the tables that trends are made from, looked at once for many motors.

    `months` has by YYYY-MM when the folder of each table was last changed, where that tells.
    """

    output: Path
    months: dict[str, list[int]] = field(default_factory=dict)
    _nights: dict[tuple[str, str], dict[str, str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        stamps = [month_stamps(self.output, table) for table in LOOKED_AT]
        settled = time.time_ns() - SETTLED_NS
        # Of nights without a log of any motor there may be alarms alone.
        for month in sorted(stamps[0].keys() | stamps[-1].keys()):
            found = [one.get(month, NO_FOLDER) for one in stamps]
            self.months[month] = [NOT_SETTLED if one > settled else one for one in found]

    def same(self, month: str, kept: KeptMonth) -> bool:
        """True if no file of a month can have changed."""
        found = self.months.get(month, [])
        return found == kept.folders and NOT_SETTLED not in found

    def files(self, table: Table, month: str) -> dict[str, str]:
        """Stamp of a table's file, by night."""
        key = (table.name, month)
        if key not in self._nights:
            self._nights[key] = night_stamps(self.output, table, month)
        return self._nights[key]

    def files_read(self, month: str) -> dict[str, str]:
        """Stamps of the files of `READ`, by night."""
        key = ("", month)
        if key not in self._nights:
            first, *rest = (self.files(table, month) for table in READ)
            self._nights[key] = {
                night: "|".join((stamp, *(one.get(night, "") for one in rest)))
                for night, stamp in first.items()
            }
        return self._nights[key]
