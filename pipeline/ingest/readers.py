"""Readers by the name of their format, whether built in or of an installed package.

What an installed reader does wrong is an error of the log that it was to read.
"""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from dataclasses import replace
from importlib.metadata import EntryPoint
from typing import Any

from pipeline.config.readers import reader_entry, reader_version
from pipeline.errors import LogError
from pipeline.ingest.contract import LogFile, Place, RawLog, Reader, require_possible, validate


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
        ``log_reader``: the reader broke the contract.
    """
    entry = reader_entry(file.logs.format)
    with _its_faults(file, entry, "gave what cannot be used"):
        try:
            return validate(log, file.channels, file.latest_us)
        except ValueError as error:
            raise _fault(file, entry, str(error)) from error


def checked_span(file: LogFile, span: object) -> tuple[int, int]:
    """The span that a reader gave; errors as of `checked`."""
    entry = reader_entry(file.logs.format)
    match span:
        case (int() as first, int() as last) if first <= last:
            try:
                require_possible(first, last, file.latest_us)
            except ValueError as error:
                raise _fault(file, entry, str(error)) from error
            return first, last
    raise _fault(file, entry, f"gave {span!r} as the span of a log")


def checked_piece(file: LogFile, piece: object) -> tuple[RawLog | None, Place]:
    """The piece of a log that a reader gave; errors as of `checked`."""
    match piece:
        case (None, Place() as end):
            return None, end
        case (log, Place() as end):
            return checked(file, log), end
    raise _fault(file, reader_entry(file.logs.format), f"gave {piece!r} as a piece of a log")


def checked_units(file: LogFile, units: object) -> Mapping[str, str]:
    """Units that a reader gave; errors as of `checked`."""
    match units:
        case Mapping() if all(isinstance(unit, str) for unit in units.values()):
            return units
    raise _fault(file, reader_entry(file.logs.format), f"gave {units!r} as units of columns")
