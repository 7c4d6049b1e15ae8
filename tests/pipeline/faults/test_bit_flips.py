"""Whatever bit flips in what a run has left: it is told, and never taken over into a new file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import StoreError
from pipeline.schema import QUALITY
from pipeline.store.published import verify_tables
from pipeline.store.publishing import stage, staged_file
from pipeline.store.tables import night_file
from tests.pipeline.faults.conftest import say
from tests.pipeline.simulated import NIGHT
from tests.pipeline.written import publisher_of


@pytest.fixture
def output(output: Path) -> Path:
    """All that a run leaves, and something that people said."""
    say(output)
    return output


def files_of(output: Path) -> list[Path]:
    """Every file with content that is to be proven."""
    return sorted((output / "tables").rglob("*.parquet"))


def flip(path: Path, whole: bytes, bit: int) -> None:
    changed = bytearray(whole)
    changed[bit // 8] ^= 1 << bit % 8
    path.write_bytes(changed)


def is_told(output: Path, path: Path) -> bool:
    """True if a fault names the file."""
    name = path.relative_to(output).as_posix().removeprefix("tables/")
    return any(fault.path in (name, path.name) for fault in verify_tables(output))


def test_some_bits_of_every_file(output: Path) -> None:
    rng = np.random.default_rng(1)
    for path in files_of(output):
        whole = path.read_bytes()
        flip(path, whole, int(rng.integers(8 * len(whole))))
        assert is_told(output, path), path
        path.write_bytes(whole)
    assert list(verify_tables(output)) == []


@pytest.mark.parametrize(
    "size", [pytest.param(30, id="some"), pytest.param(0, marks=pytest.mark.full, id="all")]
)
def test_no_flipped_bit_gets_into_a_new_file(output: Path, tmp_path: Path, size: int) -> None:
    """A run adds rows to the file of a month: those that are there are proven first."""
    path = night_file(output, QUALITY, NIGHT)
    whole = path.read_bytes()
    bits = np.arange(8 * len(whole))
    if size:
        bits = np.random.default_rng(4).choice(bits, size, replace=False)
    stage(staged_file(tmp_path / "nights", "M3"), {QUALITY: {NIGHT: []}})
    with publisher_of(output, staging=tmp_path) as publisher:
        for bit in bits:
            flip(path, whole, int(bit))
            with pytest.raises(StoreError, match="not what was published"):
                publisher.nights("nights", [QUALITY], ["M3"])
