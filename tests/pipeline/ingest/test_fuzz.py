"""Thousands of damaged files a format; in ``make test-full`` only."""

from __future__ import annotations

import random
from contextlib import suppress
from pathlib import Path

import pytest

from pipeline.errors import LogError
from pipeline.ingest import read_log, time_span

from .test_conformance import assert_equal, every_format, many_rows, written
from .writers import Format


def damaged(data: bytes, rng: random.Random) -> bytes:
    """Some bits flipped, bytes overwritten, cut out or put in, or the end missing."""
    at, size = rng.randrange(len(data)), rng.randrange(1, 30)
    kind = rng.randrange(6)
    if kind == 0:
        return data[:at]
    if kind == 1:
        return data[:at] + bytes(rng.choice((0, 127, 255)) for _ in range(8)) + data[at + 8 :]
    if kind == 2:
        return data[:at] + data[at + size :]
    if kind == 3:
        return data[:at] + rng.randbytes(size) + data[at:]
    flipped = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 5))):
        flipped[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(flipped)


@pytest.mark.full
@every_format
def test_damage_raises_nothing_else_and_is_found_where_checksums_are(
    form: Format, tmp_path: Path
) -> None:
    path = written(form, tmp_path, many_rows(60))
    data = path.read_bytes()
    whole = read_log(path, form.source)
    rng = random.Random(2025)  # noqa: S311
    for _ in range(3000):
        path.write_bytes(damaged(data, rng))
        with suppress(LogError):
            time_span(path, form.source)
        with suppress(LogError):
            log = read_log(path, form.source)
            if form.is_checked:
                assert_equal(log, whole)
