"""Logs made to harm: of a few kilobytes that unfold to gigabytes, or that would take for ever.

They are read in another process, as what goes wrong here may end one. `docs/operations.md` has the
limits.
"""

from __future__ import annotations

import gzip
import multiprocessing
import pickle
import resource
import struct
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import zstandard
from google.protobuf import descriptor_pb2
from mcap.writer import CompressionType

from pipeline.errors import LONGEST_MESSAGE, LogError
from pipeline.ingest import read_log, time_span
from pipeline.ingest.conformance import T0_US
from pipeline.setup.sniff import sniff

from .mcap_files import JSON, TOPIC, mcap_of
from .sources import Source, column

CPU_S = 30.0
"""Far more than any takes; without the limits, some take years."""

MEMORY_BYTES = 2**30

CHANNEL = {"speed": column("n", "rpm")}
CSV = Source.of("csv", CHANNEL)
PARQUET = Source.of("parquet", CHANNEL)
STAMP = "2025-03-01T06:00:00Z"
ROWS = 200_000

Hostile = Callable[[Path], Source]


def text(head: bytes, row: bytes = b"", count: int = 0, pack: Any = bytes) -> Hostile:
    def write(path: Path) -> Source:
        path.write_bytes(pack(head + row * count))
        return CSV

    return write


def parquet(**columns: Callable[[], Any]) -> Hostile:
    """Columns of `ROWS` rows beside a time and a speed that are sound."""

    def write(path: Path) -> Source:
        times = pa.array(np.full(ROWS, T0_US), pa.timestamp("us", "UTC"))
        made = {name: column() for name, column in columns.items()}
        table = pa.table({"time": times, "n": np.ones(ROWS)} | made)
        # Without Arrow's own schema, so that a dictionary is read as plain text.
        pq.write_table(table, path, compression="zstd", store_schema=False)
        layout = "long" if "channel" in columns else "wide"
        return Source.of("parquet", CHANNEL, layout=layout, value_column="n")

    return write


def one_page(path: Path) -> Source:
    """A page of any number of rows takes a few bytes."""
    rows = 12_000_000
    times = pa.array(np.full(rows, T0_US), pa.timestamp("us", "UTC"))
    options: Any = {"row_group_size": rows, "data_page_size": 2**30, "max_rows_per_page": 2**30}
    table = pa.table({"time": times, "n": np.ones(rows)})
    pq.write_table(table, path, compression="zstd", write_statistics=False, **options)
    assert path.stat().st_size < 2**18
    return PARQUET


def one_text(content: str) -> Callable[[], pa.Array]:
    """The same text in each row, which is stored once."""
    return lambda: pa.DictionaryArray.from_arrays(np.zeros(ROWS, np.int32), [content])


def mcap(
    payloads: list[bytes], field: str, schema: tuple[str, str, bytes], encoding: str
) -> Hostile:
    def write(path: Path) -> Source:
        options = {"compression": CompressionType.ZSTD, "chunk_size": 2**27}
        path.write_bytes(mcap_of(payloads, schema, encoding, **options))
        return Source.of("mcap", {"speed": column(TOPIC, "rpm", field=field)})

    return write


def json(*payloads: bytes, field: str = "value") -> Hostile:
    return mcap(list(payloads), field, JSON, "json")


def ros2(definition: str, payload: bytes = b"\1" * 8, language: str = "ros2msg") -> Hostile:
    message = b"\0\1\0\0" + payload
    return mcap([message] * 3, "v", ("m/msg/V", language, definition.encode()), "cdr")


def within(*parts: str) -> str:
    return f"\n{'=' * 80}\n".join(parts)


def twice_over(depth: int) -> str:
    """Each message holds the next one twice: 2 to the depth of fields, in a few lines."""
    inner = [f"MSG: m/L{i}\nL{i + 1} a\nL{i + 1} b" for i in range(depth)]
    return within("L0 a\nuint8 v", *inner, f"MSG: m/L{depth}\nint32[64] x")


def protobuf(*files: Any, payload: bytes = b"") -> Hostile:
    schema = descriptor_pb2.FileDescriptorSet(file=files).SerializeToString()
    return mcap([payload], "value", ("m.V", "protobuf", schema), "protobuf")


def imports(count: int) -> list[Any]:
    """Files of Protobuf, each of which imports the next."""
    return [
        descriptor_pb2.FileDescriptorProto(
            name=str(i), package="m", dependency=[str(i + 1)] if i < count else []
        )
        for i in range(count + 1)
    ]


def within_itself(depth: int) -> Hostile:
    """A message that may hold itself, and one that does so very often."""
    field = descriptor_pb2.FieldDescriptorProto
    message = descriptor_pb2.DescriptorProto(name="V")
    message.field.add(name="value", number=1, type=field.TYPE_DOUBLE, label=1)
    message.field.add(name="v", number=2, type=field.TYPE_MESSAGE, type_name=".m.V", label=1)
    payload = b""
    for _ in range(depth):
        payload = b"\x12" + _varint(len(payload)) + payload
    file = descriptor_pb2.FileDescriptorProto(name="a", package="m", message_type=[message])
    return protobuf(file, payload=payload)


