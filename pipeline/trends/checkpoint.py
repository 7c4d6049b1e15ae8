"""A motor's checkpoint for the next run: it saves work, and stored blocks give the same."""

from __future__ import annotations

import datetime as dt
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import lz4.frame
import numpy as np
import polars as pl
import scipy
from numpy.typing import NDArray

from pipeline.config.hashes import hash_of, own_version

# Raise it when a watch is stored as other arrays.
CHECKPOINT_VERSION = 6
# A structured array, a record for each night.
Records = NDArray[Any]

# Columns of `nights`.
OPERATED = (
    *("logged_hours", "running_hours"),
    *("pressure_zero_bar", "pressure_zero_upper"),
    *("flow_zero_l_per_min", "flow_zero_upper"),
)
# Charge above case pressure [bar], and measured viscosity over the data sheet's, of its blocks.
OF_BLOCKS = ("charge", "viscosity")
# What the watch said of a night: leakage at the reference and at the motor's own conditions
# [l/min].
WATCHED = ("reference_leakage", "own_leakage")
RECORD = np.dtype(
    [
        ("night", "M8[D]"),
        # Whether there is a row of it.
        ("known", "?"),
        ("model", "S16"),
        # Blocks that the watch counts.
        ("blocks", "i4"),
        *((name, "f8") for name in (*OF_BLOCKS, *OPERATED, *WATCHED)),
    ]
)


def blank_records(nights: Sequence[dt.date]) -> Records:
    """Return records of nights of which nothing is known."""
    records = np.zeros(len(nights), dtype=RECORD)
    for name in (*OF_BLOCKS, *OPERATED, *WATCHED):
        records[name] = np.nan
    records["night"] = np.array(nights, dtype="M8[D]")
    return records


@dataclass(frozen=True, slots=True)
class StoredWatch:
    """A motor's watch before its last night that was done, as numbers."""

    period: dt.date  # first night of its baseline period
    own: Mapping[str, Any]  # what was frozen with its baseline
    day: int  # number of the newest day that it knows
    arrays: Mapping[str, NDArray[Any]]


@dataclass(frozen=True, slots=True)
class MotorCheckpoint:
    """A motor's checkpoint; the watch is None while its baseline period has too few nights."""

    key: str
    last_night: dt.date  # last night that was done
    records: Records
    watch: StoredWatch | None

    def encoded(self) -> bytes:
        """Return it as bytes, which prove themselves when they are decoded."""
        watch = self.watch
        period = None if watch is None else [watch.period.isoformat(), watch.own, watch.day]
        arrays = {"records": self.records} | ({} if watch is None else dict(watch.arrays))
        forms = [
            (name, array.dtype.str, array.shape, array.nbytes) for name, array in arrays.items()
        ]
        head = json.dumps([self.key, self.last_night.isoformat(), period, forms]).encode()
        content = b"".join([head, b"\n", *(array.tobytes() for array in arrays.values())])
        packed: bytes = lz4.frame.compress(content, content_checksum=True)
        return packed


def decode(content: bytes | None) -> MotorCheckpoint | None:
    """Return a checkpoint from its bytes; None without any, or where they are damaged."""
    try:
        stream = io.BytesIO(lz4.frame.decompress(content or b""))
        key, last_night, watch, forms = json.loads(stream.readline())
        arrays = {
            name: np.frombuffer(stream.read(size), kind).reshape(shape)
            for name, kind, shape, size in forms
        }
        records = arrays.pop("records").view(RECORD)
    except (RuntimeError, ValueError):  # damaged, or of another version
        return None
    checkpoint = MotorCheckpoint(key, dt.date.fromisoformat(last_night), records, None)
    if watch is None:
        return checkpoint
    period, own, day = watch
    return replace(checkpoint, watch=StoredWatch(dt.date.fromisoformat(period), own, day, arrays))


def key_of(trend_hash: str) -> str:
    """Return the hash of all that shapes a motor's checkpoint beyond the tables."""
    return hash_of(
        {
            "trends": trend_hash,
            "program": own_version(),
            "form": CHECKPOINT_VERSION,
            "libraries": (np.__version__, scipy.__version__, pl.__version__),
            "records": str(RECORD.descr),
        }
    )
