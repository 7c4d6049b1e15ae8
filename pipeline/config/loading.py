"""Read all config files of a fleet and report every fault of every file at once.

Some faults no file shows alone: names of other files, and figures that do not go together.
"""

from __future__ import annotations

import datetime as dt
import errno
import json
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, Generic, TypeVar

from pydantic import BaseModel, ValidationError

from leakage import LeakageError, leakage_l_per_min
from leakage.physics.oil import kinematic_viscosity_mm2_per_s
from pipeline.config.channels import COUNTED
from pipeline.config.fleet import Fleet, MotorSpec, absolute, is_url, overlap
from pipeline.config.motor_types import FURTHEST, MotorTypeFile, OilCircuitFile, OilFile
from pipeline.config.motors import MotorFile
from pipeline.config.section import ConfigError, Fault, Section, fault_at, fault_of
from pipeline.config.settings import FleetFile, Folders, Settings

# Bytes of a config file.
LARGEST = 8 * 2**20
# Channels that tell the pressure of the low side.
LOW_SIDE = {"charge_pressure", "low_port_pressure"}
NAME_MARK = "{name_in_log}"
"""Stands in texts of the defaults for the motor's name as its log writes it."""

Document = Mapping[str, Any]
Model = TypeVar("Model", bound=BaseModel)


def load_fleet(path: Path) -> Fleet:
    """Read a fleet file and all files that it leads to; motors are sorted by id, fully resolved.

    Raises ConfigError with every fault of every file, those of the motors too where the fleet file
    has any.
    """
    faults: list[Fault] = []
    document = read_toml(path, path.name if path.is_file() else str(path), faults)
    if document is None:
        raise ConfigError(faults)
    fleet = validate(FleetFile, document, path.name, faults)
    # The other files are looked at although this file has faults.
    readable = validate(Folders, document.get("folders", {}), path.name, [])
    folders = fleet.folders if fleet else readable or Folders()
    places = dict(_places(path, folders, faults))
    types = _read_folder(places.get("motor_types"), MotorTypeFile, faults)
    oils = _read_folder(places.get("oils"), OilFile, faults)
    stated = document.get("defaults")
    defaults = stated if isinstance(stated, Mapping) else {}
    known = {"defaults": defaults, "motor_types": types.documents, "oils": oils.documents}
    motors = _read_folder(places.get("motors"), MotorFile, faults, **known)
    circuits = _read_folder(places.get("oil_circuits"), OilCircuitFile, faults)
    # Settings with faults would be reported again for each motor that overrides any.
    shared = {key: document[key] for key in Settings.model_fields if fleet and key in document}
    log_root = places.get("logs", path.parent)
    log_url = folders.logs if is_url(folders.logs) else ""
    specs: list[MotorSpec] = []
    alike: dict[str, Settings] = {}
    for name, its in sorted(motors.documents.items()):
        file, motor = f"motors/{name}.toml", motors.parsed.get(name)
        own, low = its.get("override"), motor and not LOW_SIDE.isdisjoint(motor.channels)
        # Motors of the same settings share them.
        key = json.dumps((own, low), default=str)
        settings = alike.get(key) or _settings(shared, own, file, faults, is_two_sided=bool(low))
        motor_type = types.parsed.get(motor.motor_type) if motor else None
        # Of a type or an oil with a fault no motor can be made.
        if motor and settings and motor_type and oils.parsed.keys() >= {*motor.oils}:
            alike[key] = settings
            circuit = circuits.parsed.get(motor.oil_circuit, OilCircuitFile())
            spec = MotorSpec(
                motor, motor_type, oils.parsed, settings, log_root, log_url,
                circuit_samples=circuit.oil_samples,
            )  # fmt: skip
            faults += _oil_faults(file, spec)
            specs.append(spec)
    faults += [*_impossible(specs), *_claimed_twice(specs)]
    # A motor's file that cannot be read may be of any circuit.
    if all(motors.own.values()):
        known_circuits = {its.get("oil_circuit") for its in motors.documents.values()}
        for name in sorted(circuits.documents.keys() - known_circuits):
            message = "no motor is of this oil circuit; expected the name that a motor's file has"
            faults.append(Fault(f"oil_circuits/{name}.toml", "", message))
    if not motors.documents and not faults:
        faults.append(Fault("motors", "", "expected at least one motor's file"))
    if faults or fleet is None:
        own = {f"motors/{name}.toml": document for name, document in motors.own.items()}
        raise ConfigError(_at_their_place(faults, own, defaults, path.name))
    output, textfile = places["output"], fleet.metrics.textfile
    loaded = Fleet(
        name=fleet.name,
        motors=tuple(specs),
        execution=fleet.execution,
        log_root=log_root,
        output=output,
        settings=fleet,
        copy_to=folders.copy_to,
        metrics_file=path.absolute().parent / textfile if textfile else None,
        log_url=log_url,
        formerly=fleet.formerly,
        is_live=fleet.live,
    )
    if (expected := overlap(loaded)) is not None:
        raise ConfigError([fault_at(path.name, ("folders", "output"), expected, folders.output)])
    return loaded