def _varint(number: int) -> bytes:
    low = bytes([number % 128 + (128 if number > 127 else 0)])
    return low + (_varint(number // 128) if number > 127 else b"")


SEQUENCE = within("E[] a\nuint8 v", "MSG: m/E\n")
MANY = struct.pack("<I", 3_000_000) + bytes(3_000_001)

HOSTILE: dict[str, tuple[Hostile, str]] = {
    # What unfolds
    "a gzip of a gzip": (text(gzip.compress(gzip.compress(bytes(2**24)))), "log_not_csv"),
    **{
        f"{name} of gigabytes": (
            text(b"time,n\n", f"{STAMP},1\n".encode(), 3_000_000, pack),
            "log_too_large",
        )
        for name, pack in (("Zstandard", zstandard.compress), ("gzip", gzip.compress))
    },
    "a page of millions of rows": (one_page, "log_too_large"),
    "a name of a megabyte in each row": (
        parquet(channel=one_text("x" * 10**6)),
        "log_too_large",
    ),
    "a stamp of a megabyte in each row": (
        parquet(time=one_text(STAMP + " " * 10**6)),
        "log_too_large",
    ),
    # What is deep, or long, or wide
    "arrays in arrays in JSON": (json(b'{"value":1,"x":' + b"[" * 10**6 + b"]" * 10**6 + b"}"), ""),
    "objects in objects in JSON": (
        json(b'{"x":' * 10**5 + b"1" + b"}" * 10**5),
        "log_column_missing",
    ),
    "an array of arrays for a reading": (
        json(b'{"value":' + b"[" * 10**6 + b"]" * 10**6 + b"}"),
        "log_type",
    ),
    "a number of a million digits": (json(b'{"value":' + b"9" * 10**6 + b"}"), ""),
    "an exponent beyond all": (json(b'{"value":-1e999999999}', b'{"value":1e-999999999}'), ""),
    "a header of too many cells": (text(b"time,n" + b"," * 10**5 + b"\n"), "log_not_csv"),
    "a header in each line": (text(b"", b"time,n\n", 2 * 10**4, bytes), "log_time"),
    "a line without an end": (text(b"time,n\n", b"1", 2**25 + 1, bytes), "log_not_csv"),
    # Definitions
    "a message within itself, twice each": (ros2(twice_over(27)), "log_too_large"),
    "a message within itself": (ros2(within("W w\nuint8 v", "MSG: m/W\nW w")), "log_damaged"),
    "messages in messages without an end": (
        ros2(within("L0 a\nuint8 v", *(f"MSG: m/L{i}\nL{i + 1} a" for i in range(5000)))),
        "log_damaged",
    ),
    "a sequence of millions of nothing": (ros2(SEQUENCE, MANY), "log_too_large"),
    "an array of more than there is": (ros2(f"uint8[{'9' * 30}] a\nuint8 v"), "log_too_large"),
    "a size of thousands of digits": (ros2(f"uint8[{'9' * 5000}] a\nuint8 v"), "log_damaged"),
    "files that import files": (protobuf(*imports(5000)), "log_damaged"),
    "files that import each other": (
        protobuf(*imports(1), descriptor_pb2.FileDescriptorProto(name="2", dependency=["0"])),
        "log_damaged",
    ),
    "a message of Protobuf in itself": (within_itself(2000), "log_type"),
}  # fmt: skip


@pytest.fixture(scope="module")
def process() -> Iterator[ProcessPoolExecutor]:
    """A process for all of them, which ends where it takes far too long."""
    context = multiprocessing.get_context("spawn")
    most = int(10 * CPU_S)
    limit = (resource.RLIMIT_CPU, (most, most))
    with ProcessPoolExecutor(1, context, resource.setrlimit, limit) as pool:
        yield pool


def measured(path: Path, source: Source) -> tuple[str, float, int]:
    """Code of the error that a log ends in, processor time, and memory taken to read it."""
    begin, before = time.process_time(), peak_bytes()
    with suppress(LogError):
        sniff(path)
    try:
        read_log(path, *source)
        code = ""
    except LogError as error:
        code = error.code
    return code, time.process_time() - begin, peak_bytes() - before


def peak_bytes() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


@pytest.mark.parametrize(("hostile", "code"), HOSTILE.values(), ids=HOSTILE.keys())
def test_a_hostile_log_ends_in_bounded_time_and_memory(
    tmp_path: Path, process: ProcessPoolExecutor, hostile: Hostile, code: str
) -> None:
    path = tmp_path / "log"
    found, cpu_s, taken = process.submit(measured, path, hostile(path)).result()
    assert found == code
    assert cpu_s < CPU_S
    assert taken < MEMORY_BYTES


@pytest.mark.parametrize(
    ("place", "error"),
    [("csv.read_lines", MemoryError()), ("parquet.pq.ParquetFile", pa.ArrowMemoryError("much"))],
)
def test_what_takes_more_memory_than_there_is_has_a_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str, error: Exception
) -> None:
    path, source = tmp_path / "log", CSV if "csv" in place else PARQUET
    path.write_bytes(b"PAR1" + bytes(8) + b"PAR1")

    def no_memory(*_: object, **__: object) -> object:
        raise error

    monkeypatch.setattr(f"pipeline.ingest.{place}", no_memory)
    for read in (read_log, time_span):
        with pytest.raises(LogError) as raised:
            read(path, *source)
        assert raised.value.code == "log_too_large"


def test_messages_show_a_stranger_s_text_on_one_line_of_bounded_length(tmp_path: Path) -> None:
    path = tmp_path / "a\n\x1b[2J\u202eb\udc80.csv"
    path.write_bytes(b"t\x1b[31m\xe2\x80\xa8ime," + b"x" * 10_000 + b"\n1,2\n")
    with pytest.raises(LogError) as raised:
        read_log(path, *CSV)
    message = raised.value.message
    assert message.startswith(r"a\n\x1b[2J\u202eb\udc80.csv: no column 'time'")
    assert message.isprintable()
    assert len(message) < 2 * LONGEST_MESSAGE
    again = pickle.loads(pickle.dumps(raised.value))  # noqa: S301 - our own
    assert (again.code, again.message) == (raised.value.code, message)
