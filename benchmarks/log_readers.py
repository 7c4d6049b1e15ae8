"""Just to read logs, as fast as can be: a process of its own for benchmarks.

`python -m benchmarks.log_readers READER FILE...` reads the files into columns, one after the other.
"""

from __future__ import annotations

import struct
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

Reader = Callable[[Path], Any]


def _pyarrow_parquet() -> Reader:
    import pyarrow.parquet as pq

    return lambda path: pq.read_table(path, use_threads=False)


def _pyarrow_csv() -> Reader:
    from pyarrow import csv

    return lambda path: csv.read_csv(path, csv.ReadOptions(use_threads=False))


def _plain_mcap() -> Reader:
    """JSON of chunked files, nothing checked: no reader of a package comes near.

    The `mcap` package finds the chunks. Its records one by one take twenty times as long, and a
    walk from length to length in Python five times.
    """
    import numpy as np
    import pyarrow as pa
    from mcap.data_stream import ReadDataStream
    from mcap.reader import make_reader
    from mcap.records import Chunk
    from pyarrow import json

    def positions(indexes: bytes) -> Any:
        parts, at = [], 0
        while at < len(indexes):
            (size,) = struct.unpack_from("<I", indexes, at + 11)
            parts.append(np.frombuffer(indexes, "<u8", size // 8, at + 15)[1::2])
            at += 15 + size
        return np.sort(np.concatenate(parts)).astype(np.int64)

    def columns(records: bytes, start: Any) -> tuple[Any, Any, Any]:
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

    def read(path: Path) -> list[tuple[Any, Any, Any]]:
        found = []
        with path.open("rb") as file:
            for index in make_reader(file).get_summary().chunk_indexes:
                file.seek(index.chunk_start_offset + 9)
                chunk = Chunk.read(ReadDataStream(file))
                codec = pa.Codec(chunk.compression)
                records = codec.decompress(chunk.data, chunk.uncompressed_size, asbytes=True)
                file.seek(index.chunk_start_offset + index.chunk_length)
                start = positions(file.read(index.message_index_length))
                found.append(columns(records, start))
        return found

    return read


READERS: dict[str, Callable[[], Reader]] = {
    "pyarrow_parquet": _pyarrow_parquet,
    "pyarrow_csv": _pyarrow_csv,
    "plain_mcap": _plain_mcap,
}


def main(name: str, *files: str) -> None:
    """Read the files."""
    reader = READERS[name]()
    for file in files:
        reader(Path(file))


if __name__ == "__main__":
    main(*sys.argv[1:])
