"""Columns of a motor's logs that go, come, or change their unit from one log to the next."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from pipeline.config import MotorSpec
from pipeline.errors import LogError
from pipeline.logs.files import labels_of
from pipeline.logs.ledger import FileRecord
from pipeline.setup.unit_look import columns_of

_SHOWN = 5


def column_changes(
    spec: MotorSpec, records: Mapping[str, FileRecord], path_of: Callable[[str], Path]
) -> tuple[str, ...]:
    """Faults of channels whose column is not in all logs, or changes its unit, with the date.

    The first and the last log are compared; where they differ, the first that does is looked for
    by halves, so that a few of many headers are read.
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

    low, high = 0, len(dated) - 1
    if not columns(low) or not columns(high) or wanted(low) == wanted(high):
        return ()
    before = wanted(low)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if wanted(middle) == before else (low, middle)
    label, name = dated[high]
    day = f"{label.day} {label:%B %Y}"
    return tuple(_differences(columns(low), columns(high), sources, f"the log of {day} ({name})"))


def _differences(
    before: Mapping[str, str], now: Mapping[str, str], sources: list[str], log: str
) -> Iterator[str]:
    new = [repr(one) for one in now if one not in before]
    for source in dict.fromkeys(sources):
        if source in before and source not in now:
            also = f", but {', '.join(new[:_SHOWN])}, new since then" if new else ""
            yield f"column_gone: {log} has no column {source!r}{also}"
        elif source in now and source not in before:
            yield f"column_gone: no log before {log} has column {source!r}"
        elif before.get(source) != now.get(source):
            units = f"{now[source] or 'no unit'!r}; the log before has {before[source]!r}"
            yield f"unit_changed: {log} gives {source!r} in {units}"
