"""Files of logs to raw channels: one contract, three readers.

Imports config, units and errors, nothing else of the pipeline.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from pipeline.config.motors import Channels, Logs
from pipeline.ingest.contract import Place, RawChannel, RawLog, readable
from pipeline.ingest.csv.log import csv_time_span, read_csv_log, read_csv_piece
from pipeline.ingest.csv.text import is_packed, is_utf8
from pipeline.ingest.mcap.log import mcap_time_span, read_mcap_log
from pipeline.ingest.parquet.log import parquet_time_span, read_parquet_log
from pipeline.units import CHANNELS

__all__ = ["Place", "RawChannel", "RawLog", "can_grow", "read_log", "read_piece", "time_span"]


class _Reader(NamedTuple):
    read: Callable[[Path, Logs, Channels, int | None], RawLog]
    span: Callable[[Path, Logs, Channels, int | None], tuple[int, int]]


_READERS: Mapping[str, _Reader] = MappingProxyType(
    {
        "csv": _Reader(read_csv_log, csv_time_span),
        "parquet": _Reader(read_parquet_log, parquet_time_span),
        "mcap": _Reader(read_mcap_log, mcap_time_span),
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
        return _READERS[logs.format].read(path, logs, _in_order(channels), latest_us)


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
        return read_csv_piece(path, logs, _in_order(channels), latest_us, place, most_bytes)


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
        return _READERS[logs.format].span(path, logs, _in_order(channels), latest_us)


def _in_order(channels: Channels) -> Channels:
    return dict(sorted(channels.items(), key=lambda item: CHANNELS.index(item[0])))
