"""Files as plants write them: `init` finds what is right or asks, and the tables have it.

Each table of cases is one question: the files of a plant, and what comes of them.
"""

from __future__ import annotations

import datetime as dt
import io
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from mcap.writer import Writer

from pipeline.config import MotorSpec, load_fleet
from pipeline.demo import shipped_configs
from tests.pipeline.simulated import Operation, operate
from tests.scenarios.command import Result, run_command
from tests.scenarios.covering import covers
from tests.scenarios.fleets import SEQUENTIAL, Simulated, make_fleet, table

FIRST = dt.date(2026, 1, 2)
NAMES = {
    "dp_bar": "pressure_difference",
    "oil_temp_degC": "oil_temperature",
    "speed_rpm": "speed",
    "drain_flow_lpm": "leakage_flow",
}
CHANNELS = list(NAMES.values())
ISO = "%Y-%m-%dT%H:%M:%SZ"
DAY_FIRST, MONTH_FIRST = "%d/%m/%Y %H:%M:%S", "%m/%d/%Y %H:%M:%S"
MACHINE = ("motor_type=CB400", "oil=vg68", "time_zone=UTC")
BAD = range(120, 300)  # rows of bad quality

Files = Mapping[str, str | bytes]
Edit = Callable[[int, list[Any]], list[Any]]
"""Cells of a row by its number, in the order of the channels, as they are written."""


@dataclass(frozen=True)
class Plant:
    """A folder of logs, and the fleet that is proposed from them."""

    folder: Path

    def init(self, files: Files, *answers: str) -> Result:
        """Write logs, propose a fleet of them with answers, and write it if nothing is open."""
        for name, content in files.items():
            path = self.folder / "logs" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content.encode() if isinstance(content, str) else content)
        options = [word for answer in (*MACHINE, *answers) for word in ("--answer", answer)]
        return self.run("init", "logs", "--to", "fleet", "--write", *options)

    def run(self, command: str, *arguments: object) -> Result:
        """Run a command, of the proposed fleet unless it is `init`."""
        fleet = [] if command == "init" else ["fleet/fleet.toml"]
        return run_command(command, *fleet, *arguments, folder=self.folder)

    def check(self, *options: str) -> list[dict[str, Any]]:
        """What `check` says of each motor."""
        return self.run("check", "--json", *options).lines

    def fit(self) -> Result:
        """Fit the fleet, quickly."""
        fleet = self.folder / "fleet" / "fleet.toml"
        fleet.write_text(fleet.read_text("utf-8").rstrip() + "\n" + SEQUENTIAL, "utf-8")
        return self.run("fit-fleet")

    def table(self, name: str = "nights") -> pl.DataFrame:
        """Return a published table."""
        return table(self.folder / "fleet" / "out", name)

    @property
    def motors(self) -> tuple[MotorSpec, ...]:
        """The motors that are proposed."""
        return load_fleet(self.folder / "fleet" / "fleet.toml").motors


@pytest.fixture
def plant(tmp_path: Path) -> Plant:
    return Plant(tmp_path)


@cache
def operation(night: int, minutes: float = 12.0) -> tuple[Operation, dict[str, np.ndarray]]:
    """A night of a motor of type CB400 at 1 Hz, counted from 1, and what its sensors read."""
    spec = load_fleet(shipped_configs() / "fleet.toml").motor("CB400-01")
    label = FIRST + dt.timedelta(days=night - 1)
    made = operate(label, minutes, seed=night)
    noise = np.random.default_rng(night).normal(0.0, 0.01, len(made.time_us))
    flow = made.flow(spec.motor(label, "none")) + noise
    return made, {name: value.round(4) for name, value in made.channels(flow).items()}


def rows(
    night: int = 1, form: str = ISO, edit: Edit = lambda _, row: row, minutes: float = 12.0
) -> Iterator[tuple[str, list[str]]]:
    """Stamp and cells of each row, in the order of the channels."""
    made, values = operation(night, minutes)
    stamps = pl.Series(made.time_us).cast(pl.Datetime("us")).dt.strftime(form)
    cells = zip(*(values[channel].tolist() for channel in CHANNELS), strict=True)
    for at, (stamp, row) in enumerate(zip(stamps, cells, strict=True)):
        yield stamp, [str(cell) for cell in edit(at, list(row))]


def wide(
    night: int = 1,
    form: str = ISO,
    edit: Edit = lambda _, row: row,
    names: Mapping[str, str] = NAMES,
    minutes: float = 12.0,
) -> str:
    """A night as a table of CSV, of columns by the channels that they hold."""
    places = [CHANNELS.index(channel) for channel in names.values()]
    lines = [",".join(["time", *names])]
    for stamp, row in rows(night, form, edit, minutes):
        lines.append(",".join([stamp, *(row[place] for place in places)]))
    return "\n".join([*lines, ""])


