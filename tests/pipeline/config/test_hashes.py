"""Each setting makes anew what it shapes, and nothing else: over every key of every file."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pipeline.config import MotorSpec
from pipeline.config.hashes import (
    SettingsHashes,
    config_hash,
    model_hash,
    reading_hash,
    settings_of,
    why_anew,
)
from pipeline.config.logs import Database
from pipeline.config.motor_types import LaminarPath, LeakageLimits, Unknown
from pipeline.config.motors import Event
from pipeline.config.nights import DAY
from pipeline.config.oil_samples import OilSample
from pipeline.config.section import Section
from pipeline.config.settings import FleetFile, Settings
from tests.pipeline.simulated import NIGHT, load_motor, motor_toml

# What a change of a table's keys makes anew: `reading` of the logs, the `blocks` of statistics,
# what else comes of a `night`'s samples, `figures`, `trends`, or `nothing`; `scale` is of the
# figures, and of the blocks where the path is fixed.
OF_TABLE = {
    "Nights": "reading blocks",
    **dict.fromkeys(("TimeBase", "Cleaning", "TransportDelay", "Smoothing", "Windows"), "blocks"),
    **dict.fromkeys(("Model", "PathSection", "OilFile", "Periods"), "blocks"),
    **dict.fromkeys(("AnnularGapPath", "SpeedCurvePath", "LaminarPath"), "blocks"),
    "SensorHealth": "night",
    **dict.fromkeys(("GapHeight", "Eccentricity", "Scale", "Unknown"), "scale"),
    **dict.fromkeys(("ReferenceConditions", "FlushingTable", "MotorTypeFile"), "figures"),
    "OilSample": "figures",
    **dict.fromkeys(("Trend", "LeakageLimits", "Event", "MotorFile"), "trends"),
    **dict.fromkeys(("Estimation", "Alarms", "Email", "Look", "Database"), "nothing"),
    **dict.fromkeys(("Folders", "Execution", "Retention", "Metrics", "FleetFile"), "nothing"),
    "Logs": "reading",
    "Channel": "reading blocks",
}
OF_KEY = {
    "Windows": {
        "night": "minimum_kept_share minimum_pressure_spread_bar minimum_speed_spread_rpm "
        "minimum_temperature_spread_c",
        "figures": "minimum_training_minutes",
    },
    "Model": {
        "figures": "film_pressure_share_tolerance charge_pressure_tolerance_bar roller_scale"
    },
    "Estimation": {"blocks": "loss", "figures": "sensitivity_samples"},
    "Alarms": {"trends": "alarm_percent stale_after_nights false_alarms_per_year"},
    "Logs": {"nothing": "files settle_s"},
    "Channel": {
        "reading": "source field value_column",
        "figures": "offset_tolerance gain_tolerance_percent",
    },
    "MotorFile": {
        "nothing": "name_in_log override",
        "figures": "motor_type",
        # The oil of the night, which shapes its blocks, is another one.
        "blocks figures trends": "oil",
    },
    "Event": {"nothing": "note", "blocks figures trends": "oil"},
    "OilSample": {"nothing": "note", "trends": "water_mg_per_kg"},
    "AnnularGapPath": {
        "scale": "count radius_mm length_mm height_factor eccentricity",
        "figures": "source deformation_tolerance_percent",
    },
    "SpeedCurvePath": {"figures": "source curve_tolerance_percent"},
    "LaminarPath": {"scale": "count", "figures": "source"},
    "OilFile": {
        "nothing": "source",
        "figures": "name pressure_viscosity_tolerance_percent density_tolerance_percent",
    },
}
IN_THE_NIGHT = tuple(dt.datetime(2026, 3, day, tzinfo=dt.UTC) for day in (1, 2))
# Values that others need; else a number, a text or a truth value is just another one.
OTHER_VALUES: dict[str, Any] = {
    "time_zone": "Europe/Oslo",
    "format": "csv",
    "oil": "vg46",
    **dict.fromkeys(("training", "validation"), (IN_THE_NIGHT,)),
    "viscosity_100_c_mm2_per_s": 9.5,
}
Put = Callable[[MotorSpec, Section], MotorSpec]
Hashes = dict[str, str]


@pytest.fixture(scope="module")
def spec(tmp_path_factory: pytest.TempPathFactory) -> MotorSpec:
    """A motor with every table that a file can have."""
    spec = load_motor(tmp_path_factory.mktemp("motor"), motor_toml("M1"))
    samples = (
        OilSample(date=NIGHT - DAY, viscosity_40_c_mm2_per_s=60.0, viscosity_100_c_mm2_per_s=8.0),
        OilSample(date=NIGHT + DAY, viscosity_40_c_mm2_per_s=61.0, viscosity_100_c_mm2_per_s=8.1),
    )
    database = Database(query="SELECT {start} {end}", begin=NIGHT)
    file = spec.file.model_copy(
        update={
            "logs": spec.file.logs.model_copy(update={"database": database}),
            "events": (Event(date=NIGHT - 30 * DAY, kind="overhaul"),),
            "oil_samples": samples,
        }
    )
    unknown = Unknown(value=1e-14, minimum=0.0, maximum=1e-12)
    valve = LaminarPath(
        name="valve", law="laminar", source="drawing", count=1, coefficient_m3=unknown
    )
    paths, limits = (*spec.motor_type.path, valve), LeakageLimits()
    motor_type = spec.motor_type.model_copy(update={"path": paths, "limits": limits})
    return replace(spec, file=file, motor_type=motor_type)


@pytest.fixture(autouse=True)
def one_motor(spec: MotorSpec, monkeypatch: pytest.MonkeyPatch) -> None:
    """Values that no physics takes are distinguished by the hashes all the same."""
    plain = spec.motor(NIGHT, "none")
    monkeypatch.setattr(MotorSpec, "motor", lambda *_: plain)


def hashes(spec: MotorSpec) -> Hashes:
    dated = SettingsHashes(spec)
    return {
        "reading": reading_hash(spec),
        "blocks": model_hash(spec, spec.motor(NIGHT, "none"), NIGHT),
        "night": dated.statistics(NIGHT),
        "figures": dated.figures(NIGHT),
        "all": config_hash(spec),
    }


def tables(spec: MotorSpec) -> Iterator[tuple[str, Section, Put]]:
    """Every table of a motor's config: its place, itself, and what puts another one there."""

    def of_oil(spec: MotorSpec, oil: Section) -> MotorSpec:
        return replace(spec, oils={**spec.oils, "vg68": oil})

    settings = FleetFile(name="F", **dict(spec.settings))
    yield from within("fleet", settings, lambda one, new: replace(one, settings=own(new)))
    yield from within("motor", spec.file, lambda one, new: replace(one, file=new))
    yield from within("type", spec.motor_type, lambda one, new: replace(one, motor_type=new))
    yield from within("oil", spec.oils["vg68"], of_oil)


