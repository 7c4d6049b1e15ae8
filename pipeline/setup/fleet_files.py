"""Files of a proposed fleet: what its motors have in common stands once, in `[defaults]`.

What their logs cover, and at which conditions, gives figures for the fleet file.
"""

from __future__ import annotations

import datetime as dt
import json
import os
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import median
from types import MappingProxyType
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np

from pipeline.clock import now, utc
from pipeline.config import Channel, Fleet
from pipeline.config.channels import PORT_PRESSURES
from pipeline.config.loading import NAME_MARK, complete, validate, with_name
from pipeline.config.logs import Logs
from pipeline.config.settings import Alarms, ReferenceConditions
from pipeline.errors import LogError, UsageError
from pipeline.ingest import read_log, time_span
from pipeline.logs.finding import find_logs
from pipeline.night.cleaning import STANDSTILL_RPM
from pipeline.setup.propose import LARGEST_LOG_BYTES, Proposal, ProposedMotor
from pipeline.setup.samples import silence_keys, unread
from pipeline.setup.tables import Column
from pipeline.units import canonical_unit

Document = dict[str, Any]
Span = tuple[dt.datetime, dt.datetime]
NO_ANSWERS: Mapping[str, str] = MappingProxyType({})
_MOST_MOTORS, _MOST_FILES = 12, 30
_PAUSE_H = 3
_REFERENCE = {
    "pressure_bar": "pressure_difference",
    "temperature_c": "oil_temperature",
    "speed_rpm": "speed",
}


@dataclass(frozen=True, slots=True)
class Observed:
    """A motor's logs, as far as is known."""

    spans: tuple[Span, ...] = ()  # in local time, of files by name
    # Median magnitude in the newest readable log by channel, of the speed while it turned.
    typical: Mapping[str, float] = field(default_factory=dict)
    sampling: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # keys, by channel
    fault: str = ""  # why a log cannot be read as proposed


def fleet_files(
    proposal: Proposal,
    folder: Path,
    motor_type: str,
    oil: str,
    observed: Sequence[Observed] = (),
    answers: Mapping[str, str] = NO_ANSWERS,
) -> dict[str, str]:
    """Return texts of the fleet file and of each motor's, by path below the folder.

    Of `answers`, ``MOTOR.motor_type`` and ``MOTOR.oil`` are for that motor.
    """
    own = [
        _document(motor, *machine_of(motor, motor_type, oil, answers)) for motor in proposal.motors
    ]
    first, *others = (
        _mark(document, _name(motor)) for motor, document in zip(proposal.motors, own, strict=True)
    )
    shared = {
        key: value for key, value in first.items() if all(o.get(key) == value for o in others)
    }
    logs = Path(os.path.relpath(proposal.log_root, folder.resolve()))
    folders = {"logs": logs.as_posix(), "output": "out"}
    nights: Document = {"time_zone": proposal.motors[0].logs.get("time_zone", "UTC")}
    end_hour = night_end(observed)
    fleet: Document = {
        "name": folder.resolve().name or "fleet",
        **({"live": False} if _are_past(observed) else {}),
        "folders": folders,
        "nights": nights | ({} if end_hour is None else {"end_hour": end_hour}),
        "reference": reference(observed),
        **{f"defaults.{key}": value for key, value in shared.items()},
    }
    return {"fleet.toml": _toml(fleet)} | {
        f"motors/{motor.motor_id}.toml": _motor_text(motor, its, shared)
        for motor, its in zip(proposal.motors, own, strict=True)
    }


def _are_past(observed: Sequence[Observed]) -> bool:
    """Return True for logs that ended long ago: by this machine's clock all would be stale."""
    ends = [end for motor in observed for _, end in motor.spans]
    return bool(ends) and now() - max(ends) > dt.timedelta(Alarms().stale_after_nights)


def machine_of(
    motor: ProposedMotor, motor_type: str, oil: str, answers: Mapping[str, str]
) -> tuple[str, str]:
    """Return the type and oil of a motor: its own answer, or else the fleet's."""
    own = (("motor_type", motor_type), ("oil", oil))
    type_of, oil_of = (answers.get(f"{motor.motor_id}.{key}", value) for key, value in own)
    return type_of, oil_of


def _name(motor: ProposedMotor) -> str:
    return motor.name or motor.motor_id


def _motor_text(motor: ProposedMotor, own: Document, shared: Document) -> str:
    """Return a motor's file, without what the defaults have; a channel's table stands alone."""
    head = {"motor_id": motor.motor_id}
    head |= {"name_in_log": _name(motor)} if _name(motor) != motor.motor_id else {}
    known = with_name(shared, _name(motor))
    return _toml(
        head | {key: value for key, value in own.items() if not _is_said(value, known.get(key))}
    )