def factor(channel: str, by: float) -> Edit:
    """Cells of a channel in another unit."""
    at = CHANNELS.index(channel)
    return lambda _, row: [cell * (by if place == at else 1.0) for place, cell in enumerate(row)]


def constant(channel: str, value: object, where: Callable[[int], bool] = lambda _: True) -> Edit:
    """Cells of a channel that are all alike in some rows."""
    at = CHANNELS.index(channel)
    return lambda number, row: [*row[:at], value, *row[at + 1 :]] if where(number) else row


# Quality: bad rows have half of the true values


def halved(at: int, row: list[Any]) -> list[Any]:
    return [cell / 2 for cell in row] if at in BAD else row


def marked(good: str, bad: str) -> Iterator[tuple[str, list[str], str]]:
    """Stamp, cells and code of each row."""
    for at, (stamp, row) in enumerate(rows(edit=halved)):
        yield stamp, row, bad if at in BAD else good


def long(column: str, good: str, bad: str) -> Files:
    lines = (
        f"{stamp},W.{name},{cell},{code}\n"
        for stamp, row, code in marked(good, bad)
        for name, cell in zip(NAMES, row, strict=True)
    )
    return {"hist.csv": f"DateTime,TagName,Value,{column}\n{''.join(lines)}"}


def parquet(columns: Mapping[str, Any]) -> bytes:
    sink = pa.BufferOutputStream()
    pq.write_table(pa.table(dict(columns)), sink)
    return bytes(sink.getvalue())


def messages(
    payload: Callable[[int, int, str], Mapping[str, Any]],
    late_us: Callable[[int], int] = lambda _: 0,
) -> bytes:
    """MCAP of a topic a channel; a payload is made of a row's number, a channel's, and a cell."""
    buffer = io.BytesIO()
    writer = Writer(buffer)
    writer.start()
    schema = writer.register_schema("Reading", "jsonschema", b'{"type": "object"}')
    ids = [writer.register_channel(f"/w/{name}", "json", schema) for name in NAMES]
    times = operation(1)[0].time_us.tolist()
    for at, (time_us, (_, row)) in enumerate(zip(times, rows(edit=halved), strict=True)):
        for channel, cell in enumerate(row):
            data = json.dumps(payload(at, channel, cell)).encode()
            writer.add_message(ids[channel], 1000 * (time_us + late_us(at)), data, 1000 * time_us)
    writer.finish()
    return buffer.getvalue()


def value(_at: int, _channel: int, cell: str) -> Mapping[str, Any]:
    return {"value": float(cell)}


def coded(at: int, _channel: int, cell: str) -> Mapping[str, Any]:
    return {"value": float(cell), "quality": 0 if at in BAD else 192}


QUALITIES: Mapping[str, Callable[[], Files]] = {
    "a long table": lambda: long("StatusCode", "0", "2147483648"),
    "messages": lambda: {"w.mcap": messages(coded)},
}


@pytest.mark.parametrize("form", QUALITIES)
def test_rows_of_bad_quality_are_refused_without_a_question(form: str, plant: Plant) -> None:
    assert plant.init(QUALITIES[form]()).code == 0
    (motor,) = plant.check()
    refused = {channel["refused_by"].get("bad_quality") for channel in motor["channels"]}
    assert refused == {len(BAD) / 720}
    assert [night["status"] for night in motor["forecast"]] == ["ok"]


def test_codes_that_may_mean_either_are_asked(plant: Plant) -> None:
    """0 is bad in OPC DA, and good in other systems."""
    files = long("Quality", "0", "1")
    asked = plant.init(files)
    assert asked.code == 1
    assert "--answer 'good codes of quality=…'" in asked.out
    assert plant.init(files, "good codes of quality=0").code == 0
    assert plant.fit().code == 0
    refused = plant.table("quality").filter(reason="bad_quality")
    assert refused["n_refused"].to_list() == [len(BAD)] * len(NAMES)
    true = np.delete(operation(1)[1]["leakage_flow"], BAD).mean()
    mean = plant.table()["mean_drain_flow_l_per_min"].to_list()
    assert mean == [pytest.approx(true, rel=0.05)]


def test_a_column_that_is_not_read_is_listed(plant: Plant) -> None:
    unused = plant.init(long("Quality", "0", "1"), "good codes of quality=none")
    assert unused.code == 0
    assert "not used: Quality" in unused.out
    (motor,) = plant.check()
    words = "the log has its quality, Quality, which is not used"
    assert sum(words in note for note in motor["notes"]) == 4


