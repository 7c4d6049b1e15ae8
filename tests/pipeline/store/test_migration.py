"""Tables of older versions are read as they are, written anew when asked, or refused by name."""

from __future__ import annotations

import datetime as dt
import shutil
from collections import Counter
from pathlib import Path

import duckdb
import polars as pl
import pyarrow.parquet as pq
import pytest

from pipeline.config import load_fleet
from pipeline.errors import StoreError
from pipeline.logs.ledger import content_hash
from pipeline.run.fleet import RunRequest, locked, plan_fleet
from pipeline.run.verification import verify_tables
from pipeline.schema import FITS, SCHEMA_VERSION
from pipeline.store.manifest import announce, update_manifest
from pipeline.store.migration import migrate, old_table_files, version_of
from pipeline.store.tables import VERSION_KEY, night_file
from tests.pipeline.workshop import DAY, Workshop

NIGHT = dt.date(2026, 2, 28)
# Columns that version 1 of `fits` had not.
LATER = ["validation_whiteness", "validation_independence", "previous_model_rmse_l_per_min"]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Workshop:
    workshop = Workshop.at(tmp_path_factory.mktemp("made"))
    for number in range(2):
        workshop.log(NIGHT + number * DAY, seed=number + 1)
    workshop.run()
    return workshop


@pytest.fixture
def workshop(made: Workshop, tmp_path: Path) -> Workshop:
    shutil.copytree(made.folder, tmp_path / "copy")
    return Workshop(tmp_path / "copy")


def as_of(workshop: Workshop, version: int, night: dt.date = NIGHT) -> Path:
    """A night's file of `fits` as an older version, or a newer, would have left it."""
    path = night_file(workshop.output, FITS, night)
    content = pq.read_table(path, partitioning=None)
    if version < SCHEMA_VERSION:
        content = content.drop_columns(LATER)
    with pq.ParquetWriter(path, content.schema, store_schema=False) as writer:
        writer.write_table(content)
        writer.add_key_value_metadata({VERSION_KEY: str(version)})
    name = path.relative_to(workshop.output / "tables").as_posix()
    digests = {name: content_hash(path)}
    update_manifest(workshop.output, f"{night:%Y-%m}", night.isoformat(), digests)
    assert version_of(path) == version
    return path


def migrated(workshop: Workshop) -> Counter[int]:
    with locked(workshop.output):
        return migrate(workshop.output)


def test_a_run_leaves_nothing_to_migrate(workshop: Workshop) -> None:
    assert list(old_table_files(workshop.output)) == []
    assert not migrated(workshop)


def test_an_older_file_gets_the_columns_of_today_and_keeps_its_rows(workshop: Workshop) -> None:
    before = workshop.rows("fits")
    path = as_of(workshop, 1)
    query = f"SELECT count(validation_whiteness) FROM '{path}'"  # noqa: S608
    with pytest.raises(duckdb.BinderException):
        duckdb.sql(query)
    assert [(one.path, one.version) for one in old_table_files(workshop.output)] == [(path, 1)]
    assert migrated(workshop) == {1: 1}
    assert version_of(path) == SCHEMA_VERSION
    assert duckdb.sql(query).fetchall() == [(0,)]
    after = workshop.rows("fits")
    assert after.drop(LATER).equals(before.drop(LATER))
    nulls = after.filter(night=NIGHT).select(LATER).null_count().row(0)
    assert nulls == (after.filter(night=NIGHT).height,) * len(LATER)
    assert list(verify_tables(workshop.output)) == []
    assert not migrated(workshop)


def test_an_older_file_is_read_without_it_and_no_night_is_done_again(workshop: Workshop) -> None:
    as_of(workshop, 1)
    request = RunRequest(load_fleet(workshop.fleet))
    assert dict(plan_fleet(request)) == {"M1": {}}
    # A late log of the same night is merged with what the older file holds.
    workshop.log(NIGHT, seed=9)
    assert workshop.run().nights[0] == NIGHT
    assert version_of(night_file(workshop.output, FITS, NIGHT)) == SCHEMA_VERSION


def test_a_newer_file_is_refused_by_name_and_nothing_is_written(workshop: Workshop) -> None:
    as_of(workshop, 1)
    path = as_of(workshop, SCHEMA_VERSION + 1, NIGHT + DAY)
    before = path.read_bytes()
    with pytest.raises(StoreError, match=rf"{NIGHT + DAY}.parquet is of schema version") as caught:
        migrated(workshop)
    assert caught.value.code == "store_newer"
    assert path.read_bytes() == before
    assert version_of(night_file(workshop.output, FITS, NIGHT)) == 1


def test_a_file_that_was_altered_is_not_made_good(workshop: Workshop) -> None:
    path = as_of(workshop, 1)
    rows = pl.read_parquet(path, hive_partitioning=False)
    content = rows.with_columns(pl.col("aic") + 1.0).to_arrow(compat_level=pl.CompatLevel.oldest())
    with pq.ParquetWriter(path, content.schema, store_schema=False) as writer:
        writer.write_table(content)
        writer.add_key_value_metadata({VERSION_KEY: "1"})
    before = path.read_bytes()
    with pytest.raises(StoreError, match="not what was published") as caught:
        migrated(workshop)
    assert caught.value.code == "store_read"
    assert path.read_bytes() == before
    assert [fault.code for fault in verify_tables(workshop.output)] == ["table_altered"]


def test_a_crash_between_manifest_and_file_is_mended_by_migrating_again(
    workshop: Workshop, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = as_of(workshop, 1)

    def crash(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("pipeline.store.migration.announce", _and_then(crash))
        with pytest.raises(KeyboardInterrupt):
            migrated(workshop)
    assert version_of(path) == 1
    assert list(verify_tables(workshop.output)) == []
    assert migrated(workshop) == {1: 1}
    assert list(verify_tables(workshop.output)) == []


def _and_then(crash: object) -> object:
    def update(*arguments: object) -> None:
        announce(*arguments)  # type: ignore[arg-type]
        assert callable(crash)
        crash()

    return update
