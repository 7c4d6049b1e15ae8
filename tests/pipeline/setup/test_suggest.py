"""`check --suggest`: what it prints, pasted into a motor's file, reads the log."""

from __future__ import annotations

import contextlib
import gzip
import os
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from pipeline.cli import app
from pipeline.errors import LogError
from pipeline.ingest import RawLog, read_log
from pipeline.setup.suggest import suggest
from tests.pipeline.cli.test_cli import Call
from tests.pipeline.cli.test_cli import call as call  # a fixture
from tests.pipeline.setup.text_logs import (
    EPOCH,
    Label,
    Samples,
    TextLog,
    in_unit,
    long,
    of_one_channel,
    wide,
)
from tests.pipeline.simulated import load_motor

HEAD = 'motor_id = "M1"\nmotor_type = "CB560"\noil = "vg68"\n'
LABELS = {
    "pressure_difference": Label("dp", "kPa", "kPa"),
    "oil_temperature": Label("Oil temp", "degC", "°C"),
    "speed": Label("Speed", "rpm", "1/min"),
    "leakage_flow": Label("Drain flow", "l/min", "l/min"),
}
START = datetime(2025, 3, 13, 6, tzinfo=UTC)


def times_of(count: int = 30, start: datetime = START, step_s: float = 1.0) -> list[datetime]:
    return [start + timedelta(seconds=i * step_s) for i in range(count)]


def samples_of(count: int = 30) -> dict[str, list[float | None]]:
    return {
        "pressure_difference": [200.5 + 0.25 * i for i in range(count)],
        "oil_temperature": [50.5 + 0.125 * (i % 5) for i in range(count)],
        "speed": [12.25 + 0.5 * (i % 7) for i in range(count)],
        "leakage_flow": [1.0625 + 0.0625 * (i % 3) for i in range(count)],
    }


def read_as_suggested(folder: Path, path: Path, toml: str) -> dict[str, RawLog]:
    """Logs by file, read with a motor's file that is the suggestion and the motor's name."""
    spec = load_motor(folder, HEAD + toml)
    found = {
        file.name: file
        for pattern in spec.file.logs.files
        for file in path.parent.parent.glob(pattern)
    }
    assert path.name in found, "the pattern of the files does not find the log"
    logs, channels = spec.file.logs, spec.file.channels
    return {name: read_log(file, logs, channels) for name, file in found.items()}


