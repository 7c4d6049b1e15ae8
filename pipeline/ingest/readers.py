"""Logs to raw channels by the readers of their formats, built in or of installed packages."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np

from pipeline.clock import latest_us as latest_by_clock
from pipeline.config.channels import COUNTED, Channel, Channels
from pipeline.config.dialect import reader_entry, reader_version
from pipeline.config.logs import Logs
from pipeline.errors import LogError
from pipeline.ingest.assembly import span
from pipeline.ingest.contract import (
    LogFile,
    RawChannel,
    RawLog,
    Reader,
    readable,
    require_possible,
    validate,
)
from pipeline.units import CHANNELS, to_canonical


def read_log(path: Path, logs: Logs, channels: Channels, latest_us: int | None = None) -> RawLog:
    """Read the channels of a log; one without rows gives channels without samples.

    Samples after `latest_us` [µs since 1970] lie in the future; None: after a day from now.

    Raises
    ------
    LogError
        The file cannot be read, or not be trusted; codes in `pipeline.ingest.contract`.
    """
    with _opened(path, logs, channels, latest_us) as (reader, file):
        log = validate(reader.read(file), file.channels, file.latest_us)
    return _with_constants(log, channels)


def time_span(
    path: Path, logs: Logs, channels: Channels, latest_us: int | None = None
) -> tuple[int, int]:
    """Smallest and largest time stamp [µs since 1970, UTC], without reading the whole log if so.

    A CSV is taken to be in order, its first and last rows are looked at; an MCAP file says it in
    its summary, for all topics together. Errors as `read_log`; ``log_empty`` without samples.
    """
    with _opened(path, logs, channels, latest_us) as (reader, file):
        if reader.span is None:
            log = validate(reader.read(file), file.channels, file.latest_us)
            return span(path, log.stamps())
        first, last = reader.span(file)
        require_possible(first, last, file.latest_us)
        return first, last


def _with_constants(log: RawLog, channels: Channels) -> RawLog:
    """A log with the channels that are stated: they have the samples of the drain flow."""
    stated = {name: channel for name, channel in channels.items() if channel.constant is not None}
    if not stated:
        return log
    flow = log.channels[COUNTED]
    every = dict(log.channels)
    every |= {name: _constant(name, channel, flow) for name, channel in stated.items()}
    return replace(log, channels={name: every[name] for name in CHANNELS if name in every})


def _constant(name: str, channel: Channel, flow: RawChannel) -> RawChannel:
    value = np.full(flow.value.size, to_canonical(name, channel.constant or 0.0, channel.unit))
    value[flow.missing] = np.nan
    value.flags.writeable = False
    return RawChannel(flow.time_us, value, flow.missing, 0)


@contextmanager
def _opened(
    path: Path, logs: Logs, channels: Channels, latest_us: int | None = None
) -> Iterator[tuple[Reader, LogFile]]:
    """A log's reader, and what it is given: the channels that a log holds, in their order.

    What an installed reader does wrong within is an error of the log.

    Raises
    ------
    LogError
        What is no file; ``log_reader``: there is no such reader or option, it cannot be loaded or
        used, or fails.
    """
    with readable(path):
        try:
            entry = reader_entry(logs.format)
        except ValueError as error:
            raise LogError("log_reader", path, f"format {logs.format!r}: {error}") from error
        logged = (item for item in channels.items() if item[1].constant is None)
        in_order = dict(sorted(logged, key=lambda item: CHANNELS.index(item[0])))
        with _its_faults(path, entry):
            reader = entry.load()
            if not isinstance(reader, Reader):
                raise TypeError(f"no Reader but a {type(reader).__name__}")
            latest = latest_by_clock() if latest_us is None else latest_us
            yield reader, _with_options(LogFile(path, logs, in_order, latest), reader)


@contextmanager
def _its_faults(path: Path, entry: EntryPoint) -> Iterator[None]:
    """Any error of an installed reader as one of the log; a built-in one's stay as they are.

    What it prints is none of the program's output.
    """
    try:
        with redirect_stdout(sys.stdout if entry.dist is None else sys.stderr):
            yield
    except (LogError, OSError, MemoryError):
        raise
    # An installed reader is anybody's code, over any library: it may raise whatever there is.
    except (Exception, SystemExit) as error:
        if entry.dist is None:
            raise
        last = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{last.filename.rpartition('/')[2]}, line {last.lineno}"
        how = f"failed: {type(error).__name__}: {error} ({where})"
        message = f"reader {entry.name} of {reader_version(entry)} {how}"
        raise LogError("log_reader", path, message) from error


def _with_options(file: LogFile, reader: Reader) -> LogFile:
    """The log with all options of its reader, the defaults where none are set."""
    own = file.logs.options
    if not own and not reader.options:
        return file
    for key, value in own.items():
        default = reader.options.get(key)
        if type(value) is not type(default):
            known = ", ".join(f"{name} = {known!r}" for name, known in reader.options.items())
            how = f"logs.options: got {key} = {value!r}; expected of {known or 'none'}"
            raise LogError("log_reader", file.path, how)
    return replace(file, logs=file.logs.model_copy(update={"options": {**reader.options, **own}}))
