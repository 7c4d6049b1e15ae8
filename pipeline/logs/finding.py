"""Log files of motors: found by the patterns of a config, and asked for size and time."""

from __future__ import annotations

import os
import re
import stat
import time
from bisect import bisect_left
from collections.abc import Collection, Iterable
from contextlib import suppress
from fnmatch import fnmatchcase
from functools import lru_cache
from itertools import islice, takewhile
from pathlib import Path

from pipeline.errors import one_line
from pipeline.workers.process import asking, told_alive

# Size, time of the last change [ns] and inode.
FileState = tuple[int, int, int, int]

LONGEST_PATH = 4096
GLOB_CHARACTERS = frozenset("*?[")
# A folder that was changed so lately may be changed again at the same time of its clock [ns].
JUST_NOW_NS = 2_000_000_000


def find(
    root: Path, patterns: Iterable[str], silent: Collection[str] = ()
) -> tuple[dict[str, Path], list[str]]:
    """Log files below a root, by relative path, and those that are named but absent."""
    found: set[Path] = set()
    absent: list[str] = []
    for pattern in patterns:
        named, is_glob = root / pattern, bool(GLOB_CHARACTERS & set(pattern))
        if pattern in silent:
            found |= set() if is_glob else {named}
            continue
        with asking(pattern):
            # A file may be called `a[1].csv`: a pattern that exists as a file is no glob.
            if named.exists():
                found.add(named)
            elif is_glob:
                paths = told_alive(_matching(root, pattern))
                found |= {path for path in paths if not _is_folder(path, root, silent)}
            else:
                absent.append(pattern)
    names: dict[str, Path] = {}
    for path in sorted(found):
        name = legible(path.relative_to(root).as_posix())
        while name in names:  # Another file's name is what this one's is shown as.
            name += "'"
        names[name] = path
    return names, absent


def _matching(root: Path, pattern: str) -> Iterable[Path]:
    """Paths that a glob names, as `Path.glob`; a folder of many motors is listed once."""
    place, _, last = pattern.rpartition("/")
    if GLOB_CHARACTERS & set(place) or "**" in last:
        return root.glob(pattern)
    folder = root / place
    names = _names_in(folder)
    beginning = re.split(r"[*?\[]", last)[0]
    begun = islice(names, bisect_left(names, beginning), None)
    alike = takewhile(lambda name: name.startswith(beginning), begun)
    return (folder / name for name in alike if fnmatchcase(name, last))


def _names_in(folder: Path) -> tuple[str, ...]:
    """Names in a folder, sorted; none where it cannot be listed."""
    try:
        changed_ns = folder.stat().st_mtime_ns
        if time.time_ns() - changed_ns < JUST_NOW_NS:
            return tuple(sorted(one.name for one in os.scandir(folder)))
        return _names_as_of(folder, changed_ns)
    except OSError:
        return ()


@lru_cache(maxsize=64)
def _names_as_of(folder: Path, _: int) -> tuple[str, ...]:
    return tuple(sorted(one.name for one in os.scandir(folder)))


def _is_folder(path: Path, root: Path, silent: Collection[str]) -> bool:
    """True for a folder; a path that did not answer is taken for a file."""
    if not path.is_symlink():
        return path.is_dir()
    name = legible(path.relative_to(root).as_posix())
    # A link may lead to a mount that hangs.
    with asking(name):
        return name not in silent and path.is_dir()


def require_answer(name: str, path: Path) -> None:
    """Open a log that is about to be read: if that hangs, the log is named."""
    with asking(name), suppress(OSError):  # which its reader tells
        if path.is_file():
            with path.open("rb", buffering=0) as log:
                log.read(1)


def without_match(root: Path, patterns: Iterable[str]) -> tuple[str, ...]:
    """Messages about globs that match no file."""
    return tuple(
        f"no file matches {pattern} below {root}"
        for pattern in patterns
        if GLOB_CHARACTERS & set(pattern)
        and not (root / pattern).exists()
        and not any(not path.is_dir() for path in _matching(root, pattern))
    )


def legible(text: str) -> str:
    """Text for tables, terminals and pages: characters that do not print become escapes."""
    return one_line(text, LONGEST_PATH)


def states_of(root: Path, patterns: Iterable[str]) -> dict[str, FileState] | None:
    """State of each log, by relative path; None where one is absent or no readable file."""
    found = {}
    try:
        paths, absent = find(root, patterns)
        for name, path in told_alive(paths.items()):
            state = path.stat()
            if not stat.S_ISREG(state.st_mode):
                return None
            found[name] = (state.st_size, state.st_mtime_ns, state.st_ino, state.st_ctime_ns)
    except OSError:
        return None
    return None if absent else found
