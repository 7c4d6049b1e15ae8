"""Hashes of settings: a change makes the reading, the statistics, or their figures out of date.

Each stage has a hash of the settings that name it (`section.Stage`). A night whose statistics were
shaped by others is read again; a night whose figures alone were is fitted again from its stored
statistics, without a log.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property
from importlib.metadata import version
from typing import Any

from leakage import Motor
from leakage.estimation.blocks import ChosenPeriods
from pipeline.config.fleet import MotorSpec
from pipeline.config.logs import reader_entry, reader_version
from pipeline.config.nights import night as night_labelled
from pipeline.config.section import Stage

# Raised when the code makes other samples of the same file; other statistics of the same
# samples, so that old blocks never merge with new ones; other figures of the same statistics.
READING_VERSION = 2
STATISTICS_VERSION = 3
FIGURES_VERSION = 6

ALL = ~Stage.NOTHING
# Keys of what a motor's nights decided of it: on the scale of its rollers, beside its settings, and
# on its drain flow's delay.
ROLLER, DRAIN_DELAY = "roller", "drain_delay_s"
# Of changed settings, so many are named.
SETTINGS_NAMED = 4


def hash_of(document: Mapping[str, Any]) -> str:
    """Return short hash of a JSON document, the same on every machine."""
    text = json.dumps(document, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


@cache
def own_version() -> str:
    """Return version of motor-leakage."""
    return version("motor-leakage")


def shaping(spec: MotorSpec, stage: Stage) -> dict[str, Any]:
    """Return all settings of a motor that a stage needs, of whichever file and date."""
    reader = reader_version(reader_entry(spec.file.logs.format))
    return {
        **spec.settings.shaping(stage),
        **spec.file.shaping(stage),
        "type": spec.motor_type.shaping(stage),
        "oils": {name: part for name, oil in spec.oils.items() if (part := oil.shaping(stage))},
        "circuit_samples": [
            part for sample in spec.circuit_samples if (part := sample.shaping(stage))
        ],
        **({"reader": reader} if reader and Stage.READING & stage else {}),
        **({ROLLER: "free"} if spec.roller_is_free and Stage.FIGURES & stage else {}),
    }


def config_hash(spec: MotorSpec) -> str:
    """Return hash of all that shapes a motor's figures; not of how the work is spread, or where."""
    return hash_of({"versions": (READING_VERSION, FIGURES_VERSION), **shaping(spec, ALL)})


def reading_hash(spec: MotorSpec) -> str:
    """Return hash of how a log's content is understood: dialect, channels, and what a night is."""
    parts = {key: part for key, part in shaping(spec, Stage.READING).items() if part}
    return hash_of({"version": READING_VERSION, **parts})


def model_hash(spec: MotorSpec, motor: Motor, night: dt.date) -> str:
    """Return hash of what shapes a night's statistics; blocks of different hash never merge."""
    free = {path.name for path in motor.column_paths}
    settings = spec.settings.shaping(Stage.BLOCKS)
    by_hand = _chosen_periods(spec, night)
    document = {
        "version": STATISTICS_VERSION,
        "columns": motor.columns,
        "paths": [
            path.shaping(Stage.BLOCKS if path.name in free else Stage.BLOCKS | Stage.SCALE)
            for path in spec.motor_type.path
        ],
        "oil": spec.oil_on(night).shaping(Stage.BLOCKS),
        "settings": settings,
        "channels": spec.file.shaping(Stage.BLOCKS)["channels"],
    }
    if by_hand:
        document["periods"] = [by_hand.training, by_hand.validation]
    return hash_of(document)


def _chosen_periods(spec: MotorSpec, night: dt.date) -> ChosenPeriods:
    """Return periods of a night that are chosen by hand."""
    periods = spec.file.periods
    if not periods.training and not periods.validation:
        return ChosenPeriods()
    return periods.within(night_labelled(night, spec.settings.nights))


@dataclass  # without slots: the settings are gathered once
class SettingsHashes:
    """Hashes of the settings that shape a motor's nights; a night's oil and periods are dated."""

    spec: MotorSpec
    _statistics: dict[object, str] = field(default_factory=dict)
    _figures: dict[object, str] = field(default_factory=dict)

    @cached_property
    def settings(self) -> dict[str, Any]:
        """All settings, as `settings_of`."""
        return settings_of(self.spec)

    def statistics(self, night: dt.date) -> str:
        """Return hash of all that is made of a night's samples: its statistics and what else is."""
        spec = self.spec
        key = (spec.file.oil_on(night), _chosen_periods(spec, night))
        if key not in self._statistics:
            motor = spec.stated.motor(night, spec.file.flushing.mode)
            document = {"model_hash": model_hash(spec, motor, night)}
            self._statistics[key] = hash_of(spec.settings.shaping(Stage.NIGHT) | document)
        return self._statistics[key]

    def figures(self, night: dt.date) -> str:
        """Return hash of all that shapes the figures that are made from a night's statistics."""
        spec = self.spec
        measured = spec.measured_curve(night)
        key = (spec.file.oil_on(night), measured)
        if key not in self._figures:
            stage = Stage.FIGURES | Stage.SCALE
            dated = {"oils": spec.oil_on(night).shaping(stage), "oil_samples": measured}
            document = {"version": FIGURES_VERSION, **shaping(spec, stage), **dated}
            self._figures[key] = hash_of({**document, "circuit_samples": None})
        return self._figures[key]


def settings_of(spec: MotorSpec) -> dict[str, Any]:
    """Return all settings of a motor as a document, by which a later run names what changed."""
    versions = (READING_VERSION, STATISTICS_VERSION, FIGURES_VERSION)
    document = {
        "versions": dict(zip(("reading", "statistics", "figures"), versions, strict=True)),
        "nights": shaping(spec, ALL & ~Stage.TRENDS),
        "trends": shaping(spec, Stage.TRENDS),
        **({} if spec.drain_delay_s is None else {DRAIN_DELAY: spec.drain_delay_s}),
    }
    plain: dict[str, Any] = json.loads(json.dumps(document, default=str))
    return plain


def why_anew(before: Mapping[str, Any], now: Mapping[str, Any], *, trends: bool = False) -> str:
    """Return why nights or trends are redone, in words: a new version, or changed settings."""
    versions = before.get("versions", {})
    steps = [
        f"{key} {versions.get(key, '?')} to {version}"
        for key, version in now.get("versions", {}).items()
        if version != versions.get(key)
    ]
    if steps and before:
        return f"another version of the program ({', '.join(steps)})"
    parts = ("nights", "trends") if trends else ("nights",)
    if not before or all(before.get(part) == now.get(part) for part in parts):
        return "changed settings"
    old, new = (
        dict(entry for part in parts for entry in _flat("", settings.get(part, {})))
        for settings in (before, now)
    )
    names = sorted(key for key in old.keys() | new.keys() if old.get(key) != new.get(key))
    more = ", …" if len(names) > SETTINGS_NAMED else ""
    return f"changed setting {', '.join(names[:SETTINGS_NAMED])}{more}"


def _flat(prefix: str, value: object) -> Iterator[tuple[str, str]]:
    """Yield settings by dotted key, as text."""
    if isinstance(value, list) and value and isinstance(value[0], dict):
        value = {inner.get("name", number): inner for number, inner in enumerate(value)}
    if not isinstance(value, Mapping):
        yield prefix, json.dumps(value)
        return
    for key, inner in value.items():
        yield from _flat(f"{prefix}.{key}".removeprefix("."), inner)
