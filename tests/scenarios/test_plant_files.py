"""Files as plants write them: `init` finds what is right or asks, and the tables have it."""

from __future__ import annotations

import datetime as dt
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
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

from pipeline.config import load_fleet
from pipeline.demo import shipped_configs
from tests.pipeline.ingest.mcap_files import JSON, mcap_bytes
from tests.pipeline.simulated import Operation, operate
from tests.scenarios.command import Result, run_command
from tests.scenarios.covering import covers
from tests.scenarios.fleets import Simulated, make_fleet
from tests.scenarios.published import table

FIRST = dt.date(2026, 1, 2)
NAMES = {
    "pressure_difference": "dp_bar",
    "oil_temperature": "oil_temp_degC",
    "speed": "speed_rpm",
    "leakage_flow": "drain_flow_lpm",
}
HEADER = ",".join(NAMES.values())
QUICK = '\n[execution]\nbackend = "sequential"\n'
MACHINE = ("motor_type=CB400", "oil=vg68", "time_zone=UTC")


@cache
def operation(night: int, minutes: float = 12.0) -> tuple[Operation, dict[str, np.ndarray]]:
    """A night of a motor of type CB400 at 1 Hz, counted from 1, and what its sensors read."""
    (spec,) = [
        motor
        for motor in load_fleet(shipped_configs() / "fleet.toml").motors
        if motor.motor_id == "CB400-01"
    ]
    label = FIRST + dt.timedelta(days=night - 1)
    made = operate(label, minutes, seed=night)
    noise = np.random.default_rng(night).normal(0.0, 0.01, len(made.time_us))
    flow = made.flow(spec.motor(label, "none")) + noise
    return made, {name: value.round(4) for name, value in made.channels(flow).items()}


def stamps(night: int, form: str = "%Y-%m-%dT%H:%M:%SZ", minutes: float = 12.0) -> list[str]:
    """Stamps of a night's rows."""
    times = pl.Series(operation(night, minutes)[0].time_us).cast(pl.Datetime("us"))
    return times.dt.strftime(form).to_list()


def rows(night: int, minutes: float = 12.0) -> list[tuple[float, ...]]:
    """Readings of a night's rows, in the order of `NAMES`."""
    return list(zip(*operation(night, minutes)[1].values(), strict=True))


def plain(night: int, form: str = "%Y-%m-%dT%H:%M:%SZ") -> str:
    """A night as a wide CSV."""
    body = (
        f"{time},{','.join(map(str, row))}\n"
        for time, row in zip(stamps(night, form), rows(night), strict=True)
    )
    return f"time,{HEADER}\n{''.join(body)}"


def write(folder: Path, name: str, content: str | bytes) -> None:
    """Write a log into the folder of a plant's logs."""
    path = folder / "logs" / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content.encode() if isinstance(content, str) else content)


def init(folder: Path, *answers: str) -> Result:
    """Propose a fleet of a plant's logs with answers, and write it if nothing is open."""
    options = [word for answer in (*MACHINE, *answers) for word in ("--answer", answer)]
    return run_command("init", "logs", "--to", "fleet", "--write", *options, folder=folder)


def fit(folder: Path) -> Result:
    """Fit the fleet that was written, quickly."""
    with (folder / "fleet" / "fleet.toml").open("a") as file:
        file.write(QUICK)
    return run_command("fit-fleet", "fleet/fleet.toml", folder=folder)


def nights_of(folder: Path) -> pl.DataFrame:
    """Published nights of the fleet."""
    return table(folder / "fleet" / "out", "nights").sort("motor_id", "night")


# Quality

BAD = range(120, 300)
Forms = Mapping[str, Callable[[], tuple[str, str | bytes]]]


def marked(good: str, bad: str) -> Iterator[tuple[str, list[str], str]]:
    """Stamp, cells and code of each row; those of bad rows are half of the truth."""
    for at, (time, row) in enumerate(zip(stamps(1), rows(1), strict=True)):
        is_bad = at in BAD
        yield time, [str(value / 2 if is_bad else value) for value in row], bad if is_bad else good


def long(column: str, good: str, bad: str) -> Callable[[], tuple[str, str]]:
    def text() -> tuple[str, str]:
        lines = (
            f"{time},W.{name},{cell},{code}\n"
            for time, cells, code in marked(good, bad)
            for name, cell in zip(NAMES.values(), cells, strict=True)
        )
        return "hist.csv", f"DateTime,TagName,Value,{column}\n{''.join(lines)}"

    return text


def wide(value: str, quality: str, good: str, bad: str) -> Callable[[], tuple[str, str]]:
    def text() -> tuple[str, str]:
        names = [place.format(name) for name in NAMES.values() for place in (value, quality)]
        lines = (
            f"{time},{','.join(f'{cell},{code}' for cell in cells)}\n"
            for time, cells, code in marked(good, bad)
        )
        return "hist.csv", f"time,{','.join(names)}\n{''.join(lines)}"

    return text


def one_a_row() -> tuple[str, str]:
    lines = (f"{time},{','.join(cells)},{code}\n" for time, cells, code in marked("Good", "Bad"))
    return "hist.csv", f"time,{HEADER},Quality\n{''.join(lines)}"


