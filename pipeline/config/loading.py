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
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from pydantic import BaseModel, ValidationError

from leakage import FilmPressure, LeakageError, Motor, OperatingConditions, leakage_l_per_min
from leakage.physics.walther import kinematic_viscosity_mm2_per_s
from pipeline.config.defaults import at_their_place, completed
from pipeline.config.faults import ConfigError, Fault, Place, fault_at, faults_of
from pipeline.config.motor_types import MotorTypeFile, OilFile
from pipeline.config.motors import LANDED, MotorFile, channel_faults
from pipeline.config.oil_samples import FURTHEST, OilCircuitFile, OilSample, Walther, measured_curve
from pipeline.config.settings import Execution, FleetFile, Folders, Retention, Settings

if TYPE_CHECKING:
    from leakage.estimation.model_verdict import LowSide

Model = TypeVar("Model", bound=BaseModel)
# Object stores that logs and tables may lie in.
URL_SCHEMES = ("s3", "az", "gs")

Document = Mapping[str, Any]

# Channels that tell the pressure of the low side.
LOW_SIDE = frozenset(("charge_pressure", "low_port_pressure"))

# Folders of the output that a run writes or empties.
LANDED_FOLDER = "landed"
OWN_FOLDERS = ("tables", "manifest", "ledger", "history", "staging", "report", LANDED_FOLDER)


@dataclass(frozen=True, slots=True)
class Folder(Generic[Model]):
    """The TOML files of a folder by name without ending.

    Attributes
    ----------
    own
        Content of every file there is; empty where it cannot be read.
    documents
        The same with the fleet's defaults.
    parsed
        Those without a fault.
    """

    own: Mapping[str, Document]
    documents: Mapping[str, Document]
    parsed: Mapping[str, Model]


