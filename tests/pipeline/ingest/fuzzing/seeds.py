"""Small valid logs in all that the readers read, at most 16 KB each.

They are written by the formats' own packages and know nothing of the readers.
"""

from __future__ import annotations

import gzip
import json
import struct
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import zstandard
from google.protobuf import descriptor_pb2
from mcap.writer import CompressionType, IndexType, Writer

from pipeline.ingest.conformance import CHANNELS, Row, many_rows
from tests.pipeline.ingest.fuzzing.checksums import parquet_ranges
from tests.pipeline.ingest.sources import Source, changed
from tests.pipeline.ingest.writers import FORMATS, columns, iso, number, write_csv

LARGEST = 16 * 1024
"""Bytes of a seed."""

_NAMES = ("dp", "T", "q")
_ROWS = 30
_BY_NAME = {form.name: form for form in FORMATS}
_EVERYWHERE = ((0, 2**62),)

_Ranges = tuple[tuple[int, int], ...]
_Write = Callable[[Path, Sequence[Row]], None]


@dataclass(frozen=True, slots=True)
class Seed:
    """A valid log."""

    # name, source: what it is, and how it is read.
    name: str
    source: Source
    data: bytes  # the file
    # Begin and end of the bytes with a checksum over them; nothing that is changed in these alone
    # may come out as data.
    checked: _Ranges
    file_name: str  # of the log

    @property
    def reader(self) -> str:
        """Its format."""
        return self.source.logs.format


@cache
def seeds() -> tuple[Seed, ...]:
    """All of them, by format."""
    return (*_csv_seeds(), *_parquet_seeds(), *_mcap_seeds())


def seed_named(name: str) -> Seed:
    """One of them."""
    return next(seed for seed in seeds() if seed.name == name)


def _seed(
    name: str,
    source: Source,
    write: _Write,
    checked: _Ranges | Callable[[Path], Sequence[tuple[int, int]]] = (),
) -> Seed:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"log.{source.logs.format}"
        write(path, many_rows(_ROWS))
        ranges = tuple(checked(path)) if callable(checked) else checked
        return Seed(name, source, path.read_bytes(), ranges, path.name)


def _csv_seeds() -> list[Seed]:
    plain, european = _BY_NAME["csv"], _BY_NAME["csv-european"]
    long = Source.of("csv", CHANNELS, layout="long")
    # What the format's own tool writes has a checksum, what libraries write has none.
    zst = zstandard.ZstdCompressor(write_checksum=True).compress
    return [
        _seed("csv", Source(plain.logs, CHANNELS), _plain_csv),
        _seed(
            "csv-utf-16",
            Source(european.logs, CHANNELS),
            lambda path, rows: european.write(path, rows, _NAMES),
        ),
        _seed("csv-long", long, _long_csv),
        _seed("csv-gz", Source(plain.logs, CHANNELS), _packed(gzip.compress), _EVERYWHERE),
        _seed("csv-zst", Source(plain.logs, CHANNELS), _packed(zst), _EVERYWHERE),
        _seed("csv-zst-no-checksum", Source(plain.logs, CHANNELS), _packed(zstandard.compress)),
    ]


def _plain_csv(path: Path, rows: Sequence[Row]) -> None:
    write_csv(path, rows, _NAMES)


def _long_csv(path: Path, rows: Sequence[Row]) -> None:
    cells = [(row.time_us, name, row.cells.get(name)) for row in rows for name in _NAMES]
    lines = [f"{iso(time)}Z,{name},{number(cell)}\n" for time, name, cell in cells if cell]
    path.write_text("time,channel,value\n" + "".join(lines), encoding="utf-8")


def _packed(pack: Callable[[bytes], bytes]) -> _Write:
    def write(path: Path, rows: Sequence[Row]) -> None:
        _plain_csv(path, rows)
        path.write_bytes(pack(path.read_bytes()))

    return write


def _parquet_seeds() -> list[Seed]:
    source = Source.of("parquet", CHANNELS)
    nested = source.but(
        {name: changed(one, source=f"oil.{one.source}") for name, one in CHANNELS.items()}
    )
    with_checksum: dict[str, dict[str, Any]] = {
        "none": {"compression": "none", "use_dictionary": False},
        "zstd": {"compression": "zstd", "row_group_size": 17},
        "lz4": {"compression": "lz4", "data_page_version": "2.0"},
        "brotli": {"compression": "brotli"},
    }
    without: dict[str, dict[str, Any]] = {
        "none": {"compression": "none", "row_group_size": 17},
        "snappy": {"compression": "snappy", "use_dictionary": False},
        "gzip": {"compression": "gzip", "data_page_version": "2.0"},
        "delta": {
            "use_dictionary": False,
            "column_encoding": {
                "time": "DELTA_BINARY_PACKED",
                **dict.fromkeys(_NAMES, "BYTE_STREAM_SPLIT"),
            },
        },
    }
    found = [
        _seed(
            f"parquet-checksums-{name}",
            source,
            _wide_parquet(write_page_checksum=True, **options),
            parquet_ranges,
        )
        for name, options in with_checksum.items()
    ]
    found += [
        _seed(f"parquet-{name}", source, _wide_parquet(**options))
        for name, options in without.items()
    ]
    return [
        *found,
        _seed("parquet-nested", nested, _nested_parquet),
        _seed("parquet-long-text", source.but(layout="long"), _long_parquet),
    ]