def numbers_in_parquet() -> tuple[str, bytes]:
    cells = [
        (time, f"W.{name}", float(cell), int(code))
        for time, own, code in marked("192", "0")
        for name, cell in zip(NAMES.values(), own, strict=True)
    ]
    sink = pa.BufferOutputStream()
    columns = dict(zip(("ts", "tag", "value", "quality"), zip(*cells, strict=True), strict=True))
    pq.write_table(pa.table({name: pa.array(column) for name, column in columns.items()}), sink)
    return "hist.parquet", sink.getvalue().to_pybytes()


def json_messages() -> tuple[str, bytes]:
    times = operation(1)[0].time_us.tolist()
    messages = [
        (
            f"/w/{name}",
            1000 * time,
            json.dumps({"value": float(cell), "quality": int(code)}).encode(),
        )
        for time, (_, cells, code) in zip(times, marked("192", "0"), strict=True)
        for name, cell in zip(NAMES.values(), cells, strict=True)
    ]
    return "w.mcap", mcap_bytes(messages, JSON)


QUALITIES: Forms = {
    "OPC DA, a long table": long("Quality", "192", "0"),
    "words, a long table": long("Quality", "Good", "Bad"),
    "validity, a long table": long("Validity", "1", "0"),
    "OPC UA, a long table": long("StatusCode", "0", "2147483648"),
    "beside each column": wide("W.{}", "W.{}.Quality", "192", "0"),
    "value beside quality": wide("W.{}.Value", "W.{}.Quality", "216", "64"),
    "words with underscores": wide("W_{}_VALUE", "W_{}_QUALITY", "Good", "Bad"),
    "validity beside each column": wide("W.{}", "W.{}.Validity", "1", "0"),
    "before the name": wide("{}", "Quality_{}", "GOOD", "Uncertain"),
    "one a row": one_a_row,
    "numbers in Parquet": numbers_in_parquet,
    "messages": json_messages,
}


@pytest.mark.parametrize("form", QUALITIES)
def test_rows_of_bad_quality_are_refused_without_a_question(form: str, tmp_path: Path) -> None:
    write(tmp_path, *QUALITIES[form]())
    assert init(tmp_path).code == 0
    assert fit(tmp_path).code == 0
    refused = table(tmp_path / "fleet" / "out", "quality").filter(reason="bad_quality")
    assert set(refused["channel"]) == set(NAMES)
    assert refused["n_refused"].to_list() == [len(BAD)] * len(NAMES)
    (night,) = nights_of(tmp_path).rows(named=True)
    assert night["status"] == "ok"
    true = np.delete(operation(1)[1]["leakage_flow"], BAD).mean()
    assert night["mean_drain_flow_l_per_min"] == pytest.approx(true, rel=0.05)


def test_codes_that_may_mean_either_are_asked(tmp_path: Path) -> None:
    """0 is bad in OPC DA, and good in other systems."""
    write(tmp_path, *long("Quality", "0", "1")())
    asked = init(tmp_path)
    assert asked.code == 1
    assert "--answer 'good codes of quality=…'" in asked.out
    assert init(tmp_path, "good codes of quality=0").code == 0
    assert fit(tmp_path).code == 0
    refused = table(tmp_path / "fleet" / "out", "quality").filter(reason="bad_quality")
    assert refused["n_refused"].to_list() == [len(BAD)] * len(NAMES)


def test_a_column_that_is_not_read_is_listed(tmp_path: Path) -> None:
    write(tmp_path, *long("Quality", "0", "1")())
    unused = init(tmp_path, "good codes of quality=none")
    assert unused.code == 0
    assert "not used: Quality" in unused.out
    notes = checked(tmp_path)["notes"]
    assert sum("the log has its quality, Quality, which is not used" in note for note in notes) == 4


# Layouts


@dataclass(frozen=True)
class Layout:
    """Names of one motor's logs, of nights from 1 on."""

    names: Sequence[str]
    pattern: str
    answers: Sequence[str] = ()
    nights: Sequence[int] = field(default=(1, 2, 3))


