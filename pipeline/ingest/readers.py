"""Readers by the name of their format, whether built in or of an installed package.

What an installed reader does wrong is an error of the log that it was to read.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib.metadata import EntryPoint
from typing import Any

from pipeline.config.readers import reader_entry, reader_version
from pipeline.errors import LogError
from pipeline.ingest.contract import LogFile, RawLog, Reader
from pipeline.ingest.wall_clock import EARLIEST_US, LATEST_US

_DTYPES = {"time_us": "int64", "value": "float64", "missing": "bool"}


def reader_of(file: LogFile) -> Reader:
    """The reader of a log.

    Raises
    ------
    LogError
        ``log_reader``: it is not installed, cannot be loaded, or is none.
    """
    try:
        entry = reader_entry(file.logs.format)
    except ValueError as error:
        raise LogError("log_reader", file.path, f"format {file.logs.format!r}: {error}") from error
    with _its_faults(file, entry, "cannot be loaded"):
        reader = entry.load()
    if not isinstance(reader, Reader):
        raise _fault(file, entry, f"is no Reader but of type {type(reader).__name__}")
    return reader


def called(file: LogFile, function: Callable[..., Any], *arguments: object) -> Any:
    """Result of a function of a log's reader.

    Raises
    ------
    LogError
        As the reader raises it; ``log_reader`` where an installed one raises anything else.
    """
    with _its_faults(file, reader_entry(file.logs.format), "failed"):
        return function(file, *arguments)


@contextmanager
def _its_faults(file: LogFile, entry: EntryPoint, what: str) -> Iterator[None]:
    """Any error of an installed reader as one of the log; a built-in one's stay as they are."""
    try:
        yield
    except (LogError, OSError, MemoryError):
        raise
    except (Exception, SystemExit) as error:
        if entry.dist is None:
            raise
        last = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{last.filename.rpartition('/')[2]}, line {last.lineno}"
        how = f"{what}: {type(error).__name__}: {error} ({where})"
        raise _fault(file, entry, how) from error


def _fault(file: LogFile, entry: EntryPoint, how: str) -> LogError:
    return LogError(
        "log_reader", file.path, f"reader {entry.name} of {reader_version(entry)} {how}"
    )


def with_options(file: LogFile, reader: Reader) -> LogFile:
    """The log with all options of its reader, the defaults where none are set.

    Raises
    ------
    LogError
        ``log_reader``: the reader has no such option, or the value is of another type.
    """
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


def checked(file: LogFile, log: object) -> RawLog:
    """The log that a reader gave.

    Raises
    ------
    LogError
        ``log_reader``: an installed reader broke the contract.
    """
    entry = reader_entry(file.logs.format)
    if not isinstance(log, RawLog):
        raise _fault(file, entry, f"gave no RawLog but a {type(log).__name__}")
    if entry.dist is not None:
        with _its_faults(file, entry, "gave what cannot be used"):
            breach = next(_breaches(file, log), None)
        if breach is not None:
            raise _fault(file, entry, breach)
    return log


def _breaches(file: LogFile, log: RawLog) -> Iterator[str]:
    if log.channels.keys() != file.channels.keys():
        asked, given = ", ".join(file.channels), ", ".join(log.channels)
        yield f"gave the channels {given or 'none'} where {asked} were asked for"
    for name, channel in log.channels.items():
        for part, dtype in _DTYPES.items():
            array = getattr(channel, part)
            if (array.dtype, array.shape) != (dtype, channel.time_us.shape) or array.ndim != 1:
                yield f"gave {part} of {name} as {array.dtype} {array.shape}, not as {dtype}"
    stamps = log.stamps()
    ends: tuple[int | None, int | None] = (None, None)
    if stamps:
        ends = min(int(one.min()) for one in stamps), max(int(one.max()) for one in stamps)
        if ends[0] < EARLIEST_US or ends[1] >= LATEST_US:
            yield "gave time stamps before 1990 or after 2200: they are microseconds since 1970"
    if (log.first_us, log.last_us) != ends:
        yield f"gave the ends {(log.first_us, log.last_us)}, and its time stamps have {ends}"


def checked_span(file: LogFile, span: object) -> tuple[int, int]:
    """The span that a reader gave; errors as of `checked`."""
    match span:
        case (int() as first, int() as last):
            return first, last
    raise _fault(file, reader_entry(file.logs.format), f"gave {span!r} as the span of a log")
