"""A motor's log files: finding them, their records, and the samples of a night."""

from __future__ import annotations

import datetime as dt
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.config import MotorSpec, Nights
from pipeline.config.nights import DAY, night
from pipeline.ingest import RawChannel, RawLog, read_log
from pipeline.logs import files as logs
from pipeline.logs.files import LONGEST_LOG_DAYS, covered, labels_of, slice_night
from pipeline.logs.finding import find_logs
from pipeline.logs.processed import FileRecord, content_hash
from tests.pipeline.logs.looked_at import EVENING, UNITS, looked_at, us, with_files

LABEL = dt.date(2026, 1, 2)
MINUTE = dt.timedelta(minutes=1)
YEAR = dt.timedelta(days=365)


def write(path: Path, times: Sequence[dt.datetime], rows: Sequence[str] | None = None) -> Path:
    """A CSV with a row at each time."""
    path.parent.mkdir(parents=True, exist_ok=True)
    cells = rows or ["200.0,50.0,30.0,1.0"] * len(times)
    lines = [f"{time.isoformat()},{some}" for time, some in zip(times, cells, strict=True)]
    path.write_text("\n".join(["time," + ",".join(UNITS), *lines]) + "\n")
    return path


def every_minute(begin: dt.datetime = EVENING, n: int = 60) -> list[dt.datetime]:
    return [begin + number * MINUTE for number in range(n)]


def fully_read(path: Path, spec: MotorSpec) -> FileRecord:
    log = read_log(path, spec.file.logs, spec.file.channels)
    return covered(looked_at(path, spec), log, spec)


class TestFind:
    def test_globs_and_names(self, spec: MotorSpec, tmp_path: Path) -> None:
        for name in ("b.csv", "a.csv", "old/c.csv", "old/older/d.csv", "e.txt"):
            write(tmp_path / name, every_minute(n=1))
        found, absent = find_logs(with_files(spec, "*.csv", "old/c.csv", "old/**/d.csv", "e.txt"))
        assert list(found) == ["a.csv", "b.csv", "e.txt", "old/c.csv", "old/older/d.csv"]
        assert found["old/c.csv"] == tmp_path / "old" / "c.csv"
        assert absent == []
        # A glob without a match is no fault, and an absent name is.
        for root in (tmp_path, tmp_path / "nowhere"):
            one = replace(with_files(spec, "*.mcap", "named.csv", "folder/*.csv"), log_root=root)
            assert find_logs(one) == ({}, ["named.csv"])

    def test_a_file_named_like_a_glob_is_the_file(self, spec: MotorSpec, tmp_path: Path) -> None:
        path = write(tmp_path / "a[1].csv", every_minute())
        write(tmp_path / "a1.csv", every_minute())
        found, absent = find_logs(with_files(spec, "a[1].csv"))
        assert (list(found.values()), absent) == ([path], [])

    @pytest.mark.parametrize("pattern", ["M1_*.csv", "*1_?.csv", "M[12]_a.csv", "*", "M1_a.csv*"])
    def test_a_folder_of_many_motors_is_listed_once(
        self, spec: MotorSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pattern: str
    ) -> None:
        for name in ("M1_a.csv", "M1_b.csv", "M2_a.csv", ".M1_c.csv", "m1_a.csv"):
            write(tmp_path / name, every_minute(n=1))
        os.utime(tmp_path, (1, 1))
        listed, scandir = [], os.scandir
        monkeypatch.setattr(os, "scandir", lambda path: listed.append(path) or scandir(path))
        for _ in range(3):
            found, _ = find_logs(with_files(spec, pattern))
        assert listed == [tmp_path]
        monkeypatch.undo()
        assert set(found.values()) == set(tmp_path.glob(pattern))
        # One more is seen at once.
        write(tmp_path / "M1_x.csv", every_minute(n=1))
        found, _ = find_logs(with_files(spec, pattern))
        assert set(found.values()) == set(tmp_path.glob(pattern))


