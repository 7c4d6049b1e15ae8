"""What `init` proposes from logs, and what it asks: a table of logs, and styles of headers."""

from __future__ import annotations

import csv
import tomllib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from pipeline.cli import app
from pipeline.config import load_fleet
from pipeline.config.channels import GOOD_QUALITY
from pipeline.demo import shipped_configs
from pipeline.ingest import read_log
from pipeline.logs.finding import find_logs
from pipeline.setup.fleet_files import (
    Observed,
    fleet_files,
    observe,
    observed_of,
    reference,
    write_fleet,
)
from pipeline.setup.propose import propose
from pipeline.units import QUANTITIES, from_canonical
from pipeline.units import UNITS as KNOWN_UNITS
from tests.pipeline.calling import refused
from tests.pipeline.setup.proposed import proposed

START = datetime(2026, 1, 13, 6, 0)
ROWS = 24
FOUR = "dp [bar],T [°C],n [rpm],leak [l/min]"
CELLS = "200.5,45.5,30.5,1.5"
DP, T, N, Q = "pressure_difference", "oil_temperature", "speed", "leakage_flow"


def text(columns: str, *rows: str) -> str:
    """A log of a row a second, over and over."""
    lines = (
        f"{START + timedelta(seconds=second):%Y-%m-%dT%H:%M:%SZ},{rows[second % len(rows)]}"
        for second in range(ROWS)
    )
    return "\n".join([f"time,{columns}", *lines, ""])


def several(columns: str, *rows: str) -> str:
    """A log of some rows in each second."""
    lines = (
        f"{START + timedelta(seconds=second):%Y-%m-%dT%H:%M:%SZ},{row}"
        for second in range(ROWS)
        for row in rows
    )
    return "\n".join([f"time,{columns}", *lines, ""])


def write(folder: Path, files: Mapping[str, str], encoding: str = "utf-8") -> Path:
    """Write logs; returns the folder, or the log if it is the only one."""
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(content, encoding)
    return folder / name if len(files) == 1 else folder


@dataclass(frozen=True)
class Case:
    """Logs, what is asked with its choices, answers, and then by motor what is proposed.

    Of a motor some channels are stated, each with the place in the log, and its unit behind a
    stroke, and keys of its logs.
    """

    files: Mapping[str, str]
    motors: Mapping[str, Mapping[str, str]]
    asked: Mapping[str, Sequence[str]] = field(default_factory=dict)
    answers: Mapping[str, str] = field(default_factory=dict)


