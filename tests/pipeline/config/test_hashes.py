"""Each setting makes anew what it shapes, and nothing else: over every key of every file."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import replace
from functools import reduce
from operator import or_
from pathlib import Path
from typing import Any, cast

import pytest

from pipeline.config import MotorSpec
from pipeline.config.hashes import (
    DRAIN_DELAY,
    SettingsHashes,
    config_hash,
    model_hash,
    reading_hash,
    settings_of,
    why_anew,
)
from pipeline.config.motor_types import LaminarPath, LeakageLimits, OilSample, Unknown
from pipeline.config.motors import Event
from pipeline.config.nights import DAY
from pipeline.config.section import Section, Stage
from tests.pipeline.simulated import NIGHT, load_motor, motor_toml

IN_THE_NIGHT = tuple(dt.datetime(2026, 3, day, tzinfo=dt.UTC) for day in (1, 2))
# Values that others need; else a number, a text or a truth value is just another one.
OTHER_VALUES: dict[str, Any] = {
    "time_zone": "Europe/Oslo",
    "format": "csv",
    "oil": "vg46",
    **dict.fromkeys(("training", "validation"), (IN_THE_NIGHT,)),
    "viscosity_100_c_mm2_per_s": 9.5,
}
# Of the shipped types' paths, that of the cam rollers has a fixed coefficient.
FIXED = ("motor_type", "path", 3)
Place = tuple[str | int, ...]
Hashes = dict[str, str]


@pytest.fixture(scope="module")
def spec(tmp_path_factory: pytest.TempPathFactory) -> MotorSpec:
    """A motor with every table that a file can have."""
    spec = load_motor(tmp_path_factory.mktemp("motor"), motor_toml("M1"))
    samples = (
        OilSample(date=NIGHT - DAY, viscosity_40_c_mm2_per_s=60.0, viscosity_100_c_mm2_per_s=8.0),
        OilSample(date=NIGHT + DAY, viscosity_40_c_mm2_per_s=61.0, viscosity_100_c_mm2_per_s=8.1),
    )
    file = spec.file.model_copy(
        update={"events": (Event(date=NIGHT - 30 * DAY, kind="overhaul"),), "oil_samples": samples}
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


def settings_in(spec: MotorSpec) -> Iterator[tuple[Place, Stage]]:
    """The place of every setting of a motor, and its stage."""
    for name in ("settings", "file", "motor_type"):
        yield from within((name,), getattr(spec, name))
    yield from within(("oils", "vg68"), spec.oils["vg68"])


def within(place: Place, value: Any, stage: Stage = Stage.NOTHING) -> Iterator[tuple[Place, Stage]]:
    parts = dict(enumerate(value)) if isinstance(value, tuple) else value
    if isinstance(value, Section):
        for key in type(value).model_fields:
            own = reduce(
                or_, (part for part in Stage if value.keys_of(part).get(key)), Stage.NOTHING
            )
            yield from within((*place, key), getattr(value, key), own)
    elif isinstance(parts, dict) and any(isinstance(part, Section) for part in parts.values()):
        for name, part in parts.items():
            yield from within((*place, name), part)
    else:
        yield place, stage


def changed(spec: MotorSpec, place: Place) -> MotorSpec:
    """The motor with another value in a place, which nothing has checked."""
    new: Any = deepcopy(spec)
    table = new
    for step in place[:-1]:
        table = table[step] if isinstance(table, tuple | dict) else getattr(table, str(step))
    key = str(place[-1])
    vars(table)[key] = other(key, getattr(table, key))
    return cast(MotorSpec, new)


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


def expected(stage: Stage, place: Place) -> set[str]:
    """Hashes that a change of a setting changes."""
    if place[-1] == "oil":  # the night's oil, whose own settings shape the blocks, is another one
        stage |= Stage.BLOCKS | Stage.FIGURES
    found = {"all"} if stage else set()
    if stage & Stage.READING:
        found |= {"reading"}
    if stage & Stage.BLOCKS or (stage & Stage.SCALE and place[:3] == FIXED):
        found |= {"blocks", "night"}  # all that is made of a night's samples
    if stage & Stage.NIGHT:
        found |= {"night"}
    if stage & (Stage.FIGURES | Stage.SCALE):
        found |= {"figures"}
    return found


def test_a_changed_setting_changes_the_hash_of_its_stage_and_no_other(spec: MotorSpec) -> None:
    before, stages = hashes(spec), dict(settings_in(spec))
    found = {
        place: {
            name for name, digest in hashes(changed(spec, place)).items() if digest != before[name]
        }
        for place in stages
    }
    assert found == {place: expected(stage, place) for place, stage in stages.items()}
    assert len(found) > 200


def test_hashes_of_a_motor_with_every_table_stay(spec: MotorSpec) -> None:
    """Regression, and with the shipped motors' proof that no setting goes to another stage."""
    assert hashes(spec) == {
        "reading": "8118e83ae13c398a",
        "blocks": "ebd070302943d168",
        "night": "83059ae9028e0530",
        "figures": "fe40dcc1ad785f52",
        "all": "6c7f12288115292b",
    }


