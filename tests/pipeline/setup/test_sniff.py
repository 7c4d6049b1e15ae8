"""What `init` tells of a log of any form: what it proposes reads every sample back."""

from __future__ import annotations

import os
import random
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pipeline.errors import LogError
from pipeline.setup.propose import propose
from pipeline.setup.sniff import sniff
from tests.dialects import Parquet
from tests.pipeline.calling import refused
from tests.pipeline.setup.proposed import (
    KPA,
    NAMES,
    START_US,
    log_in,
    log_of,
    require_it_reads,
    text_log,
)

DAY_US = 86_400_000_000
MARCH_4 = START_US - 9 * DAY_US


def question(source: Path, key: str) -> Any:
    return next((one for one in propose(source, {}).questions if one.key == key), None)


@pytest.mark.parametrize(
    ("logs", "options"),
    [
        ({"time_zone": "UTC"}, {}),
        *(({"encoding": name}, {}) for name in ("utf-16-be", "utf-32", "utf-32-le", "utf-32-be")),
        ({"time_format": "%m/%d/%Y %I:%M:%S %p", "unit_rows": 1}, {"packed": ".gz"}),
        ({"separator": "|", "time": "t"}, {"quoted": True, "bom": b"\xef\xbb\xbf"}),
        ({}, {"company": True, "reverse": True, "named": "word"}),
        ({"time_format": "%d.%m.%Y %H:%M:%S", "time": "Time  # UTC"}, {"header_every": 9}),
    ],
    ids=str,
)
def test_what_is_proposed_reads_the_log(
    tmp_path: Path, logs: dict[str, Any], options: dict[str, Any]
) -> None:
    log = log_of(blank=4)
    (path,) = text_log(logs, **options).write(tmp_path, "log", log)
    found = require_it_reads(path, log).logs
    assert found | logs == found


def test_a_zone_is_asked_for_where_the_stamps_have_none(tmp_path: Path) -> None:
    for form, is_asked in (
        ("%d.%m.%Y %H:%M:%S", True),
        ("epoch_s", False),
        ("%Y-%m-%dT%H:%M:%SZ", False),
    ):
        (path,) = text_log({"time_format": form}).write(tmp_path, "log", log_of())
        assert bool(question(path, "time_zone")) == is_asked


@pytest.mark.parametrize(
    ("start_us", "is_asked"),
    [
        (MARCH_4, True),
        (START_US, False),  # no month 13
        (MARCH_4 + 18 * 3_600_000_000 - 10_000_000, False),  # over midnight
    ],
)
@pytest.mark.parametrize("form", ["%d/%m/%Y %H:%M:%S", "%m/%d/%Y %H:%M:%S"])
def test_day_or_month_first_is_asked_where_nothing_tells(
    tmp_path: Path, start_us: int, is_asked: bool, form: str
) -> None:
    log = log_of(start_us=start_us)
    (path,) = text_log({"time_format": form}).write(tmp_path, "log", log)
    asked = question(path, "time_format")
    assert bool(asked) == is_asked
    if asked:
        assert f"4 March 2025 by {form}" in asked.text
        assert form in asked.choices
    require_it_reads(path, log, form)


def test_rows_further_on_tell_day_from_month(tmp_path: Path) -> None:
    log = log_of(9000, MARCH_4, step_s=120.0)
    (path,) = text_log({"time_format": "%m/%d/%Y %H:%M:%S"}).write(tmp_path, "log", log)
    assert question(path, "time_format") is None
    require_it_reads(path, log)


def test_channels_of_which_one_is_far_into_the_log(tmp_path: Path) -> None:
    log = log_of(2000)
    rows = [
        f"{START_US // 10**6 + i},{name},{value!r},{unit},Good"
        for name, unit, channel in (("dp", "bar", "pressure_difference"),
                                    ("T oil", "degC", "oil_temperature"),
                                    ("n", "1/min", "speed"), ("drain", "l/min", "leakage_flow"))
        for i, value in enumerate(log.values[channel].tolist())
    ]  # fmt: skip
    text = "\n".join(["time,Tag,Value,Unit,Quality", *rows, ""])
    motor = require_it_reads(log_in(tmp_path, text.encode()), log)
    assert {one.keys["quality_source"] for one in motor.channels.values()} == {"Quality"}


@pytest.mark.parametrize(
    ("logs", "options"),
    [
        ({}, {}),
        ({}, {"time_unit": "ns", "zone": None}),
        *(({"time_format": form}, {}) for form in ("epoch_ms", "epoch_s", "excel_days")),
        ({}, {"within": ("drive",)}),
        ({"layout": "long", "channel_column": "signal"},
         {"dictionary": True, "options": {"row_group_size": 17}}),
    ],
    ids=str,
)  # fmt: skip
def test_parquet(tmp_path: Path, logs: dict[str, Any], options: dict[str, Any]) -> None:
    log = log_of(blank=None if "layout" in logs else 4)
    dialect = Parquet(logs, KPA, names=NAMES["name"], **options)
    (path,) = dialect.write(tmp_path, "log", log)
    motor = require_it_reads(path, log)
    within = ".".join((*options.get("within", ()), "Speed [1/min]"))
    assert motor.channels["speed"].keys["source"] == within


