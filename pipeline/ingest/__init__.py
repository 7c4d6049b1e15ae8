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
from pipeline.ingest.contract import RawChannel, RawLog, readable
from pipeline.ingest.csv.log import csv_time_span, read_csv_log
from pipeline.ingest.mcap.log import mcap_time_span, read_mcap_log
from pipeline.ingest.parquet.log import parquet_time_span, read_parquet_log
from pipeline.units import CHANNELS, to_canonical

__all__ = ["RawChannel", "RawLog", "read_log", "time_span"]


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
        log = _READERS[logs.format].read(path, logs, _logged(channels), latest_us)
    return _with_constants(log, channels)


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