def _stamps(rows: Sequence[Row]) -> pa.Array:
    return pa.array([row.time_us for row in rows], pa.timestamp("us", "UTC"))


def _wide_parquet(**options: Any) -> _Write:
    def write(path: Path, rows: Sequence[Row]) -> None:
        table = pa.table({"time": _stamps(rows), **columns(rows, _NAMES)})
        pq.write_table(table, path, **options)

    return write


def _nested_parquet(path: Path, rows: Sequence[Row]) -> None:
    parts = columns(rows, _NAMES)
    inside = pa.StructArray.from_arrays(list(parts.values()), list(parts))
    pq.write_table(pa.table({"time": _stamps(rows), "oil": inside}), path)


def _long_parquet(path: Path, rows: Sequence[Row]) -> None:
    """Times and names as text, in dictionaries."""
    cells = [
        (iso(row.time_us) + "Z", name, cell) for row in rows for name, cell in row.cells.items()
    ]
    times, names, values = (pa.array(part) for part in zip(*cells, strict=True))
    pq.write_table(pa.table({"time": times, "channel": names, "value": values}), path)


def _mcap_seeds() -> list[Seed]:
    zstd, lz4, none = CompressionType.ZSTD, CompressionType.LZ4, CompressionType.NONE
    in_data = {"use_chunking": False, "enable_data_crcs": True}
    bare = {"enable_crcs": False, "index_types": IndexType.NONE, "use_statistics": False}
    sound: dict[str, tuple[str, dict[str, Any]]] = {
        "json-zstd": ("json", {"compression": zstd}),
        "json-lz4": ("json", {"compression": lz4}),
        "json-no-chunks": ("json", in_data),
        "protobuf-none": ("protobuf", {"compression": none}),
        "ros2msg-zstd": ("ros2msg", {"compression": zstd}),
    }
    unsound: dict[str, tuple[str, dict[str, Any]]] = {
        "json-none-crc-0": ("json", {"compression": none, "enable_crcs": False}),
        "json-zstd-crc-0": ("json", {"compression": zstd, **bare}),
        "protobuf-lz4-crc-0": ("protobuf", {"compression": lz4, "enable_crcs": False}),
        "protobuf-no-chunks-crc-0": ("protobuf", {"use_chunking": False, **bare}),
        "ros2msg-none-crc-0": ("ros2msg", {"compression": none, **bare}),
    }
    source = Source.of("mcap", CHANNELS)
    found = [
        _seed(f"mcap-{name}", source, _mcap(encoding, options), _EVERYWHERE)
        for name, (encoding, options) in sound.items()
    ]
    found += [
        _seed(f"mcap-{name}", source, _mcap(encoding, options))
        for name, (encoding, options) in unsound.items()
    ]
    in_part = source.but(salvage=True)
    return [
        *found,
        _seed(
            "mcap-json-zstd-salvaged", in_part, _mcap("json", {"compression": zstd}), _EVERYWHERE
        ),
        _seed(
            "mcap-json-none-crc-0-salvaged", in_part, _mcap("json", {"compression": none, **bare})
        ),
    ]


def _mcap(encoding: str, options: dict[str, Any]) -> _Write:
    schema_name, schema_encoding, schema, encode = _ENCODINGS[encoding]
    message_encoding = "cdr" if encoding.startswith("ros2") else encoding

    def write(path: Path, rows: Sequence[Row]) -> None:
        with path.open("wb") as file:
            writer = Writer(file, **{"chunk_size": 1000} | options)
            writer.start()
            schema_id = writer.register_schema(schema_name, schema_encoding, schema)
            ids = {
                name: writer.register_channel(name, message_encoding, schema_id) for name in _NAMES
            }
            for row in rows:
                for name, cell in row.cells.items():
                    if isinstance(cell, float):
                        writer.add_message(ids[name], row.time_us * 1000, encode(cell), 0)
            writer.finish()

    return write


def _descriptors() -> bytes:
    field = descriptor_pb2.FieldDescriptorProto(
        name="value",
        number=1,
        type=descriptor_pb2.FieldDescriptorProto.TYPE_DOUBLE,
        label=descriptor_pb2.FieldDescriptorProto.LABEL_OPTIONAL,
    )
    message = descriptor_pb2.DescriptorProto(name="Value", field=[field])
    file = descriptor_pb2.FileDescriptorProto(
        name="value.proto", package="motor", syntax="proto3", message_type=[message]
    )
    return bytes(descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString())


def _cdr(value: float) -> bytes:
    """Little endian: a text "oil", aligned to four, then a float64, aligned to eight."""
    return b"\x00\x01\x00\x00" + struct.pack("<I4sd", 4, b"oil", value)


_ENCODINGS: dict[str, tuple[str, str, bytes, Callable[[float], bytes]]] = {
    "json": (
        "Value",
        "jsonschema",
        b'{"type": "object"}',
        lambda value: json.dumps({"sensor": "oil", "value": value}).encode(),
    ),
    "protobuf": (
        "motor.Value",
        "protobuf",
        _descriptors(),
        lambda value: b"\x09" + struct.pack("<d", value),
    ),
    "ros2msg": ("motor/msg/Value", "ros2msg", b"string sensor\nfloat64 value\n", _cdr),
}
