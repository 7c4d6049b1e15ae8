"""Processed logs: what is written comes back, and nights are forgotten with their files."""

from __future__ import annotations

import datetime as dt
from dataclasses import replace
from pathlib import Path

from pipeline.logs.processed import (
    FileRecord,
    NightRecord,
    ProcessedChange,
    ProcessedLogs,
    forget_nights,
    note_published,
    read_processed,
    unpublished_rows,
    write_change,
)
from pipeline.store.state import open_state

NEW_YEAR = dt.date(2026, 1, 2)
SOME = ProcessedLogs(
    {"A/1.csv": FileRecord("A/1.csv", 100, 17, "ab" * 32, "", 5, 1, 2, ("2026-01-02",))},
    {
        NEW_YEAR: NightRecord("ok"),
        dt.date(2026, 1, 3): NightRecord("stood_still"),
    },
    {},
)
TWO_MONTHS = ProcessedLogs(SOME.files, {**SOME.nights, dt.date(2026, 2, 1): NightRecord("ok")}, {})

FULL = ProcessedLogs(
    {
        "x '%\N{SNOWMAN}": FileRecord(
            *("x '%\N{SNOWMAN}", 2**60, 2**62, None, "0123456789abcdef", 2**40, -(2**60), None, ()),
            *("failed", "log_time", "a\nb", 7, 2**62),
        )
    },
    {
        NEW_YEAR: NightRecord(
            *("failed", "0123", "4567", True, ("ab", "cd"), "its logs are gone", "89"),
        )
    },
    {"reference": {"leakage": 0.1 + 0.2}},
)


def write_whole(output: Path, motor_id: str, processed: ProcessedLogs) -> None:
    with open_state(output) as state:
        change = ProcessedChange.between(read_processed(state, motor_id), processed)
        write_change(state, motor_id, change)


def read(output: Path, motor_id: str) -> ProcessedLogs:
    with open_state(output) as state:
        return read_processed(state, motor_id)


def test_what_is_written_comes_back(tmp_path: Path) -> None:
    write_whole(tmp_path, "B", TWO_MONTHS)
    for processed in (SOME, FULL, ProcessedLogs({}, {}, {}), TWO_MONTHS):
        write_whole(tmp_path, "A", processed)
        assert read(tmp_path, "A") == processed
    assert read(tmp_path, "B") == TWO_MONTHS


def test_a_forgotten_night_is_forgotten_with_its_files(tmp_path: Path) -> None:
    for motor in "AB":
        write_whole(tmp_path, motor, TWO_MONTHS)
    third = dt.date(2026, 1, 3)
    with open_state(tmp_path) as state:
        assert forget_nights(state, {NEW_YEAR, third}) == {"A": {NEW_YEAR}, "B": {NEW_YEAR}}
    # The log of a night with a fit may be gone.
    kept = {night: record for night, record in TWO_MONTHS.nights.items() if night != third}
    assert read(tmp_path, "A") == read(tmp_path, "B") == ProcessedLogs({}, kept, {})


def test_a_forgotten_night_can_be_fitted_anew_from_its_statistics(tmp_path: Path) -> None:
    made = replace(SOME.nights[NEW_YEAR], figures_hash="0123456789abcdef")
    write_whole(tmp_path, "A", ProcessedLogs(SOME.files, {NEW_YEAR: made}, {}))
    with open_state(tmp_path) as state:
        forget_nights(state, {NEW_YEAR}, refit={NEW_YEAR})
    expected = replace(made, figures_hash="")
    assert read(tmp_path, "A") == ProcessedLogs({}, {NEW_YEAR: expected}, {})


def test_a_nights_own_row_comes_back_as_it_was_until_it_is_published(tmp_path: Path) -> None:
    row = {
        "motor_id": "A",
        "night": NEW_YEAR,
        "reason": None,
        "first_sample": dt.datetime(2026, 1, 1, 22, 0, 0, 5, dt.UTC),
        "mean_speed_rpm": 0.1 + 0.2,
    }
    write_whole(tmp_path, "A", ProcessedLogs({}, {NEW_YEAR: NightRecord("ok", row=row)}, {}))
    assert read(tmp_path, "A").nights[NEW_YEAR].row == row
    with open_state(tmp_path) as state:
        assert unpublished_rows(state, "A") == {NEW_YEAR: row}
        note_published(state, "A", NEW_YEAR)
        assert unpublished_rows(state, "A") == {}
