"""Nights: local days that end at a stated hour, 23 or 25 hours long at a clock change."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Times
from pipeline.config.settings import Nights

DAY = dt.timedelta(days=1)


@dataclass(frozen=True, slots=True)
class Night:
    """A night: its label (the local date on which it ends) and its borders."""

    date: dt.date
    start_us: int  # UTC
    end_us: int  # not in it


def night(date: dt.date, nights: Nights) -> Night:
    """Return the night that ends on a local date."""
    return Night(date, _end_us(date - DAY, nights), _end_us(date, nights))


def _end_us(date: dt.date, nights: Nights) -> int:
    local = dt.datetime.combine(date, dt.time(nights.end_hour), nights.zone)
    return int(local.timestamp()) * 1_000_000


def night_of(time_us: int, nights: Nights) -> dt.date:
    """Return label of the night in which a moment lies [µs since 1970]."""
    local = dt.datetime.fromtimestamp(time_us // 1_000_000, nights.zone)
    label = local.date()
    return label if time_us < _end_us(label, nights) else label + DAY


def nights_between(first: dt.date, last: dt.date) -> list[dt.date]:
    """Return all labels from the first to the last, both included."""
    return [first + index * DAY for index in range((last - first).days + 1)]


def nights_of(time_us: Times, nights: Nights) -> set[dt.date]:
    """Return labels of all nights in which any of some moments lies."""
    if not len(time_us):
        return set()
    labels = nights_between(
        night_of(int(time_us.min()), nights), night_of(int(time_us.max()), nights)
    )
    if len(labels) == 1:
        return set(labels)
    ends = np.array([_end_us(label, nights) for label in labels])
    hit = np.bincount(np.searchsorted(ends, time_us, side="right"))
    return {labels[index] for index in np.flatnonzero(hit).tolist()}
