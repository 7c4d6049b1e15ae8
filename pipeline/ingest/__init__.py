"""Files of logs to raw channels: one contract, a reader a format.

Imports config, units and errors, nothing else of the pipeline.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from pipeline.config.channels import COUNTED, Channel, Channels
from pipeline.config.logs import Logs
from pipeline.ingest.assembly import Samples, log_of_samples, span
from pipeline.ingest.contract import LogFile, Place, RawChannel, RawLog, Reader, readable, validate
from pipeline.ingest.readers import (
    called,
    checked,
    checked_piece,
    checked_span,
    checked_units,
    reader_of,
    with_options,
)
from pipeline.units import CHANNELS, to_canonical

__all__ = [
    "LogFile",
    "Place",
    "RawChannel",
    "RawLog",
    "Reader",
    "Samples",
    "can_grow",
    "header_units",
    "log_of_samples",
    "read_log",
    "read_piece",
    "time_span",
    "validate",
]


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
        reader, file = _opened(path, logs, channels, latest_us)
        return _with_constants(checked(file, called(file, reader.read)), channels)


def can_grow(path: Path, logs: Logs) -> bool:
    """True for a log that is read from a place on, as rows are appended to it.

    Raises
    ------
    LogError
        As `read_log`.
    """
    with readable(path):
        reader, file = _opened(path, logs, {}, None)
        return bool(called(file, reader.can_grow))


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
        reader, file = _opened(path, logs, channels, latest_us)
        log, end = checked_piece(file, called(file, reader.piece, place, most_bytes))
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
        reader, file = _opened(path, logs, channels, latest_us)
        if reader.span is None:
            return span(path, checked(file, called(file, reader.read)).stamps())
        return checked_span(file, called(file, reader.span))


def header_units(path: Path, logs: Logs, channels: Channels) -> dict[str, str]:
    """Units that a log's header states, as written, by channel.

    Raises
    ------
    LogError
        As `read_log`.
    """
    with readable(path):
        reader, file = _opened(path, logs, channels, None)
        units = checked_units(file, called(file, reader.units))
        return {name: units.get(one.source, "") for name, one in file.channels.items()}


def _opened(
    path: Path, logs: Logs, channels: Channels, latest_us: int | None
) -> tuple[Reader, LogFile]:
    """A log's reader, and what it is given: the channels that a log holds, in their order."""
    logged = (item for item in channels.items() if item[1].constant is None)
    in_order = dict(sorted(logged, key=lambda item: CHANNELS.index(item[0])))
    file = LogFile(path, logs, in_order, latest_us)
    reader = reader_of(file)
    return reader, with_options(file, reader)


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
