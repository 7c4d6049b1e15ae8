"""Just to read logs, as fast as can be: a process of its own for benchmarks.

`python -m benchmarks.log_readers FORMAT FILE...` reads the files into columns, in turn.
"""

from __future__ import annotations

import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa


def read_parquet(path: Path) -> object:
    """By PyArrow."""
    import pyarrow.parquet as pq

    return pq.read_table(path, use_threads=False)


def read_csv(path: Path) -> object:
    """By PyArrow."""
    from pyarrow import csv

    return csv.read_csv(path, csv.ReadOptions(use_threads=False))


def read_mcap(path: Path) -> object:
    """JSON of chunked files, nothing checked: no reader of a package comes near.

    The `mcap` package finds the chunks. Its single records take twenty times as long, and a
    walk from length to length in Python five times.
    """
    from mcap.data_stream import ReadDataStream
    from mcap.reader import make_reader
    from mcap.records import Chunk

    columns = []
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
        for index in summary.chunk_indexes if summary else ():
            file.seek(index.chunk_start_offset + 9)
            chunk = Chunk.read(ReadDataStream(file))
            codec = pa.Codec(chunk.compression)
            records = codec.decompress(chunk.data, chunk.uncompressed_size, asbytes=True)
            file.seek(index.chunk_start_offset + index.chunk_length)
            columns.append(_columns(records, _positions(file.read(index.message_index_length))))
    return columns


def _positions(indexes: bytes) -> Any:
    parts, at = [], 0
    while at < len(indexes):
        (size,) = struct.unpack_from("<I", indexes, at + 11)
        parts.append(np.frombuffer(indexes, "<u8", size // 8, at + 15)[1::2])
        at += 15 + size
    return np.sort(np.concatenate(parts)).astype(np.int64)


def _columns(records: bytes, start: Any) -> tuple[Any, Any, Any]:
    from pyarrow import json

    def at(place: int, kind: str) -> Any:
        room = len(records) - np.dtype(kind).itemsize + 1
        return np.ndarray((room,), kind, records, strides=(1,))[start + place]

    text = np.frombuffer(records, np.uint8).copy()
    text[start + 30] = ord("\n")
    edges = np.column_stack([start + 30, start + 9 + at(1, "<u8").astype(np.int64)])
    buffers = [None, pa.py_buffer(np.append(edges, edges[-1, 1])), pa.py_buffer(text)]
    pieces = pa.Array.from_buffers(pa.large_binary(), edges.size, buffers)
    lines = pieces.take(pa.array(np.arange(0, edges.size, 2))).buffers()[2]
    options = json.ReadOptions(use_threads=False, block_size=2**20)
    return at(9, "<u2"), at(23, "<u8"), json.read_json(pa.BufferReader(lines), options)


READERS = {"parquet": read_parquet, "csv": read_csv, "mcap": read_mcap}

if __name__ == "__main__":
    for log in sys.argv[2:]:
        READERS[sys.argv[1]](Path(log))
