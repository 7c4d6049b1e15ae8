"""The heartbeat of a run: its beats, and the last one after its end."""

from __future__ import annotations

import datetime as dt
import json
import threading
from pathlib import Path

import pytest

from pipeline.errors import StoreError
from pipeline.store.heartbeat import Beat, Heartbeat, heartbeat_file, read_heartbeat


def beat_of(output: Path) -> Beat:
    beat = read_heartbeat(output)
    assert beat is not None
    return beat


def test_it_beats_between_changes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pipeline.store.heartbeat.INTERVAL_S", 0.01)
    written = threading.Semaphore(0)

    class Counted(Heartbeat):
        def say(self, **changes: str | int | dt.datetime | None) -> None:
            super().say(**changes)
            written.release()

    with Counted(tmp_path, 3, None):
        assert all(written.acquire(timeout=10) for _ in range(4))
        assert beat_of(tmp_path).state == "running"


@pytest.mark.parametrize(
    ("error", "state", "code"),
    [
        (StoreError("store_write", "no room"), "failed", "store_write"),
        (KeyboardInterrupt(), "interrupted", None),
        (ZeroDivisionError(), "failed", None),
    ],
)
def test_a_run_that_ends_early_says_how(
    tmp_path: Path, error: BaseException, state: str, code: str | None
) -> None:
    good = dt.datetime(2026, 3, 1, 7, tzinfo=dt.UTC)
    with pytest.raises(type(error)), Heartbeat(tmp_path, 3, good):
        raise error
    left = beat_of(tmp_path)
    assert (left.state, left.error_code, left.last_good_run) == (state, code, good)


def test_a_beat_that_cannot_be_written_ends_nothing(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "heartbeat.json").mkdir()
    with Heartbeat(tmp_path, 1, None) as heartbeat:
        heartbeat.say()
        heartbeat.finished(interrupted=False, good=True)
    assert [record.message[:13] for record in caplog.records] == ["no heartbeat:"]
    assert [path.name for path in tmp_path.iterdir()] == ["heartbeat.json"]


@pytest.mark.parametrize(
    "text",
    ["", "[]", "{}", "3", '{"state": "running"}', "\x00", '{"started_at": 3}', "without a zone"],
)
def test_what_is_no_beat_is_none(tmp_path: Path, text: str) -> None:
    if text == "without a zone":
        with Heartbeat(tmp_path, 1, None):
            document = json.loads(heartbeat_file(tmp_path).read_text("utf-8"))
        text = json.dumps(document | {"beaten_at": "2026-03-01T07:00:00"})
    heartbeat_file(tmp_path).write_text(text, "utf-8")
    assert read_heartbeat(tmp_path) is None
