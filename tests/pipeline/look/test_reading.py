"""Reading what is new: each row once, behind what is still needed, whatever becomes of the file."""

from __future__ import annotations

import datetime as dt
import os
from collections.abc import Mapping
from pathlib import Path

import pytest

from pipeline.config import MotorSpec
from pipeline.look import reading as module
from pipeline.look.reading import FileSeen, News, read_news
from tests.pipeline.look.fleet import BEGIN, Growing, configured, rows_of
from tests.pipeline.simulated import operate

FIRST_US = int(BEGIN.timestamp()) * 1_000_000
LATEST_US = FIRST_US + 86_400_000_000


@pytest.fixture
def place(tmp_path: Path) -> Growing:
    return configured(tmp_path / "fleet")


def rows(minutes: float = 10.0) -> list[str]:
    operation = operate(BEGIN.date() + dt.timedelta(days=1), minutes)
    return rows_of(operation, operation.pressure_bar)


def read(spec: MotorSpec, seen: Mapping[str, FileSeen], from_second: int) -> News:
    needed_us = FIRST_US + from_second * 1_000_000
    return read_news(spec, seen, needed_us, LATEST_US)


def seconds(news: News) -> list[int]:
    return [
        (time - FIRST_US) // 1_000_000
        for log in news.logs
        for time in log.channels["speed"].time_us.tolist()
    ]


def test_reading_goes_on_behind_the_last_piece_before_what_is_needed(
    place: Growing, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "PIECE_BYTES", 1_000)
    spec, text = place.spec, rows()
    place.append(text[:100])
    first = read(spec, {}, 0)
    assert seconds(first) == list(range(100))
    assert read_news(spec, first.files, FIRST_US, LATEST_US) is None
    place.append(text[100:200])
    # All of the first piece is still needed, then none of it is.
    assert seconds(read(spec, first.files, 50))[-150:] == list(range(50, 200))
    second = read(spec, first.files, 100)
    assert seconds(second)[-100:] == list(range(100, 200))
    (known,) = second.files.values()
    assert 80 * len(text[0]) < known.position < 101 * (len(text[0]) + 5)
    place.append(text[200:300])
    third = seconds(read(spec, second.files, 150))
    assert third == list(range(third[0], 300))
    assert 120 < third[0] <= 150


def test_a_torn_row_waits_for_its_end(place: Growing) -> None:
    spec, text = place.spec, rows()
    place.append([*text[:10], text[10][:30]])
    first = read(spec, {}, 0)
    assert seconds(first) == list(range(10))
    place.append([text[10][30:], *text[11:20]])
    assert seconds(read(spec, first.files, 10)) == list(range(20))


def test_a_file_that_is_cut_or_replaced_is_read_from_its_begin(place: Growing) -> None:
    spec, text = place.spec, rows()
    place.append(text[:100])
    seen = read(spec, {}, 0).files
    place.today().unlink()
    place.append(text[100:110])
    assert seconds(read(spec, seen, 100)) == list(range(100, 110))
    place.today().unlink()
    # Longer than before, and another one.
    place.append(text[200:400])
    assert seconds(read(spec, seen, 100)) == list(range(200, 400))


def test_a_rotated_file_loses_no_row(place: Growing) -> None:
    spec, text = place.spec, rows()
    place.append(text[:100])
    seen = read(spec, {}, 0).files
    place.append(text[100:120])
    place.today().rename(place.today().with_name("yesterday.csv"))
    place.append(text[120:150])
    found = seconds(read(spec, seen, 100))
    assert set(range(100, 150)) <= set(found)
    assert len(found) == len(set(found))


def test_an_old_file_is_not_opened_and_a_damaged_one_is_tried_when_it_has_changed(
    place: Growing,
) -> None:
    spec = place.spec
    old = place.today().with_name("old.csv")
    old.write_text("\x00", "utf-8")
    os.utime(old, ns=((FIRST_US - 3 * 86_400_000_000) * 1000,) * 2)
    place.today().write_text("something,else\n1,2\n", "utf-8")
    first = read(spec, {}, 0)
    assert set(first.files) == {"M1/today.csv"}
    assert "no column" in first.fault
    assert read_news(spec, first.files, FIRST_US, LATEST_US) is None
    place.today().unlink()
    place.append(rows()[:10])
    assert seconds(read(spec, first.files, 0)) == list(range(10))
