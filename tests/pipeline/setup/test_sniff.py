"""What `init` says of a log of any form: what it proposes reads every sample back."""

from __future__ import annotations

import io
import json
import os
import random
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from mcap.writer import Writer
from mcap_ros2._dynamic import serialize_dynamic

from pipeline.setup.propose import propose
from pipeline.setup.sniff import sniff
from pipeline.setup.tables import Cells
from tests.dialects import Recorded
from tests.pipeline.calling import refused
from tests.pipeline.ingest.mcap_files import HEADER
from tests.pipeline.setup.proposed import (
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
    return next((asked for asked in propose(source, {}).questions if asked.key == key), None)


# Delimited text

TIMES = (
    *("iso8601", "%Y-%m-%d %H:%M:%S.%f", "%Y-%m-%dT%H:%M:%SZ", "%Y-%m-%d %H:%M"),
    *("%d.%m.%Y %H:%M:%S", "%d.%m.%Y %H:%M:%S,%f", "%d/%m/%Y %H:%M:%S", "%m/%d/%Y %H:%M:%S"),
    *(
        "%m/%d/%Y %H:%M:%S:%f",
        "%m/%d/%Y %I:%M:%S %p",
        "%d-%m-%Y %H:%M:%S",
        "%Y/%m/%d %H:%M:%S.%f",
        "%d-%b-%Y %H:%M:%S",
    ),
    *("%d.%m.%y %H:%M", "%Y%m%d %H%M%S", "%Y-%m-%d %H:%M:%S UTC", "%Y-%m-%d %H:%M:%S%z"),
    *("epoch_s", "epoch_ms", "epoch_us", "epoch_ns", "excel_days", "%y-%m-%d %H:%M"),
    *("apart %d.%m.%Y %H:%M:%S", "apart %d/%m/%Y %H:%M:%S.%f", "apart %Y-%m-%d %H:%M"),
)


# Every third form in the quick run: each draws its dialect at random.
FORMS = [pytest.param(form, marks=[pytest.mark.full] * (n % 3 > 0)) for n, form in enumerate(TIMES)]


@pytest.mark.parametrize("form", FORMS)
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
    ("logs", "options"),
    [
        *(({"encoding": name}, {}) for name in ("utf-32", "utf-32-le", "utf-16-be")),
        ({"time_format": "%m/%d/%Y %I:%M:%S %p", "unit_rows": 1}, {"packed": ".gz"}),
        ({"separator": "|", "time": "t"}, {"quoted": True, "bom": b"\xef\xbb\xbf"}),
        ({}, {"company": True, "reverse": True, "named": "word"}),
        ({"time_format": "%d.%m.%Y %H:%M:%S", "time": "Time  # UTC"}, {"header_every": 9}),
        ({"unit_rows": 1}, {"line_end": "\r\r\n"}),
    ],
    ids=str,
)
def test_what_is_proposed_reads_the_log(
    tmp_path: Path, logs: dict[str, Any], options: dict[str, Any]
) -> None:
    log = log_of(blank=4)
    (path,) = text_log(logs, **options).write(tmp_path, "log", log)
    proposed = require_it_reads(path, log).logs
    assert proposed | logs == proposed


@pytest.mark.parametrize("form", ["%d/%m/%Y %H:%M:%S", "%m/%d/%Y %H:%M:%S"])
@pytest.mark.parametrize(
    ("log", "is_asked"),
    [
        pytest.param(log_of(start_us=MARCH_4), True, id="4 March"),
        pytest.param(log_of(), False, id="no month 13"),
        pytest.param(log_of(start_us=MARCH_4 + 18 * 3_600_000_000 - 10**7), False, id="midnight"),
        pytest.param(log_of(450, MARCH_4, step_s=1800.0), False, id="rows further on"),
    ],
)
def test_day_or_month_first_is_asked_where_nothing_says_it(
    tmp_path: Path, log: Recorded, is_asked: bool, form: str
) -> None:
    (path,) = text_log({"time_format": form}).write(tmp_path, "log", log)
    asked = question(path, "time_format")
    assert bool(asked) == is_asked
    assert not asked or f"4 March 2025 by {form}" in asked.text
    require_it_reads(path, log, form)


