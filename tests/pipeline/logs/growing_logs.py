"""Logs of each format that another thread writes to while they are read."""

from __future__ import annotations

import datetime as dt
import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from mcap.writer import Writer

from tests.pipeline.remembered import ledger_of
from tests.pipeline.simulated import CANONICAL
from tests.pipeline.workshop import Workshop

MINUTES = 24.0
ROWS = round(MINUTES * 60)
PIECE = 60
PATIENCE_S = 60.0
Cells = dict[str, np.ndarray[Any, Any]]


def csv_writer(path: Path, cells: Cells) -> Iterator[None]:
    """Appends a minute of rows each time it is asked; what is written is on the disk."""
    with path.open("w", encoding="utf-8") as file:
        file.write(",".join(["time", *CANONICAL]) + "\n")
        for begin in range(0, ROWS, PIECE):
            for i in range(begin, begin + PIECE):
                moment = dt.datetime.fromtimestamp(cells["time"][i] / 1e6, dt.UTC)
                numbers = (repr(float(cells[name][i])) for name in CANONICAL)
                file.write(",".join([moment.isoformat(), *numbers]) + "\n")
            file.flush()
            yield


def parquet_writer(path: Path, cells: Cells) -> Iterator[None]:
    """Row group by row group; without its end it is no Parquet yet."""
    schema = pa.schema(
        [("time", pa.timestamp("us", "UTC")), *((name, pa.float64()) for name in CANONICAL)]
    )
    with path.open("wb") as file, pq.ParquetWriter(file, schema) as writer:
        for begin in range(0, ROWS, PIECE):
            part = {name: cells[name][begin : begin + PIECE] for name in ("time", *CANONICAL)}
            writer.write_table(
                pa.table({n: pa.array(v, schema.field(n).type) for n, v in part.items()})
            )
            file.flush()
            yield


def mcap_writer(path: Path, cells: Cells) -> Iterator[None]:
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1000)
        writer.start()
        schema = writer.register_schema("Value", "jsonschema", b'{"type": "object"}')
        ids = {name: writer.register_channel(name, "json", schema) for name in CANONICAL}
        for begin in range(0, ROWS, PIECE):
            for i in range(begin, begin + PIECE):
                for name in CANONICAL:
                    message = json.dumps({"value": float(cells[name][i])}).encode()
                    writer.add_message(ids[name], int(cells["time"][i]) * 1000, message, 0)
            file.flush()
            yield
        writer.finish()


WRITERS: dict[str, Callable[[Path, Cells], Iterator[None]]] = {
    "csv": csv_writer,
    "parquet": parquet_writer,
    "mcap": mcap_writer,
}
every_format = pytest.mark.parametrize("log_format", WRITERS)


@dataclass
class Logger:
    """Another thread that writes a log, a minute of it at a time, and then closes it."""

    steps: Iterator[None]
    may_write: threading.Semaphore = field(default_factory=lambda: threading.Semaphore(0))
    has_written: threading.Semaphore = field(default_factory=lambda: threading.Semaphore(0))

    def work(self) -> None:
        for _ in self.steps:
            self.has_written.release()
            self.may_write.acquire()
        self.has_written.release()

    def write(self, pieces: int = 1) -> None:
        """Have it write on, and wait until that is done."""
        for _ in range(pieces):
            self.may_write.release()
            assert self.has_written.acquire(timeout=PATIENCE_S)


@contextmanager
def logger(log_format: str, path: Path, cells: Cells) -> Iterator[Logger]:
    one = Logger(WRITERS[log_format](path, cells))
    thread = threading.Thread(target=one.work, daemon=True)
    thread.start()
    assert one.has_written.acquire(timeout=PATIENCE_S)
    yield one
    while thread.is_alive():  # to its end
        one.may_write.release()
        thread.join(0.01)


@dataclass(frozen=True)
class Site:
    """A motor of one format, and what it did in two nights."""

    workshop: Workshop
    log_format: str
    nights: dict[dt.date, Cells]

    def path(self, label: dt.date) -> Path:
        return self.workshop.logs / f"{label}.{self.log_format}"

    def write(self, label: dt.date) -> None:
        for _ in WRITERS[self.log_format](self.path(label), self.nights[label]):
            pass

    def known_files(self) -> set[str]:
        output = self.workshop.folder / "out"
        return set(ledger_of(output).files)