# Layouts: names of one motor's logs of three nights, and the pattern that finds them

LAYOUTS: Mapping[str, tuple[Sequence[str], str]] = {
    "day first": ([f"w_0{day}.01.2026.csv" for day in (1, 2, 3)], "w_*.csv"),
    "single digits": ([f"w_2026-1-{day}.csv" for day in (1, 2, 3)], "w_*.csv"),
    "names of months": ([f"w_0{day}Jan2026.csv" for day in (1, 2, 3)], "w_*.csv"),
    "two-digit years": ([f"w_26-01-0{day}.csv" for day in (1, 2, 3)], "w_*.csv"),
    "weeks": ([f"w_KW01_{day}.csv" for day in ("Thu", "Fri", "Sat")], "w_*.csv"),
    "months": ([f"w_2026-0{month}.csv" for month in (1, 2, 3)], "w_*.csv"),
    "folders of a year": ([f"2026/01/0{day}/w.csv" for day in (1, 2, 3)], "*/*/*/w.csv"),
    "days in months": ([f"2026/01/0{day}.csv" for day in (1, 2, 3)], "*/*/*.csv"),
    "folders of days": ([f"W1/2026-01-0{day}/W1.csv" for day in (1, 2, 3)], "W1/*/W1.csv"),
    "Hive": (
        [f"year=2026/month=1/day={day}/part-0.csv" for day in (1, 2, 3)],
        "year=*/month=*/day=*/*.csv",
    ),
    "Spark": ([f"dt=2026-01-0{n}/part-0000{n}-8d1f-c000.csv" for n in (1, 2, 3)], "dt=*/*.csv"),
    "counts": ([f"Datalog{number}.csv" for number in (0, 1, 2)], "Datalog*.csv"),
    "copies": (["Export.csv", "Export (1).csv", "Export (2).csv"], "Export*.csv"),
    "parts of a bag": ([f"shift/shift_{number}.csv" for number in (0, 1, 2)], "shift/shift_*.csv"),
    "ids": ([f"{number}f3c9a1b7d2e.csv" for number in (1, 2, 3)], "*.csv"),
    "hours in folders of days": (
        [f"2026/01/0{day}/hist_0{day}.csv" for day in (1, 2, 3)],
        "*/*/*/hist_*.csv",
    ),
    "a word that may name motors": ([f"winch{n}.csv" for n in (1, 2, 3)], "winch*.csv"),
}


# Those that are read as another one is.
ALIKE = ("single digits", "two-digit years", "folders of a year", "parts of a bag")


@pytest.mark.parametrize(
    "layout",
    [pytest.param(name, marks=pytest.mark.full if name in ALIKE else ()) for name in LAYOUTS],
)
def test_logs_of_one_motor_are_one_motor_s(layout: str, plant: Plant) -> None:
    names, pattern = LAYOUTS[layout]
    nights = (1, 32, 60) if layout == "months" else (1, 2, 3)
    files = {name: wide(night, minutes=2.0) for name, night in zip(names, nights, strict=True)}
    proposed = plant.init(files)
    if "may" in layout:
        assert proposed.code == 1
        assert f"--answer 'motors of {pattern}=…'" in proposed.out
        proposed = plant.init(files, f"motors of {pattern}=one")
    assert proposed.code == 0
    (spec,) = plant.motors
    assert spec.file.logs.files == (pattern,)
    (motor,) = plant.check()
    assert (motor["n_files"], motor["n_nights"]) == (3, 3)


def test_logs_of_the_same_time_are_of_several_motors(plant: Plant) -> None:
    assert plant.init({f"Datalog{number}.csv": wide() for number in (1, 2, 3)}).code == 0
    assert [spec.motor_id for spec in plant.motors] == ["Datalog1", "Datalog2", "Datalog3"]


@pytest.mark.parametrize("has_checkpoint", [False, True])
def test_files_that_a_delta_table_has_removed_are_not_read(
    has_checkpoint: bool, plant: Plant
) -> None:
    """An update wrote a file anew, with a flow of another unit before."""
    made, values = operation(1)
    columns = {"time": pa.array(made.time_us, pa.timestamp("us", "UTC"))}
    columns |= {name: pa.array(values[channel]) for name, channel in NAMES.items()}
    wrong = columns | {"drain_flow_lpm": pa.array(60.0 * values["leakage_flow"])}
    old, new = (f"part-0000{number}-8d1f-c000.snappy.parquet" for number in (0, 1))
    versions = [[{"add": {"path": old}}], [{"remove": {"path": old}}, {"add": {"path": new}}]]
    files: dict[str, str | bytes] = {old: parquet(wrong), new: parquet(columns)}
    files |= {
        f"_delta_log/{number:020}.json": "\n".join(map(json.dumps, actions))
        for number, actions in enumerate(versions)
    }
    if has_checkpoint:
        first = parquet({"add": [{"path": old}]})
        files[f"_delta_log/{0:020}.checkpoint.parquet"] = first
    assert plant.init(files).code == 0
    (motor,) = plant.check()
    assert (motor["n_files"], motor["faults"]) == (1, [])
    flow = motor["channels"][-1]
    assert flow["median"] == pytest.approx(np.median(values["leakage_flow"]), rel=0.02)


