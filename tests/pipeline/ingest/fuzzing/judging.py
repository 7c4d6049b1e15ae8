"""Verdict on the read of a damaged log: one of four allowed outcomes, or a fault."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.config.channels import Channels
from pipeline.config.logs import Logs
from pipeline.errors import LogError
from pipeline.ingest import RawChannel, RawLog, contract, read_log, time_span
from pipeline.setup.sniff import sniff
from tests.pipeline.ingest.fuzzing.checksums import has_blank_checksum
from tests.pipeline.ingest.fuzzing.mutations import Mutation
from tests.pipeline.ingest.fuzzing.seeds import Seed

CODES = frozenset(re.findall(r"``(log_\w+)``", contract.__doc__ or ""))
"""Codes that a reader may raise, as its contract lists them."""

_LONGEST_MESSAGE = 4000


class Outcome(StrEnum):
    """The end of a read of a damaged log.

    The first four are allowed. Values are `UNDETECTABLE` where they are others than written and no
    checksum covers what was changed; a log is `PART` where all that it gives was written, and it
    says that something is left out.
    """

    REFUSED = "coded error"
    RIGHT = "right"
    PART = "right in part, and said so"
    UNDETECTABLE = "undetectable"
    WRONG = "wrong under a checksum"
    UNCODED = "another exception"
    CRASHED = "crash"
    HUNG = "hang"
    MEMORY = "beyond the memory limit"

    @property
    def is_fault(self) -> bool:
        """True if the outcome is not allowed."""
        return self not in (self.REFUSED, self.RIGHT, self.PART, self.UNDETECTABLE)


@dataclass(frozen=True, slots=True)
class Verdict:
    """Verdict on one mutation; `detail` has the code, or what is wrong."""

    outcome: Outcome
    detail: str = ""
    cpu_s: float = 0.0


def judged(
    seed: Seed,
    whole: RawLog,
    folder: Path,
    mutation: Mutation,
    read: Callable[[Path, Logs, Channels], RawLog] = read_log,
) -> Verdict:
    """Write a damaged log, read it in all ways, and judge what comes of it.

    Parameters
    ----------
    seed, whole
        The valid log, and what is read of it.
    folder
        Where the damaged one is written.
    mutation
        The damage.
    read
        The reader.
    """
    data = mutation.applied(seed.data)
    path = folder / seed.file_name
    path.write_bytes(data)
    start = time.process_time()
    try:
        span = _coded(time_span, path, *seed.source)
        _coded(sniff, path)
        log = _coded(read, path, *seed.source)
    except MemoryError as error:
        return Verdict(Outcome.MEMORY, repr(error))
    except BaseException as error:  # Polars panics with what is no Exception.
        return Verdict(Outcome.UNCODED, repr(error)[:500])
    cpu_s = time.process_time() - start
    if isinstance(log, LogError):
        return Verdict(Outcome.REFUSED, log.code, cpu_s)
    outcome, detail = _compared(log, whole)
    right_span = isinstance(span, LogError) or span == (whole.first_us, whole.last_us)
    covered = mutation.touches_only(seed.checked)
    if seed.reader == "mcap" and covered:
        covered = not has_blank_checksum(data)
    if outcome is Outcome.UNDETECTABLE and covered:
        return Verdict(Outcome.WRONG, detail, cpu_s)
    if outcome is Outcome.RIGHT and covered and not right_span:
        return Verdict(Outcome.WRONG, f"time span {span}", cpu_s)
    return Verdict(outcome, detail, cpu_s)


def _coded(act: Callable[..., Any], *arguments: Any) -> Any:
    """Result of an act, or its error, which must have a code and a legible one-line message."""
    try:
        return act(*arguments)
    except LogError as error:
        message = error.message
        if error.code not in CODES:
            raise AssertionError(f"code {error.code} is not in the contract") from error
        if not message.isprintable() or len(message) > _LONGEST_MESSAGE:
            raise AssertionError(f"no legible line: {message[:200]!r}") from error
        if arguments[0].name not in message:
            raise AssertionError(f"no file in {message!r}") from error
        return error


def _compared(log: RawLog, whole: RawLog) -> tuple[Outcome, str]:
    if any(not note.isprintable() for note in log.notes):
        raise AssertionError(f"no legible notes: {log.notes}")
    pairs = [(log.channels[name], channel) for name, channel in whole.channels.items()]
    if all(_same(one, other) for one, other in pairs) and log.rows == whole.rows:
        return Outcome.RIGHT, ""
    told = bool(log.notes) or any(one.unparsed for one, _ in pairs)
    if told and all(_is_part(one, other) for one, other in pairs):
        return Outcome.PART, ""
    return Outcome.UNDETECTABLE, "; ".join(log.notes)


def _same(one: RawChannel, other: RawChannel) -> bool:
    return (
        np.array_equal(one.time_us, other.time_us)
        and np.array_equal(one.missing, other.missing)
        and np.array_equal(_bits(one.value), _bits(other.value))
        and one.unparsed == other.unparsed
    )


def _bits(values: NDArray[np.float64]) -> NDArray[np.uint64]:
    """Of all but one kind of nan; 0 and -0 are not the same."""
    return np.where(np.isnan(values), np.nan, values).view(np.uint64)


def _is_part(one: RawChannel, other: RawChannel) -> bool:
    """True if all samples of one are samples of the other."""
    return _samples(one) <= _samples(other)


def _samples(channel: RawChannel) -> set[tuple[int, int]]:
    there = ~channel.missing
    values = _bits(channel.value[there]).tolist()
    return set(zip(channel.time_us[there].tolist(), values, strict=True))
