"""Files as plants write them: `init` finds what is right or asks, and the tables have it."""

from __future__ import annotations

import datetime as dt
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pipeline.config import load_fleet
from pipeline.demo import shipped_configs
from tests.pipeline.ingest.mcap_files import JSON, mcap_bytes
from tests.pipeline.simulated import Operation, operate
from tests.scenarios.command import Result, run_command
from tests.scenarios.published import table

FIRST = dt.date(2026, 1, 2)
NAMES = {
    "pressure_difference": "dp_bar",
    "oil_temperature": "oil_temp_degC",
    "speed": "speed_rpm",
    "leakage_flow": "drain_flow_lpm",
}
HEADER = ",".join(NAMES.values())
QUICK = '\n[estimation]\nstarting_points = 0\n\n[execution]\nbackend = "sequential"\n'
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
