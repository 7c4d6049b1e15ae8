"""`init` on plants' logs: right, wrong and asked, and whether what it writes reads them."""

from __future__ import annotations

import tomllib
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from pipeline.cli import app
from pipeline.config import load_fleet
from pipeline.demo import shipped_configs
from pipeline.errors import UsageError
from pipeline.ingest import read_log
from pipeline.logs.finding import find_logs
from pipeline.setup.fleet_files import fleet_files, observed_of, write_fleet
from pipeline.setup.propose import propose
from tests.pipeline.calling import refused
from tests.pipeline.setup.plants import (
    CHANNELS,
    PLANTS,
    ROWS,
    STYLES,
    Place,
    columns,
    written,
)
from tests.pipeline.setup.proposed import proposed

RUN = CliRunner().invoke


@pytest.mark.parametrize("plant", PLANTS)
def test_every_channel_is_right_and_what_is_written_reads_the_logs(
    plant: str, tmp_path: Path
) -> None:
    """Without an answer; a unit is asked for where the log does not say it."""
    text, motors = PLANTS[plant]
    source = tmp_path / "log.csv"
    source.write_bytes(text.encode())
    found = [
        {
            channel: Place(one.keys["source"], one.unit or None, one.keys.get("quality_source", ""))
            for channel, one in motor.channels.items()
        }
        for motor in propose(source, {}).motors
    ]
    assert sorted(found, key=repr) == sorted(motors.values(), key=repr)
    require_it_reads(source, tmp_path / "fleet", len(motors))


def require_it_reads(source: Path, folder: Path, n_motors: int) -> None:
    """The fleet that is written reads every sample."""
    proposal = proposed(source)
    files = fleet_files(proposal, folder, "CB560", "vg68", tuple(observed_of(proposal).values()))
    write_fleet(files, folder, shipped_configs(), "CB560")
    fleet = load_fleet(folder / "fleet.toml")
    assert len(fleet.motors) == n_motors
    for spec in fleet.motors:
        logs, _ = find_logs(spec)
        assert logs
        for path in logs.values():
            log = read_log(path, spec.file.logs, spec.file.channels)
            assert {len(channel.value) for channel in log.channels.values()} == {ROWS}
            assert sum(channel.unparsed for channel in log.channels.values()) == 0


LEAST_RIGHT = {"known": 0.97, "held out": 0.9, "blind": 0.9, "plants": 1.0}


