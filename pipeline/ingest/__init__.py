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
from pipeline.ingest.contract import (
    LogFile,
    Place,
    RawChannel,
    RawLog,
    Reader,
    require_possible,
    validate,
)
from pipeline.ingest.readers import opened
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
    """Read the channels of a log; one without rows gives channels without samples.

    Samples after `latest_us` [µs since 1970] lie in the future; None: after a day from now.

    Raises
    ------
    LogError
        The file cannot be read, or not be trusted; codes in `pipeline.ingest.contract`.
    """
    with opened(path, logs, channels, latest_us) as (reader, file):
        log = validate(reader.read(file), file.channels, file.latest_us)
    return _with_constants(log, channels)


def can_grow(path: Path, logs: Logs) -> bool:
    """True for a log that is read from a place on, as rows are appended; errors as `read_log`."""
    with opened(path, logs, {}) as (reader, file):
        return reader.can_grow is not None and reader.can_grow(file)


def read_piece(
    path: Path,
    logs: Logs,
    channels: Channels,
    latest_us: int | None,
    place: Place,
    most_bytes: int,
) -> tuple[RawLog | None, Place]:
    """Rows that follow a place of a log that can grow, and the place behind them.

    There are at most `most_bytes` of them, and None where no whole row follows. A new `Place` is
    the file's begin; the rest, and the errors, are as for `read_log`.
    """
    with opened(path, logs, channels, latest_us) as (reader, file):
        if reader.piece is None:
            return None, place
        log, end = reader.piece(file, place, most_bytes)
        log = None if log is None else validate(log, file.channels, file.latest_us)
    return None if log is None else _with_constants(log, channels), end


def time_span(
    path: Path, logs: Logs, channels: Channels, latest_us: int | None = None
) -> tuple[int, int]:
    """Smallest and largest time stamp [µs since 1970, UTC], without reading the whole log if so.

    A CSV is taken to be in order, its first and last rows are looked at; an MCAP file says it in
    its summary, for all topics together. Errors as `read_log`; ``log_empty`` without samples.
    """
    with opened(path, logs, channels, latest_us) as (reader, file):
        if reader.span is None:
            log = validate(reader.read(file), file.channels, file.latest_us)
            return span(path, log.stamps())
        first, last = reader.span(file)
        require_possible(first, last, file.latest_us)
        return first, last


def header_units(path: Path, logs: Logs, channels: Channels) -> dict[str, str]:
    """Units that a log's header states, as written, by channel; errors as `read_log`."""
    with opened(path, logs, channels) as (reader, file):
        units = {} if reader.units is None else reader.units(file)
        return {name: str(units.get(one.source, "")) for name, one in file.channels.items()}


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
