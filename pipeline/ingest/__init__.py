"""Files of logs to raw channels: one contract, three readers.

>>> from pipeline.ingest import ChannelSource, LogSource
>>> LogSource("csv", (ChannelSource("speed", "n", "rpm"),)).time_format
'iso8601'
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from pipeline.ingest.contract import ChannelSource, LogSource, RawChannel, RawLog, reading
from pipeline.ingest.csv_log import csv_time_span, read_csv_log
from pipeline.ingest.mcap_log import mcap_time_span, read_mcap_log
from pipeline.ingest.parquet_log import parquet_time_span, read_parquet_log

__all__ = ["ChannelSource", "LogSource", "RawChannel", "RawLog", "read_log", "time_span"]


class _Reader(NamedTuple):
    read: Callable[[Path, LogSource], RawLog]
    span: Callable[[Path, LogSource], tuple[int, int]]


_READERS: Mapping[str, _Reader] = MappingProxyType(
    {
        "csv": _Reader(read_csv_log, csv_time_span),
        "parquet": _Reader(read_parquet_log, parquet_time_span),
        "mcap": _Reader(read_mcap_log, mcap_time_span),
    }
)


def read_log(path: Path, source: LogSource) -> RawLog:
    """Read the channels of a log.

    Parameters
    ----------
    path
        The file.
    source
        How it is written, and which channels are wanted.

    Returns
    -------
    RawLog
        The wanted channels; a log without rows gives channels without samples.

    Raises
    ------
    LogError
        The file cannot be read, or not be trusted; codes in `pipeline.ingest.contract`.
    """
    with reading(path):
        return _READERS[source.format].read(path, source)


def time_span(path: Path, source: LogSource) -> tuple[int, int]:
    """Time from which and until which a log goes, without reading it whole if that can be.

    A CSV is taken to be in order, its first and last rows are looked at; a Parquet file says it in
    its row groups, an MCAP file in its summary, there for all topics together.

    Parameters
    ----------
    path, source
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
    with reading(path):
        return _READERS[source.format].span(path, source)
