"""Hashes of settings: a change makes the reading, the statistics, or their figures out of date.

Each stage has a hash of the settings that shape it. A night whose statistics were shaped by others
is read again; one whose figures alone were is fitted again from its stored statistics, without a
log.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import version
from typing import Any

from leakage import Motor
from pipeline.config.fleet import MotorSpec
from pipeline.config.nights import night as night_labelled
from pipeline.config.readers import reader_entry, reader_version

# Raise it when the code makes other statistics of the same samples: old blocks then never merge
# with new ones.
STATISTICS_VERSION = 2

WORDS_AND_TOLERANCES = {
    "name",
    "source",
    "pressure_viscosity_tolerance_percent",
    "density_tolerance_percent",
    "offset_tolerance",
    "gain_tolerance_percent",
}
# Keys of logs that say nothing of what is read: another query shows in the nights' content.
NOT_OF_CONTENT = {"settle_s", "database"}
# Where a channel stands in its log, which says nothing of its values.
WHERE_IT_STANDS = {"field", "value_column"}
# Raise it when the code makes other figures of the same statistics: every night is then refitted.
FIGURES_VERSION = 5
# Raise it when a reader makes other samples of the same file.
READING_VERSION = 2

WORDS = {"source", "note"}
# Of changed settings, so many are named.
SETTINGS_NAMED = 4
# Sections that shape trends and alarms alone: no night is made anew for them.
OF_TRENDS = ("trend.", "alarms.")
# Settings that shape no figure of a night: how people are told, looks within the day, and those of
# the audit that `fit` makes.
UNSHAPING: Mapping[str, Any] = {
    "estimation": {
        "starting_points",
        "step_tolerance",
        "function_tolerance",
        "maximum_iterations",
    },
    "alarms": {"command", "webhook_url", "webhook_headers", "webhook_secret", "email"},
    "look": True,
}
# Key of a motor whose rollers' scale is free.
ROLLER = "roller"
TOLERANCES = {"offset_tolerance", "gain_tolerance_percent"}


@cache
def own_version() -> str:
    """Version of motor-leakage."""
    return version("motor-leakage")


def settings_of(spec: MotorSpec) -> dict[str, Any]:
    """All settings of a motor as a JSON document: what a run before had, to name what changed."""
    versions = {"reading": READING_VERSION, "statistics": STATISTICS_VERSION}
    return _document(spec) | {"versions": versions | {"figures": FIGURES_VERSION}}


def why_anew(before: Mapping[str, Any], now: Mapping[str, Any], *, trends: bool = False) -> str:
    """Reason in words to redo nights or trends: the settings that changed.

    Examples
    --------
    >>> why_anew({"versions": {"figures": 1}}, {"versions": {"figures": 2}, "trend": {"x": 3}})
    'another version of the program (figures 1 to 2)'
    >>> why_anew({"settings": {"trend": {"x": 2}}}, {"settings": {"trend": {"x": 3}}}, trends=True)
    'changed setting trend.x'
    >>> why_anew({"trend.x": "2"}, {"settings": {"trend": {"x": 2}}})
    'changed settings'
    """
    # Without a record, or with one of a version that kept them as text.
    if all(isinstance(one, str) for one in before.values()):
        return "changed settings"
    old, new = dict(_flat("", before)), dict(_flat("", now))
    changed = [
        key
        for key in sorted(old.keys() | new.keys())
        if old.get(key) != new.get(key) and (trends or not key.startswith(OF_TRENDS))
    ]
    versions = [key for key in changed if key.startswith("versions.")]
    settings = [key for key in changed if key not in versions]
    steps = [
        f"{key.removeprefix('versions.')} {old.get(key, '?')} to {new.get(key, '?')}"
        for key in versions
    ]
    parts = [f"another version of the program ({', '.join(steps)})"] if steps else []
    if settings:
        more = ", …" if len(settings) > SETTINGS_NAMED else ""
        parts.append(f"changed setting {', '.join(settings[:SETTINGS_NAMED])}{more}")
    return "; ".join(parts) or "changed settings"


def _flat(prefix: str, value: object) -> Iterator[tuple[str, str]]:
    """Settings by dotted key, as text."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _flat(f"{prefix}.{key}" if prefix else str(key), inner)
    elif isinstance(value, list) and value and isinstance(value[0], dict):
        for number, inner in enumerate(value):
            yield from _flat(f"{prefix}.{inner.get('name', number)}", inner)
    else:
        yield prefix.removeprefix("settings.").removeprefix("motor."), json.dumps(value)


def config_hash(spec: MotorSpec) -> str:
    """Hash of all that shapes a motor's figures; not of how the work is spread, or where."""
    return hash_of(_document(spec))


def _document(spec: MotorSpec) -> dict[str, Any]:
    return {
        "versions": (READING_VERSION, FIGURES_VERSION),
        "motor": spec.file.model_dump(
            mode="json",
            exclude={
                "override": True,
                "events": {"__all__": {"note"}},
                "oil_samples": {"__all__": {"note"}},
                "logs": NOT_OF_CONTENT,
            },
        ),
        "type": spec.motor_type.model_dump(mode="json"),
        "oils": {name: oil.model_dump(mode="json") for name, oil in sorted(spec.oils.items())},
        "circuit_samples": [
            one.model_dump(mode="json", exclude={"note"}) for one in spec.circuit_samples
        ],
        "settings": spec.settings.model_dump(mode="json", exclude=dict(UNSHAPING)),
        **_roller(spec),
        **_reader(spec),
    }


