"""Records of a motor's nights as a run has read and filtered them, kept for the next one.

One Parquet file a motor and month beside the tables. It only saves work: a night is read again
where a file is not the one that it was read from, and without any of it the same trends come out.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import scipy
from numpy.typing import NDArray

from pipeline.config import MotorSpec
from pipeline.config.hashes import config_hash, hash_of
from pipeline.schema import ALARMS, BLOCK_STATISTICS, FITS, OPERATION, PARAMETERS, Table
from pipeline.store.atomic_files import put, remove
from pipeline.store.sealed import read_if_whole
from pipeline.store.tables import month_stamps, night_stamps
from pipeline.trends.nights.decisions import Decision
from pipeline.trends.nights.records import Layout, Records
from pipeline.trends.nights.trend_record import TRENDS_VERSION, resets_of
from pipeline.versions import own_version

# Tables that a record is made from.
READ = (FITS, PARAMETERS, OPERATION)
LOOKED_AT = (*READ, BLOCK_STATISTICS, ALARMS)
# A folder that was changed so shortly before may be changed again without a later time on it: the
# coarsest file systems count two seconds.
SETTLED_NS = 10_000_000_000
NO_FOLDER, NOT_SETTLED = 0, -1
# Keys of a file's metadata, and fields of a month in the first.
HEAD, DIGEST = b"month", b"sha256"
IN_HEAD = ("folders", "files", "blocks", "alarms", "states", "until")


@dataclass(frozen=True, slots=True)
class KeptMonth:
    """Kept records of a motor's nights of a month; nights are YYYY-MM-DD.

    Attributes
    ----------
    folders
        Time of the last change of each table's folder; all of this holds until one changes.
    files
        Stamps of the files of `READ`, of each night with fits of any motor.
    blocks
        Stamp of the file of `block_statistics`, of each night without a fit.
    alarms
        Stamp of the file of `alarms`, of each night with changes of state of any motor.
    states
        Changes of state of the motor itself: indicator and new state, by night.
    records
        Records, by night.
    until
        First night that is not filtered yet; None if all are.
    """

    folders: Sequence[int]
    files: Mapping[str, str]
    blocks: Mapping[str, str]
    alarms: Mapping[str, str]
    states: Mapping[str, Sequence[Sequence[str]]]
    records: Records
    until: str | None = None

    def encoded(self, key: str) -> bytes:
        """Its file's content."""
        head = {"key": key} | {name: getattr(self, name) for name in IN_HEAD}
        return encoded_table(
            head, {name: self.records[name] for name in self.records.dtype.names or ()}
        )

    @classmethod
    def of(cls, table: pa.Table, key: str, layout: Layout) -> KeptMonth | None:
        """A month from its table; None where it was made by other settings."""
        head = head_of(table)
        if head["key"] != key:
            return None
        records = np.zeros(table.num_rows, dtype=layout.dtype)
        for name in layout.dtype.names or ():
            records[name] = values_of(table[name]).reshape(records[name].shape)
        return cls(records=records, **{name: head[name] for name in IN_HEAD})


def encoded_table(head: Mapping[str, Any], columns: Mapping[str, NDArray[Any]]) -> bytes:
    """A kept file's content: a column an array, and all else with a digest in the metadata."""
    text = json.dumps(head, separators=(",", ":"), sort_keys=True).encode()
    table = pa.table({name: _column(values) for name, values in columns.items()})
    digest = _digest(text, table)
    sink = pa.BufferOutputStream()
    pq.write_table(
        table.replace_schema_metadata({HEAD: text, DIGEST: digest}),
        sink,
        # What is read every night is to be quick to read.
        compression="lz4",
        use_dictionary=False,
        write_statistics=False,
    )
    content: bytes = sink.getvalue().to_pybytes()
    return content


def head_of(table: pa.Table) -> dict[str, Any]:
    """All that a kept file says beside its columns."""
    head: dict[str, Any] = json.loads(table.schema.metadata[HEAD])
    return head


def whole_table(content: bytes) -> pa.Table | None:
    """The table of a file's content; None where it is not as it was written."""
    try:
        table = pq.ParquetFile(pa.BufferReader(content)).read(use_threads=False)
        metadata = table.schema.metadata
        return table if metadata[DIGEST] == _digest(metadata[HEAD], table) else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _column(values: NDArray[Any]) -> pa.Array:
    """A field of records: a list a night where it has several numbers."""
    flat = pa.array(np.ascontiguousarray(values).reshape(-1))
    if values.ndim == 1:
        return flat
    return pa.FixedSizeListArray.from_arrays(flat, int(np.prod(values.shape[1:])))


def values_of(column: pa.ChunkedArray) -> NDArray[Any]:
    """All numbers of a column, night by night."""
    whole = column.combine_chunks()
    flat = whole.flatten() if pa.types.is_fixed_size_list(whole.type) else whole
    values: NDArray[Any] = flat.to_numpy(zero_copy_only=False)
    return values


def _digest(head: bytes, table: pa.Table) -> bytes:
    """SHA-256 of all that a month says."""
    found = hashlib.sha256(head)
    for name in table.column_names:
        values = values_of(table[name])
        found.update(name.encode())
        found.update(b"\0".join(values.tolist()) if values.dtype == object else values.tobytes())
    return found.hexdigest().encode()


def kept_folder(output: Path) -> Path:
    """Folder with the kept files of all motors."""
    return output / "history"


def key_of(spec: MotorSpec, layout: Layout, decisions: Sequence[Decision]) -> str:
    """Hash of all that shapes what is kept of a motor beyond the tables."""
    return hash_of(
        {
            "trends": TRENDS_VERSION,
            "program": own_version(),
            "libraries": (np.__version__, scipy.__version__, pl.__version__),
            "records": layout.digest,
            "config": config_hash(spec),
            "resets": resets_of(decisions),
        }
    )


def read_months(output: Path, motor_id: str, key: str, layout: Layout) -> dict[str, KeptMonth]:
    """Kept records of a motor by month, if whole and made with the same key."""
    found = {}
    for path in sorted((kept_folder(output) / motor_id).glob("*.parquet")):
        table = read_if_whole(path, whole_table)
        month = None if table is None else KeptMonth.of(table, key, layout)
        if month is not None:
            found[path.stem] = month
    return found


def write_month(output: Path, motor_id: str, month: str, key: str, kept: KeptMonth) -> None:
    """Keep what is known of a motor's month.

    Raises
    ------
    StoreError
        If it cannot be written.
    """
    folder = kept_folder(output) / motor_id
    put(folder / f"{month}.parquet", kept.encoded(key), durable=False)
    # As older versions named it.
    remove(folder / month)


@dataclass(slots=True)
class TableFolders:
    """The folders of the tables that trends are made from, looked at once for many motors.

    Parameters
    ----------
    output
        Output folder.

    Attributes
    ----------
    months
        By YYYY-MM, when the folder of each table was last changed, where that tells.
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