@dataclass(frozen=True, slots=True)
class MotorSpec:
    """A motor with everything that its nights need, resolved: fleet file, overrides, type, oil.

    Its logs lie below `log_root`, or below `log_url` where that is not empty; those of a database
    are written below `log_root`, a folder of the output. `roller_is_free`: the scale of the
    rollers' curve is estimated, as the motor's own nights decide. `circuit_samples` are those of
    its oil circuit's file.
    """

    file: MotorFile
    motor_type: MotorTypeFile
    oils: Mapping[str, OilFile]
    settings: Settings
    log_root: Path
    log_url: str = ""
    roller_is_free: bool = False
    circuit_samples: tuple[OilSample, ...] = ()

    def at_output(self, output: Path) -> MotorSpec:
        """The motor with the nights of its database, if it has one, below an output folder."""
        if self.file.logs.database is None:
            return self
        return replace(self, log_root=output / LANDED_FOLDER / self.motor_id, log_url="")

    @property
    def stated(self) -> MotorSpec:
        """The motor as its files state it, the scale of the rollers' curve fixed."""
        return replace(self, roller_is_free=False) if self.roller_is_free else self

    @property
    def motor_id(self) -> str:
        """The motor's id."""
        return self.file.motor_id

    def oil_on(self, night: dt.date) -> OilFile:
        """The oil of a night."""
        return self.oils[self.file.oil_on(night)]

    @property
    def low_side(self) -> LowSide:
        """The low-pressure side in the model: part of it, known and left out, or unknown."""
        model, is_logged = self.settings.model, not LOW_SIDE.isdisjoint(self.file.channels)
        if model.two_sided:
            return "modelled"
        return "known" if is_logged or model.charge_pressure_bar > 0.0 else "unknown"

    def samples_of(self, night: dt.date) -> tuple[OilSample, ...]:
        """Analyses of the filling of a night, later ones too."""
        filled = self.file.filled_on(night)
        samples = self.file.oil_samples or self.circuit_samples
        return tuple(one for one in samples if self.file.filled_on(one.date) == filled)

    def measured_curve(self, night: dt.date) -> Walther | None:
        """Walther constants of a night's oil by its analyses; None: by the data sheet."""
        samples = self.samples_of(night)
        if not samples:
            return None
        return measured_curve(samples, self.oil_on(night), self.file.filled_on(night), night)

    def motor(self, night: dt.date, flushing_mode: str) -> Motor:
        """The motor on a night and under one mode of flushing, with the data sheet's oil."""
        model = self.settings.model
        motor = Motor(
            motor_type=self.motor_type.motor_type,
            paths=(*self.motor_type.paths(), self.file.flushing.path(flushing_mode)),
            oil=self.oil_on(night).oil(),
            film_pressure=FilmPressure(model.film_pressure, model.film_pressure_share),
        )
        return motor.with_free_standard() if self.roller_is_free else motor


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
        return next((spec.log_url for spec in self.motors if spec.log_url), "")

    @property
    def has_log_folder(self) -> bool:
        """True if any motor has logs in the folder of the logs."""
        return any(not (spec.log_url or spec.file.logs.database) for spec in self.motors)

    @property
    def log_place(self) -> str:
        """Where the logs lie, for messages."""
        folder = self.log_root if self.has_log_folder else self.output / LANDED_FOLDER
        return self.log_url or str(folder)

    def at_output(self, output: Path) -> Fleet:
        """The fleet with another output folder, which goes into no object store."""
        motors = tuple(spec.at_output(output) for spec in self.motors)
        return replace(self, output=output, motors=motors, object_store="")


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
    defaults = fleet.defaults if fleet else {}
    motors = _read_folder(places.get("motors"), MotorFile, faults, defaults)
    circuits = _read_folder(_if_there(places.get("oil_circuits")), OilCircuitFile, faults)
    faults += _misnamed("motor_types", "motor_type", types.documents)
    specs = [
        spec
        for name in sorted(motors.documents)
        if (spec := _resolve(name, motors, types, oils, shared, log_root, faults)) is not None
    ]
    specs = [replace(one, circuit_samples=_shared_samples(one.file, circuits)) for one in specs]
    faults += _oil_faults(specs, motors.documents.values(), circuits)
    if not motors.documents and not faults:
        faults.append(Fault(folders.motors, "", "expected at least one motor's file"))
    if faults or fleet is None:
        own = {f"motors/{name}.toml": one for name, one in motors.own.items()}
        raise ConfigError(at_their_place(faults, own, defaults, path.name))
    log_url = folders.logs if is_url(folders.logs) else ""
    found = Fleet(
        name=fleet.name,
        motors=tuple(replace(spec, log_url=log_url).at_output(places["output"]) for spec in specs),
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
    if not fleet.has_log_folder:
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
    for key in ("motors", "motor_types", "oils", "oil_circuits", "logs", "output"):
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
    two_sided = settings.model.is_two_sided(is_logged=not LOW_SIDE.isdisjoint(motor.channels))
    model = settings.model.model_copy(update={"two_sided": two_sided})
    settings = settings.model_copy(update={"model": model})
    if motor.logs.database is not None:
        logs = motor.logs.model_copy(update={"files": LANDED})
        motor = motor.model_copy(update={"logs": logs})
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


def _if_there(folder: Path | None) -> Path | None:
    return folder if folder is not None and folder.is_dir() else None


def _shared_samples(motor: MotorFile, circuits: Folder[OilCircuitFile]) -> tuple[OilSample, ...]:
    circuit = circuits.parsed.get(motor.oil_circuit)
    return () if circuit is None else circuit.oil_samples


def _oil_faults(
    specs: Iterable[MotorSpec],
    motors: Iterable[Document],
    circuits: Folder[OilCircuitFile],
) -> Iterator[Fault]:
    """Faults of analyses that only show beside the oil, the date, or the other file."""
    named = {document.get("oil_circuit") for document in motors}
    for name in circuits.documents:
        if name not in named:
            message = "no motor is of this oil circuit; expected the name that a motor's file has"
            yield Fault(f"oil_circuits/{name}.toml", "", message)
    for spec in specs:
        own, shared = spec.file.oil_samples, spec.circuit_samples
        file = f"motors/{spec.motor_id}.toml"
        if own and shared:
            message = "expected the analyses in this file or in that of the oil circuit, not both"
            yield Fault(file, "oil_samples", message)
        if shared:
            file = f"oil_circuits/{spec.file.oil_circuit}.toml"
        for index, sample in enumerate(own or shared):
            yield from _faults_of_sample(file, ("oil_samples", index), sample, spec)


def _faults_of_sample(
    file: str, place: Place, sample: OilSample, spec: MotorSpec
) -> Iterator[Fault]:
    if sample.date > dt.datetime.now(dt.UTC).date() + dt.timedelta(days=1):
        message = "expected a day that has come: an analysis holds from its date on"
        yield fault_at(file, (*place, "date"), message, sample.date.isoformat())
    oil, at_40 = spec.oil_on(sample.date).oil(), sample.viscosity_40_c_mm2_per_s
    sheet = float(kinematic_viscosity_mm2_per_s(40.0, oil.walther_a, oil.walther_b))
    if at_40 is not None and not 1.0 / FURTHEST <= at_40 / sheet <= FURTHEST:
        message = (
            f"expected {sheet / FURTHEST:.3g} to {FURTHEST * sheet:.3g}, as {oil.name} has "
            f"{sheet:.3g}; another oil is an event"
        )
        yield fault_at(file, (*place, "viscosity_40_c_mm2_per_s"), message, at_40)


def _texts_for_times(file: str, document: Document) -> Iterator[Fault]:
    """Dates and times in quotation marks: TOML has types of its own for them."""
    periods = document.get("periods")
    for key in ("events", "oil_samples"):
        dated = document.get(key)
        for index, one in enumerate(dated if isinstance(dated, list) else ()):
            given = one.get("date") if isinstance(one, dict) else None
            if _is_time(given):
                message = "expected a date without quotation marks, such as 2026-09-01"
                yield fault_at(file, (key, index, "date"), message, given)
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


def _read_folder(
    folder: Path | None,
    model: type[Model],
    faults: list[Fault],
    defaults: Document | None = None,
) -> Folder[Model]:
    """All TOML files of a folder; none where it cannot be, which is told already."""
    if folder is None:
        return Folder({}, {}, {})
    if not folder.is_dir():
        faults.append(Fault(folder.name, "", f"expected a folder at {folder}"))
        return Folder({}, {}, {})
    own: dict[str, Document] = {}
    documents: dict[str, Document] = {}
    parsed: dict[str, Model] = {}
    for path in sorted(folder.glob("*.toml")):
        file, name = f"{folder.name}/{path.name}", path.stem
        document = _read_toml(path, file, faults)
        own[name] = document or {}
        documents[name] = completed(own[name], defaults or {}, name)
        content = None
        if document is not None:
            content = _validate(model, documents[name], file, faults)
        if content is not None:
            parsed[name] = content
    return Folder(own, documents, parsed)


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