def within(place: str, table: Section, put: Put) -> Iterator[tuple[str, Section, Put]]:
    yield place, table, put
    for key in type(table).model_fields:
        value = getattr(table, key)
        if isinstance(value, Section):
            yield from within(f"{place}.{key}", value, at(table, put, key))
        elif isinstance(value, tuple | dict):
            parts = value.items() if isinstance(value, dict) else enumerate(value)
            for name, one in parts:
                if isinstance(one, Section):
                    yield from within(f"{place}.{key}.{name}", one, at(table, put, key, name))


def at(table: Section, put: Put, key: str, inner: int | str | None = None) -> Put:
    def changed(spec: MotorSpec, new: Section) -> MotorSpec:
        value: Any = new if inner is None else getattr(table, key)
        if isinstance(inner, int):
            value = (*value[:inner], new, *value[inner + 1 :])
        elif inner is not None:
            value = {**value, inner: new}
        return put(spec, table.model_copy(update={key: value}))

    return changed


def own(fleet: Any) -> Settings:
    """What of the fleet file a motor has."""
    return Settings.model_construct(**{key: getattr(fleet, key) for key in Settings.model_fields})


def other(key: str, value: Any) -> Any:
    if key in OTHER_VALUES:
        return OTHER_VALUES[key]
    if isinstance(value, bool):
        return not value
    if isinstance(value, int | float):
        return value + 1
    if isinstance(value, dt.date):
        return value - DAY
    if isinstance(value, tuple):
        return (*value, 1.5)
    if isinstance(value, dict):
        return {**value, "more": 1}
    return 1.5 if value is None else f"{value}x"


def stages_of(table: Section, key: str) -> set[str]:
    name = type(table).__name__
    own_keys = {one: words for words, keys in OF_KEY.get(name, {}).items() for one in keys.split()}
    return set(own_keys.get(key, OF_TABLE[name]).split())


def expected(stages: set[str], place: str) -> set[str]:
    """Hashes that a change of these stages changes."""
    found: set[str] = set()
    if "reading" in stages:
        found |= {"reading", "all"}
    if "blocks" in stages or ("scale" in stages and place in FIXED):
        # All that is made of a night's samples.
        found |= {"blocks", "night", "all"}
    if "night" in stages:
        found |= {"night", "all"}
    if stages & {"figures", "scale"}:
        found |= {"figures", "all"}
    return found | ({"all"} if "trends" in stages else set())


# The path of the shipped types whose coefficient is known: that of the cam rollers.
FIXED = {"type.path.3", "type.path.3.scale"}


