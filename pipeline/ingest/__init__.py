"""Files of logs to raw channels: one contract, three readers.

Imports config, units and errors, nothing else of the pipeline.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from pipeline.config.motors import Channels, Logs
from pipeline.errors import LogError
from pipeline.ingest.contract import RawChannel, RawLog
from pipeline.ingest.csv_log import csv_time_span, read_csv_log
from pipeline.ingest.mcap_log import mcap_time_span, read_mcap_log
from pipeline.ingest.parquet_log import parquet_time_span, read_parquet_log
from pipeline.units import CHANNELS

__all__ = ["RawChannel", "RawLog", "read_log", "time_span"]


class _Reader(NamedTuple):
    read: Callable[[Path, Logs, Channels], RawLog]
    span: Callable[[Path, Logs, Channels], tuple[int, int]]


_READERS: Mapping[str, _Reader] = MappingProxyType(
    {
        "csv": _Reader(read_csv_log, csv_time_span),
        "parquet": _Reader(read_parquet_log, parquet_time_span),
        "mcap": _Reader(read_mcap_log, mcap_time_span),
    }
)


def read_log(path: Path, logs: Logs, channels: Channels) -> RawLog:
    """Read the channels of a log.

    Parameters
    ----------
    path
        The file.
    logs
        How it is written.
    channels
        What is wanted of it, by channel; at least one.

    Returns
    -------
    RawLog
        The wanted channels; a log without rows gives channels without samples.

    Raises
    ------
    LogError
        The file cannot be read, or not be trusted; codes in `pipeline.ingest.contract`.
    """
    with _readable(path):
        return _READERS[logs.format].read(path, logs, _in_order(channels))


def time_span(path: Path, logs: Logs, channels: Channels) -> tuple[int, int]:
    """Time from which and until which a log goes, without reading it whole if that can be.

    A CSV is taken to be in order, its first and last rows are looked at; a Parquet file says it in
    its row groups, an MCAP file in its summary, there for all topics together.

    Parameters
    ----------
    path, logs, channels
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
    with _readable(path):
        return _READERS[logs.format].span(path, logs, _in_order(channels))


def _in_order(channels: Channels) -> Channels:
    return dict(sorted(channels.items(), key=lambda item: CHANNELS.index(item[0])))


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Refuse what is no file; errors of the disk, and of memory, become a `LogError`."""
    try:
        _require_file(path)
        yield
    except OSError as error:
        how = f"the file cannot be read: {error.strerror}"
        raise LogError("log_not_readable", path, how) from error
    except MemoryError as error:
        how = "it takes more memory than there is: split the log"
        raise LogError("log_too_large", path, how) from error


def _require_file(path: Path) -> None:
    try:
        if not path.exists():
            raise LogError("log_missing", path, "there is no such file")
        if not path.is_file():
            raise LogError("log_not_readable", path, "this is no file")
        if not path.stat().st_size:
            raise LogError("log_empty", path, "the file has no bytes")
    except ValueError as error:  # no file can have such a name
        raise LogError("log_not_readable", path, f"the file cannot be read: {error}") from error
