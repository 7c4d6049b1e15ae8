"""The state file: whole transactions, and what is done where it is lost."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path

import pytest

from pipeline.errors import StoreError
from pipeline.store.state import (
    STATE_FILE,
    is_sound,
    make_ready,
    open_state,
    read_state_file,
)


def keep(output: Path, value: str) -> None:
    with open_state(output) as state:
        state.set_meta("value", value)


def kept(output: Path) -> str:
    with read_state_file(output) as state:
        return state.meta("value")


def test_a_transaction_is_done_or_not(tmp_path: Path) -> None:
    keep(tmp_path, "before")
    with open_state(tmp_path) as state:
        with pytest.raises(KeyboardInterrupt), state.transaction():  # noqa: PT012
            state.set_meta("value", "after")
            with state.transaction():  # a part of the other
                state.set_meta("other", "after")
            raise KeyboardInterrupt
        assert (state.meta("value"), state.meta("other")) == ("before", "")
        with state.transaction():
            state.set_meta("value", "after")
            assert kept(tmp_path) == "before"
    assert kept(tmp_path) == "after"


def test_what_cannot_be_written_says_so(tmp_path: Path) -> None:
    keep(tmp_path, "before")
    with open_state(tmp_path) as state, pytest.raises(StoreError, match="cannot be written"):
        state.write_all("INSERT INTO meta VALUES (?, ?)", [("new", "x"), ("value", "twice")])
    with read_state_file(tmp_path) as state, pytest.raises(StoreError, match="cannot be written"):
        state.set_meta("value", "by a reader")
    assert kept(tmp_path) == "before"
    with read_state_file(tmp_path) as state:
        assert state.rows("SELECT count(*) FROM meta") == [(1,)]


def test_a_reader_makes_nothing(tmp_path: Path) -> None:
    assert kept(tmp_path / "out") == ""
    assert list(tmp_path.iterdir()) == []


def test_one_of_a_newer_version_is_left_alone(tmp_path: Path) -> None:
    keep(tmp_path, "before")
    with sqlite3.connect(tmp_path / STATE_FILE) as connection:
        connection.execute("PRAGMA user_version = 99")
    connection.close()
    content = (tmp_path / STATE_FILE).read_bytes()
    for use in (kept, lambda output: keep(output, "after")):
        with pytest.raises(StoreError, match="update the program") as caught:
            use(tmp_path)
        assert caught.value.code == "store_newer"
    assert (tmp_path / STATE_FILE).read_bytes() == content


def junk(path: Path) -> None:
    content = path.read_bytes()
    path.write_bytes(content[:5000] + bytes(9000) + content[14000:])


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-5000])


@pytest.mark.parametrize("harm", [junk, cut, Path.unlink])
def test_a_lost_one_is_made_anew(
    tmp_path: Path, harm: Callable[[Path], object], caplog: pytest.LogCaptureFixture
) -> None:
    make_ready(tmp_path)
    keep(tmp_path, "before")
    make_ready(tmp_path)
    assert caplog.text == ""
    (tmp_path / "tables").mkdir()
    harm(tmp_path / STATE_FILE)
    assert is_sound(tmp_path) is (harm is Path.unlink)
    make_ready(tmp_path)
    assert "state.db is" in caplog.text
    assert kept(tmp_path) == ""
    assert is_sound(tmp_path)


def test_what_a_killed_process_left_in_its_log_is_taken_over(tmp_path: Path) -> None:
    """The main file alone is not the state: SQLite has a log beside it."""
    with open_state(tmp_path) as state:
        state.set_meta("value", "in the log")
        shutil.copytree(tmp_path, tmp_path / "killed", ignore=shutil.ignore_patterns("killed"))
    assert (tmp_path / "killed" / f"{STATE_FILE}-wal").stat().st_size > 0
    make_ready(tmp_path / "killed")
    assert kept(tmp_path / "killed") == "in the log"
