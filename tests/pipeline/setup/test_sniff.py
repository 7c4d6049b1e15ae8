"""What `init` tells of a log of any form: what it proposes reads every sample back."""

from __future__ import annotations

import gzip
import os
import random
import re
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pipeline.errors import LogError
from pipeline.setup.propose import propose
from pipeline.setup.sniff import sniff
from tests.pipeline.calling import refused
from tests.pipeline.setup.proposed import (
    LABELS,
    PARQUET_TIMES,
    columns_of,
    log_in,
    read_as_proposed,
    require_it_reads,
    samples_of,
    times_of,
    us_of,
)
from tests.pipeline.setup.text_logs import TextLog, in_unit, long, of_one_channel, wide

MARCH_4 = datetime(2025, 3, 4, 6, tzinfo=UTC)


def question(source: Path, key: str) -> Any:
    return next((one for one in propose(source, {}).questions if one.key == key), None)


@pytest.mark.parametrize(
    ("dialect", "keys"),
    [
        ({}, {"time_zone": "UTC"}),
        ({"separator": ";", "decimal": ",", "thousands": ".", "encoding": "cp1252"},
         {"encoding": "cp1252", "thousands": "."}),
        ({"separator": ";", "encoding": "utf-16", "preamble": ["Logger; 7"]}, {"skip_rows": 1}),
        ({"separator": "\t", "time": "epoch_ms", "encoding": "utf-16-le", "line_end": "\r"},
         {"time_format": "epoch_ms"}),
        ({"time": "%m/%d/%Y %I:%M:%S %p", "preamble": ["", "x,y", ""]}, {}),
        ({"units": "row", "preamble": ["Anlage,Presse 3,,,", "Nr.,12,,,"]}, {"unit_rows": 1}),
        ({"separator": "|", "time_name": "t", "quoted": True, "encoding": "utf-8-sig"}, {}),
        ({"time": "%Y-%m-%d", "clock": "%H:%M:%S.%f", "clock_name": "Time"}, {"time": "Time"}),
        ({"missing": "Sensor fault"}, {}),
        ({"columns": ("extra", "leakage_flow", "speed", "time", "pressure_difference",
                      "oil_temperature")}, {}),
        ({"time": "%d.%m.%Y %H:%M:%S", "time_name": "Time  # UTC"}, {"time": "Time  # UTC"}),
    ],
    ids=str,
)  # fmt: skip
def test_what_is_proposed_reads_the_log(
    tmp_path: Path, dialect: dict[str, Any], keys: dict[str, Any]
) -> None:
    times, samples = times_of(), samples_of()
    if "missing" in dialect:
        samples["speed"][4] = samples["leakage_flow"][7] = None
    data = wide(TextLog(LABELS, **dialect), times, samples)
    path = log_in(tmp_path, data)
    found = require_it_reads(path, times, samples).logs
    assert found | keys == found
    packed = log_in(tmp_path, gzip.compress(data), "log.csv.gz")
    assert require_it_reads(packed, times, samples).logs == found | {"files": ["log.csv.gz"]}


def test_a_zone_is_asked_for_where_the_stamps_have_none(tmp_path: Path) -> None:
    for form, is_asked in (
        ("%d.%m.%Y %H:%M", True),
        ("epoch_s", False),
        ("%Y-%m-%dT%H:%MZ", False),
    ):
        path = log_in(tmp_path, wide(TextLog(LABELS, time=form), times_of(), samples_of()))
        assert bool(question(path, "time_zone")) == is_asked
    with refused("answer", "expected a zone such as"):
        propose(
            log_in(tmp_path, wide(TextLog(LABELS), times_of(), samples_of())),
            {"time_zone": "Berlin"},
        )


@pytest.mark.parametrize(
    ("start", "name", "is_asked"),
    [
        (MARCH_4, "log.csv", True),
        (datetime(2025, 3, 13, tzinfo=UTC), "log.csv", False),  # no month 13
        (datetime(2025, 3, 4, 23, 59, 50, tzinfo=UTC), "log.csv", False),  # over midnight
        (MARCH_4, "log_2025-03-04.csv", False),  # named after its day
    ],
)
@pytest.mark.parametrize("form", ["%d/%m/%Y %H:%M:%S", "%m/%d/%Y %H:%M:%S"])
def test_day_or_month_first_is_asked_where_nothing_tells(
    tmp_path: Path, start: datetime, name: str, is_asked: bool, form: str
) -> None:
    times, samples = times_of(start=start), samples_of()
    path = log_in(tmp_path, wide(TextLog(LABELS, time=form), times, samples), name)
    asked = question(path, "time_format")
    assert bool(asked) == is_asked
    if asked:
        assert f"4 March 2025 by {form}" in asked.text
        assert form in asked.choices
    require_it_reads(path, times, samples, form)