# Sampling: sessions, and values that are sent on change


def sessions() -> str:
    """The logger records while the machine runs; the temperature every half minute."""
    times = pl.Series(operation(1, 40.0)[0].time_us)
    pauses = pl.Series(np.arange(len(times)) // 480 * 3600 * 10**6)
    stamps = (times + pauses).cast(pl.Datetime("us")).dt.strftime("%Y-%m-%d %H:%M:%SZ")
    lines = wide(edit=constant("oil_temperature", "", lambda at: at % 30 > 0), minutes=40.0)
    head, *rest = lines.splitlines()
    shifted = (f"{at},{line.partition(',')[2]}" for at, line in zip(stamps, rest, strict=True))
    return "\n".join([head, *shifted, ""])


def on_change(*, is_long: bool) -> str:
    """A temperature is written when it has changed by 0.2 °C."""
    lines, sent = [], -100.0
    for stamp, row in rows(minutes=40.0):
        if abs(float(row[1]) - sent) < 0.2:
            row[1] = ""
        else:
            sent = float(row[1])
        cells = zip(NAMES, row, strict=True)
        tags = [f"{stamp},W.{name},{cell}" for name, cell in cells if cell]
        lines += tags if is_long else [",".join([stamp, *row])]
    return "\n".join(["time,tag,value" if is_long else ",".join(["time", *NAMES]), *lines, ""])


@pytest.mark.parametrize(
    ("log", "words"),
    [
        pytest.param(sessions, "", id="sessions"),
        pytest.param(lambda: on_change(is_long=False), "oil_temperature is sent", id="wide"),
        pytest.param(lambda: on_change(is_long=True), "oil_temperature is sent", id="long"),
    ],
)
def test_silence_is_no_loss(log: Callable[[], str], words: str, plant: Plant) -> None:
    proposed = plant.init({"w_2026-01-02.csv": log()})
    assert proposed.code == 0
    assert words in proposed.out
    assert plant.fit().code == 0
    (night,) = plant.table().rows(named=True)
    assert (night["status"], night["kept_percent"] > 90.0) == ("ok", True)
    assert night["logged_hours"] == pytest.approx(40 / 60, rel=0.05)
    true = operation(1, 40.0)[1]["oil_temperature"].mean()
    assert night["mean_temperature_c"] == pytest.approx(true, abs=0.3)


# InfluxDB

ANNOTATIONS = (
    "#group,false,false,true,true,false,false,true,true,true\n"
    "#datatype,string,long,dateTime:RFC3339,dateTime:RFC3339,dateTime:RFC3339,double,string,"
    "string,string\n#default,_result,,,,,,,,\n"
)
ANNOTATED = ",result,table,_start,_stop,_time,_value,_field,_measurement,asset\n"
ROW = ",,0,2026-01-01T00:00:00Z,2026-01-03T00:00:00Z,{time},{value},{field},hyd,{motor}\n"
# A field's rows stand together: names of the first rows are all alike. Marks before each field's
# table, the names of the columns, and a row.
INFLUX = {
    "annotated": (ANNOTATIONS, ANNOTATED, ROW),
    "not annotated": ("", ANNOTATED, ROW),
    "plain": ("", "name,time,asset,field,value\n", "hyd,{time},{motor},{field},{value}\n"),
    "in fields": ("", "result,_time,_value,_field\n", "r,{time},{value},{motor}_{field}\n"),
}


@pytest.mark.parametrize("form", INFLUX)
def test_long_tables_of_influx(form: str, plant: Plant) -> None:
    marks, head, line = INFLUX[form]
    lines = [] if marks else [head]
    for motor in ("W1", "W2"):
        for at, name in enumerate(NAMES):
            lines += [marks + head] if marks else []
            lines += [
                line.format(time=stamp, value=row[at], field=name, motor=motor)
                for stamp, row in rows(minutes=8.0)
            ]
            lines += ["\n"] if marks else []
    assert plant.init({"export_2026-01-01.csv": "".join(lines)}).code == 0
    motors = plant.check()
    assert [motor["motor_id"] for motor in motors] == ["W1", "W2"]
    assert {night["status"] for motor in motors for night in motor["forecast"]} == {"ok"}


# What `check` says


@covers("check --json --full")
def test_the_forecast_is_what_the_run_does(plant: Plant) -> None:
    """Of four nights one is short, one stands still, and one reads one temperature for ever.

    Before the last there is a night without a log, behind it one whose log cannot be read. Then
    another motor has logs, of a night too short to be fitted.
    """
    nights = {
        1: wide(1),
        2: "".join(wide(2).splitlines(keepends=True)[:200]),
        3: wide(3, edit=lambda _, row: [12.0, row[1], 0.0, 0.0]),
        5: wide(5, edit=constant("oil_temperature", 48.0)),
    }
    files = {f"w_2026-01-0{night}.csv": text for night, text in nights.items()}
    files["v_2026-01-08.csv"] = "".join(wide(8).splitlines(keepends=True)[:200])
    assert plant.init(files).code == 0
    (plant.folder / "logs" / "w_2026-01-06.csv").write_text(wide(6, form=MONTH_FIRST))
    checked = plant.check("--full")
    plant.fit()
    fitted = plant.table().sort("motor_id", "night").rows(named=True)
    assert [
        (motor["motor_id"], *night.values())[:4] for motor in checked for night in motor["forecast"]
    ] == [
        (night["motor_id"], str(night["night"]), night["status"], night["reason"] or "")
        for night in fitted
    ]
    assert [night["status"] for night in fitted if night["motor_id"] == "w"] == [
        *("ok", "insufficient_data", "stood_still", "no_new_data", "ok", "failed"),
        *("no_new_data", "no_new_data"),
    ]


def negative(at: int, row: list[Any]) -> list[Any]:
    """A motor that runs backwards from its half on, written with the sign of Unicode."""
    pressure, temperature, speed, flow = row
    turned = [f"\N{MINUS SIGN}{pressure}", temperature, f"\N{MINUS SIGN}{speed}", flow]
    return row if at < 360 else turned


def with_commas(at: int, row: list[Any]) -> list[Any]:
    """Decimal commas from two thirds on, beyond what `init` judges the marks by."""
    return [f'"{cell}"'.replace(".", ",") for cell in row] if at >= 480 else row


def with_remarks() -> str:
    """Every twentieth row has a remark whose comma makes two cells of it."""
    text = wide(edit=lambda at, row: [*row[:3], f"{row[3]},{'slow, hot' if at % 20 == 9 else ''}"])
    return text.replace("\n", ",remark\n", 1)


def newest_first() -> str:
    head, *lines = wide().splitlines()
    return "\n".join([head, *reversed(lines), ""])


# A log, the code of the fault that it is, and words of the fault.
CHECKED: Mapping[str, tuple[Callable[[], str], str, str]] = {
    "without seconds": (lambda: wide(form="%Y-%m-%d %H:%MZ"), "samples_refused", "stamps lack"),
    "short": (
        lambda: "".join(wide().splitlines(keepends=True)[:241]),
        "no_night",
        "of 1 night none would be fitted",
    ),
    "a flow of no reading": (
        lambda: wide(edit=constant("leakage_flow", 65.535, lambda at: at % 150 < 5)),
        "extreme_repeated",
        "valid_range = [0,",
    ),
    "a temperature of none": (
        lambda: wide(edit=constant("oil_temperature", 85.0, lambda at: at % 150 < 5)),
        "extreme_repeated",
        "valid_range = [-40,",
    ),
    "newest first": (newest_first, "samples_refused", "rows are newest first"),
    "minus signs": (lambda: wide(edit=negative), "", ""),
    "commas further down": (
        lambda: wide(edit=with_commas),
        "cells_unread",
        "without a number, such as",
    ),
    "remarks with commas": (with_remarks, "cells_unread", "36 rows with too many or too few cells"),
}


@pytest.mark.parametrize("log", CHECKED)
def test_what_is_wrong_with_a_log_is_named(log: str, plant: Plant) -> None:
    text, code, words = CHECKED[log]
    assert plant.init({"w_2026-01-01.csv": text()}).code == int(code == "cells_unread")
    assert all(part.sampling == "periodic" for part in plant.motors[0].file.channels.values())
    ended = plant.run("check", "--json")
    assert ended.code == int(bool(code))
    (motor,) = ended.lines
    assert {fault.partition(":")[0] for fault in motor["faults"]} == ({code} if code else set())
    assert all(words in fault for fault in motor["faults"])
    if not code:
        assert {channel["share_missing"] for channel in motor["channels"]} == {0.0}
    jumps = any("oil_temperature jumps" in note for note in motor["notes"])
    assert jumps == ("temperature" in log)


def test_values_of_no_reading_are_seen_in_other_logs_than_the_newest(plant: Plant) -> None:
    """The oldest, middle and newest night of four are looked into; the second one with --full."""
    nights = {
        1: wide(1, edit=constant("leakage_flow", 65.535, lambda at: at % 150 < 5)),
        2: wide(2, edit=constant("oil_temperature", 85.0, lambda at: at % 150 < 5)),
        3: wide(3),
        4: wide(4),
    }
    plant.init({f"w_2026-01-0{night}.csv": text for night, text in nights.items()})
    for options, channels in ([], ["leakage_flow"]), (["--full"], ["leakage_flow", "oil_temp"]):
        (motor,) = plant.check(*options)
        faults = [fault.removeprefix("extreme_repeated: ")[:8] for fault in motor["faults"]]
        assert faults == [channel[:8] for channel in channels]


@covers("check")
def test_on_its_first_day_a_motor_has_no_fault(
    plant: Plant, turn_clock: Callable[[dt.timedelta], None]
) -> None:
    """Four minutes of a log so far: too few for a fit, and nothing to mend; a day later it is."""
    now = dt.datetime.now(dt.UTC)
    midday = now.replace(hour=12, minute=30)  # nights end at a full hour
    turn_clock(midday - now)
    began = midday - dt.timedelta(minutes=5)
    head, *lines = wide().splitlines()[: 1 + 4 * 60]

    def since(begin: dt.datetime) -> Files:
        stamps = (begin + dt.timedelta(seconds=second) for second in range(len(lines)))
        cells = (line[20:] for line in lines)
        shifted = (f"{stamp:{ISO}}{row}" for stamp, row in zip(stamps, cells, strict=True))
        return {"w.csv": "\n".join([head, *shifted, ""])}

    assert plant.init(since(began)).code == 0
    ended = plant.run("check")
    assert (ended.code, "no_night: of 1 night none would be fitted" in ended.out) == (0, True)
    (plant.folder / "logs" / "w.csv").write_text(str(since(began - dt.timedelta(days=1))["w.csv"]))
    assert plant.run("check").code == 1


def test_a_motor_without_a_log_is_a_fault(plant: Plant) -> None:
    logs = {f"{name}/{name}_2026-01-01.csv": wide() for name in ("A", "B")}
    assert plant.init(logs, "B.motor_type=CB1120").code == 0
    types = {spec.motor_id: spec.file.motor_type for spec in plant.motors}
    assert types == {"A": "CB400", "B": "CB1120"}
    (plant.folder / "logs" / "B" / "B_2026-01-01.csv").unlink()
    ended = plant.run("check")
    assert ended.code == 1
    assert "B: no_logs" in ended.err


def test_a_log_whose_name_contradicts_its_stamps_is_refused(plant: Plant) -> None:
    """In one of four logs the month comes first: its night would be another one."""
    files = {
        f"{motor}/{motor}_2026-01-0{night}.csv": wide(
            night, MONTH_FIRST if (motor, night) == ("W", 3) else DAY_FIRST
        )
        for motor in "VW"
        for night in (1, 2, 3, 4)
    }
    assert plant.init(files, f"time_format={DAY_FIRST}").code == 0
    ended = plant.run("check")
    assert ended.code == 1
    assert "W: log_misdated" in ended.err
    assert "V: " not in ended.err
    assert plant.fit().code == 1
    nights = plant.table()
    assert nights.filter(motor_id="V")["status"].to_list() == ["ok"] * 4
    w = dict(nights.filter(motor_id="W").select("night", "status").iter_rows())
    assert list(w.values()).count("ok") == 3
    assert max(w) < dt.date(2026, 1, 10)


# What `init` asks

DRAIN = dict(zip(("dp_bar", "T_degC", "n_rpm", "drain [0.1 l/min]"), CHANNELS, strict=True))


def test_answers_that_nobody_asks_for_are_named_or_refused(plant: Plant) -> None:
    refused = plant.init({"w_2026-01-01.csv": wide()}, "w.leakage_flo=drain_flow_lpm")
    assert refused.code == 2
    assert "did you mean 'w.leakage_flow'?" in refused.err
    done = plant.init({}, "w.motor_type=CB1120")
    assert done.code == 0
    assert "not needed: the answer time_zone" in done.out
    assert [spec.file.motor_type for spec in plant.motors] == ["CB1120"]


def test_what_is_typed_is_shown_as_an_answer_for_the_next_time(plant: Plant) -> None:
    asked = plant.init({"w_2026-01-01.csv": wide(names=DRAIN)})
    assert asked.code == 1
    with (
        patch("sys.stdin.isatty", return_value=True),
        patch("typer.prompt", side_effect=['unit = "l/min", scale = 0.1', "CB400", "vg68"]),
    ):
        done = plant.run("init", "logs", "--to", "fleet")
    assert (done.code, "scale = 0.1" in done.out) == (0, True)
    assert done.err.splitlines() == [
        """--answer 'unit of drain [0.1 l/min]=unit = "l/min", scale = 0.1'""",
        "--answer motor_type=CB400",
        "--answer oil=vg68",
    ]


def with_units(text: str) -> str:
    head, *lines = text.splitlines()
    cells = (line.replace(",", " kPa,").replace(" kPa,", ",", 1) + " l/min" for line in lines)
    return "\n".join([head, *cells, ""])


def apart() -> bytes:
    made, values = operation(1)
    times = pl.Series(made.time_us).cast(pl.Datetime("us"))
    columns = {name: pa.array(values[channel]) for name, channel in NAMES.items()}
    stamps = {"date": times.dt.date().to_arrow(), "time": times.dt.time().to_arrow()}
    return parquet(stamps | columns)


def text_of_temperatures(_at: int, channel: int, cell: str) -> Mapping[str, Any]:
    return {"value": cell if channel == 1 else float(cell)}


# What cannot be read is refused with its cause and an example.
REFUSED: Mapping[str, tuple[str, Callable[[], str | bytes], str]] = {
    "units in cells": ("w.csv", lambda: with_units(wide()), "its cells carry units (dp_bar: "),
    "a name of two lines": (
        "w.csv",
        lambda: wide().replace("speed_rpm", '"speed\n[rpm]"'),
        "a name goes over several lines",
    ),
    "a separator behind rows": (
        "w.csv",
        lambda: wide().replace("\n", ",\n").replace(",\n", "\n", 1),
        "rows end with a ','",
    ),
    "a packed MCAP": ("w.mcap.zstd", lambda: b"?", "there is w.mcap.zstd: unpack it"),
    "date and time apart": ("w.parquet", apart, "its time is apart, in date (date32[day])"),
    "numbers as text": (
        "w.mcap",
        lambda: messages(text_of_temperatures),
        "/w/oil_temp_degC: value is text",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_read_is_refused_with_its_cause(case: str, plant: Plant) -> None:
    name, content, words = REFUSED[case]
    refused = plant.init({name: content()})
    assert refused.code == 1
    assert words in refused.err
    assert not (plant.folder / "fleet").exists()


def test_samples_of_an_import_have_the_time_of_their_publishing(plant: Plant) -> None:
    """A recorder read a log in again: its own time runs faster, and on another day."""

    def late_us(at: int) -> int:
        return 60 * 86_400 * 10**6 - 980_000 * at

    assert plant.init({"w_2026-01-01.mcap": messages(value, late_us=late_us)}).code == 0
    (motor,) = plant.check()
    assert [night["status"] for night in motor["forecast"]] == ["ok"]
    assert abs(dt.date.fromisoformat(motor["last"]) - FIRST) <= dt.timedelta(days=1)


# Another unit from one night on


@covers("check --json")
def test_a_unit_that_changes_within_a_file_is_a_fault_with_its_night(plant: Plant) -> None:
    nights = [wide(1), wide(2), wide(3, edit=factor("leakage_flow", 60.0))]
    head, _, _ = nights[0].partition("\n")
    rows = (night.partition("\n")[2] for night in nights)
    assert plant.init({"w.csv": f"{head}\n{''.join(rows)}"}).code == 0
    (motor,) = plant.check()
    (fault,) = motor["faults"]
    assert fault.startswith(f"columns_changed: from the night {motor['last']} (w.csv) on: unit")


@covers("ack --night --note", "ack --night --fit --note", "fit-fleet", "check --full --json")
def test_a_night_in_another_unit_is_accepted_or_released(plant: Plant) -> None:
    """The drain flow of the fourth night of five is in l/h where the others are in l/min.

    The oil was changed that day, which changes no unit.
    """
    nights = {night: wide(night) for night in (1, 2, 3, 5)}
    nights[4] = wide(4, edit=factor("leakage_flow", 60.0))
    assert plant.init({f"w_2026-01-0{n}.csv": nights[n] for n in sorted(nights)}).code == 0
    with (plant.folder / "fleet" / "motors" / "w.toml").open("a") as file:
        file.write('[[events]]\ndate = 2026-01-04\nkind = "oil_change"\noil = "vg68"\n')
    failed = [*["ok"] * 3, "failed", "ok"]

    def checked() -> tuple[list[str], list[str]]:
        """Codes of the faults, and what is forecast."""
        (motor,) = plant.check("--full")
        codes = [fault.partition(":")[0] for fault in motor["faults"]]
        reasons.append([night["reason"] or None for night in motor["forecast"]])
        return codes, [night["status"] for night in motor["forecast"]]

    reasons: list[list[str | None]] = []
    assert checked() == (["columns_changed"], failed)
    assert plant.fit().code == 1
    assert plant.table()["status"].to_list() == failed
    assert [plant.table()["reason"].to_list()] == reasons
    label = str(plant.table()["night"][3])
    words = ("w", "--note", "seen", "--night")
    refused = plant.run("ack", *words, "2026-01-02")
    assert refused.code == 2
    assert label in refused.err
    assert plant.run("fit-fleet").code == 1
    assert "excluded" in plant.run("ack", *words, label).out
    assert checked() == ([], failed)
    assert plant.run("fit-fleet").code == 0
    assert plant.table()["status"].to_list() == failed
    assert "fits it" in plant.run("ack", *words, label, "--fit").out
    assert checked() == ([], ["ok"] * 5)
    done = plant.run("fit-fleet")
    assert (done.code, "1 ok" in done.out) == (0, True)
    assert plant.table()["status"].to_list() == ["ok"] * 5


def test_a_unit_that_changes_is_refused_until_it_is_dated(plant: Plant) -> None:
    """The flow is in l/min in three nights, then in gallons, as configured."""
    in_gallons = factor("leakage_flow", 1.0 / 3.785412)
    nights = {n: wide(n) if n < 4 else wide(n, edit=in_gallons) for n in range(1, 7)}
    assert plant.init({f"w_2026-01-0{n}.csv": text for n, text in nights.items()}).code == 0
    fleet = plant.folder / "fleet" / "fleet.toml"
    text = fleet.read_text("utf-8").replace('"l/min"', '"us_gal/min"')
    fleet.write_text(f"{text}\n{SEQUENTIAL}", "utf-8")
    for options in ((), ("--redo", "2026-01-02")):
        assert plant.run("fit-fleet", *options).code == 1
        assert plant.table()["status"].to_list() == [*["failed"] * 3, *["ok"] * 3]
        assert plant.table()["error_code"].to_list() == [*["columns_changed"] * 3, *[None] * 3]
    checked, *_ = plant.check("--full")
    assert [look["status"] for look in checked["forecast"]] == plant.table()["status"].to_list()
    assert any("earlier_units of channels.leakage_flow" in fault for fault in checked["faults"])
    with (plant.folder / "fleet" / "motors" / "w.toml").open("a") as file:
        file.write("[channels.leakage_flow]\n")
        file.write('earlier_units = [["l/min", 2026-01-04T12:00:00Z]]\n')
    assert plant.run("fit-fleet").code == 0
    truth = [operation(night)[1]["leakage_flow"].mean() for night in range(1, 7)]
    flows = plant.table()["mean_drain_flow_l_per_min"].to_list()
    assert flows == pytest.approx(truth, rel=0.01)


# Cold oil


@covers("explain")
def test_a_warm_up_is_seen_and_left_out_on_demand(tmp_path: Path) -> None:
    motors = Simulated("cold", cold_share=0.5), Simulated("warm")
    fleet = make_fleet(tmp_path, *motors, minutes=90.0, nights=2).fitted()
    words = "errors go with the time since the start: -"
    assert words in fleet.run("explain", "cold", fleet.label(2)).out
    assert words not in fleet.run("explain", "warm", fleet.label(2)).out
    checked = {motor["motor_id"]: motor["notes"] for motor in fleet.run("check", "--json").lines}
    assert {motor: words in "".join(notes) for motor, notes in checked.items()} == {
        "cold": True,
        "warm": False,
    }
    before = [row["training_fit_percent"] for row in fleet.nights("cold")]
    fleet.append("motors/cold.toml", "[override.cleaning]\nwarm_up_minutes = 40")
    assert fleet.run("fit-fleet").code == 0
    after = [row["training_fit_percent"] for row in fleet.nights("cold")]
    assert min(new - old for new, old in zip(after, before, strict=True)) > 5
    assert words not in fleet.run("explain", "cold", fleet.label(2)).out
    refused = fleet.table("quality").filter(reason="warm_up")
    assert set(refused["motor_id"]) == {"cold"}
    assert refused["n_refused"].to_list() == pytest.approx([2400] * 2, abs=150)
