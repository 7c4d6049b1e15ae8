"""Rows of motors as they are staged, and the files of tables that are made of them."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import duckdb
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from polars.testing import assert_frame_equal

from pipeline.errors import StoreError
from pipeline.schema import BLOCKS, LOG_FILES, NIGHT_TABLES, QUALITY, TABLES, Table, frame
from pipeline.store.published import note, verify_tables
from pipeline.store.publishing import VIEWS, stage, write_views
from pipeline.store.state import open_state
from pipeline.store.tables import files_of, read_rows, read_table, table_folder
from tests.pipeline.calling import contents, refused
from tests.pipeline.store.made_rows import LATER, NIGHT, Row, example, publish, publish_night, row
from tests.pipeline.written import night_file

MOTORS = st.sampled_from(["A", "AB", "B", "C"])
NIGHTS = tuple(dt.date(2026, 1, day) for day in (3, 4, 9, 31))


def published(output: Path) -> list[tuple[str, str, int, str]]:
    found = read_table(night_file(output, QUALITY, NIGHT), QUALITY)
    return [tuple(row) for row in found.select("motor_id", "reason", "n_refused", "run_id").rows()]


class TestStaged:
    @pytest.mark.parametrize("table", NIGHT_TABLES, ids=[table.name for table in NIGHT_TABLES])
    def test_every_type_survives_to_the_table(self, tmp_path: Path, table: Table) -> None:
        content = {name: value for name, value in example(table).items() if name != "run_id"}
        publish(tmp_path, {"A": {table: {NIGHT: [content], LATER: []}}}, "run")
        (path,) = files_of(tmp_path, table)
        expected = frame(table, [{**content, "run_id": "run"}])
        assert_frame_equal(read_table(path, table), expected)

    def test_a_worker_that_outlives_its_run_leaves_nothing(self, tmp_path: Path) -> None:
        """The run's folder is gone: the worker must not make it anew."""
        with pytest.raises(StoreError, match="cannot be staged"):
            stage(tmp_path / "gone" / "nights" / "A.arrow", {QUALITY: {NIGHT: []}})
        assert list(tmp_path.iterdir()) == []