def _reader(spec: MotorSpec) -> dict[str, str]:
    """Version of an installed reader; nothing for a built-in one."""
    version = reader_version(reader_entry(spec.file.logs.format))
    return {"reader": version} if version else {}


def _roller(spec: MotorSpec) -> dict[str, str]:
    """How the scale of the rollers' curve is fitted; nothing where it is fixed."""
    return {ROLLER: "free"} if spec.roller_is_free else {}


def reading_hash(spec: MotorSpec) -> str:
    """Hash of how a log's content is understood: its dialect, its channels, and what a night is."""
    return hash_of(
        {
            "version": READING_VERSION,
            "logs": spec.file.logs.model_dump(mode="json", exclude=NOT_OF_CONTENT | {"files"}),
            "channels": {
                name: channel.model_dump(mode="json", exclude=TOLERANCES)
                for name, channel in spec.file.channels.items()
            },
            "nights": spec.settings.nights.model_dump(mode="json"),
            **_reader(spec),
        }
    )


@dataclass(slots=True)
class SettingsHashes:
    """Hashes of the settings that shape a motor's nights; a night's oil and periods are dated."""

    spec: MotorSpec
    _statistics: dict[object, str] = field(default_factory=dict)
    _figures: dict[object, str] = field(default_factory=dict)

    def statistics(self, night: dt.date) -> str:
        """Hash of all that shapes a night's statistics, from its samples on."""
        spec = self.spec
        by_hand = spec.file.periods.within(night_labelled(night, spec.settings.nights))
        key = (spec.file.oil_on(night), by_hand)
        if key not in self._statistics:
            motor = spec.stated.motor(night, spec.file.flushing.mode)
            self._statistics[key] = hash_of(
                {
                    "model_hash": model_hash(spec, motor, night),
                    # The least minutes shape no statistics; the hash is that of 15, the default
                    # until version 6, so that no log is read anew for them.
                    "windows": spec.settings.windows.model_dump(mode="json")
                    | {"minimum_training_minutes": 15.0},
                    "sensor_health": spec.settings.sensor_health.model_dump(mode="json"),
                }
            )
        return self._statistics[key]

    def figures(self, night: dt.date) -> str:
        """Hash of all that shapes the figures that are made from a night's statistics."""
        spec = self.spec
        measured = spec.measured_curve(night)
        key = (spec.file.oil_on(night), measured)
        if key not in self._figures:
            settings = spec.settings
            self._figures[key] = hash_of(
                {
                    "version": FIGURES_VERSION,
                    "type": spec.motor_type.model_dump(mode="json", exclude={"limits"}),
                    "oil": spec.oil_on(night).model_dump(mode="json", exclude=WORDS),
                    "flushing": spec.file.flushing.model_dump(mode="json"),
                    "channels": {
                        name: (
                            channel.resolution,
                            channel.offset_tolerance,
                            channel.gain_tolerance_percent,
                        )
                        for name, channel in spec.file.channels.items()
                    },
                    "estimation": settings.estimation.model_dump(mode="json"),
                    "minimum_training_minutes": settings.windows.minimum_training_minutes,
                    "reference": settings.reference.model_dump(mode="json"),
                    "model": settings.model.model_dump(mode="json"),
                    **_roller(spec),
                }
                | ({} if measured is None else {"measured_oil": measured})
            )
        return self._figures[key]


def model_hash(spec: MotorSpec, motor: Motor, night: dt.date) -> str:
    """Hash of all that shapes the statistics of a night; blocks of different hash never merge.

    Counts, radii, lengths and bounds of free gaps are left out: they scale loss factors into gap
    heights and leave the columns as they are. So are tolerances and words.
    """
    free = {path.name for path in motor.column_paths}
    paths = [
        {"name": declared.name}
        | declared.model_dump(
            exclude=WORDS_AND_TOLERANCES
            | declared.tolerance_keys
            | (declared.scale_keys if declared.name in free else frozenset())
        )
        for declared in spec.motor_type.path
    ]
    settings = spec.settings.model_dump(
        include={
            "nights",
            "time_base",
            "cleaning",
            "transport_delay",
            "smoothing",
            "windows",
            "model",
            "estimation",
        },
        exclude={
            "windows": {
                "minimum_kept_share",
                "minimum_training_minutes",
                "minimum_pressure_spread_bar",
                "minimum_speed_spread_rpm",
                "minimum_temperature_spread_c",
            },
            "model": {
                "film_pressure_share_tolerance",
                "charge_pressure_tolerance_bar",
                "roller_scale",
            },
            "estimation": set(type(spec.settings.estimation).model_fields) - {"loss"},
        },
    )
    document: dict[str, Any] = {
        "version": STATISTICS_VERSION,
        "columns": motor.columns,
        "paths": paths,
        "oil": spec.oil_on(night).model_dump(exclude=WORDS_AND_TOLERANCES),
        "settings": settings,
        "channels": {
            name: channel.model_dump(exclude=WORDS_AND_TOLERANCES | WHERE_IT_STANDS)
            for name, channel in spec.file.channels.items()
        },
    }
    by_hand = spec.file.periods.within(night_labelled(night, spec.settings.nights))
    if settings["estimation"]["loss"] == "huber":
        document["weights"] = "of all kept samples"
    if by_hand:
        document["periods"] = [by_hand.training, by_hand.validation]
    return hash_of(document)


def hash_of(document: Mapping[str, Any]) -> str:
    """Short hash of a JSON document, the same on every machine."""
    text = json.dumps(document, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
