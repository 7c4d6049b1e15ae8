"""What is kept of a motor for the next run: records of its nights, and the state of its watch.

It only saves work: without it the watch begins with the era's first night, by the stored blocks,
and the same trends come out.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import lz4.frame
import numpy as np
import polars as pl
import scipy
from numpy.typing import NDArray

from pipeline.config import MotorSpec
from pipeline.config.hashes import hash_of, own_version
from pipeline.trends.nights.decisions import Decision
from pipeline.trends.nights.history import RECORD, Records
from pipeline.trends.nights.trend_record import trend_hash

DIGEST_SIZE = 32


@dataclass(frozen=True, slots=True)
class KeptWatch:
    """A motor's watch before its last night that was done, as numbers."""

    era: dt.date  # first night of its era
    own: Mapping[str, Any]  # what was frozen with its baseline
    day: int  # number of the newest day that it knows
    arrays: Mapping[str, NDArray[Any]]


@dataclass(frozen=True, slots=True)
class Kept:
    """What is kept of a motor; the watch is None while its era has too few nights."""

    key: str
    last_night: dt.date  # last night that was done
    records: Records
    watch: KeptWatch | None

    def encoded(self) -> bytes:
        """As bytes: a digest, and compressed a line of JSON and the bytes of arrays."""
        arrays: dict[str, NDArray[Any]] = {} if self.watch is None else dict(self.watch.arrays)
        head: dict[str, Any] = {
            "key": self.key,
            "last_night": self.last_night.isoformat(),
            "watch": None
            if self.watch is None
            else [self.watch.era.isoformat(), self.watch.own, self.watch.day],
            "arrays": [[name, one.dtype.str, one.shape] for name, one in arrays.items()],
        }
        parts = [one.tobytes() for one in (self.records, *arrays.values())]
        head["sizes"] = [len(part) for part in parts]
        packed: bytes = lz4.frame.compress(json.dumps(head).encode() + b"\n" + b"".join(parts))
        return hashlib.sha256(packed).digest() + packed


def decoded(content: bytes | None) -> Kept | None:
    """What is kept, from its bytes; None where there are none, or not as they were written."""
    if content is None:
        return None
    digest, packed = content[:DIGEST_SIZE], content[DIGEST_SIZE:]
    if hashlib.sha256(packed).digest() != digest:
        return None
    line, rest = lz4.frame.decompress(packed).split(b"\n", 1)
    head = json.loads(line)
    ends = np.cumsum([0, *head["sizes"]]).tolist()
    parts = [rest[begin:end] for begin, end in pairwise(ends)]
    watch = None
    if head["watch"] is not None:
        era, own, day = head["watch"]
        arrays = {
            name: np.frombuffer(part, kind).reshape(shape)
            for (name, kind, shape), part in zip(head["arrays"], parts[1:], strict=True)
        }
        watch = KeptWatch(dt.date.fromisoformat(era), own, day, arrays)
    # One of an older version has another key, and need not be read any further.
    if len(parts[0]) % RECORD.itemsize:
        return None
    last_night = dt.date.fromisoformat(head["last_night"])
    return Kept(head["key"], last_night, np.frombuffer(parts[0], RECORD), watch)


def key_of(spec: MotorSpec, decisions: Sequence[Decision]) -> str:
    """Hash of all that shapes what is kept of a motor beyond the tables."""
    return hash_of(
        {
            "trends": trend_hash(spec, decisions),
            "program": own_version(),
            "libraries": (np.__version__, scipy.__version__, pl.__version__),
            "records": str(RECORD.descr),
            "rollers": spec.roller_is_free,
        }
    )
