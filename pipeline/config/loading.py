"""Read all config files of a fleet and report every fault of every file at once."""

from __future__ import annotations

import datetime as dt
import json
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from leakage import FilmPressure, LeakageError, Motor
from pipeline.config.motor_types import MotorTypeFile, OilFile
from pipeline.config.motors import MotorFile
from pipeline.config.settings import Execution, FleetFile, Settings
from pipeline.errors import MotorLeakageError

Model = TypeVar("Model", bound=BaseModel)


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing wrong in one config file."""

    file: str
    key: str
    message: str

    def __str__(self) -> str:
        return (
            f"{self.file}: {self.key}: {self.message}"
            if self.key
            else f"{self.file}: {self.message}"
        )


class ConfigError(MotorLeakageError):
    """Everything that is wrong in a fleet's config, in one error; exit code 2."""

    def __init__(self, faults: Iterable[Fault]) -> None:
        self.faults = tuple(faults)
        lines = "\n".join(f"  {fault}" for fault in self.faults)
        count = len(self.faults)
        super().__init__("config", f"{count} config fault{'s' if count > 1 else ''}\n{lines}")


@dataclass(frozen=True, slots=True)
class Folder(Generic[Model]):
    """The TOML files of a folder by name without ending: all there are, and those without fault."""

    names: tuple[str, ...]
    parsed: Mapping[str, Model]


@dataclass(frozen=True, slots=True)
class MotorSpec:
    """A motor with everything that its nights need, resolved: fleet file, overrides, type, oil."""

    file: MotorFile
    motor_type: MotorTypeFile
    oils: Mapping[str, OilFile]
    settings: Settings
    log_root: Path

    @property
    def motor_id(self) -> str:
        """The motor's id."""
        return self.file.motor_id

    def oil_on(self, night: dt.date) -> OilFile:
        """The oil of a night."""
        return self.oils[self.file.oil_on(night)]

    def motor(self, night: dt.date, flushing_mode: str) -> Motor:
        """The motor as the physics knows it, on a night and under one mode of flushing."""
        model = self.settings.model
        return Motor(
            motor_type=self.motor_type.motor_type,
            paths=(*self.motor_type.paths(), self.file.flushing.path(flushing_mode)),
            oil=self.oil_on(night).oil(),
            film_pressure=FilmPressure(model.film_pressure, model.film_pressure_share),
        )


@dataclass(frozen=True, slots=True)
class Fleet:
    """A fleet's whole config."""

    name: str
    motors: tuple[MotorSpec, ...]
    execution: Execution
    log_root: Path
    output: Path


def load_fleet(path: Path) -> Fleet:
    """Read a fleet file and all files that it leads to.

    Parameters
    ----------
    path
        The fleet file.

    Returns
    -------
    Fleet
        Motors sorted by id, each fully resolved.

    Raises
    ------
    ConfigError
        With every fault of every file.
    """
    faults: list[Fault] = []
    document = _read_toml(path, faults)
    fleet = _validate(FleetFile, document, path.name, faults) if document is not None else None
    if fleet is None:
        raise ConfigError(faults)
    base = path.parent
    types = _read_folder(base / fleet.folders.motor_types, MotorTypeFile, faults)
    oils = _read_folder(base / fleet.folders.oils, OilFile, faults)
    motors = _read_folder(base / fleet.folders.motors, MotorFile, faults)
    log_root = (base / fleet.folders.logs).resolve()
    shared = {key: value for key, value in (document or {}).items() if key in Settings.model_fields}
    specs = [
        spec
        for name, motor in sorted(motors.parsed.items())
        if (spec := _resolve(name, motor, types, oils, shared, log_root, faults)) is not None
    ]
    if not motors.names and not faults:
        faults.append(Fault(str(fleet.folders.motors), "", "expected at least one motor's file"))
    if faults:
        raise ConfigError(faults)
    output = Path("out") if fleet.folders.output is None else base / fleet.folders.output
    return Fleet(fleet.name, tuple(specs), fleet.execution, log_root, output.resolve())


