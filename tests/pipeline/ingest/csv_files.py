"""CSV logs of a pressure and a speed, written as they stand."""

from __future__ import annotations

from pathlib import Path

import pytest

import pipeline.ingest.csv
from pipeline.errors import LogError
from pipeline.ingest import RawLog, read_log
from pipeline.ingest.csv_text import read_lines

from .sources import Source, column

SOURCE = Source.of("csv", {"pressure_difference": column("dp", "bar"), "speed": column("n", "rpm")})
DAY = "2025-03-01T06:00:0"


def read(folder: Path, data: bytes | str, source: Source = SOURCE, name: str = "log.csv") -> RawLog:
    """The log that a file's content is read as."""
    path = folder / name
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    return read_log(path, *source)


def error(
    folder: Path, data: bytes | str, source: Source = SOURCE, name: str = "log.csv"
) -> LogError:
    """The error that reading ends in, which names the file."""
    with pytest.raises(LogError) as raised:
        read(folder, data, source, name)
    assert name in raised.value.message
    return raised.value


def in_pieces(patch: pytest.MonkeyPatch, size: int) -> None:
    """Have texts read in pieces of so many bytes."""
    patch.setattr(pipeline.ingest.csv, "read_lines", lambda *at: read_lines(*at[:2], size))
