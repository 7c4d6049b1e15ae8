"""Writers of the same content in every format, for the kit that every reader has to pass.

They know the formats from their specifications and nothing of the readers.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
from google.protobuf import descriptor_pb2
from mcap.writer import CompressionType, IndexType

from pipeline.ingest.conformance import Cell, Format, Row

from .mcap_files import mcap_bytes


def iso(time_us: int, digits: int = 6) -> str:
    """Time in UTC as ISO 8601 without a zone."""
    moment = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=time_us)
    text = moment.strftime("%Y-%m-%dT%H:%M:%S.%f")
    return text[: len(text) - 6 + digits].rstrip(".")


def number(cell: Cell, decimal: str = ".") -> str:
    """A cell as text."""
    if cell is None:
        return ""
    return cell if isinstance(cell, str) else repr(float(cell)).replace(".", decimal)


def write_csv(path: Path, rows: Sequence[Row], names: Sequence[str]) -> None:
    lines = [",".join(["time", *names])]
    lines += [
        ",".join([iso(row.time_us) + "Z", *(number(row.cells.get(name)) for name in names)])
        for row in rows
    ]
    path.write_text("".join(line + "\n" for line in lines), encoding="utf-8")


def write_european_csv(path: Path, rows: Sequence[Row], names: Sequence[str]) -> None:
    """As spreadsheets of half of Europe write it: two lines of preamble, a local time of winter."""
    lines = ["Messung Nr. 7", "Maschine: Bagger", ";".join(["Zeit", *names])]
    for row in rows:
        moment = datetime(1970, 1, 1) + timedelta(microseconds=row.time_us, hours=1)
        cells = (number(row.cells.get(name), ",") for name in names)
        lines.append(";".join([moment.strftime("%d.%m.%Y %H:%M:%S,%f"), *cells]))
    path.write_bytes("".join(line + "\r\n" for line in lines).encode("utf-16"))


def columns(rows: Sequence[Row], names: Sequence[str]) -> dict[str, pa.Array]:
    return {name: pa.array([r.cells.get(name) for r in rows], pa.float64()) for name in names}


def write_parquet(path: Path, rows: Sequence[Row], names: Sequence[str]) -> None:
    stamps = pa.array([row.time_us for row in rows], pa.timestamp("us", "UTC"))
    table = pa.table({"time": stamps, **columns(rows, names)})
    pq.write_table(table, path, row_group_size=37, write_page_checksum=True)


DESCRIPTORS = descriptor_pb2.FileDescriptorSet(
    file=[
        descriptor_pb2.FileDescriptorProto(
            name="value.proto",
            package="motor",
            syntax="proto3",
            message_type=[
                descriptor_pb2.DescriptorProto(
                    name="Value",
                    field=[
                        descriptor_pb2.FieldDescriptorProto(name="value", number=1, type=1, label=1)
                    ],
                )
            ],
        )
    ]
)
ENCODINGS: dict[str, tuple[tuple[str, str, bytes], Callable[[str, Cell], bytes]]] = {
    "json": (
        ("Value", "jsonschema", b'{"type": "object"}'),
        lambda name, cell: json.dumps({"sensor": name, "value": cell}).encode(),
    ),
    "protobuf": (
        ("motor.Value", "protobuf", DESCRIPTORS.SerializeToString()),
        lambda _, cell: b"\x09" + struct.pack("<d", cell),
    ),
    # Little endian: a text "oil", aligned to four, then a float64, aligned to eight.
    "cdr": (
        ("motor/msg/Value", "ros2msg", b"string sensor\nfloat64 value\n"),
        lambda _, cell: b"\x00\x01\x00\x00" + struct.pack("<I4sd", 4, b"oil", cell),
    ),
}


def write_mcap(
    encoding: str = "json", **options: Any
) -> Callable[[Path, Sequence[Row], Sequence[str]], None]:
    schema, encode = ENCODINGS[encoding]

    def write(path: Path, rows: Sequence[Row], names: Sequence[str]) -> None:
        # Without messages mcap 1.6 leaves the channels out of the checksum of the data section.
        data_crcs = options.get("enable_data_crcs", False) and bool(rows)
        messages = [
            (name, row.time_us * 1000 + 999, encode(name, row.cells[name]))
            for row in rows
            for name in names
            if name in row.cells
        ]
        own = {"chunk_size": 2000, **options, "enable_data_crcs": data_crcs}
        path.write_bytes(mcap_bytes(messages, schema, encoding, names, **own))

    return write


def _mcap(
    name: str, *, is_checked: bool = True, names_channels: bool = True, **options: Any
) -> Format:
    return Format(
        name,
        "mcap",
        write_mcap(**options),
        wide=False,
        is_checked=is_checked,
        names_channels=names_channels,
    )


FORMATS = (
    Format("csv", "csv", write_csv, has_whole_rows=True),
    Format(
        "csv-european",
        "csv",
        write_european_csv,
        keys={
            "time": "Zeit",
            "time_format": "%d.%m.%Y %H:%M:%S,%f",
            "time_zone": "Europe/Berlin",
            "separator": ";",
            "decimal": ",",
            "encoding": "utf-16",
            "skip_rows": 2,
        },
        has_whole_rows=True,
    ),
    Format("parquet", "parquet", write_parquet, holds_text=False),
    _mcap("mcap-zstd", compression=CompressionType.ZSTD),
    _mcap("mcap-lz4", compression=CompressionType.LZ4),
    _mcap("mcap-not-chunked", use_chunking=False, enable_data_crcs=True),
    _mcap(
        "mcap-bare",
        is_checked=False,
        names_channels=False,
        index_types=IndexType.NONE,
        repeat_channels=False,
        repeat_schemas=False,
        use_statistics=False,
        use_summary_offsets=False,
        enable_crcs=False,
    ),
)
