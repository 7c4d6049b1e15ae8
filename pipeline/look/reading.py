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
from pipeline.logs.files import find_logs
from pipeline.look.state import End, FileSeen

# Bytes of a growing file read at once, and in one go before its blocks are made.
PIECE_BYTES, PASS_BYTES = 2**20, 2**23
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

    @property
    def is_all(self) -> bool:
        """False if a growing file has more."""
        return all(one.is_read for one in self.files.values())


def read_news(
    spec: MotorSpec,
    seen: Mapping[str, FileSeen],
    needed_us: int,
    latest_us: int,
    most_bytes: int = PASS_BYTES,
) -> News | None:
    """Read what is new; None: nothing is.

    Of the files, samples from `needed_us` on are still needed, and those after `latest_us` refused
    [µs since 1970]. Of a growing file at most so many bytes are read.
    """
    paths, _ = find_logs(spec)
    present = {
        name: one
        for name, path in paths.items()
        if (one := _look_at(path)) is not None and one.modified_ns // 1000 >= needed_us - OLD_US
    }
    news = {
        name
        for name, one in present.items()
        if name not in seen or not (seen[name].is_same(one) and seen[name].is_read)
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
                read, files[name] = _read(
                    spec, paths[name], now, before, needed_us, latest_us, most_bytes
                )
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
                        is_read=True,
                    )
                elif before is not None:
                    files[name] = before
    logs.sort(key=lambda one: one.first_us or 0)
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
    most_bytes: int,
) -> tuple[list[RawLog], FileSeen]:
    file = spec.file
    if not can_grow(path, file.logs):
        whole = read_log(path, file.logs, file.channels, latest_us)
        return _still_needed([whole], needed_us), replace(now, newest_us=_newest_us(whole))
    known = before.ends if before is not None and _is_continued(path, before) else ()
    ends = [*[one for one in known if one.newest_us < needed_us][-1:]]
    place = Place(ends[-1].position, ends[-1].columns) if ends else Place()
    logs, last = list[RawLog](), place.position + most_bytes
    log: RawLog | None = None
    while place.position < last:
        log, place = read_piece(path, file.logs, file.channels, latest_us, place, PIECE_BYTES)
        if log is None:
            break
        logs += _still_needed([log], needed_us)
        newest_us = max(_newest_us(log), ends[-1].newest_us if ends else 0)
        ends.append(End(place.position, tuple(place.columns), newest_us))
    kept = [*[one for one in ends if one.newest_us < needed_us][-1:]]
    kept += [one for one in ends if one.newest_us >= needed_us]
    found = replace(
        now,
        newest_us=ends[-1].newest_us if ends else 0,
        ends=tuple(kept),
        digest=_digest(path, kept[0].position) if kept else "",
        is_read=log is None,
    )
    return logs, found


def newest_us_of(channel: RawChannel) -> int:
    """Time of a channel's latest samples: a single wrong stamp does not say it."""
    return int(np.median(channel.time_us[-LATEST:]))


def _newest_us(log: RawLog) -> int:
    channels = (one for one in log.channels.values() if len(one.time_us))
    return max(map(newest_us_of, channels), default=0)


def _still_needed(logs: list[RawLog], needed_us: int) -> list[RawLog]:
    return [one for one in logs if (one.last_us or 0) >= needed_us]


def _is_continued(path: Path, before: FileSeen) -> bool:
    """False for a file that was cut, or written anew, since it was read."""
    return bool(before.ends) and _digest(path, before.ends[0].position) == before.digest


def _digest(path: Path, position: int) -> str:
    """Digest of a file's first bytes and of those before a position; empty where it is shorter."""
    with path.open("rb", buffering=0) as file:
        head = file.read(min(position, HEAD_BYTES))
        file.seek(max(position - TAIL_BYTES, 0))
        tail = file.read(min(position, TAIL_BYTES))
    is_there = len(tail) == min(position, TAIL_BYTES)
    return hashlib.sha256(head + tail).hexdigest()[:16] if is_there else ""
