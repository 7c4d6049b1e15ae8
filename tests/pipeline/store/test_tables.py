"""Tables on disk: whole or not at all; rows of others stay."""

from __future__ import annotations

import datetime as dt
import errno
import os
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import BinaryIO

import duckdb
import polars as pl
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from polars.testing import assert_frame_equal

from pipeline.errors import StoreError
from pipeline.schema import (
    BLOCK_STATISTICS,
    INPUT_FILES,
    NIGHTLY_TABLES,
    PREDICTIONS,
    QUALITY,
    RESIDUAL_TESTS,
    RUNS,
    SCHEMA_VERSION,
    Table,
)
from pipeline.store.atomic_files import TEMPORARY_PREFIX, put, remove_leftovers
from pipeline.store.encoding import ROWS_A_GROUP, prepare_table, write_table
from pipeline.store.night_files import stage
from pipeline.store.published import is_called_as_ours, verify_tables
from pipeline.store.publishing import Publisher
from pipeline.store.tables import (
    files_of,
    month_stamps,
    night_file,
    nights_back,
    read_rows,
    read_table,
    table_folder,
)
from tests.pipeline.store.made_rows import (
    LATER,
    NIGHT,
    Row,
    all_files,
    new,
    publish_night,
    row,
    rows,
)
from tests.pipeline.written import publisher_of


def published(output: Path, night: dt.date = NIGHT) -> list[tuple[str, str, int, str]]:
    found = read_table(night_file(output, QUALITY, night), QUALITY)
    return [tuple(one) for one in found.select("motor_id", "reason", "n_refused", "run_id").rows()]


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

    def test_a_night_of_many_rows_is_written_in_pieces(self, tmp_path: Path) -> None:
        path = tmp_path / "t.parquet"
        many = pl.concat([rows(row("M1")), *[rows(row("M2"))] * 40_000])
        digest = write_table(path, many)
        footer = pq.read_metadata(path)
        sizes = [footer.row_group(place).num_rows for place in range(footer.num_row_groups)]
        assert set(sizes[:-1]) == {ROWS_A_GROUP}
        pieces = [many.head(5), many.head(0), many.slice(5, 9000), many.slice(9005)]
        prepared = prepare_table(path, pieces)
        prepared.drop()
        assert prepared.sha256 == digest
        assert_frame_equal(read_table(path, QUALITY), many)

    def test_an_analyst_s_plain_read_sees_each_row(self, tmp_path: Path) -> None:
        for night in (NIGHT, LATER):
            publish_night(tmp_path, QUALITY, night, {"A": new(row("A", night=night))}, "run")
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
        assert month_stamps(tmp_path, QUALITY).keys() == {"2026-01", "2026-02"}


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

    @pytest.mark.parametrize("step", ["open", "fchmod", "write", "fsync", "pread", "replace"])
    def test_any_later_step_that_fails(
        self, file: Path, monkeypatch: pytest.MonkeyPatch, step: str
    ) -> None:
        before = file.read_bytes()

        def fail(*_: object, **__: object) -> None:
            raise OSError(errno.EIO, "Input/output error")

        some = rows(row("X"))
        monkeypatch.setattr(os, step, fail)
        with pytest.raises(StoreError):
            write_table(file, some)
        monkeypatch.undo()
        assert file.read_bytes() == before
        assert all_files(file.parent) == [file.name]

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


