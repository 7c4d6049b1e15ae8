"""Whatever bit flips in what a run has left: it is told, and never taken over into a new file."""

from __future__ import annotations

import shutil
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from pipeline.schema import QUALITY, frame
from pipeline.store.manifest import manifest_file, manifest_key, read_manifest
from pipeline.store.night_files import NewRows, prepare_file, with_nights
from pipeline.store.published import verify_tables
from pipeline.store.tables import night_file
from tests.pipeline.faults.conftest import say
from tests.pipeline.faults.disk import Disk, Killed, on
from tests.pipeline.faults.fleet import TinyFleet, check_tables, remembered_fits
from tests.pipeline.simulated import NIGHT

# Who runs or ran: nothing is made from it.
UNPROVEN = ("lock", "heartbeat.json", "views.sql")


@pytest.fixture
def output(output: Path) -> Path:
    """All that a run leaves, and something that people said."""
    say(output)
    return output


def files_of(output: Path) -> list[Path]:
    """Every file with content that is to be proven."""
    return sorted(
        path for path in output.rglob("*") if path.is_file() and path.name not in UNPROVEN
    )


def flip(path: Path, whole: bytes, bit: int) -> None:
    changed = bytearray(whole)
    changed[bit // 8] ^= 1 << bit % 8
    path.write_bytes(changed)


def is_told(output: Path, path: Path) -> bool:
    """True if a fault names the file or, for a manifest, a file that it lists."""
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


def alone(path: Path, output: Path, folder: Path) -> Path:
    """A table file in an output of its own, with its manifest; returns where it lies."""
    name = path.relative_to(output / "tables").as_posix()
    place = folder / "tables" / name
    place.parent.mkdir(parents=True)
    shutil.copy(path, place)
    key = manifest_key(name)
    manifest_file(folder, key).parent.mkdir()
    shutil.copy(manifest_file(output, key), manifest_file(folder, key))
    return place


@pytest.mark.parametrize(
    "size", [pytest.param(200, id="some"), pytest.param(0, marks=pytest.mark.full, id="all")]
)
def test_bits_of_a_table(output: Path, tmp_path: Path, size: int) -> None:
    """Pages, page headers, footer, lengths and magic numbers; the manifest's own bits as well."""
    path = alone(night_file(output, QUALITY, NIGHT), output, tmp_path / "alone")
    folder = tmp_path / "alone"
    (manifest,) = (folder / "manifest").rglob("*.json")
    # The manifest also lists what lies elsewhere.
    for file in (path, manifest):
        whole = file.read_bytes()
        bits = np.arange(8 * len(whole))
        if size:
            bits = np.random.default_rng(2).choice(bits, size, replace=False)
        for bit in bits:
            flip(file, whole, int(bit))
            assert is_told(folder, file), bit
        file.write_bytes(whole)
    assert not is_told(folder, path)


@pytest.mark.full
def test_every_byte_of_every_table(output: Path, tmp_path: Path) -> None:
    """Of one file of each."""
    rng = np.random.default_rng(3)
    for table in sorted((output / "tables").iterdir()):
        path, folder = min(table.rglob("*.parquet")), tmp_path / table.name
        place = alone(path, output, folder)
        whole = place.read_bytes()
        for byte in range(len(whole)):
            flip(place, whole, 8 * byte + int(rng.integers(8)))
            assert is_told(folder, place), byte
        shutil.rmtree(folder)


@pytest.mark.parametrize(
    "size", [pytest.param(60, id="some"), pytest.param(0, marks=pytest.mark.full, id="all")]
)
def test_no_flipped_bit_gets_into_a_new_file(output: Path, size: int) -> None:
    """A run adds rows to the file of a night: those that are there are proven first."""
    path = night_file(output, QUALITY, NIGHT)
    whole = path.read_bytes()
    manifest = read_manifest(output, f"{NIGHT:%Y-%m}")
    accepted = manifest.accepted(path.relative_to(output / "tables").as_posix())
    change = with_nights(QUALITY, [(NIGHT, NewRows(("M3",), 0, [frame(QUALITY, [])]))])
    sound = prepare_file(path, QUALITY, change, accepted)
    assert not sound.lost_rows
    bits = np.arange(8 * len(whole))
    if size:
        bits = np.random.default_rng(4).choice(bits, size, replace=False)
    for bit in bits:
        flip(path, whole, int(bit))
        file = prepare_file(path, QUALITY, change, accepted)
        file.drop()
        assert file.lost_rows, bit


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize(
    "step", [pytest.param(250, id="some"), pytest.param(7, marks=pytest.mark.full, id="many")]
)
def test_rows_of_a_damaged_file_are_made_anew_though_the_run_is_killed(
    tiny_fleet: TinyFleet, tmp_path: Path, step: int
) -> None:
    """One motor's night is published over a damaged file: the other's rows are not forgotten."""
    output = tmp_path / "out"
    point, disk = 120, Disk("killed", 0)
    with remembered_fits():
        while point == 120 or disk.struck:
            tiny_fleet.copy(output)
            path = night_file(output, QUALITY, NIGHT)
            whole = path.read_bytes()
            flip(path, whole, 8 * (len(whole) - 100))
            disk = Disk("killed", point)
            with on(disk), suppress(Killed):
                tiny_fleet.run(output)
            for _ in range(2):
                tiny_fleet.run(output)
            path.with_suffix(".damaged").unlink()
            check_tables(output, tiny_fleet)
            assert list(verify_tables(output)) == []
            point += step