ALIKE = "dp [bar],T [°C],n [rpm],flow_1 [l/min],flow_2 [l/min]"
TWO_FLOWS = {
    f"{name}/{name}_2026-01-13.csv": text(
        ",".join(f"{name}{n}_{tag}" for n in (1, 2) for tag in ALIKE.split(",")),
        ",".join([f"{CELLS},1.6"] * 2),
    )
    for name in ("A", "B")
}
GERMAN = "Druckdifferenz [bar],Öltemperatur [°C],Drehzahl [U/min],Lecköl [l/min]"
PRESSES = ("Presse 1,200.5,45.5,30.5,1.5", "Presse 2,90.5,45.5,30.5,1.5")
TAGS = (
    "dp,180.5,bar,gauges",
    "oil temperature,45.5,degC,thermo",
    "speed,30.5,rpm,encoder",
    "drain flow,1.5,l/min,meter",
)
SHREDDER = ("DP_bar", "OilTemp_degC", "Speed_rpm")
JOINED = [
    name
    for n in (1, 2)
    for name in (*(f"SHR1.M{n}.{tag}" for tag in SHREDDER), f"SHR1_M{n}_CaseFlow_lpm")
]
STATISTICS = ",".join(
    f"{name}_{statistic}"
    for name in ("dp_bar", "T_degC", "n_rpm", "q_lpm")
    for statistic in ("Avg", "Max")
)
VARYING = [f"200.{at},{CELLS[6:]}" for at in range(12)]
COUNTER = "drain_total_l|pulses"
KEYS = {
    "unit of dp [mA]": 'unit = "bar", scale = 12.5, offset = -50.0',
    "unit of T [0.1 K]": 'unit = "K", scale = 0.1',
    "unit of n % of 150 rpm": 'unit = "rpm", scale = 1.5',
    "unit of drain_total_l": 'unit = "pulses", volume_per_count_cm3 = 9.0',
}
CASES: Mapping[str, Case] = {
    "motors of one name have ids of their own": Case(
        {f"{folder}/M1/a.csv": text(FOUR, CELLS) for folder in "AB"},
        {"M1": {DP: "dp [bar]|bar"}, "M1-2": {Q: "leak [l/min]|l/min"}},
    ),
    "a motor's nights by a pattern that finds no other's": Case(
        {
            f"{name}.csv": text(FOUR, CELLS)
            for name in ("W1_2026-01-13", "W1_2026-01-14", "W1_b_2026-01-13")
        },
        {"W1": {"files": "['W1_[0-9]*.csv']"}, "W1_b": {"files": "['W1_b_*.csv']"}},
    ),
    "motors alike are asked about once": Case(
        TWO_FLOWS,
        {name: {Q: f"{name}_flow_2 [l/min]|l/min"} for name in ("A1", "A2", "B1", "B2")},
        {"A1.leakage_flow": ("A1_flow_1 [l/min]", "A1_flow_2 [l/min]")},
        {"A1.leakage_flow": "A1_flow_2 [l/min]"},
    ),
    "and have answers of their own": Case(
        TWO_FLOWS,
        {"A1": {}, "A2": {}, "B1": {Q: "B1_flow_1 [l/min]|l/min"}, "B2": {}},
        {"A1.leakage_flow": ("A1_flow_1 [l/min]", "A1_flow_2 [l/min]")},
        {"A1.leakage_flow": "A1_flow_2 [l/min]", "B1.leakage_flow": "B1_flow_1 [l/min]"},
    ),
    "motors of rows, by the column's name": Case(
        {"a.csv": text(f"Maschinen-Nr,{GERMAN}", *PRESSES)},
        {"Presse-1": {}, "Presse-2": {"motor_rows": "['Maschinen-Nr', 'Presse 2']"}},
    ),
    "motors of rows, by common stamps": Case(
        {"a.csv": several(f"where,{GERMAN}", *PRESSES)},
        {"Presse-1": {}, "Presse-2": {"motor_rows": "['where', 'Presse 2']"}},
    ),
    "a state is no motor": Case({"a.csv": text(f"where,{GERMAN}", *PRESSES)}, {"a": {}}),
    "gauges that tags are of are no motors": Case(
        {"a.csv": several("tag,value,unit,asset", *TAGS)},
        {"a": {DP: "dp|bar", T: "oil temperature|degC", N: "speed|rpm", Q: "drain flow|l/min"}},
    ),
    "an answer is for logs of one size": Case(
        {
            f"{motor}/a.csv": text("dp,T [°C],n [rpm],leak [l/min]", f"{dp},45.5,30.5,1.5")
            for motor, dp in (("M1", 180.5), ("M2", 18050.5))
        },
        {"M1": {DP: "dp|bar"}, "M2": {DP: "dp|kPa"}},
        {"unit of dp": ("bar", "psi", "kgf/cm2"), "unit of dp in M2": ("kPa", "mbar")},
        {"unit of dp": "bar", "unit of dp in M2": "kPa"},
    ),
    "a factor, a share, a current and a counter have their keys as answers": Case(
        {"w.csv": text("dp [mA],T [0.1 K],n % of 150 rpm,drain_total_l", "9.5,3202,12.5,1234.5")},
        {"w": {DP: "dp [mA]|bar", N: "n % of 150 rpm|rpm", f"{T}.scale": "0.1", Q: COUNTER}},
        dict.fromkeys(KEYS, ()),
        KEYS,
    ),
    "a unit is judged while the motor turns": Case(
        {"w.csv": text("dp_bar,T_degC,speed,drain_lpm", *["9,45,0.02,1"] * 12, *[CELLS] * 12)},
        {"w": {N: "speed|rpm"}},
        {"unit of speed": ("rpm", "rad/s", "deg/s")},
        {"unit of speed": "rpm"},
    ),
    "the gauge that says its port is not asked for": Case(
        {
            "a.csv": text(
                "HP [bar],pressure [bar],T [°C],n [rpm],q [l/min]", f"160.5,12.5,{CELLS[6:]}"
            )
        },
        {"a": {"high_port_pressure": "HP [bar]|bar", "low_port_pressure": "pressure [bar]|bar"}},
        {"a.low_port_pressure": ("pressure [bar]",)},
        {"a.low_port_pressure": "pressure [bar]"},
    ),
    "a thermometer of the tank is every motor's": Case(
        {
            "w.csv": text(
                "W1.dp_bar,W1.n_rpm,W1.q_lpm,W2.dp_bar,W2.n_rpm,W2.q_lpm,Tank.OilTemp_degC",
                "200.5,30.5,1.5,200.5,30.5,1.5,45.5",
            )
        },
        {name: {T: "Tank.OilTemp_degC|degC", N: f"{name}.n_rpm|rpm"} for name in ("W1", "W2")},
    ),
    "tags of a motor may be joined by different marks": Case(
        {"w.csv": text(",".join(JOINED), f"{CELLS},{CELLS}")},
        {f"SHR1.M{n}": {Q: f"SHR1_M{n}_CaseFlow_lpm|l/min"} for n in (1, 2)},
    ),
    "means beside extremes are the readings": Case(
        {"w.csv": text(STATISTICS, "201.5,205.5,45.5,46.5,30.5,31.5,1.5,1.6")},
        {"w": {DP: "dp_bar_Avg|bar", N: "n_rpm_Avg|rpm", Q: "q_lpm_Avg|l/min"}},
    ),
    "of copies one is a motor's": Case(
        {name: text(FOUR, *VARYING) for name in ("w_2026-01-13.csv", "w_latest.csv")},
        {"w": {DP: "dp [bar]|bar"}},
        {"motors of w_latest.csv": ("w_[0-9]*.csv", "w_latest.csv", "both")},
        {"motors of w_latest.csv": "w_[0-9]*.csv"},
    ),
    "logs of today, and packed ones before, are a motor's": Case(
        {
            f"w_2026-01-1{day}": text(FOUR, CELLS).replace("01-13", f"01-1{day[0]}")
            for day in ("3.csv.gz", "4.csv")
        },
        {"w": {"files": "['w_*.csv.gz', 'w_*.csv']"}},
    ),
    "of two formats one is a motor's": Case(
        {name: text(FOUR, *VARYING) for name in ("w_2026-01-13.csv", "w_2026-01-13.txt")},
        {"w": {DP: "dp [bar]|bar"}},
        {"motors of w_*.txt": ("w_*.csv", "w_*.txt", "both")},
        {"motors of w_*.txt": "w_*.csv"},
    ),
    "shifts of a day are a motor's": Case(
        {
            f"w_2026-01-13_{shift}.csv": text(FOUR, CELLS).replace("T06", f"T{hour}")
            for shift, hour in (("early", "06"), ("late", "14"))
        },
        {"w": {"files": "['w_*_*.csv']"}},
        {"motors of w_*_*.csv": ("one", "several")},
        {"motors of w_*_*.csv": "one"},
    ),
    "what is not asked can be put right": Case(
        {"a.csv": text(FOUR, CELLS)}, {"a": {N: "leak [l/min]|"}}, {}, {"a.speed": "leak [l/min]"}
    ),
    "gauges of other machines, and setpoints, are no motor's": Case(
        {
            "a.csv": text(
                f"{FOUR},filter_dp_bar,gearbox_oil_temp_degC,motor_speed_set_rpm",
                f"{CELLS},0.5,65.5,30",
            )
        },
        {"a": {DP: "dp [bar]|bar", T: "T [°C]|degC", N: "n [rpm]|rpm"}},
    ),
    "what is filtered, or of a geared motor, is the motor's": Case(
        {
            "a.csv": text(
                "pressure A filtered [bar],pressure B filtered [bar],gear motor oil temp [°C],"
                "n [rpm],Q [l/min]",
                "150,10,50,30,0.9",
            )
        },
        {
            "a": {
                "high_port_pressure": "pressure A filtered [bar]|bar",
                "low_port_pressure": "pressure B filtered [bar]|bar",
                T: "gear motor oil temp [°C]|degC",
            }
        },
    ),
    "of statistics in rows the means are read": Case(
        {"a.csv": several(f"statistic,{FOUR}", *(f"{of},{CELLS}" for of in ("avg", "max", "min")))},
        {"a": {"motor_rows": "['statistic', 'avg']"}},
    ),
    "a unit in each row": Case(
        {"a.csv": text("dp [bar],T [°C],n [rpm],leak,leak_unit", f"{CELLS},ml/min")},
        {"a": {Q: "leak|ml/min"}},
    ),
    "a zone in the name of the time": Case(
        {"a.csv": text(FOUR, CELLS).replace("time", "Time (GMT+1)", 1).replace("Z,", ",")},
        {"a": {"time_zone": "Etc/GMT-1"}},
    ),
    "names tell day from month": Case(
        {
            f"w_2026-01-0{day}.csv": text(FOUR, CELLS)
            .replace("2026-01-13T", f"0{day}/01/2026 ")
            .replace("Z,", ",")
            for day in (1, 2, 3)
        },
        {"w": {"time_format": "%d/%m/%Y %H:%M:%S"}},
        {"time_zone": ()},
        {"time_zone": "UTC"},
    ),
    "a dataset with #NAMES and #TYPES": Case(
        {
            "a.csv": '"#NAMES"\n"t_stamp","C/dP_bar","C/OilTemp_C","C/Speed_rpm","C/Leak_lpm"\n'
            '"#TYPES"\n"date","F","F","F","F"\n"#ROWS","24"\n'
            + "".join(
                f'"2026-01-13 06:00:{second:02},{CELLS}"\n'.replace(",", '","')
                for second in range(9)
            )
        },
        {"C": {DP: "C/dP_bar|bar", T: "C/OilTemp_C|degC", "skip_rows": "1"}},
        {"time_zone": ()},
        {"time_zone": "UTC"},
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_what_is_proposed_and_asked(name: str, tmp_path: Path) -> None:
    case = CASES[name]
    source = write(tmp_path, case.files)
    asked = dict[str, Sequence[str]]()
    for _ in range(3):
        answers = {key: value for key, value in case.answers.items() if key in asked}
        asked |= {question.key: question.choices for question in propose(source, answers).questions}
    proposal = propose(source, case.answers)
    assert asked == case.asked
    assert not proposal.questions or case.motors["a"].get(N, "").endswith("|")
    assert [motor.motor_id for motor in proposal.motors] == list(case.motors)
    for motor in proposal.motors:
        stated = {
            channel: f"{column.keys['source']}|{column.unit}"
            for channel, column in motor.channels.items()
        } | {key: str(value) for key, value in motor.logs.items()}
        for channel, column in motor.channels.items():
            stated |= {f"{channel}.{key}": str(value) for key, value in column.keys.items()}
        assert case.motors[motor.motor_id].items() <= stated.items()


@pytest.mark.parametrize(
    ("log", "words"),
    [
        (text(f"{FOUR},leak [l/min]", f"{CELLS},1.5"), "leak [l/min] is there 2 times"),
        (text(FOUR, f"+  {CELLS}"), "none was found; dp [bar] has '+  200.5', no number"),
        (text("TagIndex,Value", "1,200.5", "2,45.5"), "TagIndex has numbers for the names"),
        (text(STATISTICS.replace("Avg", "Min"), f"{CELLS},{CELLS}"), "minima, maxima and"),
        (text("value", "1.5"), 'layout = "file_per_channel"'),
        (text("dp_bar,n_rpm", "200.5,30.5"), 'layout = "file_per_channel"'),
        (text(",n_rpm", "200.5,30.5"), "a column without a name has '200.5'"),
        (
            text("dp_bar,T_degC,n_rpm,leak,leak_unit", f"{CELLS},l/min", f"{CELLS},ml/min"),
            "The log says 'l/min or ml/min'",
        ),
        (f"time,{FOUR}\n" + f"739984.5,{CELLS}\n" * 9, "counts are read as epoch_s,"),
        (text(FOUR, CELLS).replace("2026-01-13T", "").replace("Z,", ","), "written ('06:00:00')?"),
    ],
)
def test_why_something_is_not_read(log: str, words: str, tmp_path: Path) -> None:
    proposal = propose(write(tmp_path, {"w.csv": log}), {})
    texts = (*proposal.faults, *(question.text for question in proposal.questions))
    assert words in "; ".join(texts)


@pytest.mark.parametrize(
    "answer",
    [
        *("time_zone=Oslo", "time_format=dd/MM/yyyy HH:mm", "time_format of w=%d.%m."),
        *(f"unit of leak [0.1 l/min]={own}" for own in ("l/min", 'unit = "bar"', 'units = "l/h"')),
    ],
)
def test_an_answer_that_cannot_be(answer: str, tmp_path: Path) -> None:
    log = write(tmp_path, {"w.csv": text(FOUR.replace("[l", "[0.1 l"), CELLS)})
    with refused("answer"):
        propose(log, dict([answer.split("=", 1)]))


@pytest.mark.parametrize(
    ("value", "quality", "good", "bad"),
    [
        ("W.{}", "W.{}.Quality", "192", "0"),
        ("W.{}.Value", "W.{}.Quality", "216", "64"),
        ("W_{}_VALUE", "W_{}_QUALITY", "Good", "Bad"),
        ("W.{}", "W.{}.Validity", "1", "0"),
        ("W.{}", "W.{}.Q", "192", "0"),
        ("{}", "Quality_{}", "GOOD", "Uncertain"),
        ("{}", "{place}_quality", "192", "0"),
        ("{}", "{place}_Questionable", "False", "True"),
        ("{}", "Simulated", "0", "1"),
        ("{}", "is_bad", "False", "True"),
        ("{}", "quality_ok", "True", "False"),
        ("{}", "Quality", "Good", "Bad"),
        ("long", "Quality", "Good", "Bad"),
        ("long", "Validity", "1", "0"),
        ("long", "StatusCode", "0", "2147483648"),
    ],
)
def test_a_quality_in_any_usual_form_is_used(
    value: str, quality: str, good: str, bad: str, tmp_path: Path
) -> None:
    names = ("dp_bar", "T_degC", "n_rpm", "leak_lpm")
    if value == "long":
        own = dict.fromkeys(names, quality)
        pairs = zip(names, CELLS.split(","), strict=True)
        rows = (f"{name},{cell},{code}" for name, cell in pairs for code in (good, bad))
        log = several(f"tag,value,{quality}", *rows)
    else:
        own = {
            value.format(name): quality.format(name, place=name.partition("_")[0]) for name in names
        }
        columns = list(dict.fromkeys(name for pair in own.items() for name in pair))
        cells = dict(zip(own, CELLS.split(","), strict=True))
        log = text(
            ",".join(columns),
            *(",".join(cells.get(name, code) for name in columns) for code in (good, bad)),
        )
    (motor,) = propose(write(tmp_path, {"a.csv": log}), {}).motors
    assert {column.name: column.keys["quality_source"] for column in motor.channels.values()} == own
    for column in motor.channels.values():
        codes = {str(code).casefold() for code in column.keys.get("quality_good", GOOD_QUALITY)}
        assert (good.casefold() in codes, bad.casefold() in codes) == (True, False)


@pytest.mark.parametrize(
    ("name", "content", "code"),
    [
        ("notes.md", "", "log_empty"),
        ("a.csv", "time,dp,T\n", "log_not_readable"),
        ("a.csv", "year,day,n_rpm\n" + "2026,2,30.5\n" * 9, "log_not_readable"),
        ("a.parquet", "PAR1 no more", "log_not_readable"),
    ],
)
def test_a_source_without_a_log(tmp_path: Path, name: str, content: str, code: str) -> None:
    write(tmp_path, {name: content})
    with refused(code):
        propose(tmp_path, {})
    with refused("log_missing"):
        propose(tmp_path / "nowhere", {})


# Headers as plants write them

STYLES = tomllib.loads(Path(__file__).with_name("header_styles.toml").read_text("utf-8"))
LEAST_RIGHT = {"known": 0.97, "held out": 0.9, "blind": 0.9, "plants": 1.0}
# By kind of reading: channel, and a usual reading with its step.
KINDS = {
    "dp": (DP, 180.0, 4.0), "high": ("high_port_pressure", 205.0, 4.0), "temp": (T, 46.0, 0.3),
    "low": ("low_port_pressure", 18.0, 0.2), "speed": (N, 31.0, 0.7), "flow": (Q, 1.25, 0.05),
    "charge": ("charge_pressure", 20.0, 0.2), "case": ("case_pressure", 1.5, 0.05),
    "pump": (None, 1480.0, 1.0), "x": (None, 60.0, 1.1),
}  # fmt: skip


def columns_of(style: Mapping[str, Any]) -> dict[str, tuple[str, str]]:
    """Kind and unit by name of a column, those of a motor together."""
    return {
        name.replace("{}", motor): (*meant.split(" "), "")[:2]
        for motor in style.get("motors", [""])
        for name, meant in style.items()
        if name not in ("time", "motors", "units")
    }


def write_style(style: Mapping[str, Any], folder: Path) -> Path:
    """Write a log of a motor at work, with a style's header."""
    columns = columns_of(style)
    lines = [[style["time"], *columns]]
    if "units" in style:
        lines.append(["", *style["units"] * len(style.get("motors", [""]))])
    for row in range(ROWS):
        cells = [f"{START + timedelta(seconds=row):%Y-%m-%dT%H:%M:%SZ}"]
        for at, (kind, unit) in enumerate(columns.values()):
            channel, base, step = KINDS["low" if kind == "?" and at else kind.replace("?", "high")]
            number = base + step * ((4 * row) % 7) + 0.3
            if channel and unit in KNOWN_UNITS[QUANTITIES[channel]]:
                number = float(from_canonical(channel, number, unit))
            cells.append(f"{number:.3f}")
        lines.append(cells)
    with (folder / "log.csv").open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows(lines)
    return folder / "log.csv"


def score_of_style(style: Mapping[str, Any], folder: Path) -> Counter[str]:
    """Channels that are right, wrong and asked; a question is right where the log says nothing."""
    motors = propose(write_style(style, folder), {}).motors
    places = {
        column.keys["source"]: (channel, column.unit or None)
        for motor in motors
        for channel, column in motor.channels.items()
    }
    columns = columns_of(style)
    n_motors = len(style.get("motors", [""]))
    # The columns of a motor stand together.
    place_of = {name: at * n_motors // len(columns) for at, name in enumerate(columns)}
    for motor in motors:
        sources = (column.keys["source"] for column in motor.channels.values())
        assert len({place_of[source] for source in sources}) == 1
    counts: Counter[str] = Counter()
    for name, (kind, unit) in columns.items():
        got = places.get(name)
        if kind in "?x" or kind == "pump":
            counts["wrong"] += got is not None
            continue
        channel, right = KINDS[kind][0], None if unit == "-" else unit
        if got == (channel, right):
            counts["right"] += 1
        else:
            counts["asked" if got is None or got == (channel, None) else "wrong"] += 1
    return counts


@pytest.mark.parametrize("group", LEAST_RIGHT)
def test_most_channels_are_right_at_first_sight_and_none_is_wrong(
    tmp_path: Path, group: str
) -> None:
    styles = STYLES[group].values()
    total = sum((score_of_style(style, tmp_path) for style in styles), Counter[str]())
    assert total["wrong"] == 0
    assert total["right"] >= LEAST_RIGHT[group] * total.total() > 50


# The files of a fleet


def test_a_log_that_cannot_be_read_does_not_hide_the_others(tmp_path: Path) -> None:
    write(tmp_path, {f"a_2026-01-{day}.csv": text(FOUR, CELLS) for day in (13, 14)})
    (motor,) = propose(tmp_path, {}).motors
    motor.files[-1].write_text("nothing")
    observed = observe(motor)
    assert (observed.fault[:4], len(observed.spans)) == ("log_", 1)
    assert observed.typical["speed"] == 30.5


@pytest.mark.parametrize("style", STYLES["plants"])
def test_what_is_written_reads_every_sample(style: str, tmp_path: Path) -> None:
    own = STYLES["plants"][style]
    proposal = proposed(write_style(own, tmp_path))
    folder, observed = tmp_path / "fleet", tuple(observed_of(proposal).values())
    write_fleet(
        fleet_files(proposal, folder, "CB560", "vg68", observed), folder, shipped_configs(), "CB560"
    )
    fleet = load_fleet(folder / "fleet.toml")
    assert len(fleet.motors) == len(own.get("motors", [""]))
    for spec in fleet.motors:
        (path,) = find_logs(spec)[0].values()
        channels = read_log(path, spec.file.logs, spec.file.channels).channels.values()
        assert {(len(channel.value), channel.unparsed) for channel in channels} == {(ROWS, 0)}


def test_forty_motors_are_a_line_each(tmp_path: Path) -> None:
    header = ",".join(f"W{n}_{tag}" for n in range(40) for tag in FOUR.split(","))
    log = write(tmp_path, {"wide.csv": text(header, ",".join([CELLS] * 40))})
    files = fleet_files(propose(log, {}), tmp_path / "fleet", "CB560", "vg68")
    assert len(files) == 41
    assert files["motors/W7.toml"] == 'motor_id = "W7"\n'
    assert files["fleet.toml"].count("[defaults.channels.") == 4


def test_conditions_that_no_fleet_file_takes_are_left_out() -> None:
    typical = {T: 2900.0, DP: 150.0}
    assert reference([Observed(typical=typical)]) == {"pressure_bar": 150.0}


def test_the_fleet_file_has_the_fleets_own_figures(tmp_path: Path) -> None:
    """Two gauges, and a day shift from 06:00 to 21:40; a motor that is new is added to it."""
    header = "Datum;Uhrzeit;Druck 1 [bar];Druck 2 [bar];T [°C];n [1/min];Lecköl [l/min]"
    lines = [
        f"12.01.2026;{6 + i // 3:02}:{i % 3 * 20:02}:00;12,5;162,5;48,25;{i % 2 * 6},5;1,5"
        for i in range(48)
    ]
    log = "\n".join([header, *lines, ""])
    source, to = tmp_path / "logs", tmp_path / "fleet"
    write(source, {f"{motor}/{motor}_20260112.csv": log for motor in ("M1", "M2")}, "cp1252")
    asked = {question.key: question.choices for question in propose(source, {}).questions}
    # The higher gauge is shown first.
    gauges = ("Druck 2 [bar]", "Druck 1 [bar]", "none")
    assert asked == {"time_zone": (), "M1.high_port_pressure": gauges}
    answers = {"time_zone": "Europe/Oslo", "M1.high_port_pressure": "Druck 2 [bar]"}
    proposal = propose(source, answers)
    lows = {motor.channels["low_port_pressure"].name for motor in proposal.motors}
    assert lows == {"Druck 1 [bar]"}
    observed = tuple(observed_of(proposal).values())
    files = fleet_files(proposal, to, "CB560", "vg68", observed)
    fleet = tomllib.loads(files["fleet.toml"])
    assert fleet["nights"] == {"time_zone": "Europe/Oslo", "end_hour": 22}
    assert fleet["reference"] == {"pressure_bar": 150.0, "temperature_c": 48.0, "speed_rpm": 6.5}
    # What the defaults have holds for the motor that is added.
    del files["motors/M2.toml"]
    own = ('unit = "rpm"', 'unit = "rpm"\nsensor_maximum = 99.0')
    files["fleet.toml"] = files["fleet.toml"].replace(*own)
    write_fleet(files, to, shipped_configs(), "CB560", "CB1120")
    options = ["init", str(source), "--to", str(to), "--add", "--write"]
    answers["M2.motor_type"] = "CB1120"
    options += [part for pair in answers.items() for part in ("--answer", "=".join(pair))]
    run = CliRunner().invoke
    assert run(app, options).exit_code == 0
    motors = load_fleet(to / "fleet.toml").motors
    assert [spec.file.motor_type for spec in motors] == ["CB560", "CB1120"]
    speeds = [spec.file.channels["speed"] for spec in motors]
    assert [speed.sensor_maximum for speed in speeds] == [99.0, 99.0]
    assert "has all of these motors" in run(app, options).stdout
    # Not where the defaults would change how its log is read.
    (to / "motors" / "M2.toml").unlink()
    other = files["fleet.toml"].replace("[defaults.logs]", "[defaults.logs]\nskip_rows = 1")
    (to / "fleet.toml").write_text(other, "utf-8")
    assert run(app, options).exception.code == "defaults"
