"""Files of a folder that are of one channel each, and the patterns of their names."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase
from glob import escape
from itertools import takewhile
from pathlib import Path

from pipeline.setup.guess_channels import channel_of
from pipeline.units import CHANNELS

# A date, with a time or without, or a long number: what differs from file to file of one channel.
VARYING = re.compile(
    r"(?<!\d)(?:20\d\d[-_.]?\d\d[-_.]?\d\d(?:[-_T. ]?\d\d[-_.]?\d\d(?:[-_.]?\d\d)?)?|\d{6,})(?!\d)"
)

_STAR = "\0"


def suffix_of(path: Path) -> str:
    """Ending of a log's name, that of a packed one with what it packs.

    Examples
    --------
    >>> suffix_of(Path("a.2025.csv.gz")), suffix_of(Path("a.1.csv"))
    ('.csv.gz', '.csv')
    """
    packed = path.suffix.lower() in (".gz", ".zst")
    return "".join(path.suffixes[-2:]) if packed else path.suffix


def files_by_channel(path: Path) -> dict[str, tuple[str, Path]]:
    """Pattern of the names of each channel's files, and one of them; empty if this log is of none.

    The neighbours of a log with the same ending are those of the other channels; a pattern fits no
    file of another channel.
    """
    suffix = suffix_of(path)
    folder = path.resolve().parent
    names = sorted(one.name for one in folder.iterdir() if one.is_file())
    of_channel: dict[str, list[str]] = {}
    for name in (name for name in names if name.endswith(suffix)):
        channel = channel_of(VARYING.sub(" ", name.removesuffix(suffix)))
        if channel is not None:
            of_channel.setdefault(channel, []).append(name)
    if not any(path.name in own for own in of_channel.values()):
        return {}
    found = {}
    for channel in CHANNELS:
        own = of_channel.get(channel, [])
        if own:
            others = [name for name in names if name not in own]
            found[channel] = (_pattern(own, others), folder / own[0])
    return found


def _pattern(own: list[str], others: Iterable[str]) -> str:
    """Pattern that fits all of a channel's names and no other; else the first name."""
    templates = sorted({VARYING.sub(_STAR, name) for name in own})
    template = templates[0]
    if len(templates) > 1:
        head = _begin(templates)
        tail = _begin([name[len(head) :][::-1] for name in templates])[::-1]
        template = head + _STAR + tail
    pattern = "*".join(map(escape, re.split(f"{_STAR}+", template)))
    return escape(own[0]) if any(fnmatchcase(name, pattern) for name in others) else pattern


def _begin(texts: Sequence[str]) -> str:
    """The letters that all texts begin with."""
    same = takewhile(lambda letters: len(set(letters)) == 1, zip(*texts, strict=False))
    return "".join(letters[0] for letters in same)
