"""Columns and units that look wrong: by the log's header, by magnitude, or since a log on.

Of changes the first and the last log are compared; where they differ, the change is looked for by
halves, so that a few of many logs are opened. Of a header nothing but {} is known where its log
cannot be read, which is a fault of that log already.
"""

from __future__ import annotations

import datetime as dt
from bisect import bisect_left
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path

import numpy as np

from leakage import LeakageError, OperatingConditions, total_flow_l_per_min
from pipeline.config import MotorSpec
from pipeline.config.channels import COUNTED, PORT_PRESSURES
from pipeline.config.motors import MotorFile
from pipeline.errors import LogError
from pipeline.ingest import RawChannel
from pipeline.night.column_change import COLUMNS, Change, column_change
from pipeline.night.sample_rows import conditions
from pipeline.night.time_base import Samples
from pipeline.setup.names import LOW_SIDE, QUANTITY_OF, USUAL, likely_units, meaning_of
from pipeline.setup.samples import cut_flow, ended_flow, temperature_jumps
from pipeline.setup.signals import quality_words, signals_of
from pipeline.setup.sniff import header_of, sniff
from pipeline.units import QUANTITIES, canonical_unit, from_canonical

# A drain flow this many times off the configured model's is of another unit sooner than worn.
UNUSUAL_FLOW = 8.0
_SHOWN = 5  # columns that a fault names
Dated = Sequence[tuple[dt.date, str]]
"""The last night and the name of each log that can be read, in order of time."""
PathOf = Callable[[str], Path]
Header = Mapping[str, str]
"""Columns of a log, each with what is written beside it as a unit."""


def first_findings(
    spec: MotorSpec,
    label: dt.date,
    dated: Dated,
    path_of: PathOf,
    channels: Mapping[str, RawChannel],
) -> Iterator[str]:
    """Yield what `check` would say of columns and units of the night that a first run begins with.

    `channels` are raw ones of that night.
    """
    header = headers_of(spec, path_of)
    yield from column_changes(spec, dated, header)
    yield from differing_units(spec.file, header(dated[-1][1]))
    yield from suspect_units(spec, label, channels)
    yield from temperature_jumps(channels["oil_temperature"])
    yield from cut_flow(spec, channels)
    yield from ended_flow(spec, channels)


def headers_of(spec: MotorSpec, path_of: PathOf) -> Callable[[str], Header]:
    """Return a function that reads the header of a log by its name, once."""

    @cache
    def header(name: str) -> Header:
        try:
            return header_of(path_of(name), spec.file.logs)
        except LogError:
            return {}

    return header


def suspect_units(
    spec: MotorSpec, label: dt.date, channels: Mapping[str, RawChannel]
) -> Iterator[str]:
    """Yield what is unusual of a channel's magnitude under its unit, and units that would mend it.

    Pressure, temperature and speed are judged by what motors show; once these are usual, the flow
    by what the configured model has at their typical values.
    """
    typical = {
        str(name): value
        for name, channel in spec.file.channels.items()
        if not channel.is_counted
        and channel.constant is None
        and (value := _typical(name, channels[name])) is not None
    }
    judged = {
        name: USUAL[QUANTITIES[name]]
        for name in typical
        if QUANTITIES[name] in USUAL and name not in (*LOW_SIDE, COUNTED)
    }
    unusual = {name: own for name, own in judged.items() if not own[0] <= typical[name] <= own[1]}
    where = ""
    if not unusual and (expected := _model_flow(spec, label, typical)):
        usual = (expected / UNUSUAL_FLOW, expected * UNUSUAL_FLOW)
        if not usual[0] <= typical[COUNTED] <= usual[1]:
            unusual, where = {COUNTED: usual}, f" where the model has {expected:.2g}"
    for name, usual in unusual.items():
        configured = next(
            channel.unit for other, channel in spec.file.channels.items() if other == name
        )
        in_log = float(from_canonical(name, typical[name], configured))
        units = " or ".join(likely_units(name, [in_log], usual)[:2])
        mended = f"; it would be usual if the log's unit were {units}" if units else ""
        mended += ", or its numbers had a scale" if units else ""
        shown = f"{typical[name]:.3g} {canonical_unit(name).replace('degC', '°C')}"
        yield f"unit_unusual: {name}: typically {shown}, which is unusual{where}{mended}"


def differing_units(file: MotorFile, header: Header) -> Iterator[str]:
    """Yield channels that a table's header or line of units gives another unit than the config."""
    for name, channel in file.channels.items():
        unit = meaning_of(channel.source, header.get(channel.source, "")).unit
        is_judged = not channel.is_counted and channel.constant is None and channel.scale == 1.0
        if unit is None or unit in channel.units or not is_judged:
            continue
        code, more = "unit_differs", ""
        if QUANTITY_OF[unit] != QUANTITIES[name]:
            code, more = "unit_dimension", f", which is no {QUANTITIES[name]}: another column?"
        yield (
            f"{code}: {name}: configured in {channel.unit}, and the log says {unit} of "
            f"{channel.source}{more}"
        )