class TestInspect:
    def test_what_is_known_of_a_new_file(self, spec: MotorSpec, tmp_path: Path) -> None:
        path = write(tmp_path / "a.csv", every_minute(n=600))
        record = looked_at(path, spec)
        assert record.status == "ok"
        assert record.sha256 == content_hash(path)
        assert record.size == path.stat().st_size
        assert (record.first_us, record.last_us) == (us(EVENING), us(EVENING + 599 * MINUTE))
        assert record.nights == ("2026-01-02", "2026-01-03")

    def test_nights_are_those_of_the_fleet_s_zone(self, spec: MotorSpec, tmp_path: Path) -> None:
        path = write(tmp_path / "a.csv", every_minute(EVENING.replace(hour=5)))
        assert looked_at(path, spec).nights == ("2026-01-01",)
        oslo = spec.settings.model_copy(update={"nights": Nights(time_zone="Europe/Oslo")})
        assert looked_at(path, replace(spec, settings=oslo)).nights == ("2026-01-02",)

    def test_same_size_and_time_is_as_before(
        self, spec: MotorSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        path = write(tmp_path / "a.csv", every_minute())
        before = looked_at(path, spec)
        monkeypatch.setattr(logs, "content_hash", lambda _: pytest.fail("was read again"))
        assert looked_at(path, spec, before) == before

    def test_what_is_no_file(self, spec: MotorSpec, tmp_path: Path) -> None:
        (tmp_path / "folder").mkdir()
        os.mkfifo(tmp_path / "pipe")  # must not be opened: it would wait for a writer
        (tmp_path / "nowhere").symlink_to(tmp_path / "gone")
        for name in ("folder", "pipe", "nowhere", "vanished"):
            record = looked_at(tmp_path / name, spec)
            assert (record.status, record.error_code) == ("failed", "log_not_readable")
            assert record.sha256 is None


class TestWildStamps:
    """A clock that was wrong for a moment must not make nights of what lies between."""

    @pytest.mark.parametrize("at", [0, 1, 30, 58, 59])
    @pytest.mark.parametrize("off", [-30 * YEAR, 30 * YEAR, 100 * YEAR])
    def test_one_of_them(self, spec: MotorSpec, tmp_path: Path, at: int, off: dt.timedelta) -> None:
        times = every_minute()
        times[at] += off
        path = write(tmp_path / "a.csv", times)
        looked = looked_at(path, spec)
        assert looked.nights == (LABEL.isoformat(),)
        record = fully_read(path, spec)
        assert record.status == "ok"
        assert record.nights == (LABEL.isoformat(),)
        true = sorted(set(every_minute()) & set(times))
        assert (record.first_us, record.last_us) == (us(true[0]), us(true[-1]))
        assert record.message
        ahead = "1 row with a time more than a day in the future"
        assert ("1 time stamp over a year" if off.days < 0 else ahead) in record.message

    def test_a_log_that_claims_50_years(self, spec: MotorSpec, tmp_path: Path) -> None:
        """Its nights are bounded, whatever it says, and what is left out is told."""
        times = [EVENING - 30 * YEAR + number * dt.timedelta(days=7) for number in range(2600)]
        path = write(tmp_path / "a.csv", times)
        for record in (looked_at(path, spec), fully_read(path, spec)):
            assert 0 < len(record.nights) <= LONGEST_LOG_DAYS
            labels = labels_of(record)
            assert max(labels) - min(labels) <= LONGEST_LOG_DAYS * DAY
            assert "left out" in str(record.message)


class TestCovered:
    def test_only_nights_with_samples_count(self, spec: MotorSpec, tmp_path: Path) -> None:
        path = write(tmp_path / "a.csv", [*every_minute(), *every_minute(EVENING + 9 * DAY)])
        assert len(looked_at(path, spec).nights) == 10
        assert fully_read(path, spec).nights == ("2026-01-02", "2026-01-11")
        empty = covered(FileRecord("a.csv", 1, 1, "x"), RawLog({}, 0), spec)
        assert (empty.nights, empty.message) == ((), "no samples")

    def test_what_was_left_out(self, spec: MotorSpec, tmp_path: Path) -> None:
        rows = ["200.0,50.0,30.0,1.0"] * 57 + ["x,50.0,30.0,1.0", "1,2,3", "y,50.0,30.0,1.0"]
        record = fully_read(write(tmp_path / "a.csv", every_minute(), rows), spec)
        assert record.rows == 59
        assert "2 cells of pressure_difference without a number" in str(record.message)
        assert "too few cells" in str(record.message)


class TestSliceNight:
    HERE = night(LABEL, Nights())

    def log(self, *times: int, value: float = 1.0, unparsed: int = 0) -> RawLog:
        time = np.array(times, np.int64)
        blank = time % 2 == 1
        some = RawChannel(time, np.where(blank, np.nan, value), blank, unparsed)
        return RawLog({"speed": some}, len(times))

    def test_half_open(self) -> None:
        start, end = self.HERE.start_us, self.HERE.end_us
        log = self.log(start - 1, start, end - 1, end)
        found = slice_night([log], self.HERE, {})["speed"]
        assert found.time_us.tolist() == [start, end - 1]
        assert found.missing.tolist() == [False, True]

    def test_file_after_file(self) -> None:
        """In the order given, nothing sorted: backward time is for cleaning to refuse."""
        start = self.HERE.start_us
        parts = [
            self.log(start + 20, start + 30, value=1.0, unparsed=2),
            self.log(start + 10, start + 20, value=2.0, unparsed=3),
        ]
        found = slice_night(iter(parts), self.HERE, {})["speed"]
        assert (found.time_us - start).tolist() == [20, 30, 10, 20]
        assert found.value.tolist() == [1.0, 1.0, 2.0, 2.0]
        assert found.unparsed == 5
