"""The state file: whole transactions, a backup, and what is done where it is lost."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from pipeline.errors import StoreError
from pipeline.store.state import (
    BACKUP_FILE,
    DAMAGED_FILE,
    STATE_FILE,
    State,
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
    for use in (kept, make_ready):
        with pytest.raises(StoreError, match="update the program") as caught:
            use(tmp_path)
        assert caught.value.code == "store_newer"
    assert (tmp_path / STATE_FILE).read_bytes() == content


def junk(path: Path) -> None:
    content = path.read_bytes()
    path.write_bytes(content[:5000] + bytes(9000) + content[14000:])


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-5000])


HARMS = [Path.unlink, junk, cut, lambda path: path.write_bytes(b"")]


@pytest.mark.parametrize("harm", HARMS)
def test_a_lost_one_comes_back_from_the_backup(
    tmp_path: Path, harm: Callable[[Path], object], caplog: pytest.LogCaptureFixture
) -> None:
    for value in ("first", "second", "third"):
        assert make_ready(tmp_path) is (value == "first")  # it is new
        keep(tmp_path, value)
    harm(tmp_path / STATE_FILE)
    assert make_ready(tmp_path)
    assert "the backup of the run before is taken" in caplog.text
    assert kept(tmp_path) == "second"  # as it was at the begin of the last run
    assert not make_ready(tmp_path)
    names = {path.name for path in tmp_path.iterdir()} - {DAMAGED_FILE}
    assert names == {STATE_FILE, BACKUP_FILE}


@pytest.mark.parametrize("harm", [junk, cut])
def test_without_a_sound_backup_it_begins_anew(
    tmp_path: Path, harm: Callable[[Path], object], caplog: pytest.LogCaptureFixture
) -> None:
    keep(tmp_path, "before")
    make_ready(tmp_path)
    for name in (STATE_FILE, BACKUP_FILE):
        harm(tmp_path / name)
    assert not is_sound(tmp_path)
    assert make_ready(tmp_path)
    assert "it is made anew" in caplog.text
    assert kept(tmp_path) == ""
    assert is_sound(tmp_path)


def test_what_a_killed_process_left_in_its_log_is_taken_over(tmp_path: Path) -> None:
    """The main file alone is not the state: SQLite has a log beside it."""
    with open_state(tmp_path) as state:
        state.set_meta("value", "in the log")
        shutil.copytree(tmp_path, tmp_path / "killed", ignore=shutil.ignore_patterns("killed"))
    assert (tmp_path / "killed" / f"{STATE_FILE}-wal").stat().st_size > 0
    assert not make_ready(tmp_path / "killed")
    assert kept(tmp_path / "killed") == "in the log"


# The state of another machine


def decide(output: Path, motor_id: str) -> None:
    with open_state(output) as state:
        state.write(
            "INSERT INTO decisions VALUES (?, '', '2026-01-01', 'acknowledged', '2026-01-01', "
            "NULL, '', NULL, NULL)",
            motor_id,
        )


def decided(output: Path) -> list[str]:
    with read_state_file(output) as state:
        return [one for (one,) in state.rows("SELECT motor_id FROM decisions ORDER BY motor_id")]


def content_of(output: Path) -> bytes:
    with read_state_file(output) as state:
        return state.content()


@pytest.fixture
def two(tmp_path: Path) -> tuple[Path, bytes]:
    """An output with a decision of its own, and the content of a state with another one."""
    here, there = tmp_path / "here", tmp_path / "there"
    for output, motor_id in ((here, "M1"), (there, "M2")):
        keep(output, output.name)
        decide(output, "M0")
        decide(output, motor_id)
        with open_state(output) as state, state.transaction():
            state.write("INSERT INTO motors VALUES (?, '{}')", output.name)
            state.write(
                "INSERT INTO nights VALUES (?, '2026-01-01', 'ok', '', '', '', '', 1)", output.name
            )
            state.write("INSERT INTO queues VALUES ('alarms', 'mail', '', '', '')")
            state.write("INSERT INTO outbox VALUES (1, 'alarms', 'mail', ?, '', '', '')", "x")
    return here, content_of(there)


def test_another_state_is_taken_over_but_for_decisions(two: tuple[Path, bytes]) -> None:
    here, content = two
    with open_state(here) as state:
        state.replace(content)
        assert state.rows("SELECT motor_id FROM nights") == [("there",)]
        assert state.rows("SELECT motor_id FROM motors") == [("there",)]
        assert state.rows("SELECT count(*) FROM outbox") == [(1,)]
        assert state.rows("PRAGMA database_list")[1:] == []
    assert kept(here) == "there"
    assert decided(here) == ["M0", "M1", "M2"]
    assert is_sound(here)


def test_a_decision_that_is_made_meanwhile_is_kept(
    two: tuple[Path, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    here, content = two
    read, made = State.rows, []

    def decides_after(self: State, query: str, *values: object) -> list[tuple[object, ...]]:
        found = read(self, query, *values)
        made.append(f"M{3 + len(made)}")
        with closing(sqlite3.connect(here / STATE_FILE)) as other, other:
            other.execute(
                "INSERT INTO decisions SELECT ?, indicator, time, kind, night, finding, note, worn,"
                " sound FROM decisions LIMIT 1",
                made[-1:],
            )
        return found

    with open_state(here) as state, monkeypatch.context() as patch:
        patch.setattr(State, "rows", decides_after)
        state.replace(content)
    assert decided(here) == ["M0", "M1", "M2", *made]


def test_it_does_not_wait_for_ever_for_another_process(
    two: tuple[Path, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    here, content = two
    monkeypatch.setattr("pipeline.store.state.BUSY_S", 0.05)
    locked = pytest.raises(StoreError, match="is locked")
    with open_state(here) as other, open_state(here) as state, other.transaction(), locked:
        state.replace(content)
    assert kept(here) == "here"


@pytest.mark.parametrize("content", [b"no state" * 999, b"", "newer"])
def test_what_is_no_state_changes_nothing(two: tuple[Path, bytes], content: bytes | str) -> None:
    here, known = two
    code = "store_read"
    if isinstance(content, str):
        content, code = known[:60] + (99).to_bytes(4, "big") + known[64:], "store_newer"
    with open_state(here) as state:
        with pytest.raises(StoreError) as caught:
            state.replace(content)
        assert caught.value.code == code
        assert state.meta("value") == "here"
        state.set_meta("value", "still open")
    assert decided(here) == ["M0", "M1"]
