"""The Delta Lake export, read back by the library of the format."""

from __future__ import annotations

from pathlib import Path

import polars as pl
from deltalake import DeltaTable
from polars.testing import assert_frame_equal

from pipeline.export.delta import export_delta
from pipeline.schema import FITS, TABLES
from pipeline.store.tables import read_rows, table_folder
from tests.pipeline.calling import refused
from tests.pipeline.run.demo_runs import FIRST
from tests.pipeline.s3_server import BUCKET, Server
from tests.pipeline.workshop import DAY, Workshop


def back(place: str) -> pl.DataFrame:
    return pl.from_arrow(DeltaTable(place).to_pyarrow_table())


def test_every_table_comes_back_as_it_was(fitted_output: Path, tmp_path: Path) -> None:
    written = {Path(one[0]).name: one for one in export_delta(fitted_output, str(tmp_path))}
    files_of = {
        table.name: sorted(table_folder(fitted_output, table).rglob("*.parquet"))
        for table in TABLES
    }
    there = {name: files for name, files in files_of.items() if files}
    assert written.keys() == there.keys()
    for name, files in there.items():
        expected = pl.concat([pl.read_parquet(file, hive_partitioning=False) for file in files])
        place, version, n_rows = written[name]
        found = back(place)
        assert (version, n_rows) == (0, expected.height)
        assert_frame_equal(found, expected, check_row_order=False)


def test_a_further_export_is_a_new_version_without_doubled_rows(tmp_path: Path) -> None:
    shop, place = Workshop.at(tmp_path), str(tmp_path / "lake")
    shop.log(FIRST)
    shop.run()
    assert list(export_delta(shop.output, place, (FITS,))) == [(f"{place}/fits", 0, 1)]
    shop.log(FIRST + DAY)
    shop.run()
    assert list(export_delta(shop.output, place, (FITS,))) == [(f"{place}/fits", 1, 2)]
    assert back(f"{place}/fits").height == 2
    assert DeltaTable(f"{place}/fits", version=0).to_pyarrow_table().num_rows == 1


def test_it_goes_into_a_bucket(server: Server, tmp_path: Path) -> None:
    shop = Workshop.at(tmp_path)
    shop.log(FIRST)
    shop.run()
    ((place, _, _),) = export_delta(shop.output, f"s3://{BUCKET}/lake", (FITS,))
    assert place == f"s3://{BUCKET}/lake/fits"
    assert back(place)["motor_id"].to_list() == ["M1"]
    assert read_rows(shop.output, FITS, ["M1"]).height == 1


def test_what_cannot_be_exported_is_said(tmp_path: Path, fitted_output: Path) -> None:
    with refused("no_tables"):
        list(export_delta(tmp_path / "nothing", str(tmp_path)))
    with refused("delta_folder"):
        list(export_delta(fitted_output, str(fitted_output / "tables" / "lake")))
    (tmp_path / "file").write_bytes(b"")
    with refused("store_write"):
        list(export_delta(fitted_output, str(tmp_path / "file"), (FITS,)))
