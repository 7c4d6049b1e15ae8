"""Read all config files of a fleet and report every fault of every file at once."""

from __future__ import annotations

import datetime as dt
import json
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path, PurePosixPath
from typing import Any, Generic, TypeVar

from pydantic import BaseModel, ValidationError

from leakage import FilmPressure, LeakageError, Motor, OperatingConditions, leakage_l_per_min
from pipeline.config.faults import ConfigError, Fault, fault_at, faults_of
from pipeline.config.motor_types import MotorTypeFile, OilFile
from pipeline.config.motors import MotorFile, channel_faults
from pipeline.config.settings import Execution, FleetFile, Folders, Retention, Settings

Model = TypeVar("Model", bound=BaseModel)
# Object stores that logs and tables may lie in.
URL_SCHEMES = ("s3", "az", "gs")

Document = Mapping[str, Any]

# Folders of the output that a run writes or empties.
OWN_FOLDERS = ("tables", "manifest", "ledger", "history", "staging", "report")


@dataclass(frozen=True, slots=True)
class Folder(Generic[Model]):
    """The TOML files of a folder by name without ending.

    Attributes
    ----------
    documents
        Content of every file there is; empty where it cannot be read.
    parsed
        Those without a fault of their own.
    """

    documents: Mapping[str, Document]
    parsed: Mapping[str, Model]


@dataclass(frozen=True, slots=True)
class MotorSpec:
    """A motor with everything that its nights need, resolved: fleet file, overrides, type, oil.

    Its logs lie below `log_root`, or below `log_url` where that is not empty.
    """

    file: MotorFile
    motor_type: MotorTypeFile
    oils: Mapping[str, OilFile]
    settings: Settings
    log_root: Path
    log_url: str = ""

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
    """A fleet's whole config; `settings` are those that no motor overrides.

    `object_store` is where the output is published; empty: nowhere else. `log_url` is as in
    `MotorSpec`. `metrics_file` is None where none is to be written.
    """

    name: str
    motors: tuple[MotorSpec, ...]
    execution: Execution
    log_root: Path
    output: Path
    motor_types: Mapping[str, MotorTypeFile]
    oils: Mapping[str, OilFile]
    settings: Settings
    retention: Retention
    object_store: str = ""
    metrics_file: Path | None = None

    @property
    def log_url(self) -> str:
        """URL of the logs; empty where they lie in a folder."""
        return self.motors[0].log_url if self.motors else ""


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
        With every fault of every file, those of the motors too where the fleet file has one.
    """
    faults: list[Fault] = []
    document = _read_toml(path, path.name, faults)
    if document is None:
        raise ConfigError(faults)
    fleet = _validate(FleetFile, document, path.name, faults)
    folders = fleet.folders if fleet else _folders(document)
    # Settings with faults would be reported again for each motor that overrides any.
    shared = {key: document[key] for key in Settings.model_fields if fleet and key in document}
    places = dict(_places(path, folders, faults))
    log_root = places.get("logs", path.parent)
    types = _read_folder(places.get("motor_types"), MotorTypeFile, faults)
    oils = _read_folder(places.get("oils"), OilFile, faults)
    motors = _read_folder(places.get("motors"), MotorFile, faults)
    faults += _misnamed("motor_types", "motor_type", types.documents)
    specs = [
        spec
        for name in sorted(motors.documents)
        if (spec := _resolve(name, motors, types, oils, shared, log_root, faults)) is not None
    ]
    if not motors.documents and not faults:
        faults.append(Fault(folders.motors, "", "expected at least one motor's file"))
    if faults or fleet is None:
        raise ConfigError(faults)
    log_url = folders.logs if is_url(folders.logs) else ""
    found = Fleet(
        name=fleet.name,
        motors=tuple(replace(spec, log_url=log_url) for spec in specs),
        execution=fleet.execution,
        retention=fleet.retention,
        log_root=log_root,
        output=places["output"],
        motor_types=types.parsed,
        oils=oils.parsed,
        settings=fleet,
        object_store=folders.object_store,
        metrics_file=path.absolute().parent / file if (file := fleet.metrics.textfile) else None,
    )
    if (expected := overlap(found)) is not None:
        raise ConfigError([fault_at(path.name, ("folders", "output"), expected, folders.output)])
    return found


def overlap(fleet: Fleet) -> str | None:
    """The folder that was expected, where output and logs lie so that one spoils the other.

    A run would read its own tables as logs, or write into the logs, or remove them.
    """
    logs, output = fleet.log_root, fleet.output
    if fleet.log_url:
        return None
    if output == logs:
        return f"expected another folder than that of the logs, {logs}"
    if output in logs.parents and logs.relative_to(output).parts[0] in OWN_FOLDERS:
        return f"expected a folder without the logs, {logs}, among those that a run writes"
    if logs in output.parents:
        inside = output.relative_to(logs).parts
        for spec in fleet.motors:
            for pattern in spec.file.logs.files:
                if _reaches(pattern, inside):
                    return (
                        f"expected a folder in which no log is looked for: {pattern} of "
                        f"{spec.motor_id} reaches into it"
                    )
    return None


def _reaches(pattern: str, folder: tuple[str, ...]) -> bool:
    """A path or glob of files may match one below a folder, both below the log root."""
    parts = PurePosixPath(pattern).parts[:-1]
    for part, name in zip(parts, folder, strict=False):
        if part == "**":
            return True
        if not fnmatchcase(name, part):
            return False
    return len(parts) >= len(folder)


def _places(path: Path, folders: Folders, faults: list[Fault]) -> Iterator[tuple[str, Path]]:
    """The folders of a fleet file by key, without those that cannot be."""
    for key in ("motors", "motor_types", "oils", "logs", "output"):
        given = getattr(folders, key)
        place = Path("out") if given is None else path.parent / given
        if key == "logs" and is_url(given):
            place = path.parent
        try:
            yield key, absolute(place)
        except ValueError as error:
            faults.append(
                fault_at(path.name, ("folders", key), f"expected a folder: {error}", given)
            )


def absolute(folder: Path) -> Path:
    """The absolute path of a folder, which need not be there.

    Raises
    ------
    ValueError
        No folder can be there: the name is too long, say, or holds a null character.
    """
    try:
        folder = folder.resolve()
        with suppress(FileNotFoundError, NotADirectoryError):
            folder.stat()
    except OSError as error:
        raise ValueError(error.strerror) from error
    except RuntimeError as error:  # of links in a circle
        raise ValueError(str(error)) from error
    return folder


def _folders(document: Document) -> Folders:
    """The folders of a fleet file that has faults, so that the other files are looked at too."""
    try:
        return Folders.model_validate(document.get("folders", {}))
    except ValidationError:
        return Folders()


def _resolve(
    name: str,
    motors: Folder[MotorFile],
    types: Folder[MotorTypeFile],
    oils: Folder[OilFile],
    shared: Document,
    log_root: Path,
    faults: list[Fault],
) -> MotorSpec | None:
    """One motor's file brought together with what it names."""
    file, document = f"motors/{name}.toml", motors.documents[name]
    before = len(faults)
    faults += _misnamed("motors", "motor_id", {name: document})
    faults += _strangers(file, document, types.documents, oils.documents)
    faults += _texts_for_times(file, document)
    if name not in motors.parsed:
        faults += _channel_faults(file, document)
    settings = _settings(document.get("override"), shared, file, faults)
    motor, motor_type = motors.parsed.get(name), types.parsed.get(document.get("motor_type", ""))
    if len(faults) > before or not motor or not settings or not motor_type:
        return None
    spec = MotorSpec(motor, motor_type, oils.parsed, settings, log_root)
    faults += _impossible(file, spec)
    return spec


