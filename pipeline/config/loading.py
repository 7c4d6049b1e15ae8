"""Read all config files of a fleet and report every fault of every file at once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from pipeline.config.cross_checks import (
    claimed_twice,
    faults_of_channels,
    impossible,
    misnamed,
    oil_faults,
    strangers,
)
from pipeline.config.defaults import Document, at_their_place
from pipeline.config.execution import Folders
from pipeline.config.faults import ConfigError, Fault, fault_at
from pipeline.config.files import Folder, read_folder, read_toml, validated
from pipeline.config.fleet import LOW_SIDE, Fleet, MotorSpec, absolute, is_url, overlap
from pipeline.config.motor_types import MotorTypeFile, OilFile
from pipeline.config.motors import MotorFile
from pipeline.config.oil_samples import OilCircuitFile
from pipeline.config.settings import FleetFile, Settings


def load_fleet(path: Path) -> Fleet:
    """Read a fleet file and all files that it leads to; motors are sorted by id, fully resolved.

    Raises ConfigError with every fault of every file, those of the motors too where the fleet file
    has one.
    """
    faults: list[Fault] = []
    document = read_toml(path, path.name, faults)
    if document is None:
        raise ConfigError(faults)
    fleet = validated(FleetFile, document, path.name, faults)
    # The other files are looked at although this one has faults.
    known = validated(Folders, document.get("folders", {}), path.name, [])
    folders = fleet.folders if fleet else known or Folders()
    # Settings with faults would be reported again for each motor that overrides any.
    given = {key: document[key] for key in Settings.model_fields if fleet and key in document}
    shared = _SharedSettings(given)
    places = dict(_places(path, folders, faults))
    if not places.get("oil_circuits", path).is_dir():
        places.pop("oil_circuits", None)
    log_root = places.get("logs", path.parent)
    types = read_folder(places.get("motor_types"), MotorTypeFile, faults)
    oils = read_folder(places.get("oils"), OilFile, faults)
    defaults = fleet.defaults if fleet else {}
    motors = read_folder(places.get("motors"), MotorFile, faults, defaults)
    circuits = read_folder(places.get("oil_circuits"), OilCircuitFile, faults)
    faults += misnamed("motor_types", "motor_type", types.documents)
    specs = []
    for name in sorted(motors.documents):
        spec = _resolve(name, motors, types, oils, shared, log_root, faults)
        if spec is not None:
            circuit = circuits.parsed.get(spec.file.oil_circuit, OilCircuitFile())
            specs.append(replace(spec, circuit_samples=circuit.oil_samples))
    faults += claimed_twice(specs)
    faults += oil_faults(specs, motors.documents.values(), circuits)
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


def _resolve(
    name: str,
    motors: Folder[MotorFile],
    types: Folder[MotorTypeFile],
    oils: Folder[OilFile],
    shared: _SharedSettings,
    log_root: Path,
    faults: list[Fault],
) -> MotorSpec | None:
    """One motor's file brought together with what it names."""
    if not motors.own[name]:  # not read, or empty: told already
        return None
    file, document = f"motors/{name}.toml", motors.documents[name]
    before = len(faults)
    faults += misnamed("motors", "motor_id", {name: document})
    faults += strangers(file, document, types.documents, oils.documents)
    if name not in motors.parsed:
        faults += faults_of_channels(file, document)
    motor, motor_type = motors.parsed.get(name), types.parsed.get(document.get("motor_type", ""))
    is_logged = motor is not None and not LOW_SIDE.isdisjoint(motor.channels)
    settings = shared.of_motor(document.get("override"), file, faults, is_logged=is_logged)
    if len(faults) > before or not motor or not settings or not motor_type:
        return None
    if motor.logs.database is not None:
        logs = motor.logs.model_copy(update={"files": ("*.parquet",)})
        motor = motor.model_copy(update={"logs": logs})
    spec = MotorSpec(motor, motor_type, oils.parsed, settings, log_root)
    faults += impossible(file, spec)
    return spec


class _SharedSettings:
    """The fleet's settings; motors that override none of them have the same object."""

    def __init__(self, document: Document) -> None:
        self._document = document
        self._of_all: dict[bool, Settings | None] = {}

    def of_motor(
        self, override: Any, file: str, faults: list[Fault], *, is_logged: bool
    ) -> Settings | None:
        """Settings of a motor; `is_logged`: the pressure of its low side is."""
        if override:
            return self._with(override, file, faults, is_logged=is_logged)
        if is_logged not in self._of_all:
            self._of_all[is_logged] = self._with({}, file, faults, is_logged=is_logged)
        return self._of_all[is_logged]

    def _with(
        self, override: Any, file: str, faults: list[Fault], *, is_logged: bool
    ) -> Settings | None:
        """The settings with a motor's own in their place."""
        shared, merged = self._document, dict(self._document)
        for section, values in override.items() if isinstance(override, dict) else ():
            whole = isinstance(values, dict) and isinstance(shared.get(section, {}), dict)
            merged[section] = {**shared.get(section, {}), **values} if whole else values
        settings = validated(Settings, merged, file, faults, prefix="override.")
        if settings is None:
            return None
        two_sided = settings.model.is_two_sided(is_logged=is_logged)
        model = settings.model.model_copy(update={"two_sided": two_sided})
        return settings.model_copy(update={"model": model})