class TestPublish:
    def test_rows_of_other_motors_stay(self, tmp_path: Path) -> None:
        publish_night(tmp_path, QUALITY, NIGHT, {m: new(row(m)) for m in "ABC"}, "one")
        publish_night(tmp_path, QUALITY, NIGHT, {"B": new(row("B", refused=9))}, "two")
        assert published(tmp_path) == [
            ("A", "gap", 1, "one"),
            ("B", "gap", 9, "two"),
            ("C", "gap", 1, "one"),
        ]

    def test_all_rows_of_a_redone_motor_are_replaced(self, tmp_path: Path) -> None:
        before = new(row("A", "gap"), row("A", "spike"), row("A", "any"))
        publish_night(tmp_path, QUALITY, NIGHT, {"A": before, "B": new(row("B"))}, "one")
        publish_night(tmp_path, QUALITY, NIGHT, {"A": new(row("A", "frozen"))}, "two")
        assert published(tmp_path) == [("A", "frozen", 1, "two"), ("B", "gap", 1, "one")]

    def test_motor_without_rows_loses_those_it_had(self, tmp_path: Path) -> None:
        publish_night(tmp_path, QUALITY, NIGHT, {m: new(row(m)) for m in "AB"}, "one")
        publish_night(tmp_path, QUALITY, NIGHT, {"A": new()}, "two")
        assert published(tmp_path) == [("B", "gap", 1, "one")]

    def test_file_keeps_its_place_without_rows(self, tmp_path: Path) -> None:
        """A reader who has just listed it must not find it gone."""
        publish_night(tmp_path, QUALITY, NIGHT, {"A": new()}, "one")
        assert all_files(tmp_path) == []
        publish_night(tmp_path, QUALITY, NIGHT, {"A": new(row("A"))}, "two")
        publish_night(tmp_path, QUALITY, NIGHT, {"A": new()}, "three")
        assert all_files(tmp_path) == ["2026-01.parquet"]
        assert published(tmp_path) == []
        pattern = (table_folder(tmp_path, QUALITY) / "**" / "*.parquet").as_posix()
        with duckdb.connect() as analyst:
            assert analyst.read_parquet(pattern).fetchall() == []

    def test_nothing_staged_changes_nothing(self, tmp_path: Path) -> None:
        publish_night(tmp_path, QUALITY, NIGHT, {"A": new(row("A"))}, "one")
        publish_night(tmp_path, QUALITY, NIGHT, {}, "two")
        assert published(tmp_path) == [("A", "gap", 1, "one")]

    def test_motor_whose_name_begins_another_s(self, tmp_path: Path) -> None:
        both = {"CB560-1": new(row("CB560-1")), "CB560-10": new(row("CB560-10"))}
        publish_night(tmp_path, QUALITY, NIGHT, both, "one")
        publish_night(tmp_path, QUALITY, NIGHT, {"CB560-1": new()}, "two")
        assert [one[0] for one in published(tmp_path)] == ["CB560-10"]

    @given(
        st.lists(
            st.dictionaries(st.sampled_from("ABCD"), st.sets(st.sampled_from("xyz")), max_size=4),
            max_size=5,
        )
    )
    def test_any_history_leaves_each_motor_s_last_rows(
        self, tmp_path_factory: pytest.TempPathFactory, history: list[dict[str, set[str]]]
    ) -> None:
        output = tmp_path_factory.mktemp("history")
        last: dict[str, tuple[int, set[str]]] = {}
        for number, change in enumerate(history):
            staged = {m: new(*(row(m, one) for one in some)) for m, some in change.items()}
            publish_night(output, QUALITY, NIGHT, staged, str(number))
            last |= {motor: (number, some) for motor, some in change.items()}
        expected = sorted(
            (motor, reason, 1, str(number))
            for motor, (number, some) in last.items()
            for reason in some
        )
        exists = night_file(output, QUALITY, NIGHT).exists()
        assert exists == any(some for change in history for some in change.values())
        assert (published(output) if exists else []) == expected

    @settings(max_examples=30)
    @given(st.permutations([row(m, r) for m in "ABC" for r in ("gap", "spike", "any")]))
    def test_same_rows_same_bytes(
        self, tmp_path_factory: pytest.TempPathFactory, some: list[Row]
    ) -> None:
        """Whatever the order in which motors and rows came."""
        output = tmp_path_factory.mktemp("bytes")
        staged: dict[str, list[Row]] = {}
        for one in some:
            staged.setdefault(one["motor_id"], []).append(one)
        publish_night(output, QUALITY, NIGHT, {m: new(*r) for m, r in staged.items()}, "run")
        other = output / "other"
        for motor in "CAB":
            mine = sorted((one for one in some if one["motor_id"] == motor), key=str)
            publish_night(other, QUALITY, NIGHT, {motor: new(*mine)}, "run")
        written = [night_file(folder, QUALITY, NIGHT).read_bytes() for folder in (output, other)]
        assert written[0] == written[1]

    def test_rewriting_a_file_keeps_its_bytes(self, tmp_path: Path) -> None:
        publish_night(tmp_path, QUALITY, NIGHT, {m: new(row(m)) for m in "AB"}, "run")
        before = night_file(tmp_path, QUALITY, NIGHT).read_bytes()
        publish_night(tmp_path, QUALITY, NIGHT, {"A": new(row("A"))}, "run")
        assert night_file(tmp_path, QUALITY, NIGHT).read_bytes() == before

    def test_runs_of_a_month_follow_each_other(self, tmp_path: Path) -> None:
        """Also two in a microsecond; one that is added again replaces itself."""
        start = dt.datetime(2026, 1, 31, 23, 59, 59, 5, tzinfo=dt.UTC)
        earlier = start - dt.timedelta(1)
        with publisher_of(tmp_path) as publisher:
            for run_id, started in (("b", start), ("a", start), ("b", start), ("c", earlier)):
                publisher.add("2026-01", {RUNS: [{"run_id": run_id, "started_at": started}]})
        found = read_table(table_folder(tmp_path, RUNS) / "month=2026-01" / "2026-01.parquet", RUNS)
        assert found["run_id"].to_list() == ["c", "a", "b"]