def _resolve(
    name: str,
    motor: MotorFile,
    types: Folder[MotorTypeFile],
    oils: Folder[OilFile],
    shared: Mapping[str, Any],
    log_root: Path,
    faults: list[Fault],
) -> MotorSpec | None:
    """One motor's file brought together with what it names."""
    file = f"motors/{name}.toml"
    before = len(faults)
    if motor.motor_id != name:
        faults.append(
            Fault(file, "motor_id", f"got {motor.motor_id!r}; expected {name!r}, as the file")
        )
    if motor.motor_type not in types.names:
        faults.append(Fault(file, "motor_type", _unknown(motor.motor_type, types.names)))
    named = {"oil": motor.oil} | {
        f"events.{index}.oil": event.oil for index, event in enumerate(motor.events) if event.oil
    }
    faults.extend(
        Fault(file, key, _unknown(oil, oils.names))
        for key, oil in named.items()
        if oil not in oils.names
    )
    merged = {key: dict(value) for key, value in shared.items()}
    for section, values in motor.override.items():
        merged[section] = merged.get(section, {}) | values if isinstance(values, dict) else values
    settings = _validate(Settings, merged, file, faults, prefix="override.")
    if len(faults) > before or settings is None or motor.motor_type not in types.parsed:
        return None
    return MotorSpec(motor, types.parsed[motor.motor_type], oils.parsed, settings, log_root)


def _unknown(name: str, known: Iterable[str]) -> str:
    return f"got {name!r}; expected one of {', '.join(sorted(known)) or '(none is readable)'}"


def _read_folder(folder: Path, model: type[Model], faults: list[Fault]) -> Folder[Model]:
    """All TOML files of a folder."""
    if not folder.is_dir():
        faults.append(Fault(folder.name, "", f"expected a folder at {folder}"))
        return Folder((), {})
    paths = sorted(folder.glob("*.toml"))
    parsed: dict[str, Model] = {}
    for path in paths:
        document = _read_toml(path, faults)
        if document is not None:
            content = _validate(model, document, f"{folder.name}/{path.name}", faults)
            if content is not None:
                parsed[path.stem] = content
    return Folder(tuple(path.stem for path in paths), parsed)


def _read_toml(path: Path, faults: list[Fault]) -> dict[str, Any] | None:
    try:
        with path.open("rb") as stream:
            return tomllib.load(stream)
    except OSError as error:
        faults.append(Fault(path.name, "", f"cannot be read: {error.strerror}"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        faults.append(Fault(path.name, "", f"is not TOML: {error}"))
    return None


def _validate(
    model: type[Model],
    document: Mapping[str, Any],
    file: str,
    faults: list[Fault],
    prefix: str = "",
) -> Model | None:
    try:
        # By way of JSON: strict validation then still takes arrays as tuples and text as dates.
        return model.model_validate_json(json.dumps(document, default=str))
    except ValidationError as error:
        faults.extend(_fault(detail, file, prefix) for detail in error.errors())
    except LeakageError as error:
        faults.append(Fault(file, prefix.rstrip("."), str(error)))
    return None


def _fault(detail: ErrorDetails, file: str, prefix: str) -> Fault:
    """A finding of pydantic's in a reader's words: key, what stands there, what was expected."""
    key = prefix + ".".join(str(part) for part in detail["loc"])
    kind = detail["type"]
    if kind == "missing":
        return Fault(file, key, "is missing")
    if kind == "extra_forbidden":
        return Fault(file, key, "is no key of this table; check its spelling")
    message = detail["msg"].removeprefix("Value error, ")
    if isinstance(detail["input"], Mapping | list):
        return Fault(file, key, message)
    return Fault(file, key, f"got {json.dumps(detail['input'], default=str)}; {_expected(message)}")


def _expected(message: str) -> str:
    return (
        "expected" + message.removeprefix("Input should be")
        if message.startswith("Input should be")
        else message
    )
