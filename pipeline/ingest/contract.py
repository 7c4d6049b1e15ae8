"""The contract of all readers of logs, whatever the format of the file, and the way to read a log.

A reader sorts nothing, fills nothing and judges nothing but the file itself; whether a sample is
plausible is for the cleaning stage. Errors are `LogError`s with a code of `docs/operations.md`.
"""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass, field, replace
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Rows
from pipeline.clock import latest_us as latest_by_clock
from pipeline.config.channels import COUNTED, Channel, Channels
from pipeline.config.logs import Logs, reader_entry, reader_version
from pipeline.errors import LogError
from pipeline.ingest.time_stamps import EARLIEST_US, LATEST_US
from pipeline.units import CHANNELS, to_canonical


@dataclass(frozen=True, slots=True)
class RawChannel:
    """Samples of a channel as they are in the file; arrays of shape (n,), read-only."""

    # UTC, microseconds since 1970, in the order of the file: backward time is for cleaning.
    time_us: NDArray[np.int64]
    value: NDArray[np.float64]  # canonical unit; nan where missing
    # The cell was blank or null or held no number. A nan or infinity in the file is not missing.
    missing: NDArray[np.bool_]
    unparsed: int  # cells that held something that is no number; they are in `missing` too
    # Samples that the log itself does not call good; also blank cells, where their quality is
    # stated. None: the source names no quality.
    bad_quality: NDArray[np.bool_] | None = None
    example: str | None = None  # of cells that are no number: the first, if any with a digit

    @property
    def such_as(self) -> str:
        """The example in words, behind what is said of such cells."""
        return f", such as {self.example[:40]!r}" if self.example else ""

    def rows(self, chosen: Rows, time_us: NDArray[np.int64] | None = None) -> RawChannel:
        """Return some of its samples, with stamps that channels share where these are given.

        The count of what is no number stays that of all.
        """
        bad = self.bad_quality
        return RawChannel(
            self.time_us[chosen] if time_us is None else time_us,
            self.value[chosen],
            self.missing[chosen],
            self.unparsed,
            None if bad is None else bad[chosen],
            self.example,
        )

    @staticmethod
    def join(parts: Sequence[RawChannel]) -> RawChannel:
        """Return samples in turn; where a part says nothing of its quality, it is not bad."""
        marks = [part.bad_quality for part in parts]
        bad = [
            np.zeros(part.missing.size, np.bool_) if own is None else own
            for part, own in zip(parts, marks, strict=True)
        ]
        return RawChannel(
            np.concatenate([part.time_us for part in parts]),
            np.concatenate([part.value for part in parts]),
            np.concatenate([part.missing for part in parts]),
            sum(part.unparsed for part in parts),
            None if all(own is None for own in marks) else np.concatenate(bad),
            next((part.example for part in parts if part.example), None),
        )


@dataclass(frozen=True, slots=True)
class RawLog:
    """A log as read."""

    channels: Mapping[str, RawChannel]  # by name, all that are wanted
    rows: int  # rows of a table, or messages of the topics read, that have a time stamp
    notes: tuple[str, ...] = ()  # what was left out, each with its count and reason, a line each
    left_out: int = 0  # rows or messages that were

    def stamps(self) -> list[NDArray[np.int64]]:
        """Return time stamps of channels: those that several share, as in a table, once."""
        arrays = {
            (part.time_us.ctypes.data, part.time_us.size): part.time_us
            for part in self.channels.values()
        }
        return list(arrays.values())

    def ends(self) -> tuple[int, int] | None:
        """Return smallest and largest time stamp; None without any."""
        return ends(self.stamps())


@dataclass(frozen=True, slots=True)
class LogFile:
    """A log to read, and what is wanted of it."""

    path: Path
    logs: Logs  # its dialect
    channels: Channels  # to read; at least one, and no constants
    latest_us: int = LATEST_US  # samples after this time lie in the future [µs since 1970]


@dataclass(frozen=True, slots=True)
class Reader:
    """A reader of a format."""

    read: Callable[[LogFile], RawLog]  # the log, with all its channels
    # Its smallest and largest time stamp [µs since 1970, UTC], without reading everything; None:
    # the log is read for them.
    span: Callable[[LogFile], tuple[int, int]] | None = None
    # Keys that ``[logs.options]`` may have, with their defaults; `LogFile.logs` has them all.
    options: Mapping[str, Any] = field(default_factory=dict)


def ends(parts: Iterable[NDArray[np.int64]]) -> tuple[int, int] | None:
    """Return smallest and largest of some time stamps; None where there is none."""
    times = [part for part in parts if part.size]
    if not times:
        return None
    return min(int(part.min()) for part in times), max(int(part.max()) for part in times)


