"""Files of a proposed fleet: what its motors have in common stands once, in `[defaults]`."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pipeline.config.defaults import NAME_MARK
from pipeline.errors import UsageError
from pipeline.setup.plant import Proposal, ProposedMotor
from pipeline.setup.suggest import quoted

# Tables whose keys belong together, and stand as a whole or not at all.
_WHOLE = "source"

Document = dict[str, Any]


def fleet_files(proposal: Proposal, folder: Path, motor_type: str, oil: str) -> dict[str, str]:
    """Texts of the fleet file and of each motor's, by path below the folder."""
    own = {one.motor_id: _document(one, motor_type, oil) for one in proposal.motors}
    marked = {
        one.motor_id: _marked(own[one.motor_id], one.name or one.motor_id)
        for one in proposal.motors
    }
    shared = _common(list(marked.values()))
    folders = {"output": "out"}
    if "files" in proposal.motors[0].logs:
        logs = Path(os.path.relpath(proposal.log_root, folder.resolve()))
        folders = {"logs": logs.as_posix()} | folders
    zone = proposal.motors[0].logs.get("time_zone", "UTC")
    fleet: Document = {
        "name": proposal.log_root.name,
        "folders": folders,
        "nights": {"time_zone": zone},
        "defaults": shared,
    }
    files = {"fleet.toml": _toml(fleet)}
    for motor in proposal.motors:
        head = {"motor_id": motor.motor_id}
        if motor.name and motor.name != motor.motor_id:
            head["name_in_log"] = motor.name
        files[f"motors/{motor.motor_id}.toml"] = _toml(
            head | _without(marked[motor.motor_id], own[motor.motor_id], shared)
        )
    return files


def write_fleet(files: Mapping[str, str], folder: Path, types: Path, motor_type: str) -> None:
    """Write a fleet's files, the motor type and the oils that ship beside them.

    Raises UsageError (``file_exists``) if one of them is there; nothing is written then.
    """
    copies = [f"motor_types/{motor_type}.toml"]
    copies += [f"oils/{path.name}" for path in sorted((types / "oils").glob("*.toml"))]
    there = [name for name in (*files, *copies) if (folder / name).exists()]
    if there:
        message = f"{folder / there[0]} is there: nothing is overwritten; name another folder"
        raise UsageError("file_exists", message)
    for name in (*files, *copies):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        with (folder / name).open("x", encoding="utf-8") as file:
            file.write(text)
    for name in copies:
        shutil.copyfile(types / name, folder / name)


def _document(motor: ProposedMotor, motor_type: str, oil: str) -> Document:
    channels = {}
    for name, source in motor.sources.items():
        keys = {"source": source.source, "unit": source.unit}
        if source.named_field:
            keys["field"] = source.named_field
        if source.value_column:
            keys["value_column"] = source.value_column
        if motor.quality.get(name):
            keys["quality_source"] = motor.quality[name]
        channels[name] = keys
    return {
        "motor_type": motor_type,
        "oil": oil,
        "logs": dict(motor.logs),
        "channels": channels,
    }


def _marked(value: Any, name: str) -> Any:
    """Texts with the mark in the place of a motor's name."""
    if isinstance(value, dict):
        # A query is of all motors.
        own = ("database",)
        return {key: one if key in own else _marked(one, name) for key, one in value.items()}
    if isinstance(value, list):
        return [_marked(inner, name) for inner in value]
    return value.replace(name, NAME_MARK) if isinstance(value, str) else value


def _common(documents: list[Document]) -> Document:
    """What is the same in all documents."""
    first, rest = documents[0], documents[1:]
    found: Document = {}
    for key, value in first.items():
        if not all(key in one for one in rest):
            continue
        others = [one[key] for one in rest]
        if all(one == value for one in others):
            found[key] = value
        elif isinstance(value, dict) and _WHOLE not in value:
            found[key] = _common([value, *others])
    return found


def _without(marked: Document, own: Document, shared: Document) -> Document:
    """A motor's own part, as it stands."""
    found: Document = {}
    for key, value in marked.items():
        if key not in shared:
            found[key] = own[key]
        elif value != shared[key]:
            found[key] = _without(value, own[key], shared[key])
    return found


def _toml(document: Mapping[str, Any]) -> str:
    return "\n".join(_lines(document, "")).strip() + "\n"


def _lines(table: Mapping[str, Any], name: str) -> Iterator[str]:
    plain = {key: value for key, value in table.items() if not isinstance(value, dict)}
    if name and plain:
        yield f"\n[{name}]"
    for key, value in plain.items():
        yield f"{key} = {_value(value)}"
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _lines(value, f"{name}.{key}" if name else key)


def _value(value: object) -> str:
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_value, value))}]"
    return quoted(value) if isinstance(value, str) else str(value)
