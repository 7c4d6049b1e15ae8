"""Files of logs to raw channels: one contract, three readers.

Imports config, units and errors, nothing else of the pipeline.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from pipeline.config.motors import COUNTED, Channel, Channels, Logs
from pipeline.ingest.contract import Place, RawChannel, RawLog, readable
from pipeline.ingest.csv.log import csv_time_span, read_csv_log, read_csv_piece
from pipeline.ingest.csv.text import is_packed, is_utf8
from pipeline.ingest.mcap.log import mcap_time_span, read_mcap_log
from pipeline.ingest.parquet.log import parquet_time_span, read_parquet_log
from pipeline.units import CHANNELS, to_canonical

__all__ = ["Place", "RawChannel", "RawLog", "can_grow", "read_log", "read_piece", "time_span"]


class _Reader(NamedTuple):
    read: Callable[[Path, Logs, Channels, int | None], RawLog]
    span: Callable[[Path, Logs, Channels, int | None], tuple[int, int]]


_READERS: Mapping[str, _Reader] = MappingProxyType(
    {
        "csv": _Reader(read_csv_log, csv_time_span),
        "parquet": _Reader(read_parquet_log, parquet_time_span),
        "mcap": _Reader(read_mcap_log, mcap_time_span),
        # Nights of a database are written as Parquet.
        "sql": _Reader(read_parquet_log, parquet_time_span),
    }
)


def read_log(path: Path, logs: Logs, channels: Channels, latest_us: int | None = None) -> RawLog:
    """Read the channels of a log.

    Parameters
    ----------
    path
        The file.
    logs
        How it is written.
    channels
        What is wanted of it, by channel; at least one.
    latest_us
        Samples after this time lie in the future [µs since 1970]; None: a day from now.

    Returns
    -------
    RawLog
        The wanted channels; a log without rows gives channels without samples.

    Raises
    ------
    LogError
        The file cannot be read, or not be trusted; codes in `pipeline.ingest.contract`.
    """
    with readable(path):
        log = _READERS[logs.format].read(path, logs, _logged(channels), latest_us)
    return _with_constants(log, channels)


def can_grow(path: Path, logs: Logs) -> bool:
    """True for a log that is read from a place on: plain text, to which rows are appended.

    Raises
    ------
    LogError
        As `read_log`.
    """
    with readable(path):
        return logs.format == "csv" and is_utf8(logs.encoding) and not is_packed(path)


def read_piece(
    path: Path,
    logs: Logs,
    channels: Channels,
    latest_us: int | None,
    place: Place,
    most_bytes: int,
) -> tuple[RawLog | None, Place]:
    """Read what follows a place of a log that can grow.

    Parameters
    ----------
    path, logs, channels, latest_us
        As for `read_log`.
    place
        Where the piece before ended; that of a new `Place` is the file's begin.
    most_bytes
        Size of the piece; it ends behind a whole row.

    Returns
    -------
    RawLog or None
        Its rows; None where no whole row follows.
    Place
        Behind them.

    Raises
    ------
    LogError
        As `read_log`.
    """
    with readable(path):
        log, end = read_csv_piece(path, logs, _logged(channels), latest_us, place, most_bytes)
    return None if log is None else _with_constants(log, channels), end


def time_span(
    path: Path, logs: Logs, channels: Channels, latest_us: int | None = None
) -> tuple[int, int]:
    """Time from which and until which a log goes, without reading it whole if that can be.

    A CSV is taken to be in order, its first and last rows are looked at; a Parquet file says it in
    its row groups, an MCAP file in its summary, there for all topics together.

    Parameters
    ----------
    path, logs, channels, latest_us
        As for `read_log`.

    Returns
    -------
    tuple of int
        Smallest and largest time stamp [µs since 1970, UTC].

    Raises
    ------
    LogError
        As `read_log`; ``log_empty`` where the log holds no samples.
    """
    with readable(path):
        return _READERS[logs.format].span(path, logs, _logged(channels), latest_us)


def _logged(channels: Channels) -> Channels:
    """The channels that a log holds, in their order."""
    logged = (item for item in channels.items() if item[1].constant is None)
    return dict(sorted(logged, key=lambda item: CHANNELS.index(item[0])))


def _with_constants(log: RawLog, channels: Channels) -> RawLog:
    """A log with the channels that are stated: they have the samples of the drain flow."""
    stated = {name: one for name, one in channels.items() if one.constant is not None}
    if not stated:
        return log
    flow = log.channels[COUNTED]
    every = dict(log.channels)
    every |= {name: _constant(name, one, flow) for name, one in stated.items()}
    return replace(log, channels={name: every[name] for name in CHANNELS if name in every})


def _constant(name: str, channel: Channel, flow: RawChannel) -> RawChannel:
    value = np.full(flow.value.size, to_canonical(name, channel.constant or 0.0, channel.unit))
    value[flow.missing] = np.nan
    value.flags.writeable = False
    return RawChannel(flow.time_us, value, flow.missing, 0)