def span(path: Path, parts: Iterable[NDArray[np.int64]]) -> tuple[int, int]:
    """Return smallest and largest time stamp of a file's parts; none is an error ``log_empty``."""
    bounds = ends(parts)
    if bounds is None:
        raise LogError("log_empty", path, "the log holds no samples, so it has no time span")
    return bounds


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Refuse what is no file; errors of the disk, and of memory, become a `LogError`."""
    try:
        if not path.exists():
            raise LogError("log_missing", path, "there is no such file")
        if not path.is_file():
            raise LogError("log_not_readable", path, "this is no file")
        if not path.stat().st_size:
            raise LogError("log_empty", path, "the file has no bytes")
        yield
    except OSError as error:
        how = f"the file cannot be read: {error.strerror or error}"
        raise LogError("log_not_readable", path, how) from error
    except MemoryError as error:
        how = "it takes more memory than there is: split the log"
        raise LogError("log_too_large", path, how) from error


_DTYPES = {"time_us": "int64", "value": "float64", "missing": "bool", "bad_quality": "bool"}


def validate(log: object, channels: Iterable[str], latest_us: int = LATEST_US) -> RawLog:
    """Return the log that a reader gave for some channels, if it keeps this contract.

    Raises
    ------
    ValueError
        It does not; the message says in what.
    """
    if not isinstance(log, RawLog):
        raise ValueError(f"gave no RawLog but a {type(log).__name__}")  # noqa: TRY004
    if log.channels.keys() != set(channels):
        asked, given = ", ".join(channels), ", ".join(log.channels)
        raise ValueError(f"gave the channels {given or 'none'} where {asked} were asked for")
    for name, channel in log.channels.items():
        _require_arrays(name, channel)
    counts = {f"unparsed of {name}": raw.unparsed for name, raw in log.channels.items()}
    for name, count in {"rows": log.rows, "left_out": log.left_out, **counts}.items():
        if type(count) is not int or count < 0:
            raise ValueError(f"gave {name} as {count!r}, not as a count")
    if type(log.notes) is not tuple or not all(isinstance(note, str) for note in log.notes):
        raise ValueError(f"gave notes as {log.notes!r}, not as a tuple of lines")
    bounds = log.ends()
    if bounds is not None:
        require_possible(*bounds, latest_us)
    return log


def _require_arrays(name: str, channel: RawChannel) -> None:
    for part, dtype in _DTYPES.items():
        array, size = getattr(channel, part), channel.time_us.size
        if part == "bad_quality" and array is None:
            continue
        if (type(array), array.dtype, array.shape) != (np.ndarray, dtype, (size,)):
            kind = f"{type(array).__name__} of {array.dtype} {array.shape}"
            raise ValueError(f"gave {part} of {name} as {kind}, not as array of {dtype} ({size},)")


def require_possible(first_us: int, last_us: int, latest_us: int) -> None:
    """Raise ValueError for ends of a log that none can have."""
    if not EARLIEST_US <= first_us <= last_us <= latest_us:
        raise ValueError(
            f"gave time stamps from {first_us} to {last_us}, before 1990 or in the future: they "
            "are microseconds since 1970, UTC"
        )


# To read a log


def read_log(path: Path, logs: Logs, channels: Channels, latest_us: int | None = None) -> RawLog:
    """Read the channels of a log; a log without rows gives channels without samples.

    Samples after `latest_us` [µs since 1970] lie in the future; None: after a day from now.

    Raises LogError: The file cannot be read, or not be trusted; codes in `docs/operations.md`.
    """
    with _open(path, logs, channels, latest_us) as (reader, file):
        log = validate(reader.read(file), file.channels, file.latest_us)
    return _with_constants(log, channels)


def time_span(
    path: Path, logs: Logs, channels: Channels, latest_us: int | None = None
) -> tuple[int, int]:
    """Return smallest and largest time stamp [µs since 1970, UTC], if possible by its ends.

    A CSV is taken to be in order, its first and last rows are looked at; an MCAP file says it in
    its summary, for all topics together. Errors as `read_log`; ``log_empty`` without samples.
    """
    with _open(path, logs, channels, latest_us) as (reader, file):
        if reader.span is None:
            log = validate(reader.read(file), file.channels, file.latest_us)
            return span(path, log.stamps())
        first, last = reader.span(file)
        require_possible(first, last, file.latest_us)
        return first, last


def _with_constants(log: RawLog, channels: Channels) -> RawLog:
    """Return a log with the channels that are stated: they have the samples of the drain flow."""
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
def _open(
    path: Path, logs: Logs, channels: Channels, latest_us: int | None = None
) -> Iterator[tuple[Reader, LogFile]]:
    """Return a log's reader, and what it is given: the channels that a log holds, in their order.

    What an installed reader does wrong within is an error of the log.
    """
    with readable(path):
        try:
            entry = reader_entry(logs.format)
        except ValueError as error:
            raise LogError("log_reader", path, f"format {logs.format!r}: {error}") from error
        logged = (entry for entry in channels.items() if entry[1].constant is None)
        in_order = dict(sorted(logged, key=lambda entry: CHANNELS.index(entry[0])))
        with _its_faults(path, entry):
            reader = entry.load()
            if not isinstance(reader, Reader):
                raise TypeError(f"no Reader but a {type(reader).__name__}")
            latest = latest_by_clock() if latest_us is None else latest_us
            yield reader, _with_options(LogFile(path, logs, in_order, latest), reader)


@contextmanager
def _its_faults(path: Path, entry: EntryPoint) -> Iterator[None]:
    """Turn any error of an installed reader into one of the log; a built-in's stay as they are.

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
    """Return the log with all options of its reader, the defaults where none are set."""
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
