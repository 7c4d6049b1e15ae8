"""Manifests are mended like tables."""

from __future__ import annotations

import shutil
from pathlib import Path

import polars as pl
import pyarrow.parquet as pq
import pytest

from pipeline.run.mending import rebuild_manifests
from pipeline.schema import FITS, PARAMETERS, PREDICTIONS, QUALITY
from pipeline.store.encoding import write_table
from pipeline.store.manifest import manifest_file
from pipeline.store.tables import night_file
from tests.pipeline.faults.damage import MONTH, codes, found, remove_aside, rot
from tests.pipeline.faults.fleet import LATER, TinyFleet, check_repaired
from tests.pipeline.simulated import NIGHT

pytestmark = pytest.mark.usefixtures("_quick")


def manifests(output: Path) -> dict[str, bytes]:
    folder = output / "manifest"
    return {path.name: path.read_bytes() for path in folder.rglob("*.json")}


def test_a_deleted_folder_of_manifests_is_rebuilt(tiny_fleet: TinyFleet, output: Path) -> None:
    before = manifests(output)
    shutil.rmtree(output / "manifest")
    assert set(codes(output)) == {"manifest_missing"}
    result = tiny_fleet.run(output)
    assert {fault.code for fault in result.damage} == {"manifest_missing"}
    assert "13 files proven to the last byte" in result.damage[0].message
    assert result.damage_left == ()
    assert manifests(output).items() >= before.items()
    check_repaired(output, tiny_fleet)


def test_a_damaged_manifest_is_rebuilt(tiny_fleet: TinyFleet, output: Path) -> None:
    path = manifest_file(output, MONTH)
    before = path.read_bytes()
    path.write_bytes(before.replace(b"fits", b"tifs"))
    assert codes(output) == ["manifest_damaged"]
    result = tiny_fleet.run(output)
    assert found(result) == [(path.relative_to(output).as_posix(), "manifest_damaged")]
    assert path.read_bytes() == before
    check_repaired(output, tiny_fleet)


def test_a_manifest_that_is_published_damaged_is_rebuilt(output: Path) -> None:
    """Or one of an older version: the object store has no better one."""
    path = manifest_file(output, MONTH)
    path.write_bytes(b'{"files": {}, "sha256": "0"}')
    (fault,) = rebuild_manifests(output, lambda _: True)
    assert (fault.code, fault.message[:9]) == ("manifest_damaged", "made anew")
    assert codes(output) == []


def test_a_manifest_takes_in_what_is_proven_alone(tiny_fleet: TinyFleet, output: Path) -> None:
    """Neither a damaged file nor one of another night; what other libraries wrote has its pages."""
    manifest_file(output, MONTH).unlink()
    rot(night_file(output, FITS, NIGHT))
    shutil.copy(night_file(output, PREDICTIONS, LATER), night_file(output, PREDICTIONS, NIGHT))
    older, other = (night_file(output, table, NIGHT) for table in (QUALITY, PARAMETERS))
    write_table(older, pl.read_parquet(older).drop("n_samples"))
    pq.write_table(pq.read_table(other), other, write_page_checksum=True)
    mine = shutil.copy(older, older.with_name("mine.parquet"))
    result = tiny_fleet.run(output)
    told = {fault.path: fault for fault in result.damage}
    assert "8 files proven to the last byte, 1 of other libraries by the checksums of their " in (
        told[f"manifest/{MONTH}.json"].message
    )
    altered = [path for path, code in found(result) if code == "table_altered"]
    assert altered == [f"{one}/month={MONTH}/{NIGHT}.parquet" for one in ("fits", "predictions")]
    mine.unlink()
    assert result.damage_left == ()
    remove_aside(output)
    tiny_fleet.run(output)
    check_repaired(output, tiny_fleet)