def test_a_changed_setting_changes_the_hash_of_its_stage_and_no_other(spec: MotorSpec) -> None:
    before, seen = hashes(spec), set()
    wrong = {}
    for place, table, put in tables(spec):
        for key in type(table).model_fields:
            value = getattr(table, key)
            if isinstance(value, Section) or key in ("channels", "path", "events", "oil_samples"):
                continue
            seen.add((type(table), key))
            changed = put(spec, table.model_copy(update={key: other(key, value)}))
            after = hashes(changed)
            found = {name for name in before if before[name] != after[name]}
            if found != (wanted := expected(stages_of(table, key), place)):
                wrong[f"{place}.{key}"] = found ^ wanted
    assert wrong == {}
    assert len(seen) > 180


def test_analyses_of_a_circuit_are_those_of_the_motor(spec: MotorSpec) -> None:
    own_ones = spec.file.oil_samples
    of_circuit = replace(
        spec, file=spec.file.model_copy(update={"oil_samples": ()}), circuit_samples=own_ones
    )
    assert hashes(of_circuit)["figures"] == hashes(spec)["figures"]


def test_a_free_scale_of_the_rollers_is_fitted_anew_and_not_read(spec: MotorSpec) -> None:
    before, after = hashes(spec), hashes(replace(spec, roller_is_free=True))
    assert {name for name in before if before[name] != after[name]} == {"figures", "all"}


def test_another_version_of_a_reader_reads_anew(
    spec: MotorSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = hashes(spec)
    monkeypatch.setattr("pipeline.config.hashes.reader_version", lambda _: "2")
    after = hashes(spec)
    assert {name for name in before if before[name] != after[name]} == {"reading", "all"}


def test_where_logs_and_output_lie_changes_nothing(spec: MotorSpec) -> None:
    moved = replace(spec, log_root=Path("/elsewhere"), log_url="s3://bucket/logs")
    assert hashes(moved) == hashes(spec)


def test_model_hash_changes_with_the_oil_and_not_with_the_mode(tmp_path: Path) -> None:
    change = '[[events]]\ndate = 2026-03-02\nkind = "oil_change"\noil = "vg46"\n'
    spec = load_motor(tmp_path, motor_toml("M1", more=change))
    before, after = NIGHT - dt.timedelta(days=1), NIGHT
    hashes = {
        (night, mode): model_hash(spec, spec.motor(night, mode), night)
        for night in (before, after)
        for mode in ("none", "estimated")
    }
    assert hashes[before, "none"] == hashes[before, "estimated"] != hashes[after, "none"]
    assert len({hashes[after, mode] for mode in ("none", "estimated")}) == 1


@pytest.mark.parametrize(
    ("before", "now", "words"),
    [
        ({}, {"nights": {"a": 1}}, "changed settings"),
        ({}, {"versions": {"figures": 2}}, "changed settings"),
        ({"nights": {"a": 1}}, {"nights": {"a": 1}}, "changed settings"),
        ({"trends": {"a": 1}}, {"trends": {"a": 2}}, "changed settings"),
        ({"nights": {"a": 1, "b": 1}}, {"nights": {"b": 2}}, "changed setting a, b"),
        ({"nights": {"a": {"b": [1]}}}, {"nights": {"a": {"b": [2]}}}, "changed setting a.b"),
        ({"nights": {"a": []}}, {"nights": {"a": [{"x": 1}]}}, "changed setting a, a.0.x"),
        (
            {"nights": {"path": [{"name": "o", "count": 1}]}},
            {"nights": {"path": [{"name": "o", "count": 2}]}},
            "changed setting path.o.count",
        ),
        ({"nights": {"a": 0}}, {"nights": dict.fromkeys("bcda", 1)}, "changed setting a, b, c, d"),
        (
            {"nights": {"a": 0}},
            {"nights": dict.fromkeys("ebcda", 1)},
            "changed setting a, b, c, d, …",
        ),
        (
            {"versions": {"reading": 1}, "nights": {"a": 1}},
            {"versions": {"reading": 1, "figures": 2}, "nights": {"a": 2}},
            "another version of the program (figures ? to 2)",
        ),
    ],
)
def test_what_changed_is_named(before: dict[str, Any], now: dict[str, Any], words: str) -> None:
    assert why_anew(before, now) == words


@pytest.mark.parametrize(
    ("table", "key", "of_nights"),
    [("cleaning", "standstill_rpm", True), ("alarms", "alarm_percent", False)],
)
def test_settings_of_nights_are_kept_apart_from_those_of_trends(
    spec: MotorSpec, table: str, key: str, of_nights: bool
) -> None:
    one = getattr(spec.settings, table)
    new = one.model_copy(update={key: getattr(one, key) + 1})
    changed = replace(spec, settings=spec.settings.model_copy(update={table: new}))
    before, now = settings_of(spec), settings_of(changed)
    assert (before["nights"] != now["nights"], before["trends"] != now["trends"]) == (
        of_nights,
        not of_nights,
    )
    assert why_anew(before, now, trends=True) == f"changed setting {table}.{key}"