def of_circuit(spec: MotorSpec) -> MotorSpec:
    bare = spec.file.model_copy(update={"oil_samples": ()})
    return replace(spec, file=bare, circuit_samples=spec.file.oil_samples)


@pytest.mark.parametrize(
    ("other_spec", "names"),
    [
        pytest.param(of_circuit, {"all"}, id="analyses of the oil in the circuit's file"),
        pytest.param(
            lambda spec: replace(spec, roller_is_free=True), {"figures", "all"}, id="free rollers"
        ),
        pytest.param(
            lambda spec: replace(spec, log_root=Path("/x"), log_url="s3://x/logs"),
            set(),
            id="place",
        ),
    ],
)
def test_what_else_makes_anew(
    spec: MotorSpec, other_spec: Callable[[MotorSpec], MotorSpec], names: set[str]
) -> None:
    before, after = hashes(spec), hashes(other_spec(spec))
    assert {name for name in before if before[name] != after[name]} == names


def test_another_version_of_a_reader_reads_anew(
    spec: MotorSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = hashes(spec)
    monkeypatch.setattr("pipeline.config.hashes.reader_version", lambda _: "2")
    after = hashes(spec)
    assert {name for name in before if before[name] != after[name]} == {"reading", "all"}


@pytest.mark.parametrize(
    ("before", "now", "words"),
    [
        ({}, {"nights": {"a": 1}}, "changed settings"),
        ({"trends": {"a": 1}}, {"trends": {"a": 2}}, "changed settings"),
        ({"nights": {"a": 1, "b": 1}}, {"nights": {"b": 2}}, "changed setting a, b"),
        ({"nights": {"a": []}}, {"nights": {"a": [{"x": 1}]}}, "changed setting a, a.0.x"),
        (
            {"nights": {"path": [{"name": "o", "count": 1}]}},
            {"nights": {"path": [{"name": "o", "count": 2}]}},
            "changed setting path.o.count",
        ),
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
    [("cleaning", "warm_up_minutes", True), ("alarms", "alarm_percent", False)],
)
def test_settings_of_nights_are_kept_apart_from_those_of_trends(
    spec: MotorSpec, table: str, key: str, of_nights: bool
) -> None:
    section = getattr(spec.settings, table)
    new = section.model_copy(update={key: getattr(section, key) + 1})
    changed = replace(spec, settings=spec.settings.model_copy(update={table: new}))
    before, now = settings_of(spec), settings_of(changed)
    assert (before["nights"] != now["nights"], before["trends"] != now["trends"]) == (
        of_nights,
        not of_nights,
    )
    assert why_anew(before, now, trends=True) == f"changed setting {table}.{key}"


def test_a_delay_that_was_decided_is_noted_beside_the_settings(spec: MotorSpec) -> None:
    undecided, decided = settings_of(spec), settings_of(replace(spec, drain_delay_s=2.5))
    assert decided == {**undecided, DRAIN_DELAY: 2.5}
    assert DRAIN_DELAY not in undecided
