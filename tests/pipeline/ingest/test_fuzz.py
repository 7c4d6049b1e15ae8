"""Damaged logs end in a coded error, in data that is right, or in values that nothing could tell
from right ones.

They are read in this process: native code that crashes ends the tests, and is seen.
"""

from __future__ import annotations

import random
import re
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.writer import CompressionType, IndexType

from pipeline.errors import LogError
from pipeline.ingest import RawLog, contract, read_log, time_span
from pipeline.ingest.conformance import CHANNELS, NAMES, Row, many_rows
from pipeline.setup.sniff import sniff

from .sources import Source
from .writers import FORMATS, Write, csv, parquet, write_mcap

CODES = frozenset(re.findall(r"``(log_\w+)``", contract.__doc__ or ""))
"""Codes that a reader may raise, as its contract lists them."""

_LONGEST_MESSAGE = 4000
_TOKENS = (
    *(b"\n", b"\r", b",", b'"', b'"\n', b"\x00", b"\xff", b"\xef\xbb\xbf", b"nan", b"9" * 400),
    *(b"time,dp,T,q\n", b"9999-12-31T23:59:59Z", b"\x1f\x8b\x08", b"\x28\xb5\x2f\xfd", b"PAR1"),
    *(b"\x15\x80\x80\x80\x80\x10", b"\x19\xfc", b"\x1c" * 64, b"\x89MCAP0\r\n", b"[" * 200),
    *(bytes([opcode]) * 2 for opcode in range(1, 17)),
)


@dataclass(frozen=True)
class Seed:
    """A small valid log."""

    name: str
    source: Source
    write: Write
    is_checked: bool = False  # a checksum covers every sample


def write_long_csv(path: Path, rows: Sequence[Row], names: Sequence[str]) -> None:
    cells = [(row.time_us, name, row.cells.get(name)) for row in rows for name in names]
    lines = [f"{time},{name},{cell}\n" for time, name, cell in cells if cell]
    path.write_text("time,channel,value\n" + "".join(lines), encoding="utf-8")


def zstd_without_checksum(path: Path, rows: Sequence[Row], names: Sequence[str]) -> None:
    csv()(path, rows, names)
    path.write_bytes(zstandard.compress(path.read_bytes()))


CSV, PARQUET, MCAP = (Source.of(name, CHANNELS) for name in ("csv", "parquet", "mcap"))
BARE = {"enable_crcs": False, "index_types": IndexType.NONE, "use_statistics": False}
PLAIN = {"compression": CompressionType.NONE}
SEEDS = [
    *(Seed(form.name, Source(form.logs, CHANNELS), form.write) for form in FORMATS),
    Seed("csv-long", CSV.but(layout="long", time_format="epoch_us"), write_long_csv),
    Seed("csv-gz", CSV, csv(packed=".gz"), is_checked=True),
    Seed("csv-zst", CSV, csv(packed=".zst"), is_checked=True),
    Seed("csv-zst-no-checksum", CSV, zstd_without_checksum),
    Seed("parquet-lz4", PARQUET, parquet(compression="lz4", data_page_version="2.0")),
    Seed("parquet-brotli", PARQUET, parquet(compression="brotli", row_group_size=17)),
    Seed("parquet-split", PARQUET, parquet(use_dictionary=False, use_byte_stream_split=NAMES[:1])),
    Seed("mcap-protobuf", MCAP, write_mcap("protobuf", **PLAIN), is_checked=True),
    Seed("mcap-cdr", MCAP, write_mcap("cdr"), is_checked=True),
    Seed("mcap-protobuf-bare", MCAP, write_mcap("protobuf", use_chunking=False, **BARE)),
    Seed("mcap-cdr-bare", MCAP, write_mcap("cdr", **PLAIN, **BARE)),
    Seed("mcap-salvaged", MCAP.but(salvage=True), write_mcap()),
    Seed("mcap-bare-salvaged", MCAP.but(salvage=True), write_mcap(**PLAIN, **BARE)),
]


def damaged(data: bytes, rng: random.Random, count: int) -> Iterator[bytes]:
    """The file cut at every 64th byte, with a flipped bit, and with bytes put in or left out."""
    yield from (data[:at] for at in range(0, len(data), 64))
    for _ in range(count):
        at, size = rng.randrange(len(data)), rng.choice([0, 1, 4, 8, 100])
        yield data[:at] + bytes([data[at] ^ 1 << rng.randrange(8)]) + data[at + 1 :]
        token = rng.choice([*_TOKENS, b"", rng.randbytes(8)])
        yield data[:at] + token + data[at + size :]


def outcome(read: Callable[..., object], *arguments: object) -> object:
    """What a read gives, or the error that it ends in."""
    try:
        return read(*arguments)
    except LogError as error:
        return error


def judged(path: Path, source: Source) -> RawLog | None:
    """The log; None for an error, which must have a code and a legible line that names the file."""
    found = [outcome(time_span, path, *source), outcome(sniff, path)]
    log = outcome(read_log, path, *source)
    for error in (one for one in [*found, log] if isinstance(one, LogError)):
        assert error.code in CODES
        assert error.message.isprintable()
        assert len(error.message) < _LONGEST_MESSAGE
        assert path.name in error.message
    if not isinstance(log, RawLog):
        return None
    assert all(note.isprintable() for note in log.notes)
    return log


def samples(log: RawLog) -> dict[str, set[tuple[int, int]]]:
    """Samples by channel, to the last bit."""
    return {
        name: set(
            zip(
                one.time_us[~one.missing].tolist(),
                one.value[~one.missing].view(np.int64).tolist(),
                strict=True,
            )
        )
        for name, one in log.channels.items()
    }


@pytest.mark.parametrize("seed", SEEDS, ids=lambda seed: seed.name)
@pytest.mark.parametrize(
    "count", [30, pytest.param(1500, marks=pytest.mark.full)], ids=["short", "full"]
)
def test_a_damaged_log_ends_as_it_may(seed: Seed, count: int, tmp_path: Path) -> None:
    path = tmp_path / f"log.{seed.source.logs.format}"
    seed.write(path, many_rows(60), NAMES)
    data = path.read_bytes()
    whole = read_log(path, *seed.source)
    right, refused = samples(whole), 0
    rng = random.Random(zlib.crc32(seed.name.encode()))  # noqa: S311
    for other in damaged(data, rng, count):
        path.write_bytes(other)
        log = judged(path, seed.source)
        refused += log is None
        if log is not None and seed.is_checked:
            assert samples(log) == right
        if log is not None and seed.source.logs.salvage and not seed.name.startswith("mcap-bare"):
            found = samples(log)
            assert all(found[name] <= own for name, own in right.items())
            assert found == right or log.notes
    assert refused