LAYOUTS = {
    "day first": Layout([f"w_0{day}.01.2026.csv" for day in (1, 2, 3)], "w_*.csv"),
    "single digits": Layout([f"w_2026-1-{day}.csv" for day in (1, 2, 3)], "w_*.csv"),
    "names of months": Layout([f"w_0{day}Jan2026.csv" for day in (1, 2, 3)], "w_*.csv"),
    "two-digit years": Layout([f"w_26-01-0{day}.csv" for day in (1, 2, 3)], "w_*.csv"),
    "weeks": Layout([f"w_KW01_{day}.csv" for day in ("Thu", "Fri", "Sat")], "w_*.csv"),
    "months": Layout(
        [f"w_2026-0{month}.csv" for month in (1, 2, 3)], "w_*.csv", nights=(1, 32, 60)
    ),
    "folders of a year": Layout([f"2026/01/0{day}/w.csv" for day in (1, 2, 3)], "*/*/*/w.csv"),
    "days in folders of months": Layout([f"2026/01/0{day}.csv" for day in (1, 2, 3)], "*/*/*.csv"),
    "folders of days": Layout([f"W1/2026-01-0{day}/W1.csv" for day in (1, 2, 3)], "W1/*/W1.csv"),
    "Hive": Layout(
        [f"year=2026/month=1/day={day}/part-0.csv" for day in (1, 2, 3)],
        "year=*/month=*/day=*/*.csv",
    ),
    "Spark": Layout(
        [f"dt=2026-01-0{n}/part-0000{n}-8d1f-c000.csv" for n in (1, 2, 3)], "dt=*/*.csv"
    ),
    "counts": Layout([f"Datalog{number}.csv" for number in (0, 1, 2)], "Datalog*.csv"),
    "copies": Layout(["Export.csv", "Export (1).csv", "Export (2).csv"], "Export*.csv"),
    "parts of a bag": Layout(
        [f"shift/shift_{number}.csv" for number in (0, 1, 2)], "shift/shift_*.csv"
    ),
    "ids": Layout([f"{number}f3c9a1b7d2e.csv" for number in (1, 2, 3)], "*.csv"),
    "a word that may name motors": Layout(
        [f"winch{number}.csv" for number in (1, 2, 3)], "winch*.csv", ["motors of winch*.csv=one"]
    ),
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_logs_of_one_motor_are_one_motor_s(layout: str, tmp_path: Path) -> None:
    case = LAYOUTS[layout]
    for name, night in zip(case.names, case.nights, strict=True):
        write(tmp_path, name, plain(night))
    if case.answers:
        asked = init(tmp_path)
        assert asked.code == 1
        assert f"--answer '{case.answers[0].partition('=')[0]}=…'" in asked.out
    assert init(tmp_path, *case.answers).code == 0
    (spec,) = load_fleet(tmp_path / "fleet" / "fleet.toml").motors
    assert spec.file.logs.files == (case.pattern,)
    (checked,) = run_command("check", "fleet/fleet.toml", "--json", folder=tmp_path).lines
    assert (checked["n_files"], checked["n_nights"], checked["faults"]) == (3, 3, [])


def test_logs_of_the_same_time_are_of_several_motors(tmp_path: Path) -> None:
    for number in (1, 2, 3):
        write(tmp_path, f"Datalog{number}.csv", plain(1))
    assert init(tmp_path).code == 0
    motors = load_fleet(tmp_path / "fleet" / "fleet.toml").motors
    assert [spec.motor_id for spec in motors] == ["Datalog1", "Datalog2", "Datalog3"]


@pytest.mark.parametrize("has_checkpoint", [False, True])
def test_files_that_a_delta_table_has_removed_are_not_read(
    has_checkpoint: bool, tmp_path: Path
) -> None:
    """An update wrote a file anew, with a flow of another unit before."""
    old, new = (f"part-0000{number}-8d1f-c000.snappy.parquet" for number in (0, 1))
    made, values = operation(1)
    time = pa.array(made.time_us, pa.timestamp("us", "UTC"))
    for name, factor in ((old, 60.0), (new, 1.0)):
        columns = {NAMES[channel]: pa.array(value) for channel, value in values.items()}
        columns["drain_flow_lpm"] = pa.array(values["leakage_flow"] * factor)
        write(tmp_path, name, b"")
        pq.write_table(pa.table({"time": time} | columns), tmp_path / "logs" / name)
    versions = [[{"add": {"path": old}}], [{"remove": {"path": old}}, {"add": {"path": new}}]]
    for number, actions in enumerate(versions):
        lines = "\n".join(map(json.dumps, actions))
        write(tmp_path, f"_delta_log/{number:020}.json", lines)
    if has_checkpoint:
        first = tmp_path / "logs" / "_delta_log" / f"{0:020}.checkpoint.parquet"
        pq.write_table(pa.table({"add": [{"path": old}]}), first)
    assert init(tmp_path).code == 0
    assert fit(tmp_path).code == 0
    (night,) = nights_of(tmp_path).rows(named=True)
    true = values["leakage_flow"].mean()
    assert night["mean_drain_flow_l_per_min"] == pytest.approx(true, rel=0.02)


# Sessions and silences


def test_silence_between_sessions_is_no_loss(tmp_path: Path) -> None:
    """The logger records while the machine runs; the temperature every half minute."""
    times = pl.Series(operation(1, 40.0)[0].time_us)
    pauses = pl.Series(np.arange(len(times)) // 480 * 3600 * 10**6)
    stamp = (times + pauses).cast(pl.Datetime("us")).dt.strftime("%Y-%m-%d %H:%M:%SZ")
    lines = [
        f"{time},{p},{t if at % 30 == 0 else ''},{n},{q}\n"
        for at, (time, (p, t, n, q)) in enumerate(zip(stamp, rows(1, 40.0), strict=True))
    ]
    write(tmp_path, "w_2026-01-02.csv", f"time,{HEADER}\n{''.join(lines)}")
    assert init(tmp_path).code == 0
    assert fit(tmp_path).code == 0
    (night,) = nights_of(tmp_path).rows(named=True)
    assert night["status"] == "ok"
    assert night["kept_percent"] > 90.0
    assert night["logged_hours"] == pytest.approx(40 / 60, rel=0.05)


@pytest.mark.parametrize("layout", ["wide", "long"])
def test_values_that_are_sent_on_change_are_proposed_as_such(layout: str, tmp_path: Path) -> None:
    """A temperature is written when it has changed by 0.2 °C."""
    lines, sent = [], -100.0
    for time, row in zip(stamps(1, minutes=40.0), rows(1, 40.0), strict=True):
        cells = dict(zip(NAMES.values(), map(str, row), strict=True))
        if abs(row[1] - sent) < 0.2:
            cells["oil_temp_degC"] = ""
        sent = sent if cells["oil_temp_degC"] == "" else row[1]
        if layout == "wide":
            lines.append(f"{time},{','.join(cells.values())}\n")
        else:
            lines += [f"{time},W.{name},{cell}\n" for name, cell in cells.items() if cell]
    header = f"time,{HEADER}" if layout == "wide" else "time,tag,value"
    write(tmp_path, "w_2026-01-02.csv", f"{header}\n{''.join(lines)}")
    proposed = init(tmp_path)
    assert proposed.code == 0
    assert "oil_temperature is sent on change" in proposed.out
    assert fit(tmp_path).code == 0
    (night,) = nights_of(tmp_path).rows(named=True)
    assert night["status"] == "ok"
    assert night["kept_percent"] > 90.0
    true = operation(1, 40.0)[1]["oil_temperature"].mean()
    assert night["mean_temperature_c"] == pytest.approx(true, abs=0.3)


# InfluxDB

ANNOTATIONS = (
    "#group,false,false,true,true,false,false,true,true,true\n"
    "#datatype,string,long,dateTime:RFC3339,dateTime:RFC3339,dateTime:RFC3339,double,string,"
    "string,string\n#default,_result,,,,,,,,\n"
)
ANNOTATED = ",result,table,_start,_stop,_time,_value,_field,_measurement,asset\n"
SPAN = "2026-01-01T00:00:00Z,2026-01-03T00:00:00Z"
# A field's rows stand together: names of the first rows are all alike. Marks before each field's
# table, the names of the columns, and a row.
INFLUX = {
    "annotated": (ANNOTATIONS, ANNOTATED, ",,0,{span},{time},{value},{field},hyd,{motor}\n"),
    "not annotated": ("", ANNOTATED, ",,0,{span},{time},{value},{field},hyd,{motor}\n"),
    "plain": ("", "name,time,asset,field,value\n", "hyd,{time},{motor},{field},{value}\n"),
    "in fields": ("", "result,_time,_value,_field\n", "r,{time},{value},{motor}_{field}\n"),
}


@pytest.mark.parametrize("form", INFLUX)
def test_long_tables_of_influx(form: str, tmp_path: Path) -> None:
    marks, head, row = INFLUX[form]
    lines = [] if marks else [head]
    for motor in ("W1", "W2"):
        for at, field_name in enumerate(NAMES.values()):
            lines += [marks + head] if marks else []
            lines += [
                row.format(span=SPAN, time=time, value=own[at], field=field_name, motor=motor)
                for time, own in zip(stamps(1), rows(1), strict=True)
            ]
            lines += ["\n"] if marks else []
    write(tmp_path, "export_2026-01-01.csv", "".join(lines))
    assert init(tmp_path).code == 0
    assert fit(tmp_path).code == 0
    nights = nights_of(tmp_path)
    assert nights["motor_id"].to_list() == ["W1", "W2"]
    assert nights["status"].to_list() == ["ok", "ok"]


# What `check` says


def checked(folder: Path, *options: str) -> dict[str, Any]:
    """What `check` says of the one motor."""
    (motor,) = run_command("check", "fleet/fleet.toml", "--json", *options, folder=folder).lines
    return motor


def codes(motor: dict[str, Any]) -> set[str]:
    """Codes of the faults of a motor."""
    return {fault.partition(":")[0] for fault in motor["faults"]}


@covers("check --json --full")
def test_the_forecast_is_what_the_run_does(tmp_path: Path) -> None:
    """Of four nights one is short, one stands still, and one reads one temperature for ever."""
    texts = {night: plain(night).splitlines(keepends=True) for night in (1, 2, 3, 4)}
    texts[2] = texts[2][:200]
    texts[3] = [texts[3][0], *(_with(line, 2, "0.0") for line in texts[3][1:])]
    texts[4] = [texts[4][0], *(_with(line, 1, "48.0") for line in texts[4][1:])]
    for night, lines in texts.items():
        write(tmp_path, f"w_2026-01-0{night}.csv", "".join(lines))
    assert init(tmp_path).code == 0
    forecast = checked(tmp_path, "--full")["forecast"]
    fit(tmp_path)
    nights = nights_of(tmp_path).rows(named=True)
    assert [(one["night"], one["status"], one["reason"]) for one in forecast] == [
        (str(night["night"]), night["status"], night["reason"] or "") for night in nights
    ]
    assert {night["status"] for night in nights} == {"ok", "insufficient_data", "stood_still"}


def _with(line: str, at: int, cell: str) -> str:
    cells = line.split(",")
    cells[at + 1] = cell
    return ",".join(cells)


@pytest.mark.parametrize(
    ("form", "minutes", "code", "words"),
    [
        ("%Y-%m-%d %H:%MZ", 12.0, "samples_refused", "as duplicate_time: do its stamps lack"),
        ("%Y-%m-%d %H:%M:%SZ", 4.0, "no_night", "of 1 night none would be fitted"),
    ],
)
def test_a_log_that_gives_no_fit_is_a_fault(
    form: str, minutes: float, code: str, words: str, tmp_path: Path
) -> None:
    lines = plain(1, form).splitlines(keepends=True)
    write(tmp_path, "w_2026-01-01.csv", "".join(lines[: 1 + round(60 * minutes)]))
    assert init(tmp_path).code == 0
    found = run_command("check", "fleet/fleet.toml", folder=tmp_path)
    assert found.code == 1
    assert f"w: {code}: " in found.err
    assert words in found.err


@covers("check")
def test_on_its_first_day_a_motor_has_no_fault(tmp_path: Path) -> None:
    """Four minutes of a log so far: too few for a fit, and nothing to mend; a day later it is."""
    began = dt.datetime.now(dt.UTC) - dt.timedelta(minutes=5)
    lines = plain(1).splitlines(keepends=True)[: 1 + 4 * 60]
    so_far = [
        f"{began + dt.timedelta(seconds=second):%Y-%m-%dT%H:%M:%SZ}{line[20:]}"
        for second, line in enumerate(lines[1:])
    ]
    write(tmp_path, "w.csv", "".join((lines[0], *so_far)))
    assert init(tmp_path).code == 0
    found = run_command("check", "fleet/fleet.toml", folder=tmp_path)
    assert (found.code, "no_night: of 1 night none would be fitted" in found.out) == (0, True)
    yesterday = began - dt.timedelta(days=1)
    text = (
        (tmp_path / "logs" / "w.csv").read_text().replace(str(began.date()), str(yesterday.date()))
    )
    write(tmp_path, "w.csv", text)
    assert run_command("check", "fleet/fleet.toml", folder=tmp_path).code == 1


def test_a_motor_without_a_log_is_a_fault(tmp_path: Path) -> None:
    for name in ("A", "B"):
        write(tmp_path, f"{name}/{name}_2026-01-01.csv", plain(1))
    assert init(tmp_path).code == 0
    (tmp_path / "logs" / "B" / "B_2026-01-01.csv").unlink()
    found = run_command("check", "fleet/fleet.toml", folder=tmp_path)
    assert found.code == 1
    assert "B: no_logs" in found.err


@pytest.mark.parametrize(
    ("at", "value", "limit"), [(3, 65.535, "valid_range = [0,"), (1, 85.0, "valid_range = [-40,")]
)
def test_what_a_device_writes_for_no_reading_is_named(
    at: int, value: float, limit: str, tmp_path: Path
) -> None:
    head, *lines = plain(1).splitlines()
    marked = [_with(line, at, str(value)) if n % 150 < 5 else line for n, line in enumerate(lines)]
    write(tmp_path, "w_2026-01-01.csv", "\n".join([head, *marked, ""]))
    assert init(tmp_path).code == 0
    motor = checked(tmp_path)
    assert codes(motor) == {"extreme_repeated"}
    jumps = [note for note in motor["notes"] if "oil_temperature jumps" in note]
    assert len(jumps) == (at == 1)
    assert limit in motor["faults"][0]


def test_a_log_whose_name_contradicts_its_stamps_is_refused(tmp_path: Path) -> None:
    """In one of four logs the month comes first: its night would be another one."""
    for night in (1, 2, 3, 4):
        form = "%m/%d/%Y %H:%M:%S" if night == 3 else "%d/%m/%Y %H:%M:%S"
        write(tmp_path, f"W/W_2026-01-0{night}.csv", plain(night, form))
        write(tmp_path, f"V/V_2026-01-0{night}.csv", plain(night, "%d/%m/%Y %H:%M:%S"))
    assert init(tmp_path, "time_format=%d/%m/%Y %H:%M:%S").code == 0
    found = run_command("check", "fleet/fleet.toml", folder=tmp_path)
    assert found.code == 1
    assert "W: log_misdated" in found.err
    assert "V: " not in found.err
    assert fit(tmp_path).code == 1
    nights = nights_of(tmp_path)
    assert set(nights["night"].dt.year().to_list()) == {2026}
    assert nights.filter(motor_id="V")["status"].to_list() == ["ok"] * 4
    w = dict(nights.filter(motor_id="W").select("night", "status").iter_rows())
    assert list(w.values()).count("ok") == 3
    assert max(w) < dt.date(2026, 1, 10)


# What `init` asks


def columns_csv(names: Mapping[str, str], night: int = 1, still: int = 0) -> str:
    """A night as a wide CSV under names by channel; the motor stands still at first."""
    at = [list(NAMES).index(channel) for channel in names.values()]
    lines = []
    for number, (time, row) in enumerate(zip(stamps(night), rows(night), strict=True)):
        cells = [0.02 if place == 2 and number < still else row[place] for place in at]
        lines.append(f"{time},{','.join(map(str, cells))}\n")
    return f"time,{','.join(names)}\n{''.join(lines)}"


def channels_of(folder: Path) -> dict[str, dict[str, tuple[str, str]]]:
    """Source and unit of each channel, by motor."""
    motors = load_fleet(folder / "fleet" / "fleet.toml").motors
    return {
        spec.motor_id: {
            str(name): (channel.source, channel.unit)
            for name, channel in spec.file.channels.items()
        }
        for spec in motors
    }


def test_a_unit_is_judged_while_the_motor_runs_and_its_question_stays(tmp_path: Path) -> None:
    names = dict(zip(("dp_bar", "T_degC", "speed", "drain_lpm"), NAMES, strict=True))
    write(tmp_path, "w_2026-01-01.csv", columns_csv(names, still=200))
    for answers in ((), ("motor_type=CB560",)):
        asked = init(tmp_path, *answers)
        assert asked.code == 1
        assert "--answer 'unit of speed=…'" in asked.out
        assert "(rpm, " in asked.out
    assert init(tmp_path, "unit of speed=rpm").code == 0
    assert channels_of(tmp_path)["w"]["speed"] == ("speed", "rpm")


def test_one_answer_is_for_logs_that_are_alike(tmp_path: Path) -> None:
    """Of two motors one logs its drain flow in another unit under the same name."""
    names = dict(zip(("dp_bar", "T_degC", "n_rpm", "drain"), NAMES, strict=True))
    write(tmp_path, "A/a_2026-01-01.csv", columns_csv(names))
    head, *lines = columns_csv(names).splitlines()
    lines = [_with(line, 3, str(float(line.split(",")[-1]) * 0.06)) for line in lines]
    write(tmp_path, "B/b_2026-01-01.csv", "\n".join([head, *lines, ""]))
    asked = init(tmp_path, "unit of drain=l/min")
    assert asked.code == 1
    assert "--answer 'unit of drain in B=…'" in asked.out
    assert init(tmp_path, "unit of drain=l/min", "unit of drain in B=m3/h").code == 0
    units = {motor: own["leakage_flow"][1] for motor, own in channels_of(tmp_path).items()}
    assert units == {"A": "l/min", "B": "m3/h"}


def test_a_thermometer_of_the_tank_is_every_motor_s(tmp_path: Path) -> None:
    own = {"dp_bar": "pressure_difference", "n_rpm": "speed", "drain_lpm": "leakage_flow"}
    names = {f"W{n}.{name}": channel for n in (1, 2) for name, channel in own.items()}
    names |= {"Tank.OilTemp_degC": "oil_temperature"}
    write(tmp_path, "w_2026-01-01.csv", columns_csv(names))
    assert init(tmp_path).code == 0
    found = channels_of(tmp_path)
    assert {one["oil_temperature"] for one in found.values()} == {("Tank.OilTemp_degC", "degC")}
    assert {one["speed"] for one in found.values()} == {("W1.n_rpm", "rpm"), ("W2.n_rpm", "rpm")}


def test_tags_of_a_motor_may_be_joined_by_different_marks(tmp_path: Path) -> None:
    names = {
        f"SHR1{mark}M{n}{mark}{name}": channel
        for n in (1, 2)
        for mark, name, channel in (
            (".", "DP_bar", "pressure_difference"),
            (".", "OilTemp_degC", "oil_temperature"),
            (".", "Speed_rpm", "speed"),
            ("_", "CaseFlow_lpm", "leakage_flow"),
        )
    }
    write(tmp_path, "w_2026-01-01.csv", columns_csv(names))
    assert init(tmp_path).code == 0
    flows = {motor: one["leakage_flow"][0] for motor, one in channels_of(tmp_path).items()}
    assert flows == {
        "SHR1.M1": "SHR1_M1_CaseFlow_lpm",
        "SHR1.M2": "SHR1_M2_CaseFlow_lpm",
    }


def test_a_motor_may_be_of_a_type_of_its_own(tmp_path: Path) -> None:
    for name in ("A", "B"):
        write(tmp_path, f"{name}/{name}_2026-01-01.csv", plain(1))
    assert init(tmp_path, "B.motor_type=CB1120").code == 0
    motors = load_fleet(tmp_path / "fleet" / "fleet.toml").motors
    types = {spec.motor_id: spec.file.motor_type for spec in motors}
    assert types == {"A": "CB400", "B": "CB1120"}


def test_answers_that_nobody_asks_for_are_named_or_refused(tmp_path: Path) -> None:
    write(tmp_path, "w_2026-01-01.csv", plain(1))
    refused = init(tmp_path, "w.leakage_flo=drain_flow_lpm")
    assert refused.code == 2
    assert "did you mean 'w.leakage_flow'?" in refused.err
    done = init(tmp_path)
    assert done.code == 0
    assert "not needed: the answer time_zone" in done.out


def test_what_is_typed_is_shown_as_an_answer_for_the_next_time(tmp_path: Path) -> None:
    names = dict(zip(("dp_bar", "T_degC", "n_rpm", "drain"), NAMES, strict=True))
    write(tmp_path, "w_2026-01-01.csv", columns_csv(names))
    typed = ["l/min", "CB400", "vg68"]
    with (
        patch("sys.stdin.isatty", return_value=True),
        patch("typer.prompt", side_effect=typed),
    ):
        done = run_command("init", "logs", "--to", "fleet", folder=tmp_path)
    assert done.code == 0
    assert done.err.splitlines() == [
        "--answer 'unit of drain=l/min'",
        "--answer motor_type=CB400",
        "--answer oil=vg68",
    ]


def test_names_tell_day_from_month(tmp_path: Path) -> None:
    for night in (1, 2, 3):
        write(tmp_path, f"w_2026-01-0{night}.csv", plain(night, "%d/%m/%Y %H:%M:%S"))
    assert init(tmp_path).code == 0
    (spec,) = load_fleet(tmp_path / "fleet" / "fleet.toml").motors
    assert spec.file.logs.time_format == "%d/%m/%Y %H:%M:%S"


@pytest.mark.parametrize("place", ["metadata", "schema"])
def test_units_that_messages_state_are_not_asked(place: str, tmp_path: Path) -> None:
    units = dict(
        zip(
            ("dp", "temperature", "speed", "drain_flow"),
            ("bar", "degC", "rpm", "l/min"),
            strict=True,
        )
    )
    with (tmp_path / "w.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        for at, (name, unit) in enumerate(units.items()):
            value = {"type": "number"} | ({"unit": unit} if place == "schema" else {})
            schema = {"type": "object", "properties": {"value": value}}
            number = writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
            metadata = {"unit": unit} if place == "metadata" else {}
            channel = writer.register_channel(f"/w/{name}", "json", number, metadata)
            for time, row in zip(operation(1)[0].time_us.tolist(), rows(1), strict=True):
                data = json.dumps({"value": row[at]}).encode()
                writer.add_message(channel, 1000 * time, data, 1000 * time)
        writer.finish()  # type: ignore[no-untyped-call]
    write(tmp_path, "w.mcap", (tmp_path / "w.mcap").read_bytes())
    assert init(tmp_path).code == 0
    assert [unit for _, unit in channels_of(tmp_path)["w"].values()] == list(units.values())


def test_a_minus_sign_is_one(tmp_path: Path) -> None:
    """A motor that runs backwards, written with the sign of Unicode."""
    head, *lines = plain(1).splitlines()
    turned = [line if n % 2 else _reversed(line) for n, line in enumerate(lines)]
    write(tmp_path, "w_2026-01-01.csv", "\n".join([head, *turned, ""]))
    assert init(tmp_path).code == 0
    (motor,) = run_command("check", "fleet/fleet.toml", "--json", folder=tmp_path).lines
    assert {one["share_missing"] for one in motor["channels"]} == {0.0}


def _reversed(line: str) -> str:
    time, pressure, temperature, speed, flow = line.split(",")
    return f"{time},\N{MINUS SIGN}{pressure},{temperature},\N{MINUS SIGN}{speed},{flow}"


def _in_two_lines() -> str:
    head, _, body = plain(1).partition("\n")
    return head.replace("speed_rpm", '"speed\n[rpm]"') + "\n" + body


def _apart() -> bytes:
    made, values = operation(1)
    times = pl.Series(made.time_us).cast(pl.Datetime("us"))
    columns = {NAMES[name]: pa.array(value) for name, value in values.items()}
    table_of = pa.table(
        {"date": times.dt.date().to_arrow(), "time": times.dt.time().to_arrow()} | columns
    )
    sink = pa.BufferOutputStream()
    pq.write_table(table_of, sink)
    return bytes(sink.getvalue())


def _texts() -> bytes:
    messages = [
        (f"/w/{name}", 1000 * time, json.dumps({"value": str(cell) if at == 1 else cell}).encode())
        for time, row in zip(operation(1)[0].time_us.tolist(), rows(1), strict=True)
        for at, (name, cell) in enumerate(zip(NAMES.values(), row, strict=True))
    ]
    return mcap_bytes(messages, JSON)


# What cannot be read is refused with its cause and an example.
REFUSED: Mapping[str, tuple[str, Callable[[], str | bytes], str]] = {
    "units in cells": ("w.csv", lambda: _with_units(plain(1)), "its cells carry units (dp_bar: "),
    "a name of two lines": ("w.csv", _in_two_lines, "a name goes over several lines"),
    "a separator behind rows": (
        "w.csv",
        lambda: plain(1).replace("\n", ",\n").replace(",\n", "\n", 1),
        "rows end with a ','",
    ),
    "a packed MCAP": ("w.mcap.zstd", lambda: b"?", "there is w.mcap.zstd: unpack it"),
    "date and time apart": ("w.parquet", _apart, "its time is apart, in date (date32[day])"),
    "numbers as text": ("w.mcap", _texts, "/w/oil_temp_degC: value is text"),
}


def _with_units(text: str) -> str:
    head, *lines = text.splitlines()
    cells = (line.replace(",", " kPa,").replace(" kPa,", ",", 1) + " l/min" for line in lines)
    return "\n".join([head, *cells, ""])


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_read_is_refused_with_its_cause(case: str, tmp_path: Path) -> None:
    name, content, words = REFUSED[case]
    write(tmp_path, name, content())
    refused = init(tmp_path)
    assert refused.code == 1
    assert words in refused.err
    assert not (tmp_path / "fleet").exists()


def test_samples_of_an_import_have_the_time_of_their_publishing(tmp_path: Path) -> None:
    """A recorder read a log in again: its own time runs faster, and on another day."""
    with (tmp_path / "w.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("Reading", "jsonschema", b'{"type": "object"}')
        ids = [writer.register_channel(f"/w/{name}", "json", schema) for name in NAMES.values()]
        for at, (time, row) in enumerate(
            zip(operation(1)[0].time_us.tolist(), rows(1), strict=True)
        ):
            for number, cell in zip(ids, row, strict=True):
                late = 1000 * (operation(1)[0].time_us[0] + 60 * 86400 * 10**6 + 20_000 * at)
                data = json.dumps({"value": cell}).encode()
                writer.add_message(number, int(late), data, 1000 * time)
        writer.finish()  # type: ignore[no-untyped-call]
    write(tmp_path, "w_2026-01-01.mcap", (tmp_path / "w.mcap").read_bytes())
    assert init(tmp_path).code == 0
    assert fit(tmp_path).code == 0
    (night,) = nights_of(tmp_path).rows(named=True)
    assert night["status"] == "ok"
    assert abs(night["night"] - FIRST) <= dt.timedelta(days=1)


# Another unit from one night on


@covers("ack --night --note", "ack --night --fit --note", "fit-fleet")
def test_a_night_in_another_unit_is_accepted_or_released(tmp_path: Path) -> None:
    """The fifth night's drain flow is in l/h where the others are in l/min."""
    for night in (1, 2, 3, 4, 5):
        head, *lines = plain(night).splitlines()
        if night == 5:
            lines = [_with(line, 3, str(float(line.split(",")[-1]) * 60.0)) for line in lines]
        write(tmp_path, f"w_2026-01-0{night}.csv", "\n".join([head, *lines, ""]))
    assert init(tmp_path).code == 0
    assert fit(tmp_path).code == 1
    assert nights_of(tmp_path)["status"].to_list() == [*["ok"] * 4, "failed"]
    label = str(nights_of(tmp_path)["night"][-1])
    words = ("ack", "fleet/fleet.toml", "w", "--note", "seen", "--night")
    refused = run_command(*words, "2026-01-02", folder=tmp_path)
    assert refused.code == 2
    assert label in refused.err
    assert run_command("fit-fleet", "fleet/fleet.toml", folder=tmp_path).code == 1
    assert "excluded" in run_command(*words, label, folder=tmp_path).out
    assert run_command("fit-fleet", "fleet/fleet.toml", folder=tmp_path).code == 0
    assert nights_of(tmp_path)["status"].to_list() == [*["ok"] * 4, "failed"]
    assert "fits it" in run_command(*words, label, "--fit", folder=tmp_path).out
    done = run_command("fit-fleet", "fleet/fleet.toml", folder=tmp_path)
    assert (done.code, "1 ok" in done.out) == (0, True)
    assert nights_of(tmp_path)["status"].to_list() == ["ok"] * 5


def test_a_speed_in_radians_is_no_wear(tmp_path: Path) -> None:
    for night in range(1, 7):
        head, *lines = plain(night).splitlines()
        if night > 4:
            lines = [_with(line, 2, str(float(line.split(",")[3]) / 9.5493)) for line in lines]
        write(tmp_path, f"w_2026-01-0{night}.csv", "\n".join([head, *lines, ""]))
    assert init(tmp_path).code == 0
    assert fit(tmp_path).code == 1
    nights = nights_of(tmp_path)
    assert nights["status"].to_list() == [*["ok"] * 4, "failed", "failed"]
    assert "the log is now in rad/s" in nights["reason"][-1]


# Cold oil


@covers("explain")
def test_a_warm_up_is_seen_and_left_out_on_demand(tmp_path: Path) -> None:
    motors = Simulated("cold", cold_share=0.5), Simulated("warm")
    fleet = make_fleet(tmp_path, *motors, minutes=90.0, nights=2).fitted()
    words = "errors go with the time since the start: -"
    assert words in fleet.run("explain", "cold", fleet.label(2)).out
    assert words not in fleet.run("explain", "warm", fleet.label(2)).out
    before = [row["training_fit_percent"] for row in fleet.nights("cold")]
    fleet.append("motors/cold.toml", "[override.cleaning]\nwarm_up_minutes = 40")
    assert fleet.run("fit-fleet").code == 0
    after = [row["training_fit_percent"] for row in fleet.nights("cold")]
    assert min(new - old for new, old in zip(after, before, strict=True)) > 5
    assert words not in fleet.run("explain", "cold", fleet.label(2)).out
    refused = fleet.table("quality").filter(reason="warm_up")
    assert set(refused["motor_id"]) == {"cold"}
    assert refused["n_refused"].to_list() == pytest.approx([2400] * 2, abs=150)