def test_rows_further_on_tell_day_from_month(tmp_path: Path) -> None:
    times, samples = times_of(9000, MARCH_4, step_s=120.0), samples_of(9000)
    path = log_in(tmp_path, wide(TextLog(LABELS, time="%m/%d/%Y %H:%M:%S"), times, samples))
    assert question(path, "time_format") is None
    require_it_reads(path, times, samples)


@pytest.mark.parametrize("grouped", [False, True])
def test_a_row_a_sample(tmp_path: Path, grouped: bool) -> None:
    times, samples = times_of(2000), samples_of(2000)
    names = {"channel": "Messstelle", "value": "Wert"}
    dialect = TextLog(LABELS, separator=";", decimal=",", names=names)
    path = log_in(tmp_path, long(dialect, times, samples, grouped=grouped))
    assert require_it_reads(path, times, samples).logs["channel_column"] == "Messstelle"


def test_units_in_a_column_of_a_long_log(tmp_path: Path) -> None:
    times, samples = times_of(), samples_of()
    lines = ["Time;Tag;Unit;Value;Quality"]
    for i, moment in enumerate(times):
        for channel, label in LABELS.items():
            value = in_unit(samples[channel][i] or 0.0, label.unit)
            lines.append(f"{moment.isoformat()};{label.name};{label.spelled};{value};Good")
    motor = require_it_reads(log_in(tmp_path, ("\n".join(lines) + "\n").encode()), times, samples)
    assert {one.quality for one in motor.channels.values()} == {"Quality"}


@pytest.mark.parametrize(
    "names",
    [
        [f"m1_{name}_2025-03-13.csv" for name in ("dp_kPa", "temp_degC", "speed_rpm", "drain_lpm")],
        [f"2025031306000{one}.csv" for one in ("0 Delta P [kPa]", "0 T oil", "1 n", "2 Q")],
    ],
    ids=["words", "brackets"],
)
@pytest.mark.parametrize("row_of_units", [False, True])
def test_a_file_a_channel(tmp_path: Path, names: list[str], row_of_units: bool) -> None:
    times, samples = times_of(), samples_of()
    marks: dict[str, Any] = {"separator": ";", "decimal": ",", "names": {"value": "Wert"}}
    written = TextLog(LABELS, **marks, units="row") if row_of_units else TextLog(LABELS)
    units = {channel: label.unit for channel, label in LABELS.items()}
    for channel, name in zip(LABELS, names, strict=True):
        path = log_in(tmp_path, of_one_channel(written, times, samples, channel), name)
    log_in(tmp_path, b"who;what\nme;nothing\n", "notes.csv")
    motor = require_it_reads(path.parent, times, samples, units=units)
    assert motor.logs["layout"] == "file_per_channel"
    # A later night of the same names is found by the same patterns.
    for channel, name in zip(LABELS, names, strict=True):
        later = re.sub(r"2025-?03-?13", lambda date: date[0].replace("13", "14"), name)
        log_in(tmp_path, of_one_channel(written, times, samples, channel), later)
    assert len(read_as_proposed(motor, path.parent)) == 8


@pytest.mark.parametrize("form", PARQUET_TIMES)
def test_parquet_with_any_time(tmp_path: Path, form: str) -> None:
    times, samples = times_of(), samples_of()
    samples["oil_temperature"][1::2] = [None] * 15
    path = log_in(tmp_path, b"", "log.parquet")
    pq.write_table(pa.table(columns_of(samples) | PARQUET_TIMES[form](us_of(times))), path)
    require_it_reads(path, times, samples)


def test_parquet_with_nested_columns_and_units_in_the_metadata(tmp_path: Path) -> None:
    times, samples = times_of(), samples_of()
    path = log_in(tmp_path, b"", "log.parquet")
    fields = [
        pa.field(name, pa.float64(), metadata={"unit": label.spelled})
        for name, label in zip(("dp", "temp", "n", "q"), LABELS.values(), strict=True)
    ]
    nested = pa.StructArray.from_arrays(list(columns_of(samples).values()), fields=fields)
    stamps = pa.array(us_of(times), pa.timestamp("us", "UTC"))
    pq.write_table(pa.table({"drive": nested, "at": stamps}), path)
    motor = require_it_reads(path, times, samples)
    assert motor.channels["speed"].column.keys["source"] == "drive.n"


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
    units = {"pressure_difference": "bar", "leakage_flow": "l/min", "speed": "rpm"}
    require_it_reads(path, times, samples, units=units | {"oil_temperature": "degC"})


def test_what_cannot_be_told_is_a_question(tmp_path: Path) -> None:
    rows = b"2025-03-01 06:00:00,20130,7.5,me\n2025-03-01 06:00:01,20140,7.4,me\n"
    path = log_in(tmp_path, b"time,dp,n,T,who\n" + rows.replace(b"7.", b"8.5,7."))
    found = propose(path, {})
    asked = {one.key: one.choices for one in found.questions}
    assert asked["unit of dp"] == ("kPa", "mbar")
    assert asked["log.leakage_flow"] == ("dp", "n", "T")


