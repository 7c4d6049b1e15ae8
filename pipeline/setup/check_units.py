"""Units that are not the log's own, or look wrong by magnitude, and which would be right."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from leakage import LeakageError, OperatingConditions, total_flow_l_per_min
from pipeline.config import MotorSpec
from pipeline.config.channels import COUNTED
from pipeline.config.logs import Logs
from pipeline.config.motors import MotorFile
from pipeline.ingest import RawChannel
from pipeline.setup.names import LOW_SIDE, QUANTITY_OF, USUAL, likely_units, meaning_of
from pipeline.setup.sniff import header_of
from pipeline.units import QUANTITIES, UNITS, canonical_unit, from_canonical, to_canonical

# A drain flow this many times off the configured model's is of another unit sooner than worn.
UNUSUAL_FLOW = 8.0


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
        low, high = USUAL.get(QUANTITIES[name], (0.0, float("inf")))
        if name not in (*LOW_SIDE, COUNTED) and not low <= value <= high:
            found[name] = _unusual(name, value, "", likely_units(name, [_read(spec, name, value)]))
    expected = None if found else _model_flow(spec, night, typical)
    if expected and not _is_near(flow := typical[COUNTED], expected):
        read = _read(spec, COUNTED, flow)
        units = [
            unit
            for unit in UNITS["flow"]
            if _is_near(float(to_canonical(COUNTED, read, unit)), expected)
        ]
        found[COUNTED] = _unusual(COUNTED, flow, f" where the model has {expected:.2g}", units)
    return found


def units_told(path: Path, file: MotorFile) -> dict[str, str]:
    """Channels that a table's header or line of units gives another unit than the config."""
    beside = columns_of(path, file.logs) or {}
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


def columns_of(path: Path, logs: Logs) -> dict[str, str] | None:
    """Columns of a table, each with what stands in its header as a unit; None: it is no table."""
    is_table = logs.layout == "wide" and logs.format in ("csv", "parquet")
    return header_of(path) if is_table else None


def _typical(raw: RawChannel) -> float | None:
    """Upper quartile of all numbers' magnitudes, those out of range too: they tell the unit."""
    numbers = np.abs(raw.value[np.isfinite(raw.value)])
    return float(np.percentile(numbers, 75)) if len(numbers) else None


def _unusual(name: str, value: float, where: str, units: Sequence[str]) -> str:
    unit = canonical_unit(name).replace("degC", "°C")
    mended = f"; it would be usual if the log's unit were {' or '.join(units[:2])}" if units else ""
    words = f"typically {value:.3g} {unit}, which is unusual{where}{mended}"
    return f"unit_unusual: {name}: {words}"


def _read(spec: MotorSpec, name: str, value: float) -> float:
    """A value as it stands in the log."""
    configured = next(one.unit for other, one in spec.file.channels.items() if other == name)
    return float(from_canonical(name, value, configured))


def _is_near(flow: float, expected: float) -> bool:
    return expected / UNUSUAL_FLOW <= flow <= expected * UNUSUAL_FLOW


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
