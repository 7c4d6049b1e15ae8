"""MDF4 logs (ASAM) for motor-leakage: `logs.format = "mdf4"`, a signal a channel."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from asammdf import MDF

from pipeline.errors import LogError
from pipeline.ingest import LogFile, RawLog, Reader, Samples, log_of_samples


def read(file: LogFile) -> RawLog:
    """Read the wanted signals, one after the other."""
    with _opened(file.path) as mdf:
        start_us = round(mdf.start_time.timestamp() * 1e6)
        samples = {
            name: _samples(file, mdf, channel.source, start_us)
            for name, channel in file.channels.items()
        }
    return log_of_samples(file, samples)


@contextmanager
def _opened(path: Path) -> Iterator[MDF]:
    """An open file; what asammdf raises on a damaged one has no common type."""
    try:
        with MDF(path) as mdf:
            yield mdf
    except (LogError, OSError, MemoryError):
        raise
    except Exception as error:
        raise LogError("log_damaged", path, f"this is no whole MDF file: {error}") from error


def _samples(file: LogFile, mdf: MDF, name: str, start_us: int) -> Samples:
    group = _group_of(file, mdf, name)
    signal = mdf.get(name, group=group, ignore_invalidation_bits=True)
    if signal.samples.dtype.kind not in "iufb":
        raise LogError("log_type", file.path, f"signal {name!r} is no number", name)
    bits = signal.invalidation_bits
    missing = None if bits is None else np.asarray(bits, np.bool_)
    time_us = start_us + np.rint(signal.timestamps * 1e6).astype(np.int64)
    return Samples(time_us, signal.samples.astype(np.float64), missing)


def _group_of(file: LogFile, mdf: MDF, name: str) -> int:
    """Number of the group with a signal; where several have it, the option says which."""
    wanted = file.logs.options["group"]
    places = [group for group, _ in mdf.whereis(name)]
    if wanted:
        places = [at for at in places if mdf.groups[at].channel_group.acq_name == wanted]
    if not places:
        there = ", ".join(map(repr, list(mdf.channels_db)[:40]))
        raise LogError("log_column_missing", file.path, f"no signal {name!r}; there are {there}")
    if len(places) > 1:
        how = f"signal {name!r} is in {len(places)} groups: name one with logs.options.group"
        raise LogError("log_column_twice", file.path, how, name)
    return places[0]


READER = Reader(read, options={"group": ""})
