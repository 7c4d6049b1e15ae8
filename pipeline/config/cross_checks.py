"""Faults that no file shows alone: names of other files, and figures that do not go together."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from pipeline.config.channels import COUNTED
from pipeline.config.faults import Fault, fault_at
from pipeline.config.fleet import MotorSpec
from pipeline.config.oil_samples import FURTHEST


def strangers(
    file: str, document: Mapping[str, Any], types: Iterable[str], oils: Iterable[str]
) -> Iterator[Fault]:
    """Names of motor types and oils that there are not; other faults of the file do not matter."""
    events = document.get("events")
    named = [("motor_type", document, types), ("oil", document, oils)]
    named += [
        (f"events.{index}.oil", event, oils)
        for index, event in enumerate(events if isinstance(events, list) else ())
        if isinstance(event, dict)
    ]
    for key, table, known in named:
        given = table.get(key.rpartition(".")[2])
        if isinstance(given, str) and given not in known:
            choice = ", ".join(sorted(known)) or "those in its folder, which has none"
            yield fault_at(file, (key,), f"expected one of {choice}", given)


def oil_faults(
    specs: Iterable[MotorSpec], motors: Iterable[Mapping[str, Any]], circuits: Iterable[str]
) -> Iterator[Fault]:
    """Faults of analyses that only show beside the oil, the date, or the other file."""
    named = [document.get("oil_circuit") for document in motors]
    for name in circuits:
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
        yield from _faults_of_samples(file, spec)


def _faults_of_samples(file: str, spec: MotorSpec) -> Iterator[Fault]:
    from leakage.physics.walther import kinematic_viscosity_mm2_per_s

    tomorrow = dt.datetime.now(dt.UTC).date() + dt.timedelta(days=1)
    for index, sample in enumerate(spec.file.oil_samples or spec.circuit_samples):
        place = ("oil_samples", index)
        if sample.date > tomorrow:
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


def claimed_twice(specs: Iterable[MotorSpec]) -> Iterator[Fault]:
    """Motors that take their drain flow from one place."""
    first: dict[object, str] = {}
    for spec in specs:
        flow, logs = spec.file.channels[COUNTED], spec.file.logs
        query = logs.database and (logs.database.connection, logs.database.query)
        place = (query or logs.files, logs.motor_name, flow.source, flow.field, flow.value_column)
        other = first.setdefault(place, spec.motor_id)
        if other != spec.motor_id:
            message = (
                f"expected logs or a column of its own: this is the drain flow of {other}, too"
            )
            key = ("channels", COUNTED, "source")
            yield fault_at(f"motors/{spec.motor_id}.toml", key, message, flow.source)


def impossible(file: str, spec: MotorSpec) -> Iterator[Fault]:
    """Faults that only show when type, oil, flushing and settings come together."""
    from leakage import LeakageError, leakage_l_per_min

    conditions = spec.settings.reference.conditions().operating
    oils = {spec.file.oil, *(event.oil for event in spec.file.events)}
    for name in sorted(spec.oils.keys() & oils):
        for mode in spec.file.flushing.modes:
            try:
                leakage_l_per_min(spec.motor_with(spec.oils[name], mode), conditions)
            except LeakageError as error:
                yield Fault(file, "", f"with {name}: {error}")
