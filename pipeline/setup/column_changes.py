"""Columns of a motor's logs that go, come, or change their unit from one log to the next."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from pipeline.config import MotorSpec
from pipeline.errors import LogError
from pipeline.logs.files import labels_of
from pipeline.logs.ledger import FileRecord
from pipeline.setup.check_units import columns_of

_SHOWN = 5
_MOST = 8


def column_changes(
    spec: MotorSpec, records: Mapping[str, FileRecord], path_of: Callable[[str], Path]
) -> tuple[str, ...]:
    """Faults of channels whose column is not in all logs, or changes its unit, with the date.

    The first and the last log are compared; where they differ, each change between them is looked
    for by halves, so that a few of many headers are read.
    """
    dated = sorted((min(labels_of(one)), name) for name, one in records.items() if one.nights)
    if len(dated) < 2:
        return ()
    sources = [one.source for one in spec.file.channels.values() if one.constant is None]

    def columns(at: int) -> dict[str, str]:
        try:
            return columns_of(path_of(dated[at][1]), spec.file.logs) or {}
        except LogError:  # which is a fault of that log already
            return {}

    def wanted(at: int) -> dict[str, str]:
        return {name: unit for name, unit in columns(at).items() if name in sources}

    last = len(dated) - 1
    if not columns(0) or not columns(last):
        return ()
    found: list[str] = []
    begin = 0
    while wanted(begin) != wanted(last) and len(found) < _MOST:
        low, high = begin, last
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if wanted(middle) == wanted(begin) else (low, middle)
        label, name = dated[high]
        log = f"the log of {label.day} {label:%B %Y} ({name})"
        found += _differences(columns(low), columns(high), sources, log)
        begin = high
    return tuple(found[:_MOST])


def _differences(
    before: Mapping[str, str], now: Mapping[str, str], sources: list[str], log: str
) -> Iterator[str]:
    new = [repr(one) for one in now if one not in before]
    for source in dict.fromkeys(sources):
        if source in before and source not in now:
            also = f", but {', '.join(new[:_SHOWN])}, new since then" if new else ""
            yield f"column_gone: {log} has no column {source!r}{also}"
        elif source in now and source not in before:
            old = [repr(one) for one in before if one not in now]
            also = f", without {', '.join(old[:_SHOWN])} of the logs before" if old else ""
            yield f"column_gone: {log} is the first with column {source!r}{also}"
        elif before.get(source) != now.get(source):
            units = f"{now[source] or 'no unit'!r}; the log before has {before[source]!r}"
            yield f"unit_changed: {log} gives {source!r} in {units}"
