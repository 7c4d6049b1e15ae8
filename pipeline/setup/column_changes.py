"""Columns, units and readings that from one log on are others: told with the log's date.

The first and the last log are compared; where they differ, the change is looked for by halves, so
that a few of many logs are opened.
"""

from __future__ import annotations

import datetime as dt
from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from itertools import islice
from pathlib import Path

import numpy as np

from pipeline.config import MotorSpec
from pipeline.errors import LogError
from pipeline.ingest import RawChannel, read_log
from pipeline.logs.files import labels_of
from pipeline.logs.ledger import FileRecord
from pipeline.night.column_change import COLUMNS, column_change
from pipeline.setup.check_units import columns_of
from pipeline.setup.promise import operation

# Columns that a fault names, and faults of columns that are told.
_SHOWN, _MOST = 5, 8
Records = Mapping[str, FileRecord]


def column_changes(
    spec: MotorSpec, records: Records, path_of: Callable[[str], Path]
) -> tuple[str, ...]:
    """Faults of channels whose column is not in all logs, or changes its unit."""
    dated = sorted((min(labels_of(one)), name) for name, one in records.items() if one.nights)
    sources = [one.source for one in spec.file.channels.values() if one.constant is None]
    last = len(dated) - 1

    @cache
    def columns(at: int) -> Mapping[str, str]:
        try:
            return columns_of(path_of(dated[at][1]), spec.file.logs) or {}
        except LogError:  # which is a fault of that log already
            return {}

    def wanted(at: int) -> dict[str, str]:
        return {name: unit for name, unit in columns(at).items() if name in sources}

    def found() -> Iterator[str]:
        begin = 0
        while wanted(begin) != wanted(last):
            known = wanted(begin)
            behind = range(begin + 1, last)
            after = begin + 1 + bisect_left(behind, True, key=lambda at: wanted(at) != known)
            label, name = dated[after]
            log = f"the log of {label.day} {label:%B %Y} ({name})"
            yield from _differences(columns(after - 1), columns(after), sources, log)
            begin = after

    is_known = last > 0 and columns(0) and columns(last)
    return tuple(islice(found(), _MOST)) if is_known else ()


def _differences(
    before: Mapping[str, str], now: Mapping[str, str], sources: list[str], log: str
) -> Iterator[str]:
    new, old = (
        ", ".join([repr(one) for one in these if one not in others][:_SHOWN])
        for these, others in ((now, before), (before, now))
    )
    for source in dict.fromkeys(sources):
        if source in before and source not in now:
            also = f", but {new}, new since then" if new else ""
            yield f"column_gone: {log} has no column {source!r}{also}"
        elif source in now and source not in before:
            also = f", without {old} of the logs before" if old else ""
            yield f"column_gone: {log} is the first with column {source!r}{also}"
        elif before.get(source) != now.get(source):
            units = f"{now[source] or 'no unit'!r}; the log before has {before[source]!r}"
            yield f"unit_changed: {log} gives {source!r} in {units}"


def changed_readings(
    spec: MotorSpec,
    records: Records,
    path_of: Callable[[str], Path],
    newest: Mapping[str, RawChannel],
) -> str | None:
    """The log from which on readings look like those of other columns or units; None: none.

    The first log is that since the last event.
    """
    since = max((one.date for one in spec.file.baseline_events), default=dt.date.min)
    dated = sorted((max(labels_of(one)), name) for name, one in records.items() if one.nights)
    names = [name for night, name in dated if night >= since]

    def medians(at: int) -> dict[str, float]:
        try:
            log = read_log(path_of(names[at]), spec.file.logs, spec.file.channels)
        except LogError:  # which is a fault of that log already
            return {}
        return _medians(spec, log.channels)

    def why(now: dict[str, float]) -> str | None:
        return column_change(spec, usual, now) if usual and now else None

    usual = medians(0) if len(names) > 1 else {}
    if (told := why(_medians(spec, newest))) is None:
        return None
    between = range(1, len(names) - 1)
    first = 1 + bisect_left(between, True, key=lambda at: why(medians(at)) is not None)
    return f"columns_changed: from {names[first]} on: {told}"


def _medians(spec: MotorSpec, channels: Mapping[str, RawChannel]) -> dict[str, float]:
    """Medians of a log while the motor turned; empty where one is not known."""
    readings = operation(spec, channels)
    found = {name: float(np.median(one)) for name, one in readings.items() if one.size}
    return found if found.keys() >= COLUMNS.keys() else {}
