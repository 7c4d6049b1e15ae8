"""Groups of columns or tags that are one motor's, told by what repeats in their names."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from pipeline.setup.guess_channels import BRACKETED, channel_of
from pipeline.setup.guess_layout import FEWEST_CHANNELS

_MARK = re.compile(r"[._/:|\\\s-]+")


@dataclass(frozen=True, slots=True)
class Group:
    """Names that begin or end alike; `name` is that part, and `signals` the rest of each."""

    name: str
    signals: dict[str, str]  # by whole name


def groups_of(names: Sequence[str], units: dict[str, str]) -> tuple[tuple[Group, ...], list[str]]:
    """Names by motor, and those that are no motor's.

    A group is the longest common part behind which the most channels stand, each once. Names that
    share nothing are one motor's, called nothing.

    Examples
    --------
    >>> names = [f"W{n}_{tag}" for n in (1, 2) for tag in ("dp", "T_oil", "speed", "leak")]
    >>> [group.name for group in groups_of(names, {})[0]]
    ['W1', 'W2']
    """
    left = list(names)
    found: list[Group] = []
    while True:
        best = max(_candidates(left), key=lambda one: _merit(one, units), default=None)
        if best is None or _merit(best, units)[0] < FEWEST_CHANNELS:
            return tuple(found), left
        found.append(best)
        left = [name for name in left if name not in best.signals]


def _candidates(names: Sequence[str]) -> Iterator[Group]:
    yield Group("", {name: name for name in names})
    parts: dict[tuple[str, bool], dict[str, str]] = {}
    for name in names:
        for begin, end in _marks(name):
            parts.setdefault((name[:begin], True), {})[name] = name[end:]
            # What stands behind is the motor's as far as no unit follows.
            tail = BRACKETED.sub("", name[end:]).strip()
            unit = name[end:].removeprefix(tail)
            parts.setdefault((tail, False), {})[name] = name[:begin] + unit
    for (name, _), signals in parts.items():
        if name and len(signals) >= FEWEST_CHANNELS:
            yield Group(name, signals)


def _marks(name: str) -> list[tuple[int, int]]:
    """Begin and end of the marks between words, those in brackets left out."""
    hidden = BRACKETED.sub(lambda one: "x" * len(one[0]), name)
    return [
        one.span() for one in _MARK.finditer(hidden) if one.start() > 0 and one.end() < len(name)
    ]


def _merit(group: Group, units: dict[str, str]) -> tuple[int, int]:
    """Channels told once less those told again, then the length of what is common."""
    told = (channel_of(signal, units.get(name, "")) for name, signal in group.signals.items())
    counts = Counter(channel for channel in told if channel)
    return 2 * len(counts) - counts.total(), len(group.name)
