"""Units that are not the log's own, or look wrong by magnitude, and which would be right."""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Mapping
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
from pipeline.units import QUANTITIES, canonical_unit, from_canonical

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


def _unusual(
    spec: MotorSpec, name: str, value: float, usual: tuple[float, float], where: str
) -> str:
    configured = next(one.unit for other, one in spec.file.channels.items() if other == name)
    in_log = float(from_canonical(name, value, configured))
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