def test_a_mark_that_may_be_either_is_asked_and_a_decimal_comma_between_commas_refused(
    tmp_path: Path,
) -> None:
    rows = b"2025-03-01 06:00:00;20,130;1,250;40,125;1,125\n" * 3
    path = log_in(tmp_path, b"time;dp [kPa];speed [rpm];T [degC];leak [l/min]\n" + rows)
    assert question(path, "decimal").choices == (",", ".")
    (motor,) = propose(path, {"decimal": ".", "time_zone": "UTC"}).motors
    assert (motor.logs["decimal"], motor.logs["thousands"]) == (".", ",")
    dialect = TextLog(LABELS, decimal=",", quoted=True)
    path = log_in(tmp_path, wide(dialect, times_of(), samples_of()))
    with refused("log_not_csv", "another separator"):
        sniff(path)


@pytest.mark.parametrize(
    "data",
    [b"", b"no table\n", b"\0\1\2" * 100, b"PAR1" + bytes(40), b"\x89MCAP0\r\n" * 2, b"1,2\n" * 9],
    ids=["empty", "one cell", "binary", "Parquet", "MCAP", "no names"],
)
def test_what_is_no_log(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "log"
    path.write_bytes(data)
    with pytest.raises(LogError):
        sniff(path)


def test_what_is_no_file(tmp_path: Path) -> None:
    """A pipe would hold up who opens it."""
    os.mkfifo(tmp_path / "pipe")
    for name, code in (("absent", "log_missing"), ("", "log_not_readable"),
                       ("pipe", "log_not_readable"), ("x" * 300, "log_not_readable")):  # fmt: skip
        with refused(code):
            sniff(tmp_path / name)


# Any log

TIMES = (
    *("%Y-%m-%dT%H:%M:%S", "%Y-%m-%d %H:%M:%S.%f", "%Y-%m-%dT%H:%M:%SZ", "%Y-%m-%d %H:%M"),
    *("%d.%m.%Y %H:%M:%S", "%d.%m.%Y %H:%M:%S,%f", "%d/%m/%Y %H:%M:%S", "%m/%d/%Y %H:%M:%S"),
    *("%m/%d/%Y %I:%M:%S %p", "%d-%m-%Y %H:%M:%S", "%Y/%m/%d %H:%M:%S.%f", "%d-%b-%Y %H:%M:%S"),
    *("%d.%m.%y %H:%M", "%Y%m%d %H%M%S", "%Y-%m-%d %H:%M:%S UTC", "%Y-%m-%d %H:%M:%S%z"),
    *("epoch_s", "epoch_s.f", "epoch_ms", "epoch_us", "epoch_ns", "excel_days", "%y-%m-%d %H:%M"),
    *("%d.%m.%Y|%H:%M:%S", "%d/%m/%Y|%H:%M:%S.%f", "%Y-%m-%d|%H:%M"),
)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("form", TIMES)
def test_any_dialect_reads_back_what_was_written(tmp_path: Path, form: str, seed: int) -> None:
    """Each form of time with marks, encodings, line ends and places of units drawn at random."""
    draw = random.Random(f"{form} {seed}").choice  # noqa: S311
    separator = draw(",;\t")
    decimal = "." if separator == "," else draw(".,")
    layout = draw(["wide", "wide", "long"])
    date, _, clock = form.partition("|")
    dialect = TextLog(
        LABELS,
        separator=separator,
        decimal=decimal,
        thousands=draw(["", *sorted({".", ",", "'", "\u00a0"} - {separator, decimal})]),
        encoding=draw(["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "cp1252"]),
        line_end=draw(["\n", "\r\n", "\r"]),
        preamble=draw([[], ["Logger 7 of the mill", "", "Öl VG 68"], [f"Anlage{separator}Presse"]]),
        time=date,
        clock=clock,
        time_name=draw(["time", "Timestamp", "Zeit", "Datum"]),
        units=draw(["name", "word", "row", "nowhere"] if layout == "wide" else ["name", "word"]),
        missing=draw(["", "---", "Bad", "ERR"]),
        quoted=draw([True, False]),
    )
    has_fraction = "%f" in form or form in ("epoch_s.f", "epoch_ms")
    times, samples = times_of(step_s=0.2 if has_fraction else 60.0), samples_of()
    if layout == "wide":
        samples["speed"][4] = None
    write = wide if layout == "wide" else partial(long, grouped=seed == 1)
    path = log_in(tmp_path, write(dialect, times, samples))
    units = {channel: label.unit for channel, label in LABELS.items()}
    require_it_reads(path, times, samples, form.replace("|", " "), units, tolerance=1e-4)
