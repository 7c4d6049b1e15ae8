"""Every built-in format for the kit that every reader has to pass, by the writers of the dialects.

They know the formats from their specifications and nothing of the readers.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, IndexType

from pipeline.ingest.conformance import NAMES, Cell, Format, Row
from tests.dialects import Csv, write_parquet

from .mcap.protobuf_files import NAME, set_of
from .mcap_files import mcap_bytes

Write = Callable[[Path, Sequence[Row], Sequence[str]], None]


def table(write_cells: Callable[..., None]) -> Write:
    """Writer of rows as a table."""

    def write(path: Path, rows: Sequence[Row], names: Sequence[str]) -> None:
        time_us = np.array([row.time_us for row in rows], np.int64)
        write_cells(path, time_us, {name: [row.cells.get(name) for row in rows] for name in names})

    return write


def csv(written_zone: str = "UTC", **options: Any) -> Write:
    """Writer of plain CSV."""
    return table(Csv(written_zone=written_zone, **options).table)


def parquet(**options: Any) -> Write:
    """Writer of plain Parquet."""
    return table(partial(write_parquet, **options))


VALUE = set_of("proto3", Hydraulics="double value").SerializeToString()
ENCODINGS: dict[str, tuple[tuple[str, str, bytes], Callable[[str, Cell], bytes]]] = {
    "json": (
        ("Value", "jsonschema", b'{"type": "object"}'),
        lambda name, cell: json.dumps({"sensor": name, "value": cell}).encode(),
    ),
    "protobuf": ((NAME, "protobuf", VALUE), lambda _, cell: b"\x09" + struct.pack("<d", cell)),
    # Little endian: a text "oil", aligned to four, then a float64, aligned to eight.
    "cdr": (
        ("motor/msg/Value", "ros2msg", b"string sensor\nfloat64 value\n"),
        lambda _, cell: b"\x00\x01\x00\x00" + struct.pack("<I4sd", 4, b"oil", cell),
    ),
}


def write_mcap(encoding: str = "json", **options: Any) -> Write:
    """Writer of a topic a channel."""
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


# As spreadsheets of half of Europe write it: two lines of preamble, a local time of winter.
EUROPEAN = Csv(
    {
        "time": "Zeit",
        "time_format": "%d.%m.%Y %H:%M:%S,%f",
        "time_zone": "Europe/Berlin",
        "separator": ";",
        "decimal": ",",
        "encoding": "utf-16",
        "skip_rows": 2,
    },
    line_end="\r\n",
)
FORMATS = (
    Format("csv", "csv", csv(), has_whole_rows=True),
    Format("csv-european", "csv", table(EUROPEAN.table), keys=EUROPEAN.logs, has_whole_rows=True),
    Format(
        "parquet", "parquet", parquet(row_group_size=37, write_page_checksum=True), holds_text=False
    ),
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


def write_long_csv(path: Path, rows: Sequence[Row], names: Sequence[str]) -> None:
    cells = [(row.time_us, name, row.cells.get(name)) for row in rows for name in names]
    lines = [f"{time},{name},{cell}\n" for time, name, cell in cells if cell]
    path.write_text("time,channel,value\n" + "".join(lines), encoding="utf-8")


PLAIN = {"compression": CompressionType.NONE}
LONG = {"layout": "long", "time_format": "epoch_us"}
SPLIT = parquet(use_dictionary=False, use_byte_stream_split=NAMES[:1])
# They are read and damaged only: their messages hold no text, or other checks have them so.
NUMBERS_ONLY = (
    Format("csv-long", "csv", write_long_csv, wide=False, keys=LONG),
    Format("csv-gz", "csv", csv(packed=".gz"), is_checked=True),
    Format("csv-zst", "csv", csv(packed=".zst"), is_checked=True),
    Format("parquet-lz4", "parquet", parquet(compression="lz4", data_page_version="2.0")),
    Format("parquet-split", "parquet", SPLIT),
    Format("mcap-protobuf", "mcap", write_mcap("protobuf", **PLAIN), wide=False, is_checked=True),
    Format("mcap-cdr", "mcap", write_mcap("cdr"), wide=False, is_checked=True),
)