class TestRows:
    @settings(max_examples=12)
    @given(
        st.lists(
            st.dictionaries(
                st.sampled_from(["A", "AB", "B", "C"]), st.sets(st.sampled_from("xyz")), max_size=4
            ),
            max_size=5,
        )
    )
    def test_any_history_leaves_each_motor_s_last_rows(
        self, tmp_path_factory: pytest.TempPathFactory, history: list[dict[str, set[str]]]
    ) -> None:
        output = tmp_path_factory.mktemp("history")
        last: dict[str, tuple[int, set[str]]] = {}
        for number, change in enumerate(history):
            staged = {m: [row(m, reason) for reason in some] for m, some in change.items()}
            publish_night(output, staged, f"{number}")
            last |= {motor: (number, some) for motor, some in change.items()}
        expected = sorted(
            (motor, reason, 1, str(number))
            for motor, (number, some) in last.items()
            for reason in some
        )
        exists = night_file(output, QUALITY, NIGHT).exists()
        assert exists == any(some for change in history for some in change.values())
        assert (published(output) if exists else []) == expected

    @settings(max_examples=4)
    @given(st.permutations([(motor, night) for motor in "ABC" for night in NIGHTS]), st.data())
    def test_bytes_do_not_tell_in_what_order_and_how_many_runs_they_were_made(
        self,
        tmp_path_factory: pytest.TempPathFactory,
        order: list[tuple[str, dt.date]],
        data: st.DataObject,
    ) -> None:
        """Row groups of two rows: their borders are the same as well."""
        folder = tmp_path_factory.mktemp("runs")

        def rows(motor: str, nights: list[dt.date]) -> dict[Table, dict[dt.date, list[Row]]]:
            reasons = data.draw(st.permutations("ab"))
            return {
                QUALITY: {n: [row(motor, reason, night=n) for reason in reasons] for n in nights},
                BLOCKS: {n: [{"motor_id": motor, "night": n}] for n in nights},
            }

        with pytest.MonkeyPatch.context() as patched:
            patched.setattr("pipeline.store.tables.ROWS_A_GROUP", 2)
            publish(folder / "at once", {motor: rows(motor, list(NIGHTS)) for motor in "ABC"})
            while order:
                count = data.draw(st.integers(1, len(order)))
                now, order = order[:count], order[count:]
                done = {motor: [n for of, n in now if of == motor] for motor, _ in now}
                publish(folder / "in turn", {motor: rows(motor, n) for motor, n in done.items()})
        assert contents(folder / "at once" / "tables") == contents(folder / "in turn" / "tables")

    def test_a_key_without_the_night_is_never_there_twice(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """A log that moves to another month, either way, or to another night of its own."""
        seen: list[pl.DataFrame] = []
        replace = Path.replace

        def watched(path: Path, place: Path) -> None:
            replace(path, place)
            seen.append(read_rows(tmp_path, LOG_FILES, ["A"]))

        monkeypatch.setattr(Path, "replace", watched)
        for moved_to in (NIGHTS[0], LATER, NIGHTS[1], None, NIGHTS[0]):
            logs = {n: [{"motor_id": "A", "path": str(n), "night": n}] for n in (*NIGHTS, LATER)}
            moving = {"motor_id": "A", "path": "moving", "night": moved_to}
            logs[moved_to or NIGHTS[0]].append(moving)
            publish(tmp_path, {"A": {LOG_FILES: logs}})
            assert sorted(seen[-1]["path"]) == sorted([*map(str, (*NIGHTS, LATER)), "moving"])
        assert all(rows["path"].is_unique().all() for rows in seen)

    def test_what_is_remembered_is_noted_once_with_the_last_files(self, tmp_path: Path) -> None:
        n_files: list[int] = []

        def note_state() -> None:
            n_files.append(len(files_of(tmp_path, QUALITY)))

        nights = {night: [row("A", night=night)] for night in (NIGHT, LATER)}
        publish(tmp_path, {"A": {QUALITY: nights}}, published=note_state)
        publish(tmp_path, {}, published=note_state)
        assert n_files == [2, 2]


class TestRefused:
    """What is there is no sound file: the run ends, and the next one mends it."""

    @pytest.mark.parametrize("is_listed", [True, False])
    def test_damage_is_set_aside_for_the_next_run(self, tmp_path: Path, is_listed: bool) -> None:
        path = night_file(tmp_path, QUALITY, NIGHT)
        if is_listed:
            publish_night(tmp_path, {m: [row(m)] for m in "AB"})
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"something else")
        # The second time it is gone, and the nights of a listed file are still to be forgotten.
        for _ in range(2 if is_listed else 1):
            with refused("store_read", "2026-01.parquet of quality is"):
                publish_night(tmp_path, {"A": [row("A", "x")]})
            assert [file.read_bytes() for file in path.parent.iterdir()] == [b"something else"]
            assert not path.exists()
        with open_state(tmp_path) as state:
            note(state, {path.relative_to(tmp_path / "tables").as_posix(): None})
        publish_night(tmp_path, {"A": [row("A")]})
        assert [entry[0] for entry in published(tmp_path)] == ["A"]

    def test_a_failure_leaves_what_was_there(self, tmp_path: Path) -> None:
        def rows(night: dt.date) -> dict[Table, dict[dt.date, list[Row]]]:
            blocks = [{"motor_id": "A", "night": night}]
            return {QUALITY: {night: [row("A", night=night)]}, BLOCKS: {night: blocks}}

        publish(tmp_path, {"A": rows(NIGHT)})
        in_the_way = table_folder(tmp_path, BLOCKS) / "month=2026-02"
        in_the_way.touch()
        before = contents(tmp_path / "tables")
        with pytest.raises(StoreError, match="there is a file in the way"):
            publish(tmp_path, {"A": rows(LATER)})
        assert contents(tmp_path / "tables") == before
        in_the_way.unlink()
        publish(tmp_path, {"A": rows(LATER)})
        assert list(verify_tables(tmp_path)) == []


def opened(output: Path, monkeypatch: pytest.MonkeyPatch) -> duckdb.DuckDBPyConnection:
    """As `duckdb -init views.sql` in the output folder."""
    monkeypatch.chdir(output)
    connection = duckdb.connect()
    connection.execute(Path(VIEWS).read_text("utf-8"))
    return connection


def test_views_on_an_empty_output(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for _ in range(2):
        write_views(tmp_path)
    with opened(tmp_path, monkeypatch) as connection:
        for table in TABLES:
            view = connection.table(table.name)
            assert (view.columns, view.fetchall()) == (list(table.schema), [])
        asked = "SELECT column_name, comment FROM duckdb_columns() WHERE comment IS NOT NULL"
        words = dict(connection.execute(asked).fetchall())
    assert words["training_rmse_l_per_min"].endswith(" samples [l/min]")
    assert words["is_primary"].endswith(" a night")


def test_types_of_an_empty_view_are_those_of_its_files(
    tmp_path: Path, fitted_output: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_views(tmp_path)
    with opened(tmp_path, monkeypatch) as empty, opened(fitted_output, monkeypatch) as full:
        for table in TABLES:
            assert empty.table(table.name).types == full.table(table.name).types, table.name
