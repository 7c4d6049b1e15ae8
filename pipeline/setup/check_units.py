"""Units that are not the log's own, or look wrong by magnitude, and which would be right."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator, Mapping
from itertools import product
from pathlib import Path

import numpy as np

from leakage import LeakageError, OperatingConditions, total_flow_l_per_min
from pipeline.config import Channel, MotorSpec
from pipeline.config.channels import COUNTED
from pipeline.config.logs import Logs
from pipeline.config.motors import MotorFile
from pipeline.ingest import RawChannel
from pipeline.setup.names import LOW_SIDE, QUANTITY_OF, USUAL, meaning_of
from pipeline.setup.sniff import header_of
from pipeline.units import QUANTITIES, UNITS, canonical_unit, from_canonical, to_canonical

# A drain flow this many times off the configured model's is of another unit sooner than worn.
UNUSUAL_FLOW = 8.0


def suspect_units(
    spec: MotorSpec, night: dt.date, channels: Mapping[str, RawChannel]
) -> dict[str, str]:
    """Channels whose magnitude is unusual under their configured unit.

    Pressure, temperature and speed are judged by what motors show; the flow by what the configured
    model has at their typical values, in whatever units make these usual: a wrong unit of theirs is
    theirs alone to be told. Returned is what is unusual, and which units would mend it, by channel.
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
        low, high = USUAL.get(QUANTITIES[name], (0.0, float("inf")))
        if name not in (*LOW_SIDE, COUNTED) and not low <= value <= high:
            units = [unit for unit, _ in _usual_values(spec, name, value)]
            found[name] = f"{_unusual(name, value)}{_mended(units)}"
    flow = _unusual_flow(spec, night, typical, set(found))
    found |= {COUNTED: flow} if flow else {}
    return {name: f"unit_unusual: {name}: {words}" for name, words in found.items()}


def units_told(path: Path, file: MotorFile) -> dict[str, str]:
    """Channels that a table's header or line of units gives another unit than the config."""
    beside = columns_of(path, file.logs) or {}
    found = {}
    for name, channel in file.channels.items():
        said = meaning_of(channel.source, beside.get(channel.source, "")).unit
        if said is None or said == channel.unit or not _is_judged(channel):
            continue
        code, more = "unit_differs", ""
        if QUANTITY_OF[said] != QUANTITIES[name]:
            code, more = "unit_dimension", f", which is no {QUANTITIES[name]}: another column?"
        found[str(name)] = (
            f"{code}: {name}: configured in {channel.unit}, and the log says {said} of "
            f"{channel.source}{more}"
        )
    return found


def _is_judged(channel: Channel) -> bool:
    return channel.counts is None and channel.constant is None and channel.scale == 1.0


def columns_of(path: Path, logs: Logs) -> dict[str, str] | None:
    """Columns of a table, each with what stands in its header as a unit; None: it is no table."""
    is_table = logs.layout == "wide" and logs.format in ("csv", "parquet")
    return header_of(path) if is_table else None


def _typical(raw: RawChannel) -> float | None:
    """Upper quartile of all numbers' magnitudes, those out of range too: they tell the unit."""
    numbers = np.abs(raw.value[np.isfinite(raw.value)])
    return float(np.percentile(numbers, 75)) if len(numbers) else None


def _unusual(name: str, value: float) -> str:
    unit = canonical_unit(name).replace("degC", "°C")
    return f"typically {value:.3g} {unit}, which is unusual"


def _mended(units: list[str], others: list[str] | None = None) -> str:
    """The units that would make a magnitude usual, in words."""
    choices = [f"the log's unit were {' or '.join(units[:2])}"] if units else []
    choices += [f"that of {other}" for other in others or []]
    return f"; it would be usual if {', or '.join(choices)}" if choices else ""


def _in_unit(spec: MotorSpec, name: str, value: float, unit: str) -> float:
    """A reading, had the log another unit."""
    configured = next(one.unit for other, one in spec.file.channels.items() if other == name)
    return abs(float(to_canonical(name, from_canonical(name, value, configured), unit)))


def _usual_values(spec: MotorSpec, name: str, value: float) -> Iterator[tuple[str, float]]:
    """Units under which a reading is usual, and what it is then."""
    low, high = USUAL[QUANTITIES[name]]
    for unit in UNITS[QUANTITIES[name]]:
        reading = _in_unit(spec, name, value, unit)
        if low <= reading <= high:
            yield unit, reading


def _unusual_flow(
    spec: MotorSpec, night: dt.date, typical: Mapping[str, float], unusual: set[str]
) -> str | None:
    """A flow that is unusual, in words; None: it is usual, or cannot be judged."""
    pressure = "pressure_difference" if "pressure_difference" in typical else "high_port_pressure"
    inputs = (pressure, "oil_temperature", "speed")
    if not {COUNTED, *inputs} <= typical.keys():
        return None
    flow = typical[COUNTED]
    # The usual values of what is unusual as it stands, the value itself of what is not.
    values = [
        [reading for _, reading in _usual_values(spec, name, typical[name])]
        if name in unusual
        else [typical[name]]
        for name in inputs
    ]
    known = [found for one in product(*values) if (found := _model_flow(spec, night, *one))]
    if not known or _near(flow, known):
        return None
    units = [unit for unit in UNITS["flow"] if _near(_in_unit(spec, COUNTED, flow, unit), known)]
    # Inputs of which another unit, usual as well, explains the flow.
    others = [
        f"{name} {unit}"
        for at, name in enumerate(inputs if not unusual else ())
        for unit, reading in _usual_values(spec, name, typical[name])
        if (
            found := _model_flow(
                spec, night, *(reading if i == at else typical[one] for i, one in enumerate(inputs))
            )
        )
        and _near(flow, [found])
    ]
    return f"{_unusual(COUNTED, flow)} where the model has {known[0]:.2g}{_mended(units, others)}"


def _near(flow: float, expected: list[float]) -> bool:
    return min(expected) / UNUSUAL_FLOW <= flow <= max(expected) * UNUSUAL_FLOW


def _model_flow(
    spec: MotorSpec, night: dt.date, pressure_bar: float, temperature_c: float, speed_rpm: float
) -> float | None:
    conditions = OperatingConditions.from_bar(pressure_bar, temperature_c, speed_rpm)
    try:
        motor = spec.motor(night, spec.file.flushing.mode)
        return float(total_flow_l_per_min(motor, conditions)[0])
    except LeakageError:
        return None