def _places(path: Path, folders: Folders, faults: list[Fault]) -> Iterator[tuple[str, Path]]:
    """Yield the folders of a fleet file by key, without those that cannot be."""
    for key in ("motors", "motor_types", "oils", "oil_circuits", "logs", "output"):
        given = getattr(folders, key, key)
        place = Path("out") if given is None else path.parent / given
        if key == "logs" and is_url(given):
            place = path.parent
        try:
            place = absolute(place)
        except ValueError as error:
            message = f"expected a folder: {error}"
            faults.append(fault_at(path.name, ("folders", key), message, given))
        else:
            if key != "oil_circuits" or place.is_dir():
                yield key, place


class _Override(Section):
    override: Settings


def _settings(
    shared: Document, override: Any, file: str, faults: list[Fault], *, is_two_sided: bool
) -> Settings | None:
    """Return the fleet's settings with a motor's own; None where they have a fault."""
    merged = _merge(override if isinstance(override, dict) else {}, shared)
    checked = validate(_Override, {"override": merged}, file, faults)
    if checked is None:
        return None
    settings = checked.override
    model = settings.model
    if model.two_sided is None:
        model = model.model_copy(update={"two_sided": is_two_sided})
    return settings.model_copy(update={"model": model})


# Faults that no file shows alone


def _oil_faults(file: str, spec: MotorSpec) -> Iterator[Fault]:
    """Yield faults of analyses that only show beside the oil, the date, or the other file."""
    if spec.file.oil_samples and spec.circuit_samples:
        message = "expected the analyses in this file or in that of the oil circuit, not both"
        yield Fault(file, "oil_samples", message)
    if spec.circuit_samples:
        file = f"oil_circuits/{spec.file.oil_circuit}.toml"
    tomorrow = dt.datetime.now(dt.UTC).date() + dt.timedelta(days=1)
    for index, sample in enumerate(spec.file.oil_samples or spec.circuit_samples):
        place = ("oil_samples", index)
        if sample.date > tomorrow:
            message = "expected a day that has come: an analysis holds from its date on"
            yield fault_at(file, (*place, "date"), message, sample.date.isoformat())
        oil, at_40 = spec.oil_on(sample.date).oil(), sample.viscosity_40_c_mm2_per_s
        sheet = float(kinematic_viscosity_mm2_per_s(40.0, oil.walther_a, oil.walther_b))
        if not 1.0 / FURTHEST <= at_40 / sheet <= FURTHEST:
            message = (
                f"expected {sheet / FURTHEST:.3g} to {FURTHEST * sheet:.3g}, as {oil.name} has "
                f"{sheet:.3g}; another oil is an event"
            )
            yield fault_at(file, (*place, "viscosity_40_c_mm2_per_s"), message, at_40)


def _claimed_twice(specs: Iterable[MotorSpec]) -> Iterator[Fault]:
    """Yield motors that take their drain flow from the same place, or whose files' names clash."""
    first: dict[object, str] = {}
    for spec in specs:
        for of_what in ("motor_id", "oil_circuit"):
            name = getattr(spec.file, of_what)
            other = first.setdefault((of_what, name.lower()), name)
            if other != name:
                message = f"expected another name than {other}: it differs by case alone"
                yield fault_at(f"motors/{spec.motor_id}.toml", (of_what,), message, name)
        flow, logs = spec.file.channels[COUNTED], spec.file.logs
        place = (logs.files, logs.motor_rows, flow.source, flow.field)
        other = first.setdefault(place, spec.motor_id)
        if other != spec.motor_id:
            message = (
                f"expected logs or a column of its own: this is the drain flow of {other}, too"
            )
            key = ("channels", COUNTED, "source")
            yield fault_at(f"motors/{spec.motor_id}.toml", key, message, flow.source)


def _impossible(specs: Iterable[MotorSpec]) -> Iterator[Fault]:
    """Yield faults that only show when type, oil, flushing and settings come together."""
    possible: set[object] = set()  # what goes together is not tried again for the next motor
    for spec in specs:
        file, settings = spec.file, spec.settings
        for name, mode in product(file.oils, file.flushing.modes):
            together = file.motor_type, name, mode, file.flushing, id(settings)
            try:
                if together not in possible:
                    at = settings.reference.conditions().operating
                    leakage_l_per_min(spec.motor_with(spec.oils[name], mode), at)
                possible.add(together)
            except LeakageError as error:
                yield Fault(f"motors/{spec.motor_id}.toml", "", f"with {name}: {error}")


# Files


@dataclass(frozen=True, slots=True)
class _Folder(Generic[Model]):
    """The TOML files of a folder by name without ending."""

    own: dict[str, Document]  # content of every file there is; empty where it cannot be read
    documents: dict[str, Document]  # the same with the fleet's defaults
    parsed: dict[str, Model]  # those without a fault


