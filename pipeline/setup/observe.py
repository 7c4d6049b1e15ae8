"""What proposed motors' logs cover, and their conditions: figures for the fleet file."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np

from pipeline.clock import utc
from pipeline.config import Channel
from pipeline.config.channels import PORT_PRESSURES
from pipeline.config.logs import Logs
from pipeline.errors import LogError
from pipeline.ingest import read_log, time_span
from pipeline.setup.propose import Proposal, ProposedMotor
from pipeline.units import canonical_unit

LARGEST_LOG_BYTES = 200 << 20
_MOST_MOTORS, _MOST_FILES = 12, 30
_STANDSTILL_RPM = 0.5
_PAUSE_H = 3
_FOLDERS_OF_LOGS = {"log", "logs", "data", "csv", "export", "exports", "daten", "archive"}


@dataclass(frozen=True, slots=True)
class Observed:
    """A motor's logs; None for what is not known."""

    spans: tuple[tuple[dt.datetime, dt.datetime], ...] = ()  # in local time, of files by name
    pressure_bar: float | None = None  # medians in the newest log, of the speed while it turned
    temperature_c: float | None = None
    speed_rpm: float | None = None
    fault: str = ""  # why the newest log cannot be read as proposed


def observe(motor: ProposedMotor) -> Observed:
    """Look at the ends of a motor's logs, and into the newest where every unit is known."""
    if not motor.files:
        return Observed()
    logs = Logs.model_validate({**motor.logs, "files": tuple(motor.logs["files"])}, strict=False)
    channels: Any = {
        name: Channel.model_validate({"unit": canonical_unit(name)} | place.keys())
        for name, place in motor.channels.items()
    }
    zone = ZoneInfo(logs.time_zone)
    newest = motor.files[-1]
    try:
        ends = (
            time_span(path, logs, channels)
            for path in sorted({motor.files[0], *motor.files[-_MOST_FILES:]})
        )
        spans = tuple((utc(a).astimezone(zone), utc(b).astimezone(zone)) for a, b in ends)
        is_known = all(place.unit for place in motor.channels.values())
        if not is_known or newest.stat().st_size > LARGEST_LOG_BYTES:
            return Observed(spans)
        found = read_log(newest, logs, channels).channels
    except LogError as error:
        return Observed(fault=f"{error.code}: {error.message}")
    sizes = {name: np.abs(one.value[np.isfinite(one.value)]) for name, one in found.items()}
    speed = sizes.pop("speed", np.zeros(0))
    sizes["speed"] = speed[speed > _STANDSTILL_RPM]
    typical = {name: float(np.median(one)) for name, one in sizes.items() if len(one)}
    pressure = typical.get("pressure_difference")
    if typical.keys() >= set(PORT_PRESSURES):
        high, low = (typical[port] for port in PORT_PRESSURES)
        pressure = abs(high - low)
    return Observed(spans, pressure, typical.get("oil_temperature"), typical.get("speed"))


def reference(observed: Sequence[Observed]) -> dict[str, float]:
    """Conditions of `[reference]`: the fleet's own medians, to two figures; none where unknown."""
    found = {}
    for key in ("pressure_bar", "temperature_c", "speed_rpm"):
        known = [value for one in observed if (value := getattr(one, key))]
        if known:
            found[key] = float(f"{median(known):.2g}")
    return found


def night_end(observed: Sequence[Observed]) -> int | None:
    """Hour at which logs stop for some hours every day; None where they do not."""
    covered = set[int]()
    for begin, end in (span for one in observed for span in one.spans):
        hours = min(int((end - begin) / dt.timedelta(hours=1)) + 1, 24)
        covered |= {(begin + dt.timedelta(hours=i)).hour for i in range(hours)} | {end.hour}
    stops = [hour for hour in range(24) if hour not in covered and (hour - 1) % 24 in covered]
    pauses = {stop: next(i for i in range(1, 25) if (stop + i) % 24 in covered) for stop in stops}
    longest = max(pauses, key=lambda stop: pauses[stop], default=None)
    return longest if longest is not None and pauses[longest] >= _PAUSE_H else None


def fleet_name(root: Path) -> str:
    """Name of the nearest folder that is not called after logs alone."""
    names = (one.name for one in (root, *root.parents) if one.name)
    return next((name for name in names if name.lower() not in _FOLDERS_OF_LOGS), "fleet")


def observed_of(proposal: Proposal) -> dict[str, Observed]:
    """What the logs of some motors are, by id."""
    return {motor.motor_id: observe(motor) for motor in proposal.motors[:_MOST_MOTORS]}
