"""The state file: whole transactions, and what is done where it is lost."""

from __future__ import annotations

import os
import signal
import sqlite3
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from pipeline.errors import StoreError
from pipeline.store.atomic_files import INTERRUPTS, interrupts_held
from pipeline.store.state import STATE_FILE, open_state, read_state_file


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


# Signals while a file is written


@pytest.fixture
def received() -> Iterator[list[int]]:
    """Signals that the program's own handler received; it ends what is under way."""
    numbers: list[int] = []

    def stop(number: int, _: object) -> None:
        numbers.append(number)
        raise KeyboardInterrupt

    before = {number: signal.signal(number, stop) for number in INTERRUPTS}
    yield numbers
    for number, handler in before.items():
        signal.signal(number, handler)


def test_a_second_signal_does_not(received: list[int]) -> None:
    reached = []

    def twice() -> None:
        with interrupts_held():
            os.kill(os.getpid(), signal.SIGINT)
            reached.append(1)
            os.kill(os.getpid(), signal.SIGTERM)
            reached.append(2)

    with pytest.raises(KeyboardInterrupt):
        twice()
    assert (reached, received) == ([1], [signal.SIGTERM])


def test_another_thread_has_no_signals_to_hold() -> None:
    seen: list[list[int]] = []

    def work() -> None:
        with interrupts_held() as came:
            seen.append(came)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [[]]