@pytest.mark.parametrize("is_apart", [False, True])
def test_parquet_with_times_in_text_and_units_in_the_metadata(
    tmp_path: Path, is_apart: bool
) -> None:
    log, units = log_of(), ("bar", "°C", "1/min", "l/min")
    stamps = [f"13.03.2025 06:00:{i:02}" for i in range(30)]
    columns = {"time": pa.array(stamps)}
    if is_apart:
        dates, clocks = zip(*(stamp.split() for stamp in stamps), strict=True)
        columns = {"Date": pa.array(dates), "Time": pa.array(clocks)}
    columns |= {n: pa.array(v) for n, v in zip("ptnq", log.values.values(), strict=True)}
    fields = [pa.field(name, column.type) for name, column in columns.items()]
    fields[-4:] = [
        field.with_metadata({"unit": u}) for field, u in zip(fields[-4:], units, strict=True)
    ]
    path = tmp_path / "log.parquet"
    pq.write_table(pa.table(list(columns.values()), schema=pa.schema(fields)), path)
    require_it_reads(path, log)


@pytest.mark.parametrize(
    ("above", "skipped"),
    [
        (b"Report,Plant A,Line 2,,\nfrom,2025-01-01 00:00:00,2025-01-02 00:00:00,,\n", 2),
        (b"range,0,100,,\n", 1),
    ],
)
def test_a_line_above_the_names_may_hold_samples(
    tmp_path: Path, above: bytes, skipped: int
) -> None:
    row = b"2025-03-01 06:00:00,20.5,40.5,7.5,1.5\n"
    names = b"time,dp [bar],T [degC],n [rpm],drain flow [l/min]\n"
    found = sniff(log_in(tmp_path, above + names + 5 * row))
    assert found.logs["skip_rows"] == skipped
    assert found.columns[0].name == "dp [bar]"


def test_two_columns_whose_stamps_nobody_knows(tmp_path: Path) -> None:
    (column,) = sniff(log_in(tmp_path, b"time,p\n" + b"Jan 1 2025 00:00:01,1.5\n" * 5)).columns
    assert column.name == "p"


def test_what_cannot_be_told_is_a_question(tmp_path: Path) -> None:
    rows = b"2025-03-01 06:00:00,20130,7.5,me\n2025-03-01 06:00:01,20140,7.4,me\n"
    path = log_in(tmp_path, b"time,dp,n,T,who\n" + rows.replace(b"7.", b"8.5,7."))
    found = propose(path, {})
    asked = {question.key: question.choices for question in found.questions}
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
    (path,) = text_log({"decimal": ","}, quoted=True).write(tmp_path, "log", log_of())
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
    *("iso8601", "%Y-%m-%d %H:%M:%S.%f", "%Y-%m-%dT%H:%M:%SZ", "%Y-%m-%d %H:%M"),
    *("%d.%m.%Y %H:%M:%S", "%d.%m.%Y %H:%M:%S,%f", "%d/%m/%Y %H:%M:%S", "%m/%d/%Y %H:%M:%S"),
    *("%m/%d/%Y %I:%M:%S %p", "%d-%m-%Y %H:%M:%S", "%Y/%m/%d %H:%M:%S.%f", "%d-%b-%Y %H:%M:%S"),
    *("%d.%m.%y %H:%M", "%Y%m%d %H%M%S", "%Y-%m-%d %H:%M:%S UTC", "%Y-%m-%d %H:%M:%S%z"),
    *("epoch_s", "epoch_ms", "epoch_us", "epoch_ns", "excel_days", "%y-%m-%d %H:%M"),
    *("apart %d.%m.%Y %H:%M:%S", "apart %d/%m/%Y %H:%M:%S.%f", "apart %Y-%m-%d %H:%M"),
)


@pytest.mark.parametrize("form", TIMES)
def test_any_dialect_reads_back_what_was_written(tmp_path: Path, form: str) -> None:
    """Each form of time with marks, encodings, line ends and places of units drawn at random."""
    draw = random.Random(form).choice  # noqa: S311
    separator = draw(";\t") if "," in form else draw(",;\t")
    decimal = "." if separator == "," else draw(".,")
    layout = draw(["wide", "wide", "long"])
    logs = {
        "separator": separator,
        "decimal": decimal,
        "thousands": draw(["", *sorted({".", ",", "'", "\u00a0"} - {separator, decimal})]),
        "encoding": draw(["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "cp1252"]),
        "skip_rows": draw([0, 2]),
        "unit_rows": draw([0, 1]),
        "layout": layout,
        "time": draw(["time", "Timestamp", "Zeit", "Datum"]),
        "time_format": form.removeprefix("apart "),
        **({"date_column": "Tag"} if form.startswith("apart") else {}),
    }
    dialect = text_log(
        logs,
        draw(["name", "word", "nowhere"]),
        line_end=draw(["\n", "\r\n", "\r"]),
        tokens=draw([("",), ("---",)]),
        quoted=draw([True, False]),
    )
    log = log_of(step_s=60.0, blank=4 if layout == "wide" else None)
    (path,) = dialect.write(tmp_path, "log", log)
    require_it_reads(path, log, logs["time_format"])


@pytest.mark.parametrize(
    ("encoding", "header"),
    [
        (
            "cp1252",
            "Zeit;Druckdifferenz [bar];Öltemperatur [°C];Drehzahl [1/min];Leckölstrom [l/min]",
        ),
        ("cp1250", "Czas;Różnica ciśnień [bar];Temp. oleju [°C];Prędkość [1/min];Przepływ [l/min]"),
        ("gb18030", "时间;压差 [bar];油温 [°C];转速 [1/min];泄漏流量 [l/min]"),
    ],
)
def test_of_several_encodings_that_of_the_most_known_words(
    tmp_path: Path, encoding: str, header: str
) -> None:
    rows = "2025-03-01 06:00:00;20,5;40,5;7,5;1,5\n" * 5
    path = log_in(tmp_path, f"{header}\n{rows}".encode(encoding))
    (motor,) = propose(path, {"time_zone": "UTC"}).motors
    assert motor.logs["encoding"] == encoding
    assert len(motor.channels) == 4
