"""Tables on disk: whole or not at all; damage and strange schemas are reported."""

from __future__ import annotations

import errno
import itertools
import struct
from pathlib import Path
from typing import BinaryIO

import polars as pl
import pyarrow.parquet as pq
import pytest
from polars.testing import assert_frame_equal

from pipeline.errors import StoreError
from pipeline.schema import (
    BLOCKS,
    NIGHTLY_TABLES,
    PREDICTIONS,
    QUALITY,
    RESIDUAL_TESTS,
    SCHEMA_VERSION,
)
from pipeline.store.atomic_files import put
from pipeline.store.tables import files_of, nights_back, read_rows, read_table, table_folder
from tests.pipeline.store.made_rows import LATER, NIGHT, all_files, row, rows
from tests.pipeline.written import night_file, write_table


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = night_file(tmp_path, QUALITY, NIGHT)
    write_table(path, rows(*(row(f"M{number:03}", refused=number) for number in range(200))))
    return path


class TestLayout:
    def test_a_file_a_month_or_a_night_where_rows_are_many(self, tmp_path: Path) -> None:
        month = Path("month=2026-01")
        for table, name in ((QUALITY, "2026-01"), (BLOCKS, "2026-01-02")):
            path = table_folder(tmp_path, table) / month / f"{name}.parquet"
            assert night_file(tmp_path, table, NIGHT) == path
        assert NIGHTLY_TABLES == (PREDICTIONS, BLOCKS, RESIDUAL_TESTS)

    def test_written_so_that_every_reader_can(self, file: Path) -> None:
        """Texts alone have a dictionary; modes are for all users."""
        parts = pq.ParquetFile(file)
        group = parts.metadata.row_group(0)
        columns = [group.column(place) for place in range(group.num_columns)]
        assert {column.compression for column in columns} == {"ZSTD"}
        texts = {column.path_in_schema for column in columns if column.has_dictionary_page}
        assert texts == {"motor_id", "channel", "reason", "run_id"}
        stated = parts.metadata.metadata[b"motor_leakage_schema_version"]
        assert int(stated) == SCHEMA_VERSION
        assert file.stat().st_mode & 0o777 == 0o644

    def test_rows_of_a_motor_are_found_in_whichever_groups_they_stand(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr("pipeline.store.tables.ROWS_A_GROUP", 2)
        some = rows(*(row(motor, reason) for motor in "ABC" for reason in "xyz"))
        write_table(night_file(tmp_path, QUALITY, NIGHT), some)
        for motor in "ABC":
            found = read_rows(tmp_path, QUALITY, [motor], ("reason",), nights=[NIGHT])
            assert found["reason"].to_list() == ["x", "y", "z"]

    def test_a_file_that_is_no_night_s_holds_no_rows(self, file: Path, tmp_path: Path) -> None:
        later = night_file(tmp_path, QUALITY, LATER)
        write_table(later, rows(row("M000", night=LATER)))
        for stranger in (
            "stray.parquet",
            "month=2026-01/2026-01 (1).parquet",
            "month=2026-01/20260103.parquet",
            "month=2026-01/2026-13-01.parquet",
            "month=2026-01/2026-03-01.parquet",
            "month=copy/2026-03-01.parquet",
            "month=2026-99/x.parquet",
        ):
            path = table_folder(tmp_path, QUALITY) / stranger
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(file.read_bytes())
        assert files_of(tmp_path, QUALITY) == [file, later]
        assert files_of(tmp_path, QUALITY, [LATER]) == [later]
        assert list(nights_back(tmp_path, QUALITY)) == [LATER, NIGHT]
        assert read_rows(tmp_path, QUALITY, ["M000"])["night"].to_list() == [NIGHT, LATER]


class TestWhole:
    """A failed write leaves the old file whole and nothing else."""

    @pytest.mark.parametrize(
        "fault",
        [
            OSError(errno.ENOSPC, "No space left on device"),
            ValueError("a fault"),
            KeyboardInterrupt(),
            MemoryError(),
        ],
        ids=repr,
    )
    def test_write_that_fails(self, file: Path, fault: BaseException) -> None:
        before = file.read_bytes()

        def write(stream: BinaryIO) -> None:
            stream.write(b"PAR1 half of a table")
            stream.flush()
            raise fault

        is_coded = isinstance(fault, OSError)
        with pytest.raises(StoreError if is_coded else type(fault)) as caught:
            put(file, write)
        assert file.read_bytes() == before
        assert all_files(file.parent) == [file.name]
        if is_coded:
            error = caught.value
            assert isinstance(error, StoreError)
            assert error.code == "store_write"
            assert file.name in error.message
            assert "No space left on device" in error.message


def footer_begin(data: bytes) -> int:
    (length,) = struct.unpack("<I", data[-8:-4])
    return len(data) - 8 - int(length)


class TestDamage:
    @pytest.fixture
    def data(self, file: Path) -> bytes:
        return file.read_bytes()

    def test_every_flipped_bit_of_the_pages_is_detected(self, file: Path, data: bytes) -> None:
        """Or lies where it means nothing: never other rows."""
        expected = read_table(file, QUALITY)
        detected = 0
        places = range(0, 8 * footer_begin(data), 7)
        for place in places:
            flipped = bytearray(data)
            flipped[place // 8] ^= 1 << place % 8
            file.write_bytes(flipped)
            try:
                assert_frame_equal(read_table(file, QUALITY), expected)
            except StoreError:
                detected += 1
        assert detected > 0.75 * len(places)

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
        with pytest.raises(StoreError):
            read_table(file.with_name("absent"), QUALITY)
        file.write_bytes(data[:length] or b"PAR1" * 100)
        with pytest.raises(StoreError, match=r"2026-01\.parquet of quality") as caught:
            read_table(file, QUALITY)
        assert caught.value.code == "store_read"


class TestSchema:
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

    @pytest.mark.parametrize("name", QUALITY.key)
    def test_file_without_a_key_column_is_none_of_ours(self, tmp_path: Path, name: str) -> None:
        path = tmp_path / "no_key.parquet"
        write_table(path, rows(row("A")).drop(name))
        with pytest.raises(StoreError, match=f"key \\({name}\\).*`fit-fleet --redo NIGHTS`"):
            read_table(path, QUALITY)

    def test_column_of_a_newer_version_is_not_dropped_silently(self, tmp_path: Path) -> None:
        path = tmp_path / "newer.parquet"
        write_table(path, rows(row("A")).with_columns(later=1))
        with pytest.raises(StoreError, match="later"):
            read_table(path, QUALITY)
