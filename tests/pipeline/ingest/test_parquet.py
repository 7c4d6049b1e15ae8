"""Log features and faults specific to Parquet."""

from __future__ import annotations

import os
import struct
from contextlib import suppress
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import pipeline.ingest.parquet
from pipeline.errors import LogError
from pipeline.ingest import RawLog, read_log, time_span
from pipeline.ingest.conformance import T0_US

from .sources import Source, column

SOURCE = Source.of("parquet", {"pressure_difference": column("dp", "bar")})
TIMES = pa.array([T0_US, T0_US + 1, T0_US + 2], pa.timestamp("us", "UTC"))


def written(folder: Path, columns: dict[str, Any], **options: Any) -> Path:
    path = folder / "log.parquet"
    pq.write_table(pa.table(columns), path, **options)
    return path


def read(folder: Path, dp: pa.Array, time: pa.Array = TIMES, **changes: Any) -> RawLog:
    return read_log(written(folder, {"time": time, "dp": dp}), *SOURCE.but(**changes))


def error(path: Path, source: Source = SOURCE) -> LogError:
    with pytest.raises(LogError) as raised:
        read_log(path, *source)
    return raised.value


NUMBERS = (
    *(pa.int8(), pa.uint8(), pa.int32(), pa.int64(), pa.uint64(), pa.float16(), pa.float32()),
    *(pa.float64(), pa.decimal128(10, 2), pa.decimal256(40, 2)),
)


@pytest.mark.parametrize("kind", NUMBERS, ids=str)
def test_every_type_of_number_becomes_float64(tmp_path: Path, kind: pa.DataType) -> None:
    cells = pa.array([1.0, None, 3.0]).cast(kind)
    channel = read(tmp_path, cells).channels["pressure_difference"]
    np.testing.assert_array_equal(channel.value, [1.0, np.nan, 3.0], strict=True)
    assert channel.missing.tolist() == [False, True, False]


def test_integers_beyond_float64_lose_their_last_digits_only(tmp_path: Path) -> None:
    channel = read(tmp_path, pa.array([2**63 - 1, 2**53 + 1, -(2**63)])).channels
    assert channel["pressure_difference"].value.tolist() == [2.0**63, 2.0**53, -(2.0**63)]