def _is_said(value: Any, known: Any) -> bool:
    """Return True for what is known already, of a table with more keys or without."""
    are_tables = isinstance(value, dict) and isinstance(known, dict)
    return value.items() <= known.items() if are_tables else bool(value == known)


def added_files(
    proposal: Proposal,
    fleet: Fleet,
    defaults: Document,
    motor_type: str,
    oil: str,
    answers: Mapping[str, str],
) -> dict[str, str]:
    """Return texts of the files of motors that a fleet does not have, by path below its folder.

    Raises UsageError (``defaults``) where the fleet's defaults would change what was proposed.
    """
    claimed = {
        (path.resolve(), flow.source, flow.field, spec.file.logs.motor_rows or ())
        for spec in fleet.motors
        for path in find_logs(spec)[0].values()
        for flow in (spec.file.channels["leakage_flow"],)
    }
    ids = {spec.motor_id for spec in fleet.motors}
    files = {}
    for motor in proposal.motors:
        keys = motor.channels["leakage_flow"].keys
        flow = (keys["source"], keys.get("field", ""), tuple(motor.logs.get("motor_rows", ())))
        if any((path, *flow) in claimed for path in motor.files):
            continue
        own = _document(motor, *machine_of(motor, motor_type, oil, answers))
        text = _motor_text(motor, own, _flat(defaults))
        whole = complete(tomllib.loads(text), defaults, motor.motor_id)
        if motor.motor_id in ids or whole["logs"] != motor.logs:
            message = (
                f"{motor.motor_id} does not fit the fleet's [defaults] or ids: write it by hand"
            )
            raise UsageError("defaults", message)
        files[f"motors/{motor.motor_id}.toml"] = text
    return files


def write_fleet(files: Mapping[str, str], folder: Path, types: Path, *motor_types: str) -> None:
    """Write a fleet's files, the motor types and the oils that ship beside them.

    Of a fleet that is there, only the files of its new motors are. Raises UsageError
    (``file_exists``) if any of them is there; nothing is written then.
    """
    copies = [f"motor_types/{name}.toml" for name in dict.fromkeys(motor_types)]
    copies += [f"oils/{path.name}" for path in sorted((types / "oils").glob("*.toml"))]
    copies = copies if "fleet.toml" in files else []
    there = [name for name in (*files, *copies) if (folder / name).exists()]
    if there:
        message = f"{folder / there[0]} is there: nothing is overwritten; name another folder"
        raise UsageError("file_exists", message)
    texts = dict(files) | {name: (types / name).read_text("utf-8") for name in copies}
    for name, text in texts.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        with (folder / name).open("x", encoding="utf-8") as file:
            file.write(text)


def defaults_of(fleet_file: Path) -> Document:
    """Return `[defaults]` of a fleet file that can be read."""
    return dict(tomllib.loads(fleet_file.read_bytes().decode("utf-8-sig")).get("defaults", {}))


def _document(motor: ProposedMotor, motor_type: str, oil: str) -> Document:
    channels = {name: dict(channel.keys) for name, channel in motor.channels.items()}
    machine = {"motor_type": motor_type, "oil": oil}
    return _flat({**machine, "logs": motor.logs, "channels": channels})


def _flat(document: Document) -> Document:
    """Return a motor's document with the keys of logs, and the channels, by their paths."""
    settings = {key: value for key, value in document.items() if key not in ("logs", "channels")}
    for table in ("logs", "channels"):
        settings |= {f"{table}.{key}": value for key, value in document.get(table, {}).items()}
    return settings


def _mark(value: Any, name: str) -> Any:
    """Return texts with the mark in the place of a motor's name; a query is of all motors."""
    if isinstance(value, dict):
        return value if "query" in value else {k: _mark(inner, name) for k, inner in value.items()}
    if isinstance(value, list):
        return [_mark(inner, name) for inner in value]
    return value.replace(name, NAME_MARK) if isinstance(value, str) else value


def _toml(document: Document) -> str:
    """Return text of values, and of tables of values, by their path."""
    tables: dict[str, Document] = {}
    for path, value in document.items():
        table, _, key = path.rpartition(".")
        if isinstance(value, dict):
            tables[path] = value
        else:
            tables.setdefault(table, {})[key] = value
    lines: list[str] = []
    for name, own in tables.items():
        lines += [f"\n[{name}]"] * bool(name and own)
        lines += [f"{key} = {_value(setting)}" for key, setting in own.items()]
    return "\n".join(lines).strip() + "\n"


