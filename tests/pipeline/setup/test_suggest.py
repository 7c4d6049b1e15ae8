"""`check --suggest`: what it prints, pasted into a motor's file, reads the log."""

from __future__ import annotations

import gzip
import os
import re
import tomllib
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pipeline.errors import LogError
from pipeline.setup.suggest import suggest
from tests.pipeline.calling import Call, refused
from tests.pipeline.setup.suggested import (
    DAY_OR_MONTH,
    LABELS,
    PARQUET_TIMES,
    columns_of,
    log_in,
    read_as_suggested,
    require_it_reads,
    require_same,
    samples_of,
    times_of,
    us_of,
)
from tests.pipeline.setup.text_logs import TextLog, in_unit, long, of_one_channel, wide


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


def test_a_date_that_can_be_read_in_two_ways_is_shown_in_both(tmp_path: Path) -> None:
    times, samples = times_of(start=datetime(2025, 3, 4, 6, tzinfo=UTC)), samples_of()
    for form, other in (("%d/%m/%Y", "%m/%d/%Y"), ("%m/%d/%Y", "%d/%m/%Y")):
        path = log_in(tmp_path, wide(TextLog(LABELS, time=f"{form} %H:%M:%S"), times, samples))
        toml = suggest(path)
        said = re.search(DAY_OR_MONTH, toml)
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
    assert (said[1], said[2]) == ("13 March 2025", "25 March 2013")


def test_the_end_of_a_long_log_tells_day_from_month(tmp_path: Path) -> None:
    times = times_of(9000, datetime(2025, 3, 4, 6, tzinfo=UTC), step_s=120.0)
    samples = samples_of(9000)
    path = log_in(tmp_path, wide(TextLog(LABELS, time="%m/%d/%Y %H:%M:%S"), times, samples))
    assert "day or month" not in require_it_reads(tmp_path, path, times, samples)


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
        [f"m1_{name}_2025-03-13.csv" for name in ("dp_kPa", "temp_degC", "speed_rpm", "drain_lpm")],
        [f"2025031306000{one}.csv" for one in ("0 Delta P [kPa]", "0 T oil", "1 n", "2 Q")],
    ],
    ids=["words", "brackets"],
)
@pytest.mark.parametrize(
    "dialect",
    [{}, {"separator": ";", "decimal": ",", "names": {"value": "Wert"}, "units": "row"}],
    ids=str,
)
def test_a_file_a_channel(tmp_path: Path, names: list[str], dialect: dict[str, Any]) -> None:
    times, samples = times_of(), samples_of()
    written = TextLog(LABELS, **dialect)
    paths = {
        channel: log_in(tmp_path, of_one_channel(written, times, samples, channel), name)
        for channel, name in zip(LABELS, names, strict=True)
    }
    log_in(tmp_path, b"who;what\nme;nothing\n", "notes.csv")
    first = require_it_reads(tmp_path, paths["speed"], times, samples)
    assert 'layout = "file_per_channel"' in first
    if written.units == "row":
        assert "the log does not say it" not in first
    for path in paths.values():
        assert suggest(path) == first
    # A later night of the same names is found by the same patterns.
    for channel, path in paths.items():
        later = re.sub(r"2025-?03-?13", lambda date: date[0].replace("13", "14"), path.name)
        log_in(tmp_path, of_one_channel(written, times, samples, channel), later)
        patterns = tomllib.loads(first)["logs"]["files"]
        found = [path.name for pattern in patterns for path in (tmp_path / "logs").glob(pattern)]
        assert later in found


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


def test_a_mark_that_may_be_either_is_said_and_a_decimal_comma_between_commas_refused(
    tmp_path: Path,
) -> None:
    path = log_in(tmp_path, b"time;dp;speed\n2025-03-01 06:00:00;20,130;1,250\n" * 3)
    said = 'decimal = ","  # or is it between thousands: decimal = ".", thousands = ","?'
    assert said in suggest(path)
    dialect = TextLog(LABELS, decimal=",", quoted=True)
    path = log_in(tmp_path, wide(dialect, times_of(), samples_of()))
    with refused("log_not_csv", "another separator"):
        suggest(path)


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
        with refused(code):
            suggest(tmp_path / name)


def test_the_command_prints_it_or_ends_with_1(tmp_path: Path, call: Call) -> None:
    path = log_in(tmp_path, wide(TextLog(LABELS), times_of(), samples_of()))
    assert call("check", "--suggest", path) == (0, suggest(path), "")
    told = "motor-leakage: log_missing: absent: there is no such file\n"
    assert call("check", "--suggest", tmp_path / "absent") == (1, "", told)
