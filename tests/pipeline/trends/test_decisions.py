"""The journal of what people said: kept across runs and faults, and nothing lost."""

from __future__ import annotations

import datetime as dt
import json
import logging
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.errors import StoreError
from pipeline.trends.nights.decisions import Decision, journal_file, read_decisions, record_decision

SAID = Decision(
    "M1",
    "K_piston_ring",
    dt.datetime(2026, 3, 1, 12, tzinfo=dt.UTC),
    "finding",
    dt.date(2026, 2, 17),
    "confirmed",
    'rings worn; "really", said µ—Å\n2nd line',
)


def test_it_comes_back_as_it_was_said(tmp_path: Path) -> None:
    record_decision(tmp_path / "new" / "out", SAID)
    assert read_decisions(tmp_path / "new" / "out") == (SAID,)


def test_the_oldest_is_first_whoever_wrote_it(tmp_path: Path) -> None:
    later = replace(SAID, time=SAID.time + dt.timedelta(hours=1), kind="acknowledged", finding=None)
    record_decision(tmp_path, later)
    record_decision(tmp_path, SAID)
    assert read_decisions(tmp_path) == (SAID, later)


def test_without_a_journal_nothing_was_said(tmp_path: Path) -> None:
    assert read_decisions(tmp_path) == ()


def test_a_line_that_was_cut_off_costs_itself_and_no_other(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    record_decision(tmp_path, SAID)
    with journal_file(tmp_path).open("ab") as stream:
        stream.write(b'{"finding": "confirmed", "motor_')
    after = replace(SAID, motor_id="M2")
    record_decision(tmp_path, after)
    with caplog.at_level(logging.WARNING):
        assert read_decisions(tmp_path) == (SAID, after)
    assert "decisions.jsonl, line 2 is damaged and left out" in caplog.text


@pytest.mark.parametrize(
    "spoil",
    [
        lambda line: line.replace(b"confirmed", b"confirmeD"),
        lambda line: line.replace(b"M1", b"M2"),
        lambda _: b"[" * 100_000,
        lambda _: b"null",
        lambda _: b"\xff\xfe\x00",
        lambda line: json.dumps({**json.loads(line), "more": 1}).encode(),
    ],
)
def test_a_changed_line_is_left_out(tmp_path: Path, spoil: object) -> None:
    record_decision(tmp_path, SAID)
    record_decision(tmp_path, replace(SAID, motor_id="M3"))
    first, second, _ = journal_file(tmp_path).read_bytes().split(b"\n")
    journal_file(tmp_path).write_bytes(spoil(first) + b"\n" + second + b"\n")  # type: ignore[operator]
    assert [one.motor_id for one in read_decisions(tmp_path)] == ["M3"]


def test_a_line_of_an_older_version_is_read(tmp_path: Path) -> None:
    """They had 16 digits of the SHA-256; nobody can say again what people said."""
    record_decision(tmp_path, SAID)
    document = json.loads(journal_file(tmp_path).read_bytes())
    document["sha256"] = document["sha256"][:16]
    journal_file(tmp_path).write_text(json.dumps(document) + "\n", "utf-8")
    assert read_decisions(tmp_path) == (SAID,)


def test_many_may_write_at_once(tmp_path: Path) -> None:
    said = [replace(SAID, motor_id=f"M{number}", note="x" * 500) for number in range(40)]
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda one: record_decision(tmp_path, one), said))
    assert {one.motor_id for one in read_decisions(tmp_path)} == {one.motor_id for one in said}


def test_where_it_cannot_be_written_it_is_said(tmp_path: Path) -> None:
    journal_file(tmp_path).mkdir()
    with pytest.raises(StoreError, match="cannot be written") as caught:
        record_decision(tmp_path, SAID)
    assert caught.value.code == "store_write"
    with pytest.raises(StoreError, match="cannot be read") as caught:
        read_decisions(tmp_path)
    assert caught.value.code == "store_read"
