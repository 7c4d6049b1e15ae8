"""New samples of a motor's logs: rows that were appended, and files that are new or changed."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pipeline.arrays import SECOND_US
from pipeline.config import MotorSpec
from pipeline.errors import LogError
from pipeline.ingest import Place, RawChannel, RawLog, can_grow, read_log, read_piece
from pipeline.logs.finding import find_logs
from pipeline.look.state import FileSeen

# Bytes of a growing file read at once.
PIECE_BYTES = 2**20
# A file last written to so long before the samples that are wanted holds none of them.
OLD_US = 86_400 * SECOND_US
# Latest samples of a channel that say how far it goes.
LATEST = 5
# Bytes at a file's begin and before a place that show that it is still the same file.
HEAD_BYTES, TAIL_BYTES = 4096, 256


@dataclass(frozen=True, slots=True)
class News:
    """Samples that were read."""

    logs: tuple[RawLog, ...]  # what was read, in order of time
    # All files as they are now known, by path relative to the log root.
    files: Mapping[str, FileSeen]
    fault: str = ""  # why a file could not be read; empty without one


def read_news(
    spec: MotorSpec,
    seen: Mapping[str, FileSeen],
    needed_us: int,
    latest_us: int,
) -> News | None:
    """Read what is new; None: nothing is.

    Of the files, samples from `needed_us` on are still needed, and those after `latest_us` refused
    [µs since 1970].
    """
    paths, _ = find_logs(spec)
    present = {
        name: one
        for name, path in paths.items()
        if (one := _look_at(path)) is not None and one.modified_ns // 1000 >= needed_us - OLD_US
    }
    news = {
        name for name, one in present.items() if name not in seen or not seen[name].is_same(one)
    }
    if not news:
        return None
    logs, files, fault = list[RawLog](), dict[str, FileSeen](), ""
    for name, now in present.items():
        before = seen.get(name)
        if before is not None and name not in news and before.newest_us < needed_us:
            files[name] = before
        else:
            try:
                read, files[name] = _read(spec, paths[name], now, before, needed_us, latest_us)
                logs += read
            except OSError as error:  # rotated away in between, or out of reach
                fault = f"{name}: {error.strerror}"
                files |= {} if before is None else {name: before}
            except LogError as error:
                fault = error.message
                # One that is damaged is tried again once it has changed.
                if error.code != "log_not_readable":
                    files[name] = replace(
                        before or now,
                        size=now.size,
                        modified_ns=now.modified_ns,
                        inode=now.inode,
                    )
                elif before is not None:
                    files[name] = before
    logs.sort(key=lambda one: one.ends() or (0, 0))
    return News(tuple(logs), files, fault)


def _look_at(path: Path) -> FileSeen | None:
    """Size, time and inode of a file; None if it is gone."""
    try:
        state = path.stat()
    except OSError:
        return None
    return FileSeen(state.st_size, state.st_mtime_ns, state.st_ino)


def _read(
    spec: MotorSpec,
    path: Path,
    now: FileSeen,
    before: FileSeen | None,
    needed_us: int,
    latest_us: int,
) -> tuple[list[RawLog], FileSeen]:
    file = spec.file
    if not can_grow(path, file.logs):
        whole = read_log(path, file.logs, file.channels, latest_us)
        return _still_needed(whole, needed_us), replace(now, newest_us=_newest_us(whole))
    place, logs, newest_us = Place(), list[RawLog](), 0
    if before is not None and before.digest == _digest(path, before.position):
        place = Place(before.position, before.columns)
    # Reading goes on behind the last piece before all samples still needed.
    kept = place
    while True:
        log, place = read_piece(path, file.logs, file.channels, latest_us, place, PIECE_BYTES)
        if log is None:
            break
        newest_us = max(newest_us, _newest_us(log))
        if newest_us < needed_us:
            kept = place
        logs += _still_needed(log, needed_us)
    newest_us = max(newest_us, 0 if before is None else before.newest_us)
    return logs, replace(
        now,
        newest_us=newest_us,
        position=kept.position,
        columns=tuple(kept.columns),
        digest=_digest(path, kept.position),
    )


def newest_us_of(channel: RawChannel) -> int:
    """Time of a channel's latest samples: a single wrong stamp does not say it."""
    return int(np.median(channel.time_us[-LATEST:]))


def _newest_us(log: RawLog) -> int:
    channels = (one for one in log.channels.values() if len(one.time_us))
    return max(map(newest_us_of, channels), default=0)


def _still_needed(log: RawLog, needed_us: int) -> list[RawLog]:
    return [log] if (log.ends() or (0, 0))[1] >= needed_us else []


def _digest(path: Path, position: int) -> str:
    """Digest of a file's first bytes and of those before a position; empty where it is shorter."""
    with path.open("rb", buffering=0) as file:
        head = file.read(min(position, HEAD_BYTES))
        file.seek(max(position - TAIL_BYTES, 0))
        tail = file.read(min(position, TAIL_BYTES))
    is_there = len(tail) == min(position, TAIL_BYTES)
    return hashlib.sha256(head + tail).hexdigest()[:16] if is_there else ""