@pytest.mark.parametrize(
    ("cells", "time_format"),
    [
        (pa.array([T0_US // 10**6], pa.timestamp("s", "Asia/Tokyo")), "iso8601"),
        (pa.array([T0_US * 1000 + 999], pa.timestamp("ns", "UTC")), "iso8601"),
        (pa.array([T0_US // 10**6], pa.uint32()), "epoch_s"),
        (pa.array([T0_US / 10**6]), "epoch_s"),
        (pa.array([T0_US * 1000 + 999]), "epoch_ns"),
        (pa.array(["2025-03-01T06:00:00Z"], pa.large_string()), "iso8601"),
        (pa.array(["01.03.2025 06:00:00"]), "%d.%m.%Y %H:%M:%S"),
        (pa.array(["1740808800"]), "epoch_s"),
    ],
)
def test_time_in_every_type(tmp_path: Path, cells: pa.Array, time_format: str) -> None:
    source = SOURCE.but(time_format=time_format)
    for columns, keys in (
        ({"time": cells}, {}),
        ({"head": pa.StructArray.from_arrays([cells], ["stamp"])}, {"time": "head.stamp"}),
    ):
        path = written(tmp_path, {**columns, "dp": [1.0]})
        assert (read_log(path, *source.but(**keys)).ends() or ())[0] == T0_US
        assert time_span(path, *source.but(**keys)) == (T0_US, T0_US)


NO_UTF8 = pa.StringArray.from_buffers(
    1, pa.py_buffer(np.array([0, 20], np.int32)), pa.py_buffer(b"2025-03-01T06:00:00\xff")
)
ONE = pa.array([1.0])
# Time, pressure, format of the time, and the code.
REFUSED: tuple[tuple[pa.Array, pa.Array, str, str], ...] = (
    *(
        (TIMES, cells, "iso8601", "log_type")
        for cells in (
            pa.array(["1", "2", "3"]),
            pa.array([True, False, None]),
            pa.array([b"1", b"2", b"3"]),
            pa.array([[1.0], [2.0], [3.0]]),
            TIMES,
            pa.array([date(2025, 3, 1)] * 3),
            pa.array(["1", "2", "3"]).dictionary_encode(),
        )
    ),
    *(
        (cells, ONE, form, "log_time")
        for cells, form in (
            (pa.array([T0_US // 10**6]), "iso8601"),
            (pa.array([T0_US // 10**6], pa.int64()), "epoch_ms"),
            (pa.array([T0_US / 10**6], pa.float32()), "epoch_s"),
            (pa.array([date(2025, 3, 1)]), "iso8601"),
            (pa.array([True]), "epoch_s"),
            (pa.array([b"2025-03-01T06:00:00Z"]), "iso8601"),
            (pa.array(["6 am"]), "iso8601"),
            (pa.nulls(1), "epoch_s"),
            (pa.array([None], pa.timestamp("us", "UTC")), "iso8601"),
        )
    ),
    (NO_UTF8, ONE, "iso8601", "log_damaged"),
)


@pytest.mark.parametrize(("time", "cells", "form", "code"), REFUSED)
def test_what_is_no_number_or_no_time(
    tmp_path: Path, time: pa.Array, cells: pa.Array, form: str, code: str
) -> None:
    path = written(tmp_path, {"time": time, "dp": cells})
    wrong = error(path, SOURCE.but(time_format=form))
    assert wrong.code == code
    assert code != "log_type" or "'dp'" in wrong.message
    if code == "log_time":
        with pytest.raises(LogError) as raised:
            time_span(path, *SOURCE.but(time_format=form))
        assert raised.value.code == code


def test_columns_of_one_name_are_an_error(tmp_path: Path) -> None:
    path = tmp_path / "log.parquet"
    table = pa.table([TIMES, [1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], names=["time", "dp", "dp"])
    pq.write_table(table, path)
    assert error(path).code == "log_column_twice"


def test_nested_columns_by_their_paths(tmp_path: Path) -> None:
    # Null within, null around it, and a name that has a dot itself.
    rows = [
        {"pressure": {"a": 1.0, "b": 9.0}, "oil.T": {"in": 50}, "x": [1]},
        {"pressure": {"a": None, "b": 9.0}, "oil.T": None, "x": None},
        None,
    ]
    columns = {"time": TIMES, "hydraulics": pa.array(rows)}
    path = written(tmp_path, columns)
    for name, value in (("pressure.a", 1.0), ("oil.T.in", 50.0)):
        source = SOURCE.but({"pressure_difference": column(f"hydraulics.{name}", "bar")})
        found = read_log(path, *source).channels["pressure_difference"]
        assert found.missing.tolist() == [False, True, True]
        assert found.value[0] == value
    columns["hydraulics.pressure.a"] = pa.array([4.0, 5.0, 6.0])
    written(tmp_path, columns)
    for name, code in (
        ("pressure.c", "log_column_missing"),
        ("pressure", "log_column_missing"),
        ("x", "log_type"),
        ("pressure.a", "log_column_twice"),
    ):
        wrong = error(
            path, SOURCE.but({"pressure_difference": column(f"hydraulics.{name}", "bar")})
        )
        assert wrong.code == code
        assert code != "log_column_missing" or "'hydraulics.pressure.a'" in wrong.message


LONG = SOURCE.but(layout="long", channel_column="tag", value_column="v")


def test_a_long_table_whose_names_are_numbers(tmp_path: Path) -> None:
    path = written(tmp_path, {"time": TIMES, "tag": [1, 2, 3], "v": [1.0, 2.0, 3.0]})
    assert error(path, LONG).code == "log_type"


def test_more_rows_than_fit_are_refused_while_they_unfold(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = 3_000_000
    times = pa.array(np.full(rows, T0_US), pa.timestamp("us", "UTC"))
    path = written(tmp_path, {"time": times, "dp": np.ones(rows)})
    assert path.stat().st_size < rows / 100
    assert read_log(path, *SOURCE).rows == rows
    monkeypatch.setattr(pipeline.ingest.parquet, "MOST_ROWS", 1_000_000)
    assert error(path).code == "log_too_large"


@pytest.mark.parametrize("end", [b"PAR1", b"PARE"])
def test_a_footer_that_is_not_one(tmp_path: Path, end: bytes) -> None:
    path = tmp_path / "log.parquet"
    for body in (b"", b"\0" * 8, b"\xff" * 8, b"\x00" * 20 + (8).to_bytes(4, "little")):
        path.write_bytes(b"PAR1" + body + end)
        assert error(path).code in {"log_damaged", "log_truncated"}


def test_a_reading_that_its_page_s_checksum_denies_is_damage(tmp_path: Path) -> None:
    options = {"write_page_checksum": True, "use_dictionary": False, "compression": "none"}
    path = written(tmp_path, {"time": TIMES, "dp": [1.0, 200.5, 3.0]}, **options)
    data = path.read_bytes()
    reading, other = struct.pack("<d", 200.5), struct.pack("<d", 200.25)
    assert data.count(reading) > 0
    path.write_bytes(data.replace(reading, other))
    assert error(path).code == "log_damaged"


def test_damaged_metadata_of_a_column_do_not_end_the_process(tmp_path: Path) -> None:
    # PyArrow 26 ends the process where it is asked for the statistics of such a column.
    path = written(tmp_path, {"time": TIMES, "dp": pa.array([1.0, None, 3.0])})
    data = path.read_bytes()
    footer = len(data) - 8 - int.from_bytes(data[-8:-4], "little")
    for at in range(footer, len(data), 3):
        damaged = bytearray(data)
        damaged[at] ^= 1 << (at % 8)
        path.write_bytes(damaged)
        for reader in (read_log, time_span):
            with suppress(LogError):
                reader(path, *SOURCE)
        with suppress(LogError):
            assert read_log(path, *SOURCE).rows == pq.read_metadata(path).num_rows


def test_malformed_files_of_others_raise_nothing_else(foreign_files: Path) -> None:
    """The files of apache/parquet-testing ``bad_data``: some columns can be read, some not."""
    paths = sorted((foreign_files / "parquet_bad").glob("*.parquet"))
    assert len(paths) >= 8
    for path in paths:
        for name in _names(path):
            channels = {"pressure_difference": column(name, "bar")}
            with suppress(LogError):
                read_log(path, *Source.of("parquet", channels, time=name))


def _names(path: Path) -> list[str]:
    try:
        with pq.ParquetFile(path) as file:
            return list(file.schema_arrow.names)
    except OSError:
        return ["time"]


def test_a_name_that_is_not_utf_8_is_no_damage(tmp_path: Path) -> None:
    plain = written(tmp_path, {"time": TIMES, "dp": [7.0, 8.0, 9.0]})
    path = plain.rename(tmp_path / os.fsdecode(b"log\xff.parquet"))
    assert read_log(path, *SOURCE).channels["pressure_difference"].value.tolist() == [7, 8, 9]
