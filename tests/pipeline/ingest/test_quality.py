"""Quality of samples as a log states it, the same in every format and layout."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import Writer
from mcap_ros2._dynamic import serialize_dynamic

import pipeline.ingest.csv.log
import pipeline.ingest.mcap.log
from pipeline.config import ConfigError, load_fleet
from pipeline.errors import LogError
from pipeline.ingest import RawChannel, RawLog, read_log
from pipeline.ingest.conformance import T0_US
from pipeline.ingest.csv.text import read_lines
from pipeline.ingest.quality import quality_states
from tests.pipeline.simulated import motor_toml, write_configs

from .sources import Source, changed, column
from .writers import iso, mcap_bytes

SPEED = column("n", "rpm", quality_source="quality")
PRESSURE = column("dp", "bar", quality_source="quality")


@dataclass(frozen=True)
class Case:
    """A cell, its quality, and whether the sample is bad; by the words of the config."""

    value: float | None
    quality: str | float | None
    is_bad: bool


# OPC DA 3.00, 6.8: 192 good, 216 forced by hand, 64 uncertain, 24 no connection, 0 bad.
CASES = (
    Case(1.0, "Good", False),
    Case(2.0, " GOOD", False),
    Case(3.0, 192, False),
    Case(4.0, "Bad", True),
    Case(5.0, "Uncertain", True),
    Case(6.0, 216, True),
    Case(7.0, 0, True),
    Case(8.0, None, True),  # a value of which nobody says that it is good
    Case(None, 24, True),  # no value, and the log says why
    Case(None, "Bad", True),
    Case(None, "Good", False),
    Case(None, None, False),  # no sample at all
    Case(9.0, "good", False),
)
NUMBERS = tuple(
    replace(case, quality={"Good": 192, " GOOD": 192, "good": 192, "Bad": 8}.get(case.quality, 64))
    if isinstance(case.quality, str)
    else case
    for case in CASES
)
EXPECTED = [case.is_bad for case in CASES]


def read(written: tuple[Path, Source]) -> RawLog:
    path, source = written
    return read_log(path, *source)


def stamps() -> pa.Array:
    return pa.array([T0_US + i for i in range(len(CASES))], pa.timestamp("us", "UTC"))


def text(cell: object) -> str:
    return "" if cell is None else str(cell)


def csv_lines(head: str, row: Callable[[Case], str]) -> str:
    rows = [f"{iso(T0_US + i)}Z,{row(case)}" for i, case in enumerate(CASES)]
    return "\n".join([f"time,{head}", *rows, ""])


def wide_csv(folder: Path) -> tuple[Path, Source]:
    path = folder / "log.csv"
    path.write_text(csv_lines("n,quality,x", lambda c: f"{text(c.value)},{text(c.quality)},1"))
    return path, Source.of("csv", {"speed": SPEED})


def wide_csv_with_bad_cells(folder: Path) -> tuple[Path, Source]:
    """Another column holds no number somewhere, so that cells are parsed as text."""
    path, source = wide_csv(folder)
    lines = path.read_text().splitlines()
    lines[2:4] = [line[:-1] + "---" for line in lines[2:4]]
    lines[5] = lines[5][:-1] + "broken"
    path.write_text("\n".join([*lines, ""]))
    return path, source.but({"speed": SPEED, "oil_temperature": column("x", "degC")})


def csv_with_a_token_for_a_value(folder: Path) -> tuple[Path, Source]:
    """A token that stands for no value in one column is a valid answer in the other."""
    path, source = wide_csv(folder)
    path.write_text(path.read_text().replace("Z,,Bad", "Z,Bad,Bad").replace("Z,,24", "Z,---,24"))
    return path, source


def long_csv(folder: Path) -> tuple[Path, Source]:
    path = folder / "log.csv"
    lines = csv_lines("channel,value,quality", lambda c: f"n,{text(c.value)},{text(c.quality)}")
    others = [f"{iso(T0_US + i)}Z,dp,{i},Bad\n" for i in range(5)]
    path.write_text(lines + "".join(others))
    other = column("dp", "bar")
    channels = {"speed": SPEED, "pressure_difference": other}
    return path, Source.of("csv", channels, layout="long")


def csv_of_a_channel(folder: Path) -> tuple[Path, Source]:
    path = folder / "speed.csv"
    path.write_text(csv_lines("value,quality", lambda c: f"{text(c.value)},{text(c.quality)}"))
    other = changed(PRESSURE, source="dp*", quality_source="other quality")
    channels = {"speed": changed(SPEED, source="sp*"), "pressure_difference": other}
    return path, Source.of("csv", channels, layout="file_per_channel")


def table(cases: tuple[Case, ...], kind: pa.DataType) -> pa.Table:
    as_text = pa.types.is_string(kind)
    cells = [c.quality if c.quality is None or not as_text else str(c.quality) for c in cases]
    return pa.table(
        {
            "time": stamps(),
            "n": pa.array([c.value for c in cases], pa.float64()),
            "quality": pa.array(cells, kind),
        }
    )


def wide_parquet(
    cases: tuple[Case, ...], kind: pa.DataType, *, encoded: bool = False
) -> Callable[[Path], tuple[Path, Source]]:
    def write(folder: Path) -> tuple[Path, Source]:
        path = folder / "log.parquet"
        content = table(cases, kind)
        if encoded:
            content = content.set_column(2, "quality", content["quality"].dictionary_encode())
        pq.write_table(content, path, row_group_size=4)
        return path, Source.of("parquet", {"speed": SPEED})

    return write


def nested_parquet(folder: Path) -> tuple[Path, Source]:
    flat = table(CASES, pa.string())
    nested = pa.StructArray.from_arrays(
        [flat["n"].combine_chunks(), flat["quality"].combine_chunks()], ["v", "q"]
    )
    path = folder / "log.parquet"
    pq.write_table(pa.table({"time": stamps(), "speed": nested}), path)
    speed = column("speed.v", "rpm", quality_source="speed.q")
    return path, Source.of("parquet", {"speed": speed})


def long_parquet(folder: Path) -> tuple[Path, Source]:
    flat = table(CASES, pa.string())
    n = len(CASES)
    rows = pa.table(
        {
            "time": pa.concat_arrays([stamps(), stamps()]),
            "channel": ["n"] * n + ["dp"] * n,
            "value": pa.concat_arrays([flat["n"].combine_chunks(), pa.array([1.0] * n)]),
            "quality": pa.concat_arrays([flat["quality"].combine_chunks(), pa.nulls(n, "string")]),
        }
    )
    path = folder / "log.parquet"
    pq.write_table(rows, path, row_group_size=5)
    other = column("dp", "bar")
    channels = {"speed": SPEED, "pressure_difference": other}
    return path, Source.of("parquet", channels, layout="long")


def json_mcap(cases: tuple[Case, ...]) -> Callable[[Path], tuple[Path, Source]]:
    def write(folder: Path) -> tuple[Path, Source]:
        messages = [
            ("/n", (T0_US + i) * 1000, json.dumps({"value": c.value, "q": {"code": c.quality}}))
            for i, c in enumerate(cases)
        ]
        path = folder / "log.mcap"
        path.write_bytes(mcap_bytes([(topic, at, data.encode()) for topic, at, data in messages]))
        speed = changed(SPEED, source="/n", quality_source="/n.q.code")
        return path, Source.of("mcap", {"speed": speed})

    return write


def schema_mcap(
    folder: Path, schema: tuple[str, str, bytes], encoding: str, payloads: list[bytes]
) -> tuple[Path, Source]:
    path = folder / "log.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=200)
        writer.start()
        channel = writer.register_channel("/n", encoding, writer.register_schema(*schema))
        for i, payload in enumerate(payloads):
            writer.add_message(channel, (T0_US + i) * 1000, payload, 0)
        writer.finish()
    return path, Source.of("mcap", {"speed": changed(SPEED, source="/n")})


def protobuf_mcap(folder: Path) -> tuple[Path, Source]:
    """Fields that say whether they are set."""
    file = descriptor_pb2.FileDescriptorProto(name="n.proto", package="t", syntax="proto2")
    kind = file.message_type.add(name="N")
    types = descriptor_pb2.FieldDescriptorProto
    for number, (name, cpp) in enumerate(
        [("value", types.TYPE_DOUBLE), ("quality", types.TYPE_UINT32)], 1
    ):
        kind.field.add(name=name, number=number, type=cpp, label=types.LABEL_OPTIONAL)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    make = message_factory.GetMessageClass(pool.FindMessageTypeByName("t.N"))
    payloads = []
    for case in NUMBERS:
        given = {"value": case.value, "quality": case.quality}
        set_ones = {name: value for name, value in given.items() if value is not None}
        payloads.append(make(**set_ones).SerializeToString())
    files = descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()
    return schema_mcap(folder, ("t.N", "protobuf", files), "protobuf", payloads)


EVERY_WAY = {
    "csv": wide_csv,
    "csv-cell-by-cell": wide_csv_with_bad_cells,
    "csv-tokens": csv_with_a_token_for_a_value,
    "csv-long": long_csv,
    "csv-file-per-channel": csv_of_a_channel,
    "parquet-text": wide_parquet(CASES, pa.string()),
    "parquet-dictionary": wide_parquet(CASES, pa.string(), encoded=True),
    "parquet-int16": wide_parquet(NUMBERS, pa.int16()),
    "parquet-float32": wide_parquet(NUMBERS, pa.float32()),
    "parquet-nested": nested_parquet,
    "parquet-long": long_parquet,
    "mcap-json-mixed": json_mcap(CASES),
    "mcap-json-numbers": json_mcap(NUMBERS),
    "mcap-protobuf": protobuf_mcap,
}
every_way = pytest.mark.parametrize("write", EVERY_WAY.values(), ids=EVERY_WAY.keys())


@every_way
def test_what_the_log_does_not_call_good_is_bad(
    write: Callable[[Path], tuple[Path, Source]], tmp_path: Path
) -> None:
    log = read(write(tmp_path))
    speed = log.channels["speed"]
    assert speed.bad_quality is not None
    assert speed.bad_quality.tolist() == EXPECTED
    assert speed.missing.tolist() == [case.value is None for case in CASES]
    assert speed.value[~speed.missing].tolist() == [float(i) for i in range(1, 10)]
    assert not speed.bad_quality.flags.writeable
    others = [one for name, one in log.channels.items() if name != "speed"]
    assert [one.bad_quality for one in others] == [None] * len(others)


@every_way
def test_a_log_that_names_no_quality_says_nothing(
    write: Callable[[Path], tuple[Path, Source]], tmp_path: Path
) -> None:
    path, source = write(tmp_path)
    plain = {name: changed(one, quality_source="") for name, one in source.channels.items()}
    assert read_log(path, *source.but(plain)).channels["speed"].bad_quality is None


@every_way
def test_a_quality_that_is_not_there_is_named(
    write: Callable[[Path], tuple[Path, Source]], tmp_path: Path
) -> None:
    path, source = write(tmp_path)
    speed = changed(source.channels["speed"], quality_source="kwality")
    with pytest.raises(LogError, match="'kwality'") as raised:
        read_log(path, *source.but({**source.channels, "speed": speed}))
    assert raised.value.code == "log_column_missing"


@pytest.mark.parametrize("piece", [120, 200, 2**24])
def test_pieces_of_a_file_change_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, piece: int
) -> None:
    path, source = wide_csv(tmp_path)
    monkeypatch.setattr(
        pipeline.ingest.csv.log, "read_lines", lambda *at: read_lines(*at[:2], piece)
    )
    bad = read_log(path, *source).channels["speed"].bad_quality
    assert bad is not None
    assert bad.tolist() == EXPECTED
    monkeypatch.setattr(pipeline.ingest.mcap.log, "_PIECE", piece)
    for write in (json_mcap(CASES), protobuf_mcap):
        bad = read(write(tmp_path)).channels["speed"].bad_quality
        assert bad is not None
        assert bad.tolist() == EXPECTED


def test_rows_without_a_time_take_their_quality_with_them(tmp_path: Path) -> None:
    path, source = wide_csv(tmp_path)
    lines = path.read_text().splitlines()
    lines[4] = "yesterday" + lines[4][lines[4].index(",") :]
    path.write_text("\n".join([*lines, ""]))
    bad = read_log(path, *source).channels["speed"].bad_quality
    assert bad is not None
    assert bad.tolist() == EXPECTED[:3] + EXPECTED[4:]


def test_channels_may_share_a_column_and_differ_in_what_is_good(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(csv_lines("n,dp,quality", lambda c: f"1,1,{text(c.quality)}"))
    forced = changed(PRESSURE, quality_good=(192, 216, 0))
    source = Source.of("csv", {"speed": SPEED, "pressure_difference": forced})
    channels = read_log(path, *source).channels
    strict, loose = channels["speed"].bad_quality, channels["pressure_difference"].bad_quality
    assert strict is not None
    assert loose is not None
    answers = [text(case.quality).strip().casefold() for case in CASES]
    assert strict.tolist() == [answer not in ("good", "192") for answer in answers]
    assert loose.tolist() == [answer not in ("192", "216", "0") for answer in answers]


def test_a_night_of_texts_that_are_all_called_bad_is_no_wrong_column(tmp_path: Path) -> None:
    """Texts as a historian writes them while its source is down; an error without a quality."""
    path = tmp_path / "log.csv"
    path.write_text(csv_lines("n,quality", lambda _: "I/O Timeout,Bad"))
    source = Source.of("csv", {"speed": SPEED})
    speed = read_log(path, *source).channels["speed"]
    assert speed.unparsed == len(CASES)
    assert speed.bad_quality is not None
    assert speed.bad_quality.all()
    with pytest.raises(LogError) as raised:
        read_log(path, *source.but({"speed": column("n", "rpm")}))
    assert raised.value.code == "log_type"


@pytest.mark.parametrize(
    ("cells", "good", "bad"),
    [
        (pa.array([True, False, None]), (True,), [False, True, True]),
        (pa.array([1, 0, None]), (True,), [False, True, True]),
        (pa.array([True, False]), (1,), [False, True]),
        (pa.array(["true", "no"]), (True,), [False, True]),
        (pa.array([0, 192], pa.uint8()), (0,), [False, True]),
        (pa.array([0.0, -0.0, np.nan]), (0,), [False, False, True]),
        (pa.array([Decimal("192.00"), Decimal("19.2")]), (192,), [False, True]),
        (pa.array(["192.0", "+192", "1.92e2", "0xC0"]), (192,), [False] * 3 + [True]),
        (pa.array(["0xc0", "C0"]), ("0xC0",), [False, True]),
        (pa.array(["", " ", None, "Good"]), ("",), [False, False, False, True]),
        (pa.array([100, 0]), (100.0,), [False, True]),
        (pa.array([2**63 - 1]), (192,), [True]),
        (pa.nulls(2), (192,), [True, True]),
        (pa.array(["a", "b"]).cast(pa.large_string()), ("A",), [False, True]),
    ],
    ids=lambda value: str(getattr(value, "type", value)),
)
def test_qualities_of_every_type(cells: pa.Array, good: Any, bad: list[bool]) -> None:
    """Beside a value: a blank is then bad, too, unless it stands for good."""
    states = quality_states(Path("log"), "quality", cells, good)
    assert (states != 0).tolist() == bad


@given(st.lists(st.sampled_from(["Good", "192", "0", "Bad", "", None, "x", "64.5"]), max_size=60))
def test_any_qualities_as_one_by_one(words: list[str | None]) -> None:
    expected = [word in ("Good", "192") for word in words]
    in_chunks = pa.chunked_array([words[:7], words[7:9], words[9:]], pa.string())
    for cells in (pa.array(words, pa.string()), in_chunks):
        states = quality_states(Path("log"), "quality", cells, ("Good", 192))
        assert (states == 0).tolist() == expected
        assert (states == 2).tolist() == [word in ("", None) for word in words]


@pytest.mark.parametrize(
    "cells",
    [
        pa.array([[1]]),
        pa.array([{"a": 1}]),
        pa.array([T0_US], pa.timestamp("us")),
        pa.array([b"Good"]),
        pa.array(np.arange(5000.0)),
    ],
    ids=lambda cells: str(cells.type),
)
def test_what_is_no_quality(tmp_path: Path, cells: pa.Array) -> None:
    path = tmp_path / "log.parquet"
    times = pa.array([T0_US + i for i in range(len(cells))], pa.timestamp("us", "UTC"))
    pq.write_table(pa.table({"time": times, "n": [1.0] * len(cells), "quality": cells}), path)
    with pytest.raises(LogError, match=r"log\.parquet, quality: ") as raised:
        read_log(path, *Source.of("parquet", {"speed": SPEED}))
    assert raised.value.code == "log_type"


def test_a_path_that_is_none(tmp_path: Path) -> None:
    text = motor_toml("M1")
    text = text.replace('source = "speed"\n', 'source = "speed"\nquality_source = "a..b"\n')
    load_fleet(write_configs(tmp_path, {"M1": text}))  # a column may be called so
    text = text.replace('format = "parquet"', 'format = "mcap"')
    with pytest.raises(ConfigError, match=r"channels\.speed\.quality_source"):
        load_fleet(write_configs(tmp_path, {"M1": text}))


@pytest.mark.parametrize(
    ("keys", "place"),
    [
        ("quality_good = [192]", "quality_good"),
        ('quality_source = "q"\nquality_good = []', "quality_good"),
        ('quality_source = "q"\nquality_good = 192', "quality_good"),
        ('quality_source = "q"\nquality_good = [[192]]', "quality_good"),
        ("quality_source = 1", "quality_source"),
    ],
)
def test_keys_that_cannot_be(tmp_path: Path, keys: str, place: str) -> None:
    text = motor_toml("M1").replace('source = "speed"\n', f'source = "speed"\n{keys}\n')
    with pytest.raises(ConfigError) as caught:
        load_fleet(write_configs(tmp_path, {"M1": text}))
    assert [fault.key for fault in caught.value.faults] == [f"channels.speed.{place}"]


def test_what_is_good_keeps_its_type(tmp_path: Path) -> None:
    keys = 'quality_source = "q"\nquality_good = ["ok", 0, true]\n'
    text = motor_toml("M1").replace('source = "speed"\n', f'source = "speed"\n{keys}')
    (spec,) = load_fleet(write_configs(tmp_path, {"M1": text})).motors
    channels = spec.file.channels
    assert repr(channels["speed"].quality_good) == "('ok', 0, True)"
    assert channels["oil_temperature"].quality_source == ""


def test_parts_of_a_channel_are_joined_with_their_quality() -> None:
    def part(bad: list[bool] | None) -> RawChannel:
        return RawChannel(
            np.arange(2),
            np.ones(2),
            np.zeros(2, np.bool_),
            1,
            None if bad is None else np.array(bad),
        )

    both = RawChannel.joined([part([True, False]), part(None)])
    assert both.bad_quality is not None
    assert both.bad_quality.tolist() == [True, False, False, False]
    assert both.unparsed == 2
    assert RawChannel.joined([part(None), part(None)]).bad_quality is None
    assert both.rows(slice(1, None)).bad_quality is not None


def test_ros_2_messages(tmp_path: Path) -> None:
    """Its fields are always set, so a missing value is a nan."""
    definition = "float64 value\nuint8 quality\n"
    encode = serialize_dynamic("t/msg/N", definition)["t/msg/N"]
    cases = [case for case in NUMBERS if case.value is not None and case.quality is not None]
    payloads = [encode({"value": case.value, "quality": case.quality}) for case in cases]
    schema = ("t/msg/N", "ros2msg", definition.encode())
    bad = read(schema_mcap(tmp_path, schema, "cdr", payloads)).channels["speed"].bad_quality
    assert bad is not None
    assert bad.tolist() == [case.is_bad for case in cases]