def _misnamed(folder: str, key: str, documents: Mapping[str, Document]) -> Iterator[Fault]:
    """Files whose own name for what they describe is not the file's."""
    for name, document in documents.items():
        own = document.get(key, name)
        if own != name:
            message = (
                f"got {json.dumps(own, default=str)}; expected {json.dumps(name)}, as the file"
            )
            yield Fault(f"{folder}/{name}.toml", key, message)


def _strangers(
    file: str, document: Document, types: Iterable[str], oils: Iterable[str]
) -> Iterator[Fault]:
    """Names of motor types and oils that there are not; other faults of the file do not matter."""
    events = document.get("events")
    named = [("motor_type", document.get("motor_type"), types), ("oil", document.get("oil"), oils)]
    named += [
        (f"events.{index}.oil", event.get("oil"), oils)
        for index, event in enumerate(events if isinstance(events, list) else ())
        if isinstance(event, dict)
    ]
    for key, given, known in named:
        if isinstance(given, str) and given not in known:
            choice = ", ".join(sorted(known)) or "those in its folder, which has none"
            yield Fault(file, key, f"got {json.dumps(given)}; expected one of {choice}")


def _texts_for_times(file: str, document: Document) -> Iterator[Fault]:
    """Dates and times in quotation marks: TOML has types of its own for them."""
    events, periods = document.get("events"), document.get("periods")
    for index, event in enumerate(events if isinstance(events, list) else ()):
        given = event.get("date") if isinstance(event, dict) else None
        if _is_time(given):
            message = "expected a date without quotation marks, such as 2026-09-01"
            yield fault_at(file, ("events", index, "date"), message, given)
    for name, pairs in periods.items() if isinstance(periods, dict) else ():
        for index, pair in enumerate(pairs if isinstance(pairs, list) else ()):
            for end, given in enumerate(pair if isinstance(pair, list) else ()):
                if _is_time(given):
                    message = "expected a time without quotation marks"
                    yield fault_at(file, ("periods", name, index, end), message, given)


