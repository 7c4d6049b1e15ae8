"""Tables on disk: whole or not at all; rows of others stay."""

from __future__ import annotations

import errno
from pathlib import Path
from typing import BinaryIO

import duckdb
import polars as pl
import pyarrow.parquet as pq
import pytest

from pipeline.errors import StoreError
from pipeline.schema import (
    BLOCK_STATISTICS,
    NIGHTLY_TABLES,
    PREDICTIONS,
    QUALITY,
    RESIDUAL_TESTS,
    SCHEMA_VERSION,
    frame,
)
from pipeline.store.atomic_files import TEMPORARY_PREFIX, put, remove_leftovers
from pipeline.store.tables import (
    ROWS_A_GROUP,
    files_of,
    night_file,
    nights_back,
    read_rows,
    table_folder,
    write_table,
)
from tests.pipeline.store.made_rows import (
    LATER,
    NIGHT,
    all_files,
    row,
    rows,
)


class TestLayout:
    def test_a_file_a_month_or_a_night_where_rows_are_many(self, tmp_path: Path) -> None:
        month = Path("month=2026-01")
        for table, name in ((QUALITY, "2026-01"), (BLOCK_STATISTICS, "2026-01-02")):
            path = table_folder(tmp_path, table) / month / f"{name}.parquet"
            assert night_file(tmp_path, table, NIGHT) == path
        assert NIGHTLY_TABLES == (PREDICTIONS, BLOCK_STATISTICS, RESIDUAL_TESTS)

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

    def test_many_rows_are_written_in_pieces(self, tmp_path: Path) -> None:
        """Of which one without a wanted motor is not read."""
        path = night_file(tmp_path, BLOCK_STATISTICS, NIGHT)
        motors = sorted(f"M{number % 40_000:05}" for number in range(80_000))
        many = [{"motor_id": one, "night": NIGHT, "n": n} for n, one in enumerate(motors)]
        write_table(path, frame(BLOCK_STATISTICS, many))
        footer = pq.read_metadata(path)
        sizes = [footer.row_group(place).num_rows for place in range(footer.num_row_groups)]
        assert set(sizes[:-1]) == {ROWS_A_GROUP}
        assert len(sizes) == 5
        for number in (0, 8191, 8192, 39_999):
            wanted = [f"M{number:05}"]
            found = read_rows(tmp_path, BLOCK_STATISTICS, wanted, ("n",), nights=[NIGHT])
            assert found["n"].to_list() == [2 * number, 2 * number + 1]

    def test_an_analyst_s_plain_read_sees_each_row(self, tmp_path: Path) -> None:
        for night in (NIGHT, LATER):
            write_table(night_file(tmp_path, QUALITY, night), rows(row("A", night=night)))
        pattern = (table_folder(tmp_path, QUALITY) / "**" / "*.parquet").as_posix()
        with duckdb.connect() as analyst:
            found = analyst.read_parquet(pattern).order("night").project("night").fetchall()
        assert found == [(NIGHT,), (LATER,)]
        assert pl.read_parquet(pattern).height == 2

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

        told = isinstance(fault, OSError)
        with pytest.raises(StoreError if told else type(fault)) as caught:
            put(file, write)
        assert file.read_bytes() == before
        assert all_files(file.parent) == [file.name]
        if told:
            error = caught.value
            assert isinstance(error, StoreError)
            assert error.code == "store_write"
            assert file.name in error.message
            assert "No space left on device" in error.message

    def test_folder_that_cannot_be_made(self, tmp_path: Path) -> None:
        (tmp_path / "tables").write_text("in the way")
        with pytest.raises(StoreError):
            write_table(night_file(tmp_path, QUALITY, NIGHT), rows(row("X")))

    def test_what_is_being_written_is_no_table_yet(self, file: Path) -> None:
        """A reader's glob must not see it, and a reader sees the old rows till the end."""
        content, seen = file.read_bytes(), []
        file.write_bytes(b"before")

        def write(stream: BinaryIO) -> None:
            stream.write(content)
            stream.flush()
            # A rename is whole only within a file system.
            (temporary,) = set(file.parent.iterdir()) - {file}
            assert temporary.read_bytes() == content
            seen.append((list(file.parent.glob("*.parquet")), file.read_bytes()))

        put(file, write)
        assert seen == [([file], b"before")]
        assert file.read_bytes() == content

    def test_leftovers_of_a_killed_run(self, file: Path, tmp_path: Path) -> None:
        (file.parent / f"{TEMPORARY_PREFIX}abc").write_bytes(b"half")
        remove_leftovers([tmp_path / "tables", tmp_path / "nowhere"])
        assert all_files(tmp_path) == [file.name]
