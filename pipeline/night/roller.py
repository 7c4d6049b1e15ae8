"""The scale of the cam rollers' curve: estimated, or as the motor type states it."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from itertools import pairwise

# Part of a baseline's first nights that are to tell the scale: later nights are like most of them.
MOST = 0.8


def is_roller_free(
    tells: Mapping[dt.date, bool | None], begins: Sequence[dt.date], needed: int
) -> bool:
    """Decide by the first nights of the latest stretch that has enough: it is frozen with them.

    `tells` says by night whether it tells the scale, None without a fit; `begins` are the dates of
    the events that begin a baseline, and so many nights with a fit as are `needed` decide.
    """
    borders = sorted({dt.date.min, *begins, dt.date.max})
    for begin, end in reversed(list(pairwise(borders))):
        nights = sorted(label for label in tells if begin <= label < end)
        first = [tells[label] for label in nights if tells[label] is not None][:needed]
        if len(first) == needed:
            return sum(map(bool, first)) >= MOST * needed
    return False