def _is_time(given: object) -> bool:
    """A text could be taken for a date or time."""
    try:
        return isinstance(given, str) and bool(dt.datetime.fromisoformat(given))
    except ValueError:
        return False


def _channel_faults(file: str, document: Document) -> Iterator[Fault]:
    """Faults of the channels as a whole; where the file has others, nothing else looks at them."""
    channels = document.get("channels")
    if isinstance(channels, dict):
        tables = {name: part for name, part in channels.items() if isinstance(part, dict)}
        units = {name: part.get("unit") for name, part in tables.items()}
        for place, message, given in channel_faults(units):
            yield fault_at(file, place, message, given)


def _settings(override: Any, shared: Document, file: str, faults: list[Fault]) -> Settings | None:
    """The fleet's settings with a motor's own in their place."""
    merged: dict[str, Any] = dict(shared)
    for section, values in override.items() if isinstance(override, dict) else ():
        whole = isinstance(values, dict) and isinstance(shared.get(section, {}), dict)
        merged[section] = {**shared.get(section, {}), **values} if whole else values
    return _validate(Settings, merged, file, faults, prefix="override.")


def _impossible(file: str, spec: MotorSpec) -> Iterator[Fault]:
    """Faults that only show when type, oil, flushing and settings come together."""
    reference = spec.settings.reference
    conditions = OperatingConditions.from_bar(
        reference.pressure_bar, reference.temperature_c, reference.speed_rpm
    )
    for night in (dt.date.min, *(event.date for event in spec.file.events)):
        if spec.file.oil_on(night) not in spec.oils:
            continue
        for mode in spec.file.flushing.modes:
            try:
                leakage_l_per_min(spec.motor(night, mode), conditions)
            except LeakageError as error:
                yield Fault(file, "", f"with {spec.file.oil_on(night)}: {error}")


def _read_folder(folder: Path | None, model: type[Model], faults: list[Fault]) -> Folder[Model]:
    """All TOML files of a folder; none where it cannot be, which is told already."""
    if folder is None:
        return Folder({}, {})
    if not folder.is_dir():
        faults.append(Fault(folder.name, "", f"expected a folder at {folder}"))
        return Folder({}, {})
    documents: dict[str, Document] = {}
    parsed: dict[str, Model] = {}
    for path in sorted(folder.glob("*.toml")):
        file = f"{folder.name}/{path.name}"
        document = _read_toml(path, file, faults)
        documents[path.stem] = document or {}
        content = _validate(model, document, file, faults) if document is not None else None
        if content is not None:
            parsed[path.stem] = content
    return Folder(documents, parsed)


def _read_toml(path: Path, file: str, faults: list[Fault]) -> dict[str, Any] | None:
    try:
        # Windows' editors begin a file with a byte order mark.
        document = tomllib.loads(path.read_bytes().decode("utf-8-sig"))
        # Whatever cannot be written as JSON: too deep, or a number of thousands of digits.
        json.dumps(document, default=str)
    except OSError as error:
        faults.append(Fault(file, "", f"cannot be read: {error.strerror}"))
    except UnicodeDecodeError as error:
        faults.append(Fault(file, "", f"is not UTF-8, as TOML must be: byte {error.start}"))
    except (ValueError, RecursionError) as error:
        faults.append(Fault(file, "", f"is not TOML: {error}"))
    else:
        return document
    return None


def _validate(
    model: type[Model], document: Document, file: str, faults: list[Fault], prefix: str = ""
) -> Model | None:
    try:
        # By way of JSON: strict validation then still takes arrays as tuples and text as dates.
        return model.model_validate_json(json.dumps(document, default=str))
    except ValidationError as error:
        faults += faults_of(error, file, prefix, document)
    return None


def is_url(text: str) -> bool:
    """Tell the URL of an object store from a folder.

    Examples
    --------
    >>> is_url("s3://bucket/logs"), is_url("../logs")
    (True, False)
    """
    return text.partition("://")[0] in URL_SCHEMES and "://" in text
