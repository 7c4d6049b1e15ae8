"""Columns and units that look wrong: by the log's header, by magnitude, or since one log on.

Of changes the first and the last log are compared; where they differ, the change is looked for by
halves, so that a few of many logs are opened.
"""

from __future__ import annotations

import datetime as dt
import math
from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from itertools import islice
from pathlib import Path

import numpy as np

from leakage import LeakageError, OperatingConditions, total_flow_l_per_min
from pipeline.config import MotorSpec
from pipeline.config.channels import COUNTED, PORT_PRESSURES
from pipeline.config.motors import MotorFile
from pipeline.errors import LogError
from pipeline.ingest import RawChannel, read_log
from pipeline.logs.files import labels_of
from pipeline.logs.processed import FileRecord
from pipeline.night.column_change import COLUMNS, column_change
from pipeline.night.sample_rows import conditions
from pipeline.night.time_base import Samples
from pipeline.setup.names import LOW_SIDE, QUANTITY_OF, USUAL, likely_units, meaning_of
from pipeline.setup.operation import night_of_log
from pipeline.setup.sniff import header_of
from pipeline.units import QUANTITIES, canonical_unit, from_canonical

# A drain flow this many times off the configured model's is of another unit sooner than worn.
UNUSUAL_FLOW = 8.0
# Columns that a fault names, and faults of columns that are told.
_SHOWN, _MOST = 5, 8
Records = Mapping[str, FileRecord]


def suspect_units(
    spec: MotorSpec, night: dt.date, channels: Mapping[str, RawChannel]
) -> dict[str, str]:
    """What is unusual of a channel's magnitude under its unit, and which units would mend it.

    Pressure, temperature and speed are judged by what motors show; once these are usual, the flow
    by what the configured model has at their typical values.
    """
    typical = {
        str(name): value
        for name, channel in spec.file.channels.items()
        if channel.counts is None
        and channel.constant is None
        and (value := _typical(channels[name])) is not None
    }
    found: dict[str, str] = {}
    for name, value in typical.items():
        usual = USUAL.get(QUANTITIES[name], (0.0, math.inf))
        if name not in (*LOW_SIDE, COUNTED) and not usual[0] <= value <= usual[1]:
            found[name] = _unusual(spec, name, value, usual, "")
    if not found and (expected := _model_flow(spec, night, typical)):
        usual, flow = (expected / UNUSUAL_FLOW, expected * UNUSUAL_FLOW), typical[COUNTED]
        if not usual[0] <= flow <= usual[1]:
            where = f" where the model has {expected:.2g}"
            found[COUNTED] = _unusual(spec, COUNTED, flow, usual, where)
    return found


def units_told(path: Path, file: MotorFile) -> dict[str, str]:
    """Channels that a table's header or line of units gives another unit than the config."""
    beside = header_of(path, file.logs)
    found = {}
    for name, channel in file.channels.items():
        said = meaning_of(channel.source, beside.get(channel.source, "")).unit
        is_judged = channel.counts is None and channel.constant is None and channel.scale == 1.0
        if said is None or said == channel.unit or not is_judged:
            continue
        code, more = "unit_differs", ""
        if QUANTITY_OF[said] != QUANTITIES[name]:
            code, more = "unit_dimension", f", which is no {QUANTITIES[name]}: another column?"
        found[str(name)] = (
            f"{code}: {name}: configured in {channel.unit}, and the log says {said} of "
            f"{channel.source}{more}"
        )
    return found


def _typical(raw: RawChannel) -> float | None:
    """Upper quartile of all numbers' magnitudes, those out of range too: they tell the unit."""
    numbers = np.abs(raw.value[np.isfinite(raw.value)])
    return float(np.percentile(numbers, 75)) if len(numbers) else None


def _unusual(
    spec: MotorSpec, name: str, value: float, usual: tuple[float, float], where: str
) -> str:
    configured = {str(other): one.unit for other, one in spec.file.channels.items()}
    in_log = float(from_canonical(name, value, configured[name]))
    units = " or ".join(likely_units(name, [in_log], usual)[:2])
    mended = f"; it would be usual if the log's unit were {units}" if units else ""
    unit = canonical_unit(name).replace("degC", "°C")
    return f"unit_unusual: {name}: typically {value:.3g} {unit}, which is unusual{where}{mended}"


def _model_flow(spec: MotorSpec, night: dt.date, typical: Mapping[str, float]) -> float | None:
    """Flow of the configured model at typical values; None where these are not known."""
    pressure = "pressure_difference" if "pressure_difference" in typical else "high_port_pressure"
    if not {COUNTED, pressure, "oil_temperature", "speed"} <= typical.keys():
        return None
    try:
        conditions = OperatingConditions.from_bar(
            typical[pressure], typical["oil_temperature"], typical["speed"]
        )
        motor = spec.motor(night, spec.file.flushing.mode)
        return float(total_flow_l_per_min(motor, conditions)[0])
    except LeakageError:
        return None


# Changes from one log on


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
            return header_of(path_of(dated[at][1]), spec.file.logs)
        except LogError:  # which is a fault of that log already
            return {}

    def wanted(at: int) -> dict[str, str]:
        return {name: unit for name, unit in columns(at).items() if name in sources}

    def found() -> Iterator[str]:
        begin = 0
        while wanted(begin) != wanted(last):
            known = wanted(begin)
            after = bisect_left(range(last), True, begin + 1, key=lambda at: wanted(at) != known)
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
    last = len(dated) - 1
    first = bisect_left(range(last), True, 1, key=lambda at: why(means(at)) is not None)
    return f"columns_changed: from {dated[first][1]} on: {told}"


def _means(samples: Samples) -> dict[str, float]:
    """Means of the kept samples, as those of a run; and of each gauge of two."""
    row = conditions(samples)
    found = {name: row[column] for name, column in COLUMNS.items()}
    if (low := samples.low_pressures_bar.get("low_port_pressure")) is not None:
        high = samples.pressure_difference_bar + low
        found |= dict(zip(PORT_PRESSURES, (float(high.mean()), float(low.mean())), strict=True))
    return found