def _typical(name: str, raw: RawChannel) -> float | None:
    """Return the upper quartile of all numbers, those out of range too: they tell the unit.

    The sign of a pressure, a speed or a flow is its direction, and left out.
    """
    numbers = raw.value[np.isfinite(raw.value)]
    if name != "oil_temperature":
        numbers = np.abs(numbers)
    return float(np.percentile(numbers, 75)) if len(numbers) else None


def _model_flow(spec: MotorSpec, label: dt.date, typical: Mapping[str, float]) -> float | None:
    """Return the flow of the configured model at typical values; None where these are not known."""
    pressure = "pressure_difference" if "pressure_difference" in typical else "high_port_pressure"
    if not {COUNTED, pressure, "oil_temperature", "speed"} <= typical.keys():
        return None
    try:
        conditions = OperatingConditions.from_bar(
            typical[pressure], typical["oil_temperature"], typical["speed"]
        )
        motor = spec.motor(label, spec.file.flushing.mode)
        return float(total_flow_l_per_min(motor, conditions)[0])
    except LeakageError:
        return None


def unused_qualities(path: Path, header: Header, file: MotorFile) -> Iterator[str]:
    """Yield the channels of which the log has a quality that the config does not name."""
    # To take a log apart costs more than all else of a check.
    if header and not any(map(quality_words, header)):
        return
    try:
        columns = signals_of(sniff(path)).columns
    except LogError:
        return
    qualities = {column.keys["source"]: column.quality for column in columns}
    for name, channel in file.channels.items():
        quality = qualities.get(channel.source)
        if quality is not None and not channel.quality_source:
            yield (
                f"{name}: the log has its quality, {quality.source}, which is not used: then "
                "quality_source and quality_good"
            )


# Changes from a log on


def column_changes(spec: MotorSpec, dated: Dated, header: Callable[[str], Header]) -> Iterator[str]:
    """Yield channels whose column is not in all logs, or changes its unit."""
    last = len(dated) - 1

    def columns(at: int) -> Header:
        return header(dated[at][1])

    if last < 1 or not (columns(0) and columns(last)):
        return
    for source, dated_units in {of.source: of.units for of in spec.file.channels.values()}.items():
        was, now = (columns(at).get(source) for at in (0, last))
        units = {meaning_of(source, unit or "").unit for unit in (was, now)}
        if was == now or units.issubset(dated_units):
            continue
        after = bisect_left(range(last), True, 1, key=lambda at: columns(at).get(source) != was)
        label, name = dated[after]
        log = f"the log of {label.day} {label:%B %Y} ({name})"
        new, old = (_alone(columns(at), columns(2 * after - 1 - at)) for at in (after, after - 1))
        if was is None or now is None:
            how = "has no column" if now is None else "is the first with column"
            yield f"column_gone: {log} {how} {source!r}; new in it: {new}; no longer in it: {old}"
        else:
            how = f"{now or 'no unit'!r}; the log before has {was!r}: earlier_units date a unit"
            yield f"unit_changed: {log} gives {source!r} in {how}"


def _alone(these: Iterable[str], others: Collection[str]) -> str:
    """Return the first columns of a log that the other does not have."""
    return ", ".join([repr(column) for column in these if column not in others][:_SHOWN]) or "none"


def changed_readings(
    spec: MotorSpec,
    labels: Sequence[dt.date],
    samples_of: Callable[[dt.date], Samples | None],
    newest: Samples,
) -> tuple[dt.date, str] | None:
    """Return the night from which on readings look like those of other columns or units, and why.

    The first night is that since the last event; None where the newest is as the first.
    """
    since, _ = spec.file.alike(dt.date.max)
    labels = [label for label in labels if label >= since]

    def means(label: dt.date) -> dict[str, float]:
        samples = samples_of(label)
        return {} if samples is None else _means(samples)

    def change_to(now: dict[str, float]) -> Change | None:
        return column_change(spec, usual, now) if usual and now else None

    usual = means(labels[0]) if len(labels) > 1 else {}
    if (change := change_to(_means(newest))) is None:
        return None
    last = len(labels) - 1
    first = bisect_left(
        labels, True, 1, last, key=lambda label: change_to(means(label)) is not None
    )
    return labels[first], change.words


def _means(samples: Samples) -> dict[str, float]:
    """Return means of the kept samples, as those of a run; and of each gauge of two."""
    row = conditions(samples)
    means = {name: row[column] for name, column in COLUMNS.items()}
    if (low := samples.low_pressures_bar.get("low_port_pressure")) is not None:
        high = samples.pressure_difference_bar + low
        means |= dict(zip(PORT_PRESSURES, (float(high.mean()), float(low.mean())), strict=True))
    return means