def score_of_style(style: Mapping[str, Any], folder: Path) -> Counter[str]:
    """Channels that are right, wrong and asked; a question is right where the log says nothing."""
    motors = propose(written(style, folder), {}).motors
    found = {
        place.keys["source"]: (channel, place.unit or None)
        for motor in motors
        for channel, place in motor.channels.items()
    }
    own = columns(style)
    n_motors = len(style.get("motors", [""]))
    # The columns of a motor stand together.
    place_of = {name: at * n_motors // len(own) for at, name in enumerate(own)}
    for motor in motors:
        assert len({place_of[one.keys["source"]] for one in motor.channels.values()}) == 1
    counts: Counter[str] = Counter()
    for name, (kind, unit) in own.items():
        got, right = found.get(name), (CHANNELS.get(kind), None if unit == "-" else unit)
        if kind in "?x":
            counts["wrong"] += got is not None
        elif got == right:
            counts["right"] += 1
        else:
            counts["asked" if got is None or got == (right[0], None) else "wrong"] += 1
    return counts


@pytest.mark.parametrize("group", LEAST_RIGHT)
def test_most_channels_are_right_at_first_sight_and_none_is_wrong(
    tmp_path: Path, group: str
) -> None:
    styles = STYLES[group].values()
    total = sum((score_of_style(style, tmp_path) for style in styles), Counter[str]())
    assert total["wrong"] == 0
    assert total["right"] >= LEAST_RIGHT[group] * total.total() > 50


@pytest.mark.parametrize("style", STYLES["plants"])
def test_what_is_written_for_a_table_reads_it(style: str, tmp_path: Path) -> None:
    own = STYLES["plants"][style]
    require_it_reads(written(own, tmp_path), tmp_path / "fleet", len(own.get("motors", [""])))


def seconds(log: Path, header: str, line: str) -> Path:
    """Write a log whose rows are alike but for the stamps."""
    log.parent.mkdir(parents=True, exist_ok=True)
    rows = [f"2026-01-13T06:00:{i:02}Z{line}" for i in range(9)]
    log.write_text("\n".join([header, *rows, ""]), "utf-8")
    return log


def test_a_motors_nights_are_found_by_a_pattern_that_finds_no_other_motors(tmp_path: Path) -> None:
    for name in ("W1_2026-01-13", "W1_2026-01-14", "W1_b_2026-01-13"):
        header = "time,dp [bar],T [°C],n [rpm],leak [l/min]"
        seconds(tmp_path / f"{name}.csv", header, ",200.5,45.5,30.5,1.5")
    found = {
        motor.motor_id: (motor.logs["files"], len(motor.files))
        for motor in propose(tmp_path, {}).motors
    }
    assert found == {"W1": (["W1_[0-9]*.csv"], 2), "W1_b": (["W1_b_*.csv"], 1)}


def test_motors_of_one_name_have_ids_of_their_own(tmp_path: Path) -> None:
    for folder in ("A", "B"):
        header = "time,dp [bar],T [°C],n [rpm],leak [l/min]"
        seconds(tmp_path / folder / "M1" / "a.csv", header, ",200.5,45.5,30.5,1.5")
    assert [motor.motor_id for motor in propose(tmp_path, {}).motors] == ["M1", "M1-2"]


def test_forty_motors_are_a_line_each(tmp_path: Path) -> None:
    tags = ("dp [bar]", "T [°C]", "n [rpm]", "leak [l/min]")
    header = ",".join(["time", *(f"W{n}_{tag}" for n in range(40) for tag in tags)])
    log = seconds(tmp_path / "wide.csv", header, ",200.5,45.5,30.5,1.5" * 40)
    files = fleet_files(propose(log, {}), tmp_path / "fleet", "CB560", "vg68")
    assert len(files) == 41
    assert files["motors/W7.toml"] == 'motor_id = "W7"\n'
    assert files["fleet.toml"].count("[defaults.channels.") == 4


def test_motors_alike_are_asked_about_once(tmp_path: Path) -> None:
    tags = ("dp [bar]", "T [°C]", "n [rpm]", "flow_1 [l/min]", "flow_2 [l/min]")
    for name in ("A", "B"):
        header = ",".join(["time", *(f"{name}{n}_{tag}" for n in (1, 2) for tag in tags)])
        log = tmp_path / "plant" / name / f"{name}_2026-01-13.csv"
        seconds(log, header, ",200.5,45.5,30.5,1.5,1.6" * 2)
    (question,) = propose(tmp_path / "plant", {}).questions
    assert question.key == "A1.leakage_flow"
    answers = {"A1.leakage_flow": "A1_flow_2 [l/min]", "B1.leakage_flow": "B1_flow_1 [l/min]"}
    found = propose(tmp_path / "plant", answers)
    assert not found.questions
    flows = {motor.motor_id: motor.channels["leakage_flow"].name for motor in found.motors}
    assert {name: flow[3:9] for name, flow in flows.items()} == {
        **dict.fromkeys(("A1", "A2", "B2"), "flow_2"),
        "B1": "flow_1",
    }


@pytest.mark.parametrize("column", ["Maschinen-Nr", "where"])
def test_rows_of_several_motors_are_motors(tmp_path: Path, column: str) -> None:
    header = f"time,{column},Druckdifferenz [bar],Öltemperatur [°C],Drehzahl [U/min],Lecköl [l/min]"
    rows = [
        f"2026-01-13T06:00:{i:02}Z,{name},{p},45.5,30.5,1.5"
        for i in range(9)
        for name, p in (("Presse 1", 200.5), ("Presse 2", 90.5))
    ]
    log = tmp_path / "log.csv"
    log.write_text("\n".join([header, *rows]) + "\n", "utf-8")
    found = propose(log, {})
    assert [motor.motor_id for motor in found.motors] == ["Presse-1", "Presse-2"]
    assert not found.questions
    assert found.motors[1].logs["motor_name"] == "Presse 2"
    # Without stamps in common, only a name tells a motor from a state.
    alone = [header, *rows[::2], rows[-1].replace(":08Z", ":09Z"), ""]
    log.write_text("\n".join(alone), "utf-8")
    assert len(propose(log, {}).motors) == (1 if column == "where" else 2)


def test_nothing_is_overwritten_and_nothing_written_unasked(tmp_path: Path) -> None:
    four = STYLES["plants"]["Excel, four motors by a prefix, a row of units"]
    source = written(four, tmp_path)
    options = ["init", str(source), "--to", str(tmp_path / "fleet")]
    known = ["--answer", "motor_type=CB560", "--answer", "oil=vg68", "--answer", "decimal=."]
    assert RUN(app, [*options, "--write"]).exit_code == 1
    assert RUN(app, [*options, *known]).exit_code == 0
    assert not (tmp_path / "fleet").exists()
    assert RUN(app, [*options, *known, "--write"]).exit_code == 0
    before = (tmp_path / "fleet" / "fleet.toml").read_text("utf-8")
    assert RUN(app, [*options, *known, "--write"]).exception.code == "file_exists"
    assert (tmp_path / "fleet" / "fleet.toml").read_text("utf-8") == before


@pytest.mark.parametrize(
    ("name", "content", "code"),
    [
        ("", "", "log_empty"),
        ("a.csv", "", "log_not_readable"),
        ("a.csv", "time,dp,T\n", "log_not_readable"),
        ("a.parquet", "PAR1 no more", "log_not_readable"),
    ],
)
def test_a_source_without_a_log(tmp_path: Path, name: str, content: str, code: str) -> None:
    if name:
        (tmp_path / name).write_text(content, "utf-8")
    with refused(code):
        propose(tmp_path, {})
    with refused("log_missing"):
        propose(tmp_path / "nowhere", {})


def test_an_answer_for_one_log_is_not_taken_for_another_of_another_size(tmp_path: Path) -> None:
    """180 bar in one, and 18 000 kPa in the other, under the same name."""
    for motor, pressure in (("M1", "180.5"), ("M2", "18050.5")):
        header = "time,dp,T [°C],n [rpm],leak [l/min]"
        seconds(tmp_path / motor / "a.csv", header, f",{pressure},45.5,30.5,1.5")
    answers = {"unit of dp": "bar"}
    (question,) = propose(tmp_path, answers).questions
    assert (question.key, question.choices) == ("unit of dp in M2", ("kPa", "mbar"))
    found = propose(tmp_path, answers | {question.key: "kPa"})
    assert [one.channels["pressure_difference"].unit for one in found.motors] == ["bar", "kPa"]


def test_of_two_gauges_the_one_that_says_its_port_is_not_asked_for(tmp_path: Path) -> None:
    header = "time,HP [bar],pressure [bar],T [°C],n [rpm],leak [l/min]"
    log = seconds(tmp_path / "a.csv", header, ",160.5,12.5,45.5,30.5,1.5")
    (question,) = propose(log, {}).questions
    assert question.key == "a.low_port_pressure"
    found = propose(log, {question.key: "pressure [bar]"})
    assert found.questions == ()
    assert found.motors[0].channels["high_port_pressure"].name == "HP [bar]"


def test_gauges_that_tags_are_of_are_no_motors(tmp_path: Path) -> None:
    tags = {
        "dp": ("180.5", "bar", "gauges"), "oil temperature": ("45.5", "degC", "thermo"),
        "speed": ("30.5", "rpm", "encoder"), "drain flow": ("1.5", "l/min", "meter"),
    }  # fmt: skip
    rows = [
        f"2025-03-01T06:00:{second:02}Z,{tag},{value},{unit},{asset}"
        for second in range(30)
        for tag, (value, unit, asset) in tags.items()
    ]
    log = tmp_path / "a.csv"
    log.write_text("\n".join(["time,tag,value,unit,asset", *rows, ""]))
    (motor,) = propose(log, {}).motors
    assert set(motor.channels) == {
        "pressure_difference", "oil_temperature", "speed", "leakage_flow"
    }  # fmt: skip
    assert "motor_column" not in motor.logs


def test_the_fleet_file_has_the_fleets_own_figures(tmp_path: Path) -> None:
    """Two gauges, and a day shift from 06:00 to 21:40."""
    header = "Datum;Uhrzeit;Druck 1 [bar];Druck 2 [bar];T [°C];n [1/min];Lecköl [l/min]"
    for motor in ("M1", "M2"):
        rows = [
            f"12.01.2026;{6 + i // 3:02}:{i % 3 * 20:02}:00;12,5;162,5;48,25;{i % 2 * 6},5;1,5"
            for i in range(48)
        ]
        log = tmp_path / "mill" / "logs" / motor / f"{motor}_20260112.csv"
        log.parent.mkdir(parents=True)
        log.write_text("\n".join([header, *rows, ""]), "cp1252")
    source = tmp_path / "mill" / "logs"
    asked = {question.key: question for question in propose(source, {}).questions}
    assert set(asked) == {"time_zone", "M1.high_port_pressure"}
    # The higher one is shown first.
    assert asked["M1.high_port_pressure"].choices == ("Druck 2 [bar]", "Druck 1 [bar]", "none")
    answers = {"time_zone": "Europe/Oslo", "M1.high_port_pressure": "Druck 2 [bar]"}
    found = propose(source, answers)
    lows = {one.channels["low_port_pressure"].name for one in found.motors}
    assert lows == {"Druck 1 [bar]"}
    to = tmp_path / "fleet"
    files = fleet_files(found, to, "CB560", "vg68", tuple(observed_of(found).values()))
    fleet = tomllib.loads(files["fleet.toml"])
    assert fleet["name"] == "fleet"
    assert fleet["nights"] == {"time_zone": "Europe/Oslo", "end_hour": 22}
    assert fleet["reference"] == {"pressure_bar": 150.0, "temperature_c": 48.0, "speed_rpm": 6.5}
    # A motor that is new to the fleet is added, and no other; what the defaults have holds for it.
    del files["motors/M2.toml"]
    own = ('unit = "rpm"', 'unit = "rpm"\nsensor_maximum = 99.0')
    files["fleet.toml"] = files["fleet.toml"].replace(*own)
    write_fleet(files, to, shipped_configs(), "CB560")
    options = ["init", str(source), "--to", str(to), "--add", "--write"]
    options += [part for item in answers.items() for part in ("--answer", "=".join(item))]
    assert RUN(app, options).exit_code == 0
    maxima = {
        one.motor_id: one.file.channels["speed"].sensor_maximum
        for one in load_fleet(to / "fleet.toml").motors
    }
    assert maxima == {"M1": 99.0, "M2": 99.0}
    assert "has all of these motors" in RUN(app, options).stdout
    # Not where the defaults would change how its log is read.
    (to / "motors" / "M2.toml").unlink()
    other = files["fleet.toml"].replace("[defaults.logs]", "[defaults.logs]\nsettle_s = 1.0")
    (to / "fleet.toml").write_text(other, "utf-8")
    assert RUN(app, options).exception.code == "defaults"


def test_answers_that_cannot_be_are_refused(tmp_path: Path) -> None:
    header = "time,dp [bar],T [°C],n [rpm],q [l/min]"
    log = seconds(tmp_path / "a.csv", header, ",9.5,45.5,30.5,1.5")
    with refused("answer", "dpp: there is no such question; open: none is open"):
        propose(log, {"dpp": "bar"})
    with refused("answer", "time_zone: got 'Mars/Phobos'; expected the name of an IANA time zone"):
        propose(log, {"time_zone": "Mars/Phobos"})
    with pytest.raises(UsageError, match=r"expected one of .*q \[l/min\]"):
        propose(log, {"a.leakage_flow": "Flow 3 [l/min]"})
    # What was not asked can be put right.
    (motor,) = propose(log, {"a.speed": "q [l/min]"}).motors
    assert motor.channels["speed"].name == "q [l/min]"