def _read_folder(
    folder: Path | None, model: type[Model], faults: list[Fault], **context: Document
) -> _Folder[Model]:
    """Return all TOML files of a folder; none where it cannot be read, which is reported."""
    files: _Folder[Model] = _Folder({}, {}, {})
    paths: list[Path] = []
    if folder is not None:
        try:
            # A hidden file, as macOS leaves beside each, is none of the fleet's.
            shown = (path for path in folder.iterdir() if not path.name.startswith("."))
            paths = sorted(path for path in shown if path.suffix == ".toml")
        except PermissionError as error:
            faults.append(Fault(folder.name, "", f"cannot be read: {error.strerror}"))
        except OSError:
            faults.append(Fault(folder.name, "", f"expected a folder at {folder}"))
    for path in paths:
        file, name = f"{path.parent.name}/{path.name}", path.stem
        document = read_toml(path, file, faults)
        files.own[name] = document or {}
        files.documents[name] = complete(document or {}, context.get("defaults", {}), name)
        if document is not None and (
            content := validate(model, files.documents[name], file, faults, stem=name, **context)
        ):
            files.parsed[name] = content
    return files


def read_toml(path: Path, file: str, faults: list[Fault]) -> dict[str, Any] | None:
    """Return content of a TOML file; None if it has a fault."""
    try:
        # Windows' editors begin a file with a byte order mark.
        document = tomllib.loads(_content(path).decode("utf-8-sig"))
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


def _content(path: Path) -> bytes:
    """Return all of a file. Raises OSError for a huge file, a pipe or a device."""
    if not (path.is_file() or path.is_dir()) and path.exists():
        raise OSError(errno.EINVAL, "is no regular file")
    with path.open("rb") as stream:
        content = stream.read(LARGEST + 1)
    if len(content) > LARGEST:
        raise OSError(errno.EFBIG, f"is larger than {LARGEST // 2**20} MiB")
    return content


def validate(
    model: type[Model], document: Document, file: str, faults: list[Fault], **context: Any
) -> Model | None:
    """Return model of a file's content; None if it has a fault. `context`: what its fields know."""
    try:
        # By way of JSON: strict validation then still takes arrays as tuples and text as dates.
        return model.model_validate_json(json.dumps(document, default=str), context=context)
    except ValidationError as error:
        faults += [fault_of(detail, file, document) for detail in error.errors()]
    return None


# `[defaults]` of the fleet file: what its motors' files have in common


def complete(own: Document, defaults: Document, name: str) -> dict[str, Any]:
    """Return a motor's file with the defaults where it says nothing; `name` is the file's.

    Tables are merged key by key; a channel's that names its source or a constant stands alone.

    Examples
    --------
    >>> complete({"oil": "vg46"}, {"oil": "vg68", "logs": {"files": ["{name_in_log}/*"]}}, "W1")
    {'oil': 'vg46', 'logs': {'files': ['W1/*']}}
    """
    known = own.get("name_in_log")
    return _merge(own, with_name(defaults, known if isinstance(known, str) and known else name))


def _merge(own: Document, defaults: Document) -> dict[str, Any]:
    merged = dict(defaults)
    for key, value in own.items():
        below = defaults.get(key)
        is_part = isinstance(value, Mapping) and isinstance(below, Mapping) and not _is_whole(value)
        merged[key] = _merge(value, below or {}) if is_part else value
    return merged


def _is_whole(value: object) -> bool:
    """Return True for a channel's table, which takes nothing from the defaults."""
    return isinstance(value, Mapping) and bool({"source", "constant"} & value.keys())


def with_name(value: Any, name: str) -> Any:
    """Return a table, list or text with a motor's name in the mark's place."""
    if isinstance(value, Mapping):
        return {key: with_name(inner, name) for key, inner in value.items()}
    if isinstance(value, list):
        return [with_name(inner, name) for inner in value]
    return value.replace(NAME_MARK, name) if isinstance(value, str) else value


def _at_their_place(
    faults: Iterable[Fault], own: Mapping[str, Document], defaults: Document, fleet_file: str
) -> Iterator[Fault]:
    """Yield faults of motors' files, at the fleet file where the defaults have the key."""
    for fault in faults:
        parts = fault.key.split(".")
        is_own = fault.file not in own or _depth(own[fault.file], parts) >= _depth(defaults, parts)
        yield fault if is_own else Fault(fleet_file, f"defaults.{fault.key}", fault.message)


def _depth(document: Any, parts: list[str]) -> int:
    """Return how many steps of a key there are; what a whole table lacks is not the defaults'."""
    for depth, part in enumerate(parts):
        if not isinstance(document, Mapping) or part not in document:
            return depth
        document = document[part]
        if _is_whole(document):
            break
    return len(parts)
