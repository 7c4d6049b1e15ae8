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

from pipeline.config import MotorSpec
from pipeline.config.channels import PORT_PRESSURES
from pipeline.errors import LogError
from pipeline.ingest import read_log
from pipeline.logs.files import labels_of
from pipeline.logs.processed import FileRecord
from pipeline.night.column_change import COLUMNS, column_change
from pipeline.night.sample_rows import conditions
from pipeline.night.time_base import Samples
from pipeline.setup.check_units import columns_of
from pipeline.setup.promise import night_of_log

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
    newest: Samples,
) -> str | None:
    """The log from which on readings look like those of other columns or units; None: none.

    The first log is that since the last event.
    """
    since = max((one.date for one in spec.file.baseline_events), default=dt.date.min)
    known = ((max(labels_of(one)), name) for name, one in records.items() if one.nights)
    dated = sorted(one for one in known if one[0] >= since)

    def means(at: int) -> dict[str, float]:
        label, name = dated[at]
        try:
            log = read_log(path_of(name), spec.file.logs, spec.file.channels)
        except LogError:  # which is a fault of that log already
            return {}
        samples = night_of_log(spec, label, log)
        return {} if samples is None else _means(samples)

    def why(now: dict[str, float]) -> str | None:
        return column_change(spec, usual, now) if usual and now else None

    usual = means(0) if len(dated) > 1 else {}
    if (told := why(_means(newest))) is None:
        return None
    between = range(1, len(dated) - 1)
    first = 1 + bisect_left(between, True, key=lambda at: why(means(at)) is not None)
    return f"columns_changed: from {dated[first][1]} on: {told}"


def _means(samples: Samples) -> dict[str, float]:
    """Means of the kept samples, as those of a run; and of each gauge of two."""
    row = conditions(samples)
    found = {name: row[column] for name, column in COLUMNS.items()}
    if (low := samples.low_pressures_bar.get("low_port_pressure")) is not None:
        high = samples.pressure_difference_bar + low
        found |= dict(zip(PORT_PRESSURES, (float(high.mean()), float(low.mean())), strict=True))
    return found