def _value(value: object) -> str:
    # Text of JSON is text of TOML, but for a single character.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


# Figures of the fleet file


def observe(motor: ProposedMotor) -> Observed:
    """Look at the ends of a motor's logs, and into the newest where every unit is known."""
    logs = Logs.model_validate({**motor.logs, "files": tuple(motor.logs["files"])}, strict=False)
    channels: Any = {
        name: Channel.model_validate({"unit": canonical_unit(name), **channel.keys}, strict=False)
        for name, channel in motor.channels.items()
    }
    zone, spans, fault = ZoneInfo(logs.time_zone), dict[Path, Span](), ""
    for path in dict.fromkeys((motor.files[0], *motor.files[-_MOST_FILES:])):
        try:
            first, last = time_span(path, logs, channels)
            spans[path] = utc(first).astimezone(zone), utc(last).astimezone(zone)
        except LogError as error:
            fault = f"{error.code}: {error.message}"
    observed, newest = Observed(tuple(spans.values()), fault=fault), next(reversed(spans), None)
    is_known = all(channel.unit for channel in motor.channels.values())
    if newest is None or not is_known or newest.stat().st_size > LARGEST_LOG_BYTES:
        return observed
    try:
        log = read_log(newest, logs, channels)
    except LogError as error:
        return replace(observed, fault=f"{error.code}: {error.message}")
    raw_channels, lost = log.channels, unread(log)
    if lost:
        words = next(iter(lost.values()))
        observed = replace(observed, fault=f"cells_unread: {newest.name}: {words}")
    every_us = np.unique(np.concatenate([raw.time_us for raw in raw_channels.values()]))
    sampling = {name: silence_keys(raw, every_us) for name, raw in raw_channels.items()}
    sizes = {name: np.abs(raw.value[np.isfinite(raw.value)]) for name, raw in raw_channels.items()}
    if "speed" in sizes:
        sizes["speed"] = sizes["speed"][sizes["speed"] > STANDSTILL_RPM]
    typical = {name: float(np.median(size)) for name, size in sizes.items() if len(size)}
    if typical.keys() >= set(PORT_PRESSURES):
        high, low = (typical[port] for port in PORT_PRESSURES)
        typical["pressure_difference"] = abs(high - low)
    # What is lost leaves silences, too.
    sampling = {name: keys for name, keys in sampling.items() if keys and name not in lost}
    return replace(observed, typical=typical, sampling=sampling)


def reference(observed: Sequence[Observed]) -> dict[str, float]:
    """Return conditions of `[reference]`: the fleet's medians, to two figures, if possible."""
    conditions: dict[str, float] = {}
    for key, name in _REFERENCE.items():
        known = [value for observation in observed if (value := observation.typical.get(name))]
        rounded = {key: float(f"{median(known):.2g}")} if known else {}
        if validate(ReferenceConditions, rounded, "", []):
            conditions |= rounded
    return conditions


def night_end(observed: Sequence[Observed]) -> int | None:
    """Return hour at which logs stop for some hours every day; None where they do not."""
    covered = set[int]()
    for begin, end in (span for observation in observed for span in observation.spans):
        hours = min(int((end - begin) / dt.timedelta(hours=1)) + 1, 24)
        covered |= {(begin + dt.timedelta(hours=i)).hour for i in range(hours)} | {end.hour}
    stops = [hour for hour in range(24) if hour not in covered and (hour - 1) % 24 in covered]
    pauses = {stop: next(i for i in range(1, 25) if (stop + i) % 24 in covered) for stop in stops}
    longest = max(pauses, key=lambda stop: pauses[stop], default=None)
    return longest if longest is not None and pauses[longest] >= _PAUSE_H else None


def with_sampling(proposal: Proposal, observed: Mapping[str, Observed]) -> Proposal:
    """Return the proposal with the sampling of each motor's channels.

    Motors that nobody looked into have what all others have in common.
    """
    known = [observation.sampling for observation in observed.values() if observation.typical]
    common = known[0] if known and all(sampling == known[0] for sampling in known) else {}

    def channels(motor: ProposedMotor) -> dict[str, Column]:
        own = observed[motor.motor_id].sampling if motor.motor_id in observed else common
        return {
            name: replace(column, keys={**column.keys, **own.get(name, {})})
            for name, column in motor.channels.items()
        }

    motors = tuple(replace(motor, channels=channels(motor)) for motor in proposal.motors)
    return replace(proposal, motors=motors)


def observed_of(proposal: Proposal) -> dict[str, Observed]:
    """Return what the logs of some motors are, by id."""
    return {motor.motor_id: observe(motor) for motor in proposal.motors[:_MOST_MOTORS]}
