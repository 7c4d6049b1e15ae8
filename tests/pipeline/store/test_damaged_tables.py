"""Damage and strange schemas of table files are reported."""

from __future__ import annotations

import itertools
import struct
from pathlib import Path

import polars as pl
import pytest
from polars.testing import assert_frame_equal

from pipeline.errors import StoreError
from pipeline.schema import QUALITY, TABLES, Table, frame
from pipeline.store import tables
from pipeline.store.tables import night_file, read_rows, read_table, write_table
from tests.pipeline.store.made_rows import (
    LATER,
    NIGHT,
    example,
    publish_night,
    row,
    rows,
)


def footer_begin(data: bytes) -> int:
    (length,) = struct.unpack("<I", data[-8:-4])
    return len(data) - 8 - int(length)


class TestDamage:
    @pytest.fixture
    def data(self, file: Path) -> bytes:
        return file.read_bytes()

    def test_every_flipped_bit_of_the_pages_is_told(self, file: Path, data: bytes) -> None:
        """Or lies where it means nothing: never other rows."""
        expected = read_table(file, QUALITY)
        told = 0
        places = range(0, 8 * footer_begin(data), 7)
        for place in places:
            flipped = bytearray(data)
            flipped[place // 8] ^= 1 << place % 8
            file.write_bytes(flipped)
            try:
                assert_frame_equal(read_table(file, QUALITY), expected)
            except StoreError:
                told += 1
        assert told > 0.75 * len(places)

    @pytest.mark.parametrize("column", [column.name for column in QUALITY.columns])
    def test_a_damaged_name_is_no_column_of_nulls(
        self, file: Path, data: bytes, column: str
    ) -> None:
        """Checksums do not cover the footer."""
        begin = data.index(column.encode(), footer_begin(data))
        for place, bit in itertools.product(range(begin, begin + len(column)), (0, 7)):
            flipped = bytearray(data)
            flipped[place] ^= 1 << bit
            file.write_bytes(flipped)
            with pytest.raises(StoreError):
                read_table(file, QUALITY)

    @pytest.mark.parametrize("length", [0, 3, 4, 100, -1, -4, -8, -100])
    def test_truncated(self, file: Path, data: bytes, length: int) -> None:
        file.write_bytes(data[:length])
        with pytest.raises(StoreError, match=r"2026-01\.parquet of quality") as caught:
            read_table(file, QUALITY)
        assert caught.value.code == "store_read"

    @pytest.mark.parametrize("content", [b"", b"motor_id,night\n", b"PAR1" * 100, bytes(500)])
    def test_something_else(self, file: Path, content: bytes) -> None:
        file.write_bytes(content)
        with pytest.raises(StoreError):
            read_table(file, QUALITY)

    @pytest.mark.parametrize("content", ["junk", "other types"])
    def test_one_of_many_is_told_by_name(self, file: Path, content: str) -> None:
        output = file.parents[3]
        path = night_file(output, QUALITY, LATER)
        path.parent.mkdir()
        if content == "junk":
            path.write_bytes(b"junk")
        else:
            pl.DataFrame({"motor_id": ["M001"], "night": ["today"]}).write_parquet(path)
        with pytest.raises(StoreError, match=r"2026-02\.parquet of quality is") as raised:
            read_rows(output, QUALITY, ["M001"])
        assert raised.value.code == "store_read"

    def test_absent(self, tmp_path: Path) -> None:
        with pytest.raises(StoreError):
            read_table(tmp_path / "2026-01-02.parquet", QUALITY)

    def test_a_file_of_a_newer_version_is_refused_and_stays(
        self, tmp_path: Path, file: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        before = file.read_bytes()
        monkeypatch.setattr(tables, "SCHEMA_VERSION", 0)
        with pytest.raises(StoreError) as refused:
            publish_night(tmp_path, {"A": [row("A")]})
        assert refused.value.code == "store_newer"
        assert file.read_bytes() == before


class TestSchema:
    def test_order_and_types(self, file: Path) -> None:
        found = read_table(file, QUALITY)
        assert dict(found.schema) == {
            name: kind if isinstance(kind, pl.DataType) else kind()
            for name, kind in QUALITY.schema.items()
        }
        assert found.columns == [column.name for column in QUALITY.columns]

    def test_column_that_an_older_file_has_not(self, tmp_path: Path) -> None:
        """Columns are only ever added: at its end, or between those there were."""
        older = rows(row("A"), row("B")).drop("n_samples", "run_id")
        path = tmp_path / "old.parquet"
        write_table(path, older)
        found = read_table(path, QUALITY)
        assert found.columns == list(QUALITY.schema)
        assert found["n_samples"].dtype == pl.Int64
        assert found["n_samples"].null_count() == found["run_id"].null_count() == 2
        assert_frame_equal(found.select(older.columns), older)

    def test_older_file_takes_new_rows(self, tmp_path: Path) -> None:
        path = night_file(tmp_path, QUALITY, NIGHT)
        write_table(path, rows(row("A"), row("B")).drop("n_samples"))
        publish_night(tmp_path, {"B": [row("B", refused=7)]})
        found = read_table(path, QUALITY)
        assert found["n_samples"].to_list() == [None, 864_000]

    @pytest.mark.parametrize("name", QUALITY.key)
    def test_file_without_a_key_column_is_none_of_ours(self, tmp_path: Path, name: str) -> None:
        path = tmp_path / "no_key.parquet"
        write_table(path, rows(row("A")).drop(name))
        with pytest.raises(StoreError, match=f"key \\({name}\\).*`fit-fleet --force`"):
            read_table(path, QUALITY)

    def test_column_of_a_newer_version_is_not_dropped_silently(self, tmp_path: Path) -> None:
        path = tmp_path / "newer.parquet"
        write_table(path, rows(row("A")).with_columns(later=1))
        with pytest.raises(StoreError, match="later"):
            read_table(path, QUALITY)

    @pytest.mark.parametrize("table", TABLES, ids=[table.name for table in TABLES])
    def test_every_table_survives_the_disk(self, tmp_path: Path, table: Table) -> None:
        whole = frame(table, [example(table), dict.fromkeys(table.key, None)])
        write_table(tmp_path / "t.parquet", whole)
        assert_frame_equal(read_table(tmp_path / "t.parquet", table), whole)
