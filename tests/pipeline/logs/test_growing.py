"""A log that is written to while it is read: left out, with its nights, until the next run."""

from __future__ import annotations

import datetime as dt
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from pipeline.config import load_fleet
from pipeline.logs.files import change_of, stat_log
from pipeline.setup.check import check_motor
from tests.pipeline.calling import Call
from tests.pipeline.simulated import NIGHT, motor_toml
from tests.pipeline.workshop import DAY, Workshop, check_same_figures

HASH = "pipeline.logs.files.content_hash"
SPAN = "pipeline.logs.files.time_span"
READ = "pipeline.logs.motor_logs.read_log"


def shop_of(folder: Path, more: str = "") -> Workshop:
    """A motor with logs as text, and the log of a first night."""
    shop = Workshop(folder)
    text = motor_toml("M1", "MINI", files='"M1/*.csv"')
    shop.take(text.replace('format = "parquet"', f'format = "csv"\n{more}'))
    write(shop, NIGHT)
    return shop


def write(shop: Workshop, label: dt.date, name: str = "", seed: int = 0) -> Path:
    """The log of a night as text."""
    path = shop.log(label, seed=seed or label.day)
    log = path.with_name(name or f"{label}.csv")
    pl.read_parquet(path).write_csv(log, datetime_format="%Y-%m-%dT%H:%M:%S%.6fZ")
    path.unlink()
    return log


def when_called(
    monkeypatch: pytest.MonkeyPatch, place: str, path: Path, write_on: Callable[[], object]
) -> None:
    """Have a file written on behind its first reading at one of the places that read."""
    module, name = place.rsplit(".", 1)
    real, called = getattr(sys.modules[module], name), []

    def read(at: Path, *more: Any) -> Any:
        content = real(at, *more)
        if at == path and not called:
            called.append(at)
            write_on()
        return content

    monkeypatch.setattr(place, read)


def fates(outcome: Any) -> dict[str, int]:
    return {fate: n for fate, n in outcome.files.items() if n}


def test_what_grows_waits_and_the_next_run_reads_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another process writes on while it is read."""
    shop, undisturbed = (shop_of(tmp_path / name) for name in "ab")
    assert shop.run().nights == (NIGHT,)
    path = write(shop, NIGHT + DAY)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with monkeypatch.context() as patch:
        when_called(patch, READ, path, lambda: path.write_bytes(whole))
        outcome = shop.run()
    assert (outcome.status, outcome.error_code, outcome.nights) == ("no_new_data", None, ())
    assert fates(outcome) == {"unchanged": 1, "growing": 1}
    assert path.name in outcome.growing[0]
    assert shop.statuses() == {NIGHT: "ok"}
    assert shop.rows("log_files").height == 1
    assert shop.run().nights == (NIGHT + DAY,)
    write(undisturbed, NIGHT + DAY)
    undisturbed.run()
    check_same_figures(shop, undisturbed)


def test_a_night_with_a_growing_log_waits_as_a_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half a night would be published, and corrected by the next run."""
    shop = shop_of(tmp_path)
    write(shop, NIGHT + DAY)
    more = write(shop, NIGHT + DAY, "more.csv", seed=9)
    with monkeypatch.context() as patch:
        when_called(patch, HASH, more, lambda: os.utime(more, (1, 1)))
        outcome = shop.run()
    assert outcome.nights == (NIGHT,)
    assert fates(outcome) == {"read": 1, "growing": 1, "left": 1}
    outcome = shop.run()
    assert outcome.nights == (NIGHT + DAY,)
    assert fates(outcome) == {"read": 2, "unchanged": 1}


@pytest.mark.parametrize(
    ("content", "words"),
    [("time,m\n", "it changed while"), ("time,n\nx", "it went from 7 to 8 bytes"), (None, "")],
)
def test_a_change_shows_in_size_or_time(tmp_path: Path, content: str | None, words: str) -> None:
    """Also where another file takes the name, with the old size and time; none if it is gone."""
    path, new = tmp_path / "a.csv", tmp_path / "new"
    path.write_text("time,n\n")
    record = stat_log("a.csv", path)
    path.unlink()
    if content is not None:
        new.write_text(content)
        os.utime(new, ns=(0, record.modified_ns))
        new.replace(path)
    why = change_of(record, path)
    assert (why and why.code) == ("log_growing" if words else None)
    assert words in str(why)


def test_a_backup_that_links_a_log_changes_nothing(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time,n\n")
    record = stat_log("a.csv", path)
    (tmp_path / "copy").hardlink_to(path)
    path.chmod(0o640)
    assert stat_log("a.csv", path).state != record.state
    assert change_of(record, path) is None


def test_the_check_notes_it_and_finds_no_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shop = shop_of(tmp_path)
    path = shop.logs / f"{NIGHT}.csv"
    when_called(monkeypatch, SPAN, path, lambda: path.write_bytes(path.read_bytes() + b"2026"))
    (found,) = map(check_motor, load_fleet(shop.fleet).motors)
    assert not found.faults
    assert {"log_growing", "no_night"} <= {note.split(":")[0] for note in found.notes}


def test_the_command_says_so_and_ends_with_0(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: Call
) -> None:
    shop = shop_of(tmp_path)
    path = shop.logs / f"{NIGHT}.csv"
    for command, options, ended in (
        ("fit-fleet", (), (0, "logs: 0 read, 0 unchanged, 1 growing, 0 failed, 0 left")),
        ("fit-fleet", ("--json",), (0, '"growing": ["')),
        ("fit", ("M1", str(NIGHT)), (4, "log_growing: the night waits")),
    ):
        with monkeypatch.context() as patch:
            when_called(patch, HASH, path, lambda: path.write_bytes(path.read_bytes() + b"2026"))
            code, out, err = call(command, str(shop.fleet), *options)
        assert code == ended[0]
        assert ended[1] in out + err