def require_same(
    logs: Sequence[RawLog], times: Sequence[datetime], samples: Samples, tolerance: float = 1e-9
) -> None:
    """All of the samples are there, at their times, in the units of the tables."""
    expected_us = np.array([(one - EPOCH) // timedelta(microseconds=1) for one in times])
    for channel, values in samples.items():
        (raw,) = [log.channels[channel] for log in logs if log.channels[channel].time_us.size]
        np.testing.assert_array_equal(raw.time_us, expected_us)
        assert raw.unparsed == 0
        wanted = np.array([np.nan if value is None else value for value in values])
        np.testing.assert_array_equal(raw.missing, np.isnan(wanted))
        np.testing.assert_allclose(raw.value, wanted, rtol=0, atol=tolerance)


def log_in(folder: Path, data: bytes, name: str = "log.csv") -> Path:
    path = folder / "logs" / "M1" / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return path


def require_it_reads(folder: Path, path: Path, times: Any, samples: Any, **options: Any) -> str:
    toml = suggest(path)
    require_same(list(read_as_suggested(folder, path, toml).values()), times, samples, **options)
    return toml


# CSV, a column a channel


@pytest.mark.parametrize(
    "dialect",
    [
        {},
        {"encoding": "utf-8-sig", "line_end": "\r\n", "preamble": ["Logger 7", "the mill"]},
        {"separator": ";", "decimal": ",", "encoding": "utf-16", "preamble": ["Logger; 7"]},
        {"separator": ";", "decimal": ",", "thousands": ".", "encoding": "cp1252"},
        {"separator": "\t", "time": "epoch_ms", "encoding": "utf-16-le", "line_end": "\r"},
        {"separator": ";", "time": "epoch_s", "encoding": "utf-16-be"},
        {"separator": ";", "decimal": ",", "time": "epoch_s.f"},
        {"time": "epoch_us"},
        {"time": "epoch_ns"},
        {"time": "%d.%m.%Y %H:%M:%S", "time_name": "Zeit"},
        {"time": "%m/%d/%Y %I:%M:%S %p", "time_name": "Timestamp", "preamble": ["", "x,y", ""]},
        {"time": "%d-%b-%Y %H:%M:%S"},
        {"time": "%Y/%m/%d %H:%M:%S"},
        {"time": "%Y%m%d %H%M%S"},
        {"time": "%Y-%m-%d %H:%M:%S UTC"},
        {"time": "%Y-%m-%dT%H:%M:%S%z"},
        {"time": "excel_days", "separator": ";", "decimal": ","},
        {"units": "row"},
        {"units": "row", "preamble": ["Anlage,Presse 3,,,", "Nr.,12,,,"]},
        {"separator": "|", "time_name": "t", "quoted": True},
        {"time": "%d.%m.%Y", "clock": "%H:%M:%S", "time_name": "Datum", "separator": ";"},
        {"time": "%Y-%m-%d", "clock": "%H:%M:%S.%f", "time_name": "Date", "clock_name": "Time"},
        {"missing": "Sensor fault"},
        {"columns": ("extra", "leakage_flow", "speed", "time", "pressure_difference",
                     "oil_temperature")},
    ],
    ids=str,
)  # fmt: skip
def test_what_is_suggested_reads_the_log(tmp_path: Path, dialect: dict[str, Any]) -> None:
    times, samples = times_of(), samples_of()
    if "missing" in dialect:
        samples["speed"][4] = samples["leakage_flow"][7] = None
    data = wide(TextLog(LABELS, **dialect), times, samples)
    path = log_in(tmp_path, data)
    toml = require_it_reads(tmp_path, path, times, samples)
    packed = log_in(tmp_path, gzip.compress(data), "log.csv.gz")
    path.unlink()
    assert suggest(packed).replace(".csv.gz", ".csv") == toml


def test_a_local_time_is_left_to_be_named(tmp_path: Path) -> None:
    path = log_in(tmp_path, wide(TextLog(LABELS, time="%d.%m.%Y %H:%M"), times_of(), samples_of()))
    assert 'time_zone = "UTC"  # the stamps name no zone: which is it?' in suggest(path)
    path = log_in(tmp_path, wide(TextLog(LABELS, time="epoch_s"), times_of(), samples_of()))
    assert "time_zone" not in suggest(path)


# Day and month


DAY_OR_MONTH = r'day or month first\? The log begins on (.*) so, on (.*) with "(.*)"'


def test_a_date_that_can_be_read_in_two_ways_is_shown_in_both(tmp_path: Path) -> None:
    times, samples = times_of(start=datetime(2025, 3, 4, 6, tzinfo=UTC)), samples_of()
    for form, other in (("%d/%m/%Y", "%m/%d/%Y"), ("%m/%d/%Y", "%d/%m/%Y")):
        path = log_in(tmp_path, wide(TextLog(LABELS, time=f"{form} %H:%M:%S"), times, samples))
        toml = suggest(path)
        said = re.search(DAY_OR_MONTH, toml)
        assert said is not None
        first = tomllib.loads(toml)["logs"]["time_format"]
        readings = {first: said[1], said[3]: said[2]}
        assert readings == {
            f"{form} %H:%M:%S": "4 March 2025",
            f"{other} %H:%M:%S": "3 April 2025",
        }
        right = toml.replace(f'"{first}"', f'"{form} %H:%M:%S"', 1)
        (log,) = read_as_suggested(tmp_path, path, right).values()
        require_same([log], times, samples)


@pytest.mark.parametrize(
    ("start", "name"),
    [
        (datetime(2025, 3, 13, tzinfo=UTC), "log.csv"),  # no month 13
        (datetime(2025, 3, 4, 23, 59, 50, tzinfo=UTC), "log.csv"),  # the day after is a day later
        (datetime(2025, 3, 4, 6, tzinfo=UTC), "log_2025-03-04.csv"),  # named after its day
    ],
    ids=["by its size", "over midnight", "by the file's name"],
)
@pytest.mark.parametrize("form", ["%d/%m/%Y %H:%M:%S", "%m/%d/%Y %H:%M:%S", "%d-%m-%Y %H:%M:%S"])
def test_what_tells_day_from_month(tmp_path: Path, start: datetime, name: str, form: str) -> None:
    times, samples = times_of(start=start), samples_of()
    path = log_in(tmp_path, wide(TextLog(LABELS, time=form), times, samples), name)
    toml = require_it_reads(tmp_path, path, times, samples)
    assert "day or month" not in toml


def test_a_year_of_two_digits_may_stand_first(tmp_path: Path) -> None:
    path = log_in(tmp_path, wide(TextLog(LABELS, time="%y-%m-%d %H:%M"), times_of(), samples_of()))
    said = re.search(DAY_OR_MONTH, suggest(path))
    assert said is not None
    assert (said[1], said[2]) == ("13 March 2025", "25 March 2013")


def test_the_end_of_a_long_log_tells_day_from_month(tmp_path: Path) -> None:
    times = times_of(9000, datetime(2025, 3, 4, 6, tzinfo=UTC), step_s=120.0)
    samples = samples_of(9000)
    path = log_in(tmp_path, wide(TextLog(LABELS, time="%m/%d/%Y %H:%M:%S"), times, samples))
    assert "day or month" not in require_it_reads(tmp_path, path, times, samples)


# Other layouts


@pytest.mark.parametrize("grouped", [False, True])
@pytest.mark.parametrize(
    "dialect",
    [
        {},
        {"separator": ";", "decimal": ",", "names": {"channel": "Messstelle", "value": "Wert"}},
        {"units": "word", "time": "epoch_ms", "names": {"channel": "tag"}},
        {"time": "%d.%m.%Y", "clock": "%H:%M:%S,%f", "separator": "\t"},
    ],
    ids=str,
)
def test_a_row_a_sample(tmp_path: Path, dialect: dict[str, Any], grouped: bool) -> None:
    times, samples = times_of(2000), samples_of(2000)
    path = log_in(tmp_path, long(TextLog(LABELS, **dialect), times, samples, grouped=grouped))
    toml = require_it_reads(tmp_path, path, times, samples)
    assert 'layout = "long"' in toml


def test_units_in_a_column_of_a_long_log(tmp_path: Path) -> None:
    times, samples = times_of(), samples_of()
    lines = ["Time;Tag;Unit;Value;Quality"]
    for i, moment in enumerate(times):
        for channel, label in LABELS.items():
            value = in_unit(samples[channel][i] or 0.0, label.unit)
            lines.append(f"{moment.isoformat()};{label.name};{label.spelled};{value};Good")
    path = log_in(tmp_path, ("\n".join(lines) + "\n").encode())
    toml = require_it_reads(tmp_path, path, times, samples)
    assert 'channel_column = "Tag"' in toml
    assert tomllib.loads(toml)["channels"]["pressure_difference"]["unit"] == "kPa"


@pytest.mark.parametrize(
    "names",
    [
        {
            "pressure_difference": "m1_dp_kPa_2025-03-13.csv",
            "oil_temperature": "m1_temp_degC_2025-03-13.csv",
            "speed": "m1_speed_rpm_2025-03-13.csv",
            "leakage_flow": "m1_drain_lpm_2025-03-13.csv",
        },
        {
            "pressure_difference": "20250313060000 Delta P [kPa].csv",
            "oil_temperature": "20250313060000 T oil.csv",
            "speed": "20250313060001 n.csv",
            "leakage_flow": "20250313060002 Q.csv",
        },
    ],
    ids=["words", "brackets"],
)
@pytest.mark.parametrize(
    "dialect",
    [{}, {"separator": ";", "decimal": ",", "names": {"value": "Wert"}, "units": "row"}],
    ids=str,
)
def test_a_file_a_channel(tmp_path: Path, names: dict[str, str], dialect: dict[str, Any]) -> None:
    times, samples = times_of(), samples_of()
    written = TextLog(LABELS, **dialect)
    paths = {
        channel: log_in(tmp_path, of_one_channel(written, times, samples, channel), name)
        for channel, name in names.items()
    }
    log_in(tmp_path, b"who;what\nme;nothing\n", "notes.csv")
    first = require_it_reads(tmp_path, paths["speed"], times, samples)
    assert 'layout = "file_per_channel"' in first
    if written.units == "row":
        assert "the log does not say it" not in first
    for path in paths.values():
        assert suggest(path) == first
    # A later night of the same names is found by the same patterns.
    for channel, name in names.items():
        later = re.sub(r"2025-?03-?13", lambda date: date[0].replace("13", "14"), name)
        log_in(tmp_path, of_one_channel(written, times, samples, channel), later)
        patterns = tomllib.loads(first)["logs"]["files"]
        found = [path.name for pattern in patterns for path in (tmp_path / "logs").glob(pattern)]
        assert later in found


# Parquet


def columns_of(samples: Samples) -> dict[str, pa.Array]:
    return {
        f"{label.name} [{label.spelled}]": pa.array(
            [None if x is None else in_unit(x, label.unit) for x in samples[channel]], pa.float64()
        )
        for channel, label in LABELS.items()
    }


def us_of(times: Sequence[datetime]) -> list[int]:
    return [(one - EPOCH) // timedelta(microseconds=1) for one in times]


PARQUET_TIMES: Mapping[str, Any] = {
    "typed": lambda us: {"when": pa.array(us, pa.timestamp("us", "UTC"))},
    "naive": lambda us: {"when": pa.array([1000 * t for t in us], pa.timestamp("ns"))},
    "epoch_ms": lambda us: {"t": pa.array([t // 1000 for t in us])},
    "epoch_s": lambda us: {"time": pa.array([t / 1e6 for t in us])},
    "days": lambda us: {"Zeit": pa.array([25569 + t / 86_400e6 for t in us])},
    "text": lambda us: {
        "time": pa.array([f"{EPOCH + timedelta(microseconds=t):%d.%m.%Y %H:%M:%S}" for t in us])
    },
    "date and time": lambda us: {
        "Date": pa.array([f"{EPOCH + timedelta(microseconds=t):%d/%m/%Y}" for t in us]),
        "Time": pa.array([f"{EPOCH + timedelta(microseconds=t):%H:%M:%S}" for t in us]),
    },
}


@pytest.mark.parametrize("form", PARQUET_TIMES)
def test_parquet_with_any_time(tmp_path: Path, form: str) -> None:
    times, samples = times_of(), samples_of()
    samples["oil_temperature"][1::2] = [None] * 15
    path = log_in(tmp_path, b"", "log.parquet")
    pq.write_table(pa.table(columns_of(samples) | PARQUET_TIMES[form](us_of(times))), path)
    require_it_reads(tmp_path, path, times, samples)


def test_parquet_with_nested_columns_and_units_in_the_metadata(tmp_path: Path) -> None:
    times, samples = times_of(), samples_of()
    path = log_in(tmp_path, b"", "log.parquet")
    arrays = list(columns_of(samples).values())
    fields = [
        pa.field(name, pa.float64(), metadata={"unit": label.spelled})
        for name, label in zip(("dp", "temp", "n", "q"), LABELS.values(), strict=True)
    ]
    nested = pa.StructArray.from_arrays(arrays, fields=fields)
    stamps = pa.array(us_of(times), pa.timestamp("us", "UTC"))
    pq.write_table(pa.table({"drive": nested, "at": stamps}), path)
    toml = require_it_reads(tmp_path, path, times, samples)
    assert tomllib.loads(toml)["channels"]["speed"]["source"] == "drive.n"


@pytest.mark.parametrize("is_dictionary", [False, True])
def test_parquet_with_a_row_a_sample(tmp_path: Path, is_dictionary: bool) -> None:
    times, samples = times_of(), samples_of()
    names = pa.array([LABELS[channel].name for channel in samples for _ in times])
    table = {
        "ts": pa.array(us_of(times) * 4, pa.timestamp("us", "UTC")),
        "signal": names.dictionary_encode() if is_dictionary else names,
        "value": pa.array([x for values in samples.values() for x in values]),
    }
    path = log_in(tmp_path, b"", "log.parquet")
    pq.write_table(pa.table(table), path, row_group_size=17)
    toml = require_it_reads(
        tmp_path, path, times, {name: samples[name] for name in ("speed", "oil_temperature")}
    )
    assert 'channel_column = "signal"' in toml


# What cannot be told, and what is no log


def test_what_cannot_be_told_is_a_question(tmp_path: Path) -> None:
    path = log_in(
        tmp_path,
        b"time,dp,AI_4,who\n2025-03-01 06:00:00,20130,7.5,me\n2025-03-01 06:00:01,20140,7.4,me\n",
    )
    text = suggest(path)
    assert 'unit = "kPa"  # the log does not say it (by its size kPa or mbar): which' in text
    assert "# not found, give source and unit: oil_temperature, speed, leakage_flow" in text
    assert '#   "AI_4"   7.5; 7.4\n#   "who"   me; me\n' in text
    assert tomllib.loads(text)["channels"]["pressure_difference"]["source"] == "dp"


def test_a_mark_that_may_be_either_is_said(tmp_path: Path) -> None:
    path = log_in(tmp_path, b"time;dp;speed\n2025-03-01 06:00:00;20,130;1,250\n" * 3)
    assert (
        'decimal = ","  # or is it between thousands: decimal = ".", thousands = ","?'
        in suggest(path)
    )


def test_a_decimal_comma_between_commas_is_refused(tmp_path: Path) -> None:
    path = log_in(
        tmp_path, wide(TextLog(LABELS, decimal=",", quoted=True), times_of(), samples_of())
    )
    with pytest.raises(LogError, match="another separator") as refused:
        suggest(path)
    assert refused.value.code == "log_not_csv"


def test_names_that_no_comment_and_no_text_may_hold(tmp_path: Path) -> None:
    path = tmp_path / "a[1].CSV"
    path.write_bytes('time,"d""p\\ \x07",\x01\U000e0001\n2025-03-01,1,x\x02\n'.encode() * 3)
    found = tomllib.loads(suggest(path))
    assert found["logs"]["files"] == [f"{tmp_path.name}/*.CSV"]


@pytest.mark.parametrize(
    "data",
    [b"", b"no table\n", b"\0\1\2" * 100, b"PAR1" + bytes(40), b"\x89MCAP0\r\n" * 2, b"1,2\n" * 9],
    ids=["empty", "one cell", "binary", "Parquet", "MCAP", "no names"],
)
def test_what_is_no_log(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "log"
    path.write_bytes(data)
    with pytest.raises(LogError):
        suggest(path)


def test_what_is_no_file(tmp_path: Path) -> None:
    """A pipe would hold up who opens it."""
    os.mkfifo(tmp_path / "pipe")
    for name, code in (
        ("absent", "log_missing"),
        ("", "log_not_readable"),
        ("pipe", "log_not_readable"),
        ("x" * 300, "log_not_readable"),
    ):
        with pytest.raises(LogError) as raised:
            suggest(tmp_path / name)
        assert raised.value.code == code


def test_the_command_prints_it(tmp_path: Path) -> None:
    path = log_in(tmp_path, wide(TextLog(LABELS), times_of(), samples_of()))
    result = CliRunner().invoke(app, ["check", "--suggest", str(path)])
    assert result.exit_code == 0
    assert result.output == suggest(path)


def test_the_command_ends_with_1_where_there_is_nothing_to_suggest(
    tmp_path: Path, call: Call
) -> None:
    code, out, err = call("check", "--suggest", tmp_path / "absent")
    assert (code, out) == (1, "")
    assert err == "motor-leakage: log_missing: absent: there is no such file\n"


# Any dialect


NAMES = {
    "pressure_difference": ("dp", "Delta P", "Druck", "PressureDiff", "tryck"),
    "high_port_pressure": ("p_high", "P_A", "HighPortPressure", "Hochdruck"),
    "low_port_pressure": ("p_low", "P_B", "LowPortPressure", "Niederdruck"),
    "oil_temperature": ("T_oil", "Oil temp", "Öltemperatur", "OilTemp", "temp"),
    "speed": ("n", "Drehzahl", "MotorSpeed", "varvtal", "speed"),
    "leakage_flow": ("q", "Lecköl", "DrainFlow", "case drain", "flow"),
}
SPELLED = {
    "pressure": (("bar", "bar"), ("kPa", "kPa"), ("MPa", "MPa"), ("psi", "PSI")),
    "temperature": (("degC", "°C"), ("degF", "°F"), ("K", "K")),
    "speed": (("rpm", "rpm"), ("rpm", "1/min"), ("1/s", "1/s")),
    "flow": (("l/min", "l/min"), ("l/min", "L/min"), ("m3/h", "m³/h"), ("us_gal/min", "gpm")),
}
QUANTITY = {
    **dict.fromkeys(("pressure_difference", "high_port_pressure", "low_port_pressure"), "pressure"),
    "oil_temperature": "temperature",
    "speed": "speed",
    "leakage_flow": "flow",
}
TIMES = (
    *("%Y-%m-%dT%H:%M:%S", "%Y-%m-%d %H:%M:%S.%f", "%Y-%m-%dT%H:%M:%SZ", "%Y-%m-%d %H:%M"),
    *("%d.%m.%Y %H:%M:%S", "%d.%m.%Y %H:%M:%S,%f", "%d/%m/%Y %H:%M:%S", "%m/%d/%Y %H:%M:%S"),
    *("%m/%d/%Y %I:%M:%S %p", "%d-%m-%Y %H:%M:%S", "%Y/%m/%d %H:%M:%S.%f", "%d-%b-%Y %H:%M:%S"),
    *("%d.%m.%y %H:%M", "%Y%m%d %H%M%S", "%Y-%m-%d %H:%M:%S UTC", "%Y-%m-%d %H:%M:%S%z"),
    *("epoch_s", "epoch_s.f", "epoch_ms", "epoch_us", "epoch_ns", "excel_days"),
)
SPLIT = (("%d.%m.%Y", "%H:%M:%S"), ("%d/%m/%Y", "%H:%M:%S.%f"), ("%Y-%m-%d", "%H:%M"))


@st.composite
def labels(draw: st.DrawFn) -> dict[str, Label]:
    channels = ["oil_temperature", "speed", "leakage_flow"]
    ports = draw(st.booleans())
    channels += ["high_port_pressure", "low_port_pressure"] if ports else ["pressure_difference"]
    found = {}
    for channel in channels:
        unit, spelled = draw(st.sampled_from(SPELLED[QUANTITY[channel]]))
        found[channel] = Label(draw(st.sampled_from(NAMES[channel])), unit, spelled)
    return found


@st.composite
def dialects(draw: st.DrawFn) -> TextLog:
    separator = draw(st.sampled_from(",;\t|"))
    decimal = draw(st.sampled_from("." if separator == "," else ".,"))
    marks = {".", ",", "'", " ", "\u00a0"} - {separator, decimal}
    encoding = draw(st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "cp1252"]))
    clock = ""
    form = draw(st.sampled_from(TIMES))
    if draw(st.integers(0, 3)) == 0:
        form, clock = draw(st.sampled_from(SPLIT))
    found = draw(labels())
    lines = ["Logger 7 of the mill", "Nr.: 4711", "", f"Anlage{separator}Presse 3", "Öl VG 68"]
    return TextLog(
        labels=found,
        layout=draw(st.sampled_from(["wide", "wide", "long", "file_per_channel"])),
        separator=separator,
        decimal=decimal,
        thousands=draw(st.sampled_from(["", *sorted(marks)])),
        encoding=encoding,
        line_end=draw(st.sampled_from(["\n", "\r\n", "\r"])),
        preamble=draw(st.lists(st.sampled_from(lines), max_size=3)),
        time=form,
        clock=clock,
        time_name=draw(st.sampled_from(["time", "Timestamp", "Zeit", "Datum", "Date"])),
        clock_name=draw(st.sampled_from(["Uhrzeit", "clock", "time of day"])),
        units=draw(st.sampled_from(["name", "word", "row", "nowhere"])),
        columns=draw(st.permutations(["time", "extra", *found])),
        missing=draw(st.sampled_from(["", "---", "Bad", "ERR"])),
        quoted=draw(st.booleans()),
        digits=draw(st.integers(4, 6)),
        names=draw(
            st.sampled_from(
                [{"channel": "Tag", "value": "Value"}, {"channel": "Kanal", "value": "Wert"}]
            )
        ),
    )


MEANS = {"pressure": 200.0, "temperature": 50.0, "speed": 30.0, "flow": 2.0}


@st.composite
def recordings(draw: st.DrawFn, dialect: TextLog) -> tuple[list[datetime], dict[str, list[Any]]]:
    count = draw(st.integers(12, 30))
    day = draw(st.dates(datetime(2002, 1, 1).date(), datetime(2026, 6, 1).date()))
    start = datetime(day.year, day.month, day.day, draw(st.integers(0, 23)), tzinfo=UTC)
    fraction = "%f" in dialect.time + dialect.clock or dialect.time in ("epoch_s.f", "epoch_ms")
    times = times_of(count, start, 0.2 if fraction else 60.0)
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    samples: dict[str, list[Any]] = {}
    for channel in dialect.labels:
        mean = MEANS[QUANTITY[channel]] * (0.1 if channel == "low_port_pressure" else 1.0)
        samples[channel] = (mean * rng.uniform(0.8, 1.2, count)).tolist()
        if dialect.layout == "wide":
            samples[channel][int(rng.integers(1, count))] = None
    return times, samples


def written(folder: Path, dialect: TextLog, times: Any, samples: Any) -> list[Path]:
    if dialect.layout == "file_per_channel":
        return [
            log_in(
                folder,
                of_one_channel(dialect, times, samples, channel),
                f"{dialect.labels[channel].name} {times[0]:%Y%m%d}.csv",
            )
            for channel in dialect.labels
        ]
    make = wide if dialect.layout == "wide" else lambda *one: long(*one, grouped=True)
    return [log_in(folder, make(dialect, times, samples))]


def told(toml: str, form: str, unit_by_channel: Mapping[str, str]) -> str:
    """The suggestion with what it asks answered, where the answer is among those it shows."""
    found = re.search(DAY_OR_MONTH, toml)
    if found is not None:
        first = tomllib.loads(toml)["logs"]["time_format"]
        assert form in (first, *re.findall(r'with "([^"]*)"', toml))
        toml = toml.replace(f'"{first}"', f'"{form}"', 1)
    for channel, unit in unit_by_channel.items():
        asked = rf'(\[channels\.{channel}\]\nsource = .*\n)unit = "[^"]*"(?=  # the log does not)'
        toml = re.sub(asked, rf'\1unit = "{unit}"', toml)
    return toml


@settings(max_examples=60)
@given(st.data())
def test_any_dialect_reads_back_what_was_written(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    dialect = data.draw(dialects())
    times, samples = data.draw(recordings(dialect))
    if dialect.layout == "file_per_channel" and dialect.units != "row":
        # Neither the name of the file nor that of the column says the unit.
        dialect = replace(dialect, units="row")
    if dialect.layout == "long" and dialect.units == "row":
        dialect = replace(dialect, units="name")
    folder = tmp_path_factory.mktemp("any")
    path, *_ = written(folder, dialect, times, samples)
    form = f"{dialect.time} {dialect.clock}".strip()
    units = {channel: label.unit for channel, label in dialect.labels.items()}
    toml = told(suggest(path), form, units)
    logs = list(read_as_suggested(folder, path, toml).values())
    finest = 10.0**-dialect.digits / min(
        in_unit_factor(one.unit) for one in dialect.labels.values()
    )
    require_same(logs, times, samples, tolerance=finest)


def in_unit_factor(unit: str) -> float:
    return abs(in_unit(1.0, unit) - in_unit(0.0, unit))


@settings(max_examples=20)
@given(st.data())
def test_any_parquet_reads_back_what_was_written(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    """Wide, nested or a row a sample; figures of any type; units in names or in the metadata."""
    draw = data.draw
    layout = draw(st.sampled_from(["wide", "nested", "long"]))
    dialect = TextLog(draw(labels()), layout, units=draw(st.sampled_from(["name", "word"])))
    times, samples = draw(recordings(dialect))
    number = draw(st.sampled_from([pa.float64(), pa.float32(), pa.decimal128(18, 6)]))
    columns = {
        dialect.label(channel): pa.array(
            [
                None if x is None else round(in_unit(x, dialect.labels[channel].unit), 6)
                for x in own
            ],
            pa.float64(),
        ).cast(number, safe=False)
        for channel, own in samples.items()
    }
    stamps = PARQUET_TIMES[draw(st.sampled_from(["typed", "naive", "epoch_ms", "epoch_s", "text"]))]
    us = us_of(times)
    if layout == "long":
        names = [name for name in columns for _ in times]
        values = pa.concat_arrays(columns.values())
        table = stamps(us * len(columns)) | {"tag": pa.array(names), "value": values}
    elif layout == "nested":
        inner = pa.StructArray.from_arrays(list(columns.values()), names=list(columns))
        table = stamps(us) | {"drive": inner, "note": pa.array(["x"] * len(us))}
    else:
        table = columns | stamps(us) | {"shift": pa.array(range(len(us)))}
    path = log_in(tmp_path_factory.mktemp("any"), b"", "log.parquet")
    pq.write_table(pa.table(table), path, row_group_size=draw(st.integers(5, 1000)))
    units = {channel: label.unit for channel, label in dialect.labels.items()}
    toml = told(suggest(path), "", units)
    logs = list(read_as_suggested(path.parents[2], path, toml).values())
    require_same(logs, times, samples, tolerance=2e-4)


MAGIC = [b"", b"PAR1", b"\x89MCAP0\r\n", b"\xff\xfe", b"time;dp\n2025-03-01 06:00:00;1\n"]


@settings(max_examples=60)
@given(st.sampled_from(MAGIC), st.binary(max_size=400))
def test_any_bytes_are_refused_in_words_or_give_toml(
    tmp_path_factory: pytest.TempPathFactory, magic: bytes, data: bytes
) -> None:
    path = tmp_path_factory.getbasetemp() / "bytes"
    path.write_bytes(magic + data + magic[:4] * (magic == b"PAR1"))
    with contextlib.suppress(LogError):
        tomllib.loads(suggest(path))
