"""The outbox's two files, damage, and what is read and written of it."""

from __future__ import annotations

import datetime as dt
import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pipeline.errors import StoreError
from pipeline.run.verification import verify_tables
from pipeline.schema import ALARMS
from pipeline.store import sealed
from pipeline.store.sealed import DamagedError, put_sealed
from pipeline.store.tables import night_file
from pipeline.telling import outbox as module
from pipeline.telling.outbox import (
    OUTBOX_FILES,
    Outbox,
    Told,
    add_summary,
    open_outbox,
    read_outbox,
    read_outbox_file,
    write_outbox,
)
from tests.pipeline.telling.made_alarms import FIRST, FLEET, Fake, publish, row, run, undelivered


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


@pytest.mark.parametrize("harm", [flip, Path.unlink], ids=["flipped", "gone"])
@pytest.mark.parametrize("name", OUTBOX_FILES)
def test_either_of_its_files_is_enough(
    tmp_path: Path, name: str, harm: Callable[[Path], None]
) -> None:
    receiver = Fake(refuses=lambda _: True)
    run(tmp_path, [row("M1")], receiver)
    before = read_outbox(tmp_path)
    harm(tmp_path / name)
    codes = [(one.path, one.code) for one in verify_tables(tmp_path) if "outbox" in one.path]
    assert codes == ([(name, "outbox_damaged")] if harm is flip else [])
    assert undelivered(tmp_path, receiver) == [1]
    receiver.refuses = lambda _: False
    assert run(tmp_path, [], receiver) == ()
    assert [one["change"] for one in receiver.changes()] == ["new"]
    assert len({(tmp_path / one).read_bytes() for one in OUTBOX_FILES}) == 1
    assert read_outbox(tmp_path).known == before.known


def test_without_both_the_receivers_begin_anew_and_the_run_says_so(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    receiver = Fake(refuses=lambda _: True)
    run(tmp_path, [row("M1"), row("M2")], receiver)
    for name in OUTBOX_FILES:
        flip(tmp_path / name)
    assert len([one for one in verify_tables(tmp_path) if one.code == "outbox_damaged"]) == 2
    receiver.refuses = lambda _: False
    run(tmp_path, [], receiver)
    assert receiver.taken == []
    assert "outbox.json is damaged" in caplog.text
    assert "the 2 rows of `alarms` so far are not sent" in caplog.text


@pytest.mark.parametrize(
    "harm",
    [
        {"queues": []},
        {"queues": {"command": {}}},
        {"queues": {"command": {"told_since": "x", "waiting": [], "fault": ""}}},
        {"known": ["x"]},
        {"known": [1]},
    ],
)
def test_a_sealed_file_of_another_shape_is_damaged(tmp_path: Path, harm: dict[str, Any]) -> None:
    path, sound = tmp_path / OUTBOX_FILES[0], {"queues": {}, "known": [], "stamps": {}}
    put_sealed(path, sound)
    assert read_outbox_file(path) == Outbox()
    put_sealed(path, sound | harm)
    with pytest.raises(DamagedError, match="is damaged"):
        read_outbox_file(path)


def test_one_that_cannot_be_read_is_not_taken_for_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run(tmp_path, [row("M1")], Fake())

    def unreadable(path: Path) -> bytes:
        raise OSError(5, "Input/output error", str(path))

    monkeypatch.setattr(sealed, "read", unreadable)
    with pytest.raises(StoreError, match="cannot be read: Input/output error"):
        read_outbox(tmp_path)


def test_a_damaged_table_waits_and_keeps_nothing_else(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    receiver, later = Fake(), FIRST + dt.timedelta(1)
    open_outbox(tmp_path, ["command"], FLEET)
    publish(tmp_path, row("M1"), row("M2", later))
    whole = night_file(tmp_path, ALARMS, FIRST).read_bytes()
    night_file(tmp_path, ALARMS, FIRST).write_bytes(whole[:-4])
    run(tmp_path, [], receiver)
    assert receiver.motors() == ["M2"]
    assert "2026-02-17.parquet of alarms is damaged" in caplog.text
    night_file(tmp_path, ALARMS, FIRST).write_bytes(whole)
    run(tmp_path, [], receiver)
    assert receiver.motors() == ["M2", "M1"]


def test_only_months_that_were_written_to_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    receiver = Fake()
    run(tmp_path, [row("M1"), row("M2", dt.date(2026, 3, 1))], receiver)
    read: list[str] = []
    real = module._rows_of

    def counted(output: Path, month: str, told: Told) -> tuple[list[dict[str, Any]], bool]:
        read.append(month)
        return real(output, month, told)

    monkeypatch.setattr(module, "_rows_of", counted)
    run(tmp_path, [], receiver)
    assert read == []
    run(tmp_path, [row("M3", dt.date(2026, 3, 2))], receiver)
    assert set(read) == {"2026-03"}


def test_nothing_is_written_where_nothing_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    receiver = Fake()
    run(tmp_path, [row("M1", deviation_percent=float("nan"))], receiver)
    assert receiver.changes()[0]["deviation_percent"] is None  # what is not finite is null

    def forbidden(*_: Any) -> None:
        raise AssertionError

    monkeypatch.setattr(sealed, "put", forbidden)
    with caplog.at_level(logging.WARNING):
        run(tmp_path, [], receiver)
    assert caplog.text == ""
    write_outbox(tmp_path, replace(read_outbox(tmp_path)))


def test_a_summary_waits_once_for_each_date_it_is_due_on(tmp_path: Path) -> None:
    open_outbox(tmp_path, ["email"], "Mill 3")
    made: list[int] = []

    def rows() -> list[dict[str, Any]]:
        made.append(1)
        return [{"motor_id": "M", "state": "ok"}]

    for due in (dt.date(2026, 11, 16), dt.date(2026, 11, 16), dt.date(2026, 11, 23)):
        add_summary(tmp_path, "email", "Mill 3", due, rows)
        add_summary(tmp_path, "stranger", "Mill 3", due, rows)
    waiting = read_outbox(tmp_path).queues["email"].waiting
    assert [one.kind for one in waiting] == ["summary", "summary"]
    assert len({one.id for one in waiting}) == len(made) == 2