NAMED = b"time,dp [bar],T [degC],n [rpm],drain flow [l/min]\n"
SAMPLE = b"2025-03-01 06:00:00,20.5,40.5,7.5,1.5\n"


@pytest.mark.parametrize(
    ("data", "skipped", "columns"),
    [
        (
            b"Report,Plant A,Line 2,,\nfrom,2025-01-01 00:00:00,2025-01-02 00:00:00,,\n" + NAMED,
            2,
            4,
        ),
        (b"range,0,100,,\n" + NAMED, 1, 4),
        (b"time,p\n" + b"Jan 1 2025 00:00:01,1.5\n" * 5, 0, 1),
    ],
    ids=["samples above the names", "a number above the names", "stamps that nobody knows"],
)
def test_the_line_of_names(tmp_path: Path, data: bytes, skipped: int, columns: int) -> None:
    table = sniff(log_in(tmp_path, data + (b"" if columns == 1 else 5 * SAMPLE)))
    assert (table.logs.get("skip_rows", 0), len(table.columns)) == (skipped, columns)


BOTH = ("time", "read at")


@pytest.mark.parametrize(
    ("names", "others", "time", "choices"),
    [
        (("server time", "read at"), ("07:00:0{}", "06:00:0{}"), "read at", ()),
        (BOTH, ("06:00:0{}", "06:00:0{}"), "time", ()),
        (BOTH, ("06:00:0{}", "06:00:00"), "time", ()),
        (BOTH, ("06:00:0{}", "05:59:0{}"), "time", BOTH),
        (BOTH, ("06:00:0{}", ""), "time", ()),
    ],
    ids=["of arrival", "the same", "of a begin", "another", "blank"],
)
def test_of_several_columns_of_times_that_of_the_readings(
    tmp_path: Path, names: Cells, others: Cells, time: str, choices: Cells
) -> None:
    first, second = (
        [f"2025-03-01T{text.format(at)}Z" if text else "" for at in range(5)] for text in others
    )
    rows = "".join(f"{a},{b},20.5,40.5,7.5,1.5\n" for a, b in zip(first, second, strict=True))
    channels = NAMED.decode().partition(",")[2]
    path = log_in(tmp_path, f"{','.join(names)},{channels}{rows}".encode())
    asked = question(path, "time")
    assert (sniff(path).times, asked.choices if asked else ()) == ((time,), choices)
    if choices:
        (motor,) = propose(path, {"time": names[1]}).motors
        assert motor.logs["time"] == names[1]


@pytest.mark.parametrize("newest", [b"", NAMED, NAMED[:9]], ids=["empty", "names", "cut"])
def test_a_newest_log_without_rows_is_of_the_kind_of_that_before(
    tmp_path: Path, newest: bytes
) -> None:
    folder = log_in(tmp_path, NAMED + 5 * SAMPLE, "2025-03-01.csv").parent
    log_in(tmp_path, newest, "2025-03-02.csv")
    (motor,) = propose(folder, {"time_zone": "UTC"}).motors
    assert motor.logs["files"] == ["*.csv"]


def test_the_zone_is_asked_where_any_end_of_the_logs_names_none(tmp_path: Path) -> None:
    with_zone = SAMPLE.replace(b"00,20", b"00Z,20")
    for folder, samples in ("a", (SAMPLE, with_zone)), ("b", (with_zone, with_zone)):
        for day, sample in enumerate(samples, 1):
            log_in(tmp_path / folder, NAMED + 5 * sample, f"2025-03-0{day}.csv")
        assert bool(question(tmp_path / folder, "time_zone")) == (folder == "a")


def test_a_half_of_the_day_in_a_column_of_its_own_is_refused(tmp_path: Path) -> None:
    rows = b"2025-03-01 06:00:00,p. m.,20.5,40.5,7.5,1.5\n" * 5
    with refused("log_time", "'half' has AM or PM alone"):
        sniff(log_in(tmp_path, NAMED.replace(b"time,", b"time,half,") + rows))


