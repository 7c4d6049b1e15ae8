"""Staged rows of motors, and the nights that are put together from them."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from pathlib import Path

import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st
from polars.testing import assert_frame_equal

from pipeline.errors import StoreError
from pipeline.schema import BLOCK_STATISTICS, NIGHT_TABLES, QUALITY, TREND_TABLES, Table, frame
from pipeline.store.night_files import StagedRows, new_rows, stage
from pipeline.store.tables import night_file, read_table
from tests.pipeline.store.made_rows import LATER, NIGHT, Row, example, publish_night, row, rows


def rows_of(staged: StagedRows, night: dt.date, table: Table = QUALITY) -> pl.DataFrame | None:
    """Staged rows of a motor's night; None where it was not staged."""
    found = dict(new_rows(table, {"A": staged}, [night], "run")).get(night)
    return None if found is None else pl.concat(found.pieces)


class TestStaged:
    def staged(
        self, tmp_path: Path, nights: Mapping[dt.date, list[Row]], table: Table = QUALITY
    ) -> StagedRows:
        path = tmp_path / "staging" / "nights" / "A.arrow"
        path.parent.parent.mkdir()
        stage(path, {table: nights})
        return StagedRows(path)

    @given(
        st.dictionaries(
            st.dates(dt.date(2026, 1, 1), dt.date(2026, 3, 1)),
            st.integers(0, 3),
            min_size=1,
            max_size=8,
        )
    )
    def test_nights_without_rows_keep_their_place(
        self, tmp_path_factory: pytest.TempPathFactory, sizes: dict[dt.date, int]
    ) -> None:
        nights = {
            night: [row("A", str(one), night.toordinal(), night) for one in range(size)]
            for night, size in sizes.items()
        }
        staged = self.staged(tmp_path_factory.mktemp("staged"), nights)
        assert list(staged.heights[QUALITY.name].items()) == sorted(sizes.items())
        for night, expected in nights.items():
            found = rows_of(staged, night)
            assert found is not None
            assert_frame_equal(found, rows(*expected, run_id="run"))

    @pytest.mark.parametrize("nights", [[NIGHT, LATER], [LATER]])
    def test_more_motors_than_are_read_together(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, nights: list[dt.date]
    ) -> None:
        """The rows of a night come sorted by its key, with motors that have none."""
        monkeypatch.setattr("pipeline.store.night_files.MOTORS_AT_ONCE", 2)
        staged = {}
        for motor_id, reasons in {"D": "b", "B": "ba", "A": "", "E": "a", "C": "a"}.items():
            path = tmp_path / "nights" / f"{motor_id}.arrow"
            some = [
                row(motor_id, reason, night=night) for night in (LATER, NIGHT) for reason in reasons
            ]
            by_night = {n: [one for one in some if one["night"] == n] for n in (LATER, NIGHT)}
            stage(path, {QUALITY: by_night})
            staged[motor_id] = StagedRows(path)
        found = {n: (one, list(one.pieces)) for n, one in new_rows(QUALITY, staged, nights, "run")}
        for night in nights:
            one, pieces = found[night]
            assert sorted(one.motor_ids) == list("ABCDE")
            keys = pl.concat(pieces).select(QUALITY.key).rows()
            assert one.height == len(keys)
            assert [(one[0], one[3]) for one in keys] == [
                ("B", "a"), ("B", "b"), ("C", "a"), ("D", "b"), ("E", "a")
            ]  # fmt: skip
            assert {one[1] for one in keys} == {night}

    def test_a_night_that_only_some_tables_have(self, tmp_path: Path) -> None:
        path = tmp_path / "nights" / "A.arrow"
        block = {"motor_id": "A", "night": LATER}
        stage(path, {QUALITY: {NIGHT: [row("A")]}, BLOCK_STATISTICS: {NIGHT: [], LATER: [block]}})
        staged = StagedRows(path)
        assert staged.heights == {
            "quality": {NIGHT: 1},
            "block_statistics": {NIGHT: 0, LATER: 1},
        }
        assert rows_of(staged, LATER) is None
        found = rows_of(staged, LATER, BLOCK_STATISTICS)
        assert found is not None
        assert found["night"].to_list() == [LATER]

    def test_keys_begin_with_the_motor(self) -> None:
        """So that motors which are put together one after the other are sorted."""
        assert {table.key[0] for table in (*NIGHT_TABLES, *TREND_TABLES)} == {"motor_id"}

    def test_a_worker_that_outlives_its_run_leaves_nothing(self, tmp_path: Path) -> None:
        """The run's folder is gone: the worker must not make it anew."""
        with pytest.raises(StoreError, match="cannot be staged"):
            stage(tmp_path / "gone" / "nights" / "A.arrow", {QUALITY: {NIGHT: []}})
        assert list(tmp_path.iterdir()) == []

    def test_more_motors_than_a_process_may_open_files(self, tmp_path: Path) -> None:
        staged = self.staged(tmp_path, {NIGHT: [row("A")]})
        before = len(list(Path("/proc/self/fd").iterdir()))
        kept = [StagedRows(tmp_path / "staging" / "nights" / "A.arrow") for _ in range(5)]
        found = [rows_of(one, NIGHT) for one in kept]
        assert len(list(Path("/proc/self/fd").iterdir())) == before
        for one in found:
            assert one is not None
            assert_frame_equal(one, rows_of(staged, NIGHT))

    def test_night_that_was_not_done(self, tmp_path: Path) -> None:
        assert rows_of(self.staged(tmp_path, {NIGHT: []}), LATER) is None

    @pytest.mark.parametrize("table", NIGHT_TABLES, ids=[table.name for table in NIGHT_TABLES])
    def test_every_type_survives_to_the_table(self, tmp_path: Path, table: Table) -> None:
        one = {name: value for name, value in example(table).items() if name != "run_id"}
        staged = self.staged(tmp_path, {NIGHT: [one], LATER: []}, table)
        found, empty = rows_of(staged, NIGHT, table), rows_of(staged, LATER, table)
        assert found is not None
        assert empty is not None
        publish_night(tmp_path, table, NIGHT, {"A": found, "B": empty}, "run")
        expected = frame(table, [{**one, "run_id": "run"}])
        assert_frame_equal(read_table(night_file(tmp_path, table, NIGHT), table), expected)

    def test_rows_outlive_the_staging_folder(self, tmp_path: Path) -> None:
        """They are read lazily from a map of the file, which the run removes at its end."""
        staged = self.staged(tmp_path, {NIGHT: [row("A"), row("A", "spike")]})
        found = rows_of(staged, NIGHT)
        (tmp_path / "staging" / "nights" / "A.arrow").unlink()
        assert found is not None
        assert found["reason"].to_list() == ["gap", "spike"]

    def test_long_statistics(self, tmp_path: Path) -> None:
        """A night of 96 blocks with their factors."""
        begin = dt.datetime(2026, 1, 1, 6, tzinfo=dt.UTC)
        blocks = [
            {
                "motor_id": "A",
                "night": NIGHT,
                "block_start": begin + dt.timedelta(minutes=15 * number),
                "statistics": [number + place / 7 for place in range(21)],
            }
            for number in range(96)
        ]
        found = rows_of(
            self.staged(tmp_path, {NIGHT: blocks}, BLOCK_STATISTICS), NIGHT, BLOCK_STATISTICS
        )
        assert found is not None
        assert found["statistics"].to_list() == [block["statistics"] for block in blocks]