NIGHTS = tuple(dt.date(2026, 1, day) for day in (3, 4, 9, 31))


def publish(output: Path, motors: Mapping[str, Iterable[dt.date]], run_id: str = "r") -> Publisher:
    """Publish nights of motors, as a run does."""
    staging = output / "staging" / "run"
    staging.mkdir(parents=True, exist_ok=True)
    for motor, nights in motors.items():
        tables: dict[Table, dict[dt.date, list[Row]]] = {
            QUALITY: {n: [row(motor, one, night=n) for one in ("b", "a")] for n in nights},
            BLOCK_STATISTICS: {n: [{"motor_id": motor, "night": n}] for n in nights},
        }
        stage(staging / "nights" / f"{motor}.arrow", tables)
    with publisher_of(output, run_id, threads=2) as publisher:
        publisher.nights("nights", (QUALITY, BLOCK_STATISTICS), list(motors), lambda *_: None)
    return publisher


def contents(output: Path) -> dict[str, bytes]:
    tables = output / "tables"
    return {path.relative_to(tables).as_posix(): path.read_bytes() for path in tables.rglob("*.*")}


class TestMonths:
    @settings(max_examples=15)
    @given(st.permutations([(motor, night) for motor in "ABC" for night in NIGHTS]), st.data())
    def test_bytes_do_not_tell_how_many_runs_made_them(
        self,
        tmp_path_factory: pytest.TempPathFactory,
        order: list[tuple[str, dt.date]],
        data: st.DataObject,
    ) -> None:
        """Row groups of two rows, and few cells at once: also their borders are the same."""
        folder = tmp_path_factory.mktemp("runs")
        with pytest.MonkeyPatch.context() as patched:
            patched.setattr("pipeline.store.encoding.ROWS_A_GROUP", 2)
            publish(folder / "at once", dict.fromkeys("ABC", NIGHTS))
            patched.setattr("pipeline.store.night_files.CELLS_AT_ONCE", 40)
            patched.setattr("pipeline.store.night_files.MOTORS_AT_ONCE", 2)
            while order:
                count = data.draw(st.integers(1, len(order)))
                now, order = order[:count], order[count:]
                done = {motor: [n for one, n in now if one == motor] for motor, _ in now}
                publish(folder / "one by one", done)
        assert contents(folder / "at once") == contents(folder / "one by one")

    def test_a_night_that_is_made_anew_leaves_the_others(self, tmp_path: Path) -> None:
        publish(tmp_path, {"A": NIGHTS, "B": NIGHTS}, "one")
        publish(tmp_path, {"A": NIGHTS[1:2]}, "two")
        found = read_rows(tmp_path, QUALITY, ["A", "B"])
        assert found.select("night", "motor_id", "reason").rows() == [
            (night, motor, reason) for night in NIGHTS for motor in "AB" for reason in "ab"
        ]
        again = found.filter(run_id="two").select("motor_id", "night").unique().rows()
        assert again == [("A", NIGHTS[1])]
        assert list(nights_back(tmp_path, QUALITY)) == list(NIGHTS[::-1])
        assert read_rows(tmp_path, QUALITY, ["A"], nights=NIGHTS[:1]).height == 2
        assert list(verify_tables(tmp_path)) == []

    def test_a_damaged_month_is_put_aside_and_its_nights_are_forgotten(
        self, tmp_path: Path
    ) -> None:
        publish(tmp_path, {"A": NIGHTS, "B": NIGHTS})
        path = night_file(tmp_path, QUALITY, NIGHT)
        path.write_bytes(path.read_bytes()[:-9])
        forgotten: dict[dt.date, Collection[str]] = {}
        staged = tmp_path / "staging" / "run" / "nights" / "A.arrow"
        stage(staged, {QUALITY: {NIGHTS[0]: [row("A")]}})
        with publisher_of(tmp_path) as publisher:
            publisher.nights(
                "nights", [QUALITY], ["A"], lambda n, keep: forgotten.update(dict.fromkeys(n, keep))
            )
        assert len(forgotten) == 31
        assert {night: keep for night, keep in forgotten.items() if keep} == {NIGHTS[0]: {"A"}}
        assert publisher.damaged == ["quality/month=2026-01/2026-01.parquet"]
        assert path.with_suffix(".damaged").exists()
        assert read_table(path, QUALITY).height == 1

    def test_a_key_without_the_night_is_never_there_twice(self, tmp_path: Path) -> None:
        """A log that moves to another month, either way, or to another night of its own."""
        paths = []
        for moved_to in (NIGHTS[0], LATER, NIGHTS[1], None, NIGHTS[0]):
            staging = tmp_path / "staging" / "run"
            staging.mkdir(parents=True, exist_ok=True)
            logs = {n: [{"motor_id": "A", "path": str(n), "night": n}] for n in (*NIGHTS, LATER)}
            moving = {"motor_id": "A", "path": "moving", "night": moved_to}
            logs[moved_to or NIGHTS[0]].append(moving)
            stage(staging / "nights" / "A.arrow", {INPUT_FILES: logs})
            with publisher_of(tmp_path) as publisher:
                publisher.nights("nights", [INPUT_FILES], ["A"], lambda *_: None)
            paths = read_rows(tmp_path, INPUT_FILES, ["A"])["path"].to_list()
            assert sorted(paths) == sorted([*map(str, (*NIGHTS, LATER)), "moving"])

    def test_a_failure_leaves_what_was_there(self, tmp_path: Path) -> None:
        publish(tmp_path, {"A": NIGHTS[:1]})
        before = contents(tmp_path)
        in_the_way = table_folder(tmp_path, BLOCK_STATISTICS) / "month=2026-02"
        in_the_way.touch()
        with pytest.raises(StoreError):
            publish(tmp_path, {"A": [LATER]})
        assert contents(tmp_path) == before
        in_the_way.unlink()
        publish(tmp_path, {"A": [LATER]})
        assert list(verify_tables(tmp_path)) == []


@pytest.mark.parametrize(
    ("name", "is_ours"),
    [
        ("fits/month=2026-01/2026-01.parquet", True),
        ("predictions/month=2026-01/2026-01-05.parquet", True),
        ("latest/latest.parquet", True),
        ("fits/month=2026-01/2026-02.parquet", False),
        ("fits/month=2026-13/2026-13.parquet", False),
        ("fits/2026-01.parquet", False),
        ("fits/month=2026-01/2026-01.csv", False),
        ("others/month=2026-01/2026-01.parquet", False),
    ],
)
def test_names_under_which_a_run_publishes(tmp_path: Path, name: str, is_ours: bool) -> None:
    assert is_called_as_ours(tmp_path, name) == is_ours