def test_a_mark_that_may_be_either_is_asked_and_a_decimal_comma_between_commas_refused(
    tmp_path: Path,
) -> None:
    rows = b"2025-03-01 06:00:00;20,130;1,250;40,125;1,125\n" * 3
    path = log_in(tmp_path, b"time;dp [kPa];speed [rpm];T [degC];leak [l/min]\n" + rows)
    assert question(path, "decimal").choices == (",", ".")
    (motor,) = propose(path, {"decimal": ".", "time_zone": "UTC"}).motors
    assert (motor.logs["decimal"], motor.logs["thousands"]) == (".", ",")
    for mark in ("decimal", "thousands"):
        (path,) = text_log({mark: ","}, quoted=True).write(tmp_path, "log", log_of())
        with refused("log_not_csv", "another separator"):
            sniff(path)


@pytest.mark.parametrize(
    ("encoding", "header"),
    [
        ("cp1252", "Zeit;Druckdifferenz [bar];Öltemperatur [°C];Drehzahl [1/min];Lecköl [l/min]"),
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
    assert (motor.logs["encoding"], len(motor.channels)) == (encoding, 4)


@pytest.mark.parametrize(
    ("name", "code"),
    [("absent", "log_missing"), (".", "log_not_readable"), ("pipe", "log_not_readable")],
)
def test_what_is_no_file(tmp_path: Path, name: str, code: str) -> None:
    """A pipe would hold up who opens it."""
    os.mkfifo(tmp_path / "pipe")
    with refused(code):
        sniff(tmp_path / name)


# Parquet


@pytest.mark.parametrize("form", ["ns", "epoch_ms", "excel_days", "within", "long"])
def test_parquet(tmp_path: Path, form: str) -> None:
    log = log_of(blank=None if form == "long" else 4)
    stamps = {
        "ns": pa.array(1000 * log.time_us, pa.timestamp("ns")),
        "epoch_ms": pa.array(log.time_us // 1000),
        "excel_days": pa.array(log.time_us / 86_400e6 + 25_569.0),
    }
    time = stamps.get(form, pa.array(log.time_us, pa.timestamp("us", "UTC")))
    columns = {
        title: pa.array(
            100.0 * log.values[name] if "kPa" in title else log.values[name], from_pandas=True
        )
        for name, title in NAMES["name"].items()
    }
    if form == "within":
        columns = {"drive": pa.StructArray.from_arrays(list(columns.values()), list(columns))}
    elif form == "long":
        tags = [name for name in columns for _ in log.time_us]
        time = pa.concat_arrays([time] * len(columns))
        columns = {
            "signal": pa.array(tags).dictionary_encode(),
            "value": pa.concat_arrays(list(columns.values())),
        }
    sink = pa.BufferOutputStream()
    pq.write_table(pa.table({"time": time, **columns}), sink, row_group_size=17)
    motor = require_it_reads(log_in(tmp_path, sink.getvalue().to_pybytes(), "log.parquet"), log)
    assert ("Speed [1/min]" if form != "within" else "drive.Speed [1/min]") == motor.channels[
        "speed"
    ].keys["source"]


@pytest.mark.parametrize("is_apart", [False, True])
def test_parquet_with_times_in_text_and_units_in_the_metadata(
    tmp_path: Path, is_apart: bool
) -> None:
    log, units = log_of(), ("bar", "°C", "1/min", "l/min")
    stamps = [f"13.03.2025 06:00:{i:02}" for i in range(30)]
    columns: dict[str, Any] = {"time": stamps}
    if is_apart:
        columns = dict(
            zip(("Date", "Time"), zip(*map(str.split, stamps), strict=True), strict=True)
        )
    fields = [pa.field(name, pa.string()) for name in columns]
    for name, unit, values in zip("ptnq", units, log.values.values(), strict=True):
        columns[name] = values
        fields.append(pa.field(name, pa.float64(), metadata={"unit": unit}))
    sink = pa.BufferOutputStream()
    pq.write_table(pa.table(columns, schema=pa.schema(fields)), sink)
    require_it_reads(log_in(tmp_path, sink.getvalue().to_pybytes(), "log.parquet"), log)


def test_a_scale_in_the_metadata_is_asked_for_and_truth_values_are_a_quality(
    tmp_path: Path,
) -> None:
    stated = {"unit": "l/min", "scale": "0.01"}
    fields = [pa.field(name, pa.float64()) for name in ("dp_bar", "T_degC", "n_rpm")]
    fields = [pa.field("t", pa.timestamp("us")), *fields, pa.field("q", pa.int64(), True, stated)]
    fields += [pa.field("valid", pa.bool_()), pa.field("level", pa.decimal256(40, 2))]
    columns = [
        pa.array(values, field.type)
        for values, field in zip([*[[1, 2]] * 5, [True, False], [1, 2]], fields, strict=True)
    ]
    sink = pa.BufferOutputStream()
    pq.write_table(pa.table(columns, schema=pa.schema(fields)), sink)
    path = log_in(tmp_path, sink.getvalue().to_pybytes(), "log.parquet")
    assert "'0.01 l/min'" in question(path, "unit of q").text
    (motor,) = propose(path, {}).motors
    assert motor.channels["speed"].keys["quality_source"] == "valid"


# MCAP

LATE_US = 3_000  # between a sample and its record
LATE = Recorded(log_of().time_us + LATE_US, log_of().values)
UNITS = {"pressure_difference": "bar", "leakage_flow": "l/min"}
P, T, N, Q = log_of().values.values()
Message = Callable[[int], Mapping[str, Any]]
"""What a topic says, by a sample's number."""


def mcap(folder: Path, topics: Mapping[str, Message], units: str = "") -> Path:
    """A log of JSON messages; `units`: where each topic's unit is stated."""
    buffer = io.BytesIO()
    writer = Writer(buffer, chunk_size=2000)
    writer.start()
    ids = {}
    for topic, unit in zip(topics, ("bar", "degC", "rpm", "l/min"), strict=False):
        stated = {"schema": {"unit": unit}, "description": {"description": f"Reading ({unit})"}}
        value = {"type": "number"} | stated.get(units, {})
        schema = json.dumps({"type": "object", "properties": {"value": value}}).encode()
        number = writer.register_schema(topic, "jsonschema", schema)
        metadata = {"unit": unit} if units == "metadata" else {}
        ids[topic] = writer.register_channel(topic, "json", number, metadata)
    for i, time_us in enumerate(LATE.time_us.tolist()):
        for topic, number in ids.items():
            data = json.dumps(topics[topic](i)).encode()
            writer.add_message(number, 1000 * time_us, data, 1000 * time_us)
    writer.finish()
    return log_in(folder, buffer.getvalue(), "log.mcap")


def a_topic_a_channel(**beside: Any) -> dict[str, Message]:
    names = ("/mill/dp", "/mill/oil_temperature", "/mill/speed", "/mill/drain_flow")
    return {
        name: lambda i, values=values: {"value": values[i], **beside}
        for name, values in zip(names, (P, T, N, Q), strict=True)
    }


def test_a_topic_a_channel(tmp_path: Path) -> None:
    topics = a_topic_a_channel(quality=192)
    operator = {"/mill/operator": lambda i: {"name": "me", "shift": i % 3}}
    motor = require_it_reads(mcap(tmp_path, topics | operator), LATE, units=UNITS)
    assert [column.keys["source"] for column in motor.channels.values()] == list(topics)
    assert {column.keys["quality_source"] for column in motor.channels.values()} == {"quality"}
    assert motor.logs["time"] == "log_time"


@pytest.mark.parametrize("place", ["metadata", "schema", "description"])
def test_units_that_messages_state_are_not_asked(place: str, tmp_path: Path) -> None:
    proposal = propose(mcap(tmp_path, a_topic_a_channel(), place), {})
    units = [column.unit for column in proposal.motors[0].channels.values()]
    assert (proposal.questions, units) == ((), ["bar", "degC", "rpm", "l/min"])


def test_one_topic_with_fields_within_fields_units_and_a_stamp(tmp_path: Path) -> None:
    time_us = log_of().time_us

    def message(i: int) -> dict[str, Any]:
        return {
            "stamp": {"sec": int(time_us[i]) // 10**6, "nanosec": int(time_us[i]) % 10**6 * 1000},
            "hydraulics": {"pressure.diff": {"value": P[i] * 100, "unit": "kPa"}},
            "readings": [{"drain_flow_lpm": Q[i], "ok": True}],
            "shaft": {"rpm": N[i]},
            "temps": {"oil_degC": T[i], "ambient_degC": 20.0},
        }

    motor = require_it_reads(mcap(tmp_path, {"/drive": message}), log_of())
    assert motor.logs["time"] == "stamp"
    pressure, _, _, flow = (column.keys for column in motor.channels.values())
    assert (pressure["field"], pressure["unit"]) == (r"hydraulics.pressure\.diff.value", "kPa")
    assert flow["field"] == "readings[0].drain_flow_lpm"


@pytest.mark.parametrize(
    ("stamp", "form"),
    [
        (lambda us: us // 1000, "epoch_ms"),
        (lambda us: us / 1e6, "epoch_s"),
        (lambda us: f"{np.datetime64(us, 'us')}Z", "iso8601"),
    ],
)
def test_stamps_that_are_a_number_or_text(
    tmp_path: Path, stamp: Callable[[int], Any], form: str
) -> None:
    log = log_of()
    topics = {
        f"/{channel}": lambda i, values=values: {"t": stamp(int(log.time_us[i])), "v": values[i]}
        for channel, values in log.values.items()
    }
    logs = require_it_reads(mcap(tmp_path, topics), log, units=UNITS).logs
    assert (logs["time"], logs["time_format"]) == ("t", form)


# By topic: message, its fields, the field of the reading, and readings.
ROS_2: Mapping[str, tuple[str, str, str, Any]] = {
    "/dp": (
        "sensor_msgs/msg/FluidPressure",
        "float64 fluid_pressure\nfloat64 variance\n",
        "fluid_pressure",
        P * 1e5,
    ),
    "/oil": (
        "sensor_msgs/msg/Temperature",
        "float64 temperature\nfloat64 variance\n",
        "temperature",
        T,
    ),
    "/shaft": ("motor_msgs/msg/Shaft", "float32[2] speeds\n", "speeds", N),
    "/drain": ("motor_msgs/msg/Drain", "float64 flow_m3_h\nstring note\n", "flow_m3_h", Q * 0.06),
}


def test_ros_2_with_the_units_of_its_standard_messages(tmp_path: Path) -> None:
    log, buffer = log_of(), io.BytesIO()
    writer = Writer(buffer)
    writer.start()
    for topic, (name, fields, field, values) in ROS_2.items():
        text = f"std_msgs/Header header\n{fields}{HEADER}"
        encode = serialize_dynamic(name, text)[name]
        schema = writer.register_schema(name, "ros2msg", text.encode())
        number = writer.register_channel(topic, "cdr", schema)
        for i, time_us in enumerate(log.time_us.tolist()):
            stamp = {"sec": time_us // 10**6, "nanosec": time_us % 10**6 * 1000}
            content = {"header": {"stamp": stamp, "frame_id": "x"}, "note": "", "variance": 0.5}
            content[field] = [values[i], -1.0] if field == "speeds" else values[i]
            writer.add_message(number, 1000 * time_us + 7000, encode(content), 0)
    writer.finish()
    motor = require_it_reads(log_in(tmp_path, buffer.getvalue(), "log.mcap"), log, units=UNITS)
    assert motor.logs["time"] == "header.stamp"
    units = [column.unit for column in motor.channels.values()]
    assert units == ["Pa", "degC", "rpm", "m3/h"]


def test_a_topic_without_a_reading_is_no_motor_s(tmp_path: Path) -> None:
    fields = {"variance": 0.5, "sensor_id": 7, "x": 1.0}
    path = mcap(tmp_path, {"/drain_flow": lambda i: {"seq": i, **fields}})
    proposal = propose(path, {})
    assert not proposal.motors
    assert proposal.faults[0].startswith("no_motor: log.mcap")
