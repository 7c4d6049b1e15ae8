"""A motor's log files: finding them, their records, and the samples of a night."""

from __future__ import annotations

import datetime as dt
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.config import Channel, MotorSpec, Nights, load_fleet
from pipeline.config.logs import Logs
from pipeline.config.nights import DAY, Night, night, night_of
from pipeline.demo import shipped_configs
from pipeline.ingest import RawChannel, RawLog, read_log
from pipeline.logs import files as logs
from pipeline.logs.files import (
    LONGEST_LOG_DAYS,
    covered,
    find_logs,
    inspect_log,
    labels_of,
    slice_night,
)
from pipeline.logs.ledger import FileRecord, content_hash
from pipeline.logs.told_nights import PlausibleNights, place_failed
from pipeline.messages import counted

UNITS = {
    "pressure_difference": "bar",
    "oil_temperature": "degC",
    "speed": "rpm",
    "leakage_flow": "l/min",
}
EVENING = dt.datetime(2026, 1, 1, 22, tzinfo=dt.UTC)
LABEL = dt.date(2026, 1, 2)
LATEST = dt.date(2026, 6, 1)
MINUTE = dt.timedelta(minutes=1)
YEAR = dt.timedelta(days=365)


@pytest.fixture(scope="session")
def shipped() -> MotorSpec:
    return load_fleet(shipped_configs() / "fleet.toml").motors[0]


@pytest.fixture
def spec(shipped: MotorSpec, tmp_path: Path) -> MotorSpec:
    """A motor with CSV logs below the test's folder, nights of UTC that end at 6."""
    return with_files(replace(shipped, log_root=tmp_path), "*.csv")


def with_files(spec: MotorSpec, *files: str) -> MotorSpec:
    channels = {name: Channel(source=name, unit=unit) for name, unit in UNITS.items()}
    update = {"logs": Logs(format="csv", files=files), "channels": channels}
    return replace(spec, file=spec.file.model_copy(update=update))


def write(path: Path, times: Sequence[dt.datetime], rows: Sequence[str] | None = None) -> Path:
    """A CSV with a row at each time."""
    path.parent.mkdir(parents=True, exist_ok=True)
    cells = rows or ["200.0,50.0,30.0,1.0"] * len(times)
    lines = [f"{time.isoformat()},{some}" for time, some in zip(times, cells, strict=True)]
    path.write_text("\n".join(["time," + ",".join(UNITS), *lines]) + "\n")
    return path


def every_minute(begin: dt.datetime = EVENING, n: int = 60) -> list[dt.datetime]:
    return [begin + number * MINUTE for number in range(n)]


def looked_at(path: Path, spec: MotorSpec, before: FileRecord | None = None) -> FileRecord:
    return inspect_log(path.relative_to(spec.log_root).as_posix(), path, before, spec)


def fully_read(path: Path, spec: MotorSpec) -> FileRecord:
    log = read_log(path, spec.file.logs, spec.file.channels)
    return covered(looked_at(path, spec), log, spec)


def us(time: dt.datetime) -> int:
    return int(time.timestamp()) * 1_000_000


class TestFind:
    def test_globs_and_names(self, spec: MotorSpec, tmp_path: Path) -> None:
        for name in ("b.csv", "a.csv", "old/c.csv", "old/older/d.csv", "e.txt"):
            write(tmp_path / name, every_minute(n=1))
        found, absent = find_logs(with_files(spec, "*.csv", "old/c.csv", "old/**/d.csv", "e.txt"))
        assert list(found) == ["a.csv", "b.csv", "e.txt", "old/c.csv", "old/older/d.csv"]
        assert found["old/c.csv"] == tmp_path / "old" / "c.csv"
        assert absent == []

    def test_file_that_two_patterns_find_is_read_once(
        self, spec: MotorSpec, tmp_path: Path
    ) -> None:
        write(tmp_path / "a.csv", every_minute(n=1))
        found, _ = find_logs(with_files(spec, "*.csv", "a.csv", "a*", "**/*.csv"))
        assert list(found) == ["a.csv"]

    def test_glob_without_a_match_is_no_fault_and_an_absent_name_is(self, spec: MotorSpec) -> None:
        found, absent = find_logs(with_files(spec, "*.csv", "named.csv", "folder/*.csv"))
        assert found == {}
        assert absent == ["named.csv"]

    def test_a_file_named_like_a_glob_is_the_file(self, spec: MotorSpec, tmp_path: Path) -> None:
        path = write(tmp_path / "a[1].csv", every_minute())
        write(tmp_path / "a1.csv", every_minute())
        found, absent = find_logs(with_files(spec, "a[1].csv"))
        assert (list(found.values()), absent) == ([path], [])

    def test_a_glob_takes_no_folders(self, spec: MotorSpec, tmp_path: Path) -> None:
        (tmp_path / "folder.csv").mkdir()
        assert find_logs(spec) == ({}, [])

    def test_a_root_that_is_not_there(self, spec: MotorSpec, tmp_path: Path) -> None:
        gone = replace(with_files(spec, "*.csv", "a.csv"), log_root=tmp_path / "nowhere")
        assert find_logs(gone) == ({}, ["a.csv"])


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

    def test_same_content_is_as_before(self, spec: MotorSpec, tmp_path: Path) -> None:
        """A copy of the whole archive to another disk makes nothing new."""
        path = write(tmp_path / "a.csv", every_minute())
        before = fully_read(path, spec)
        os.utime(path, ns=(1, 2))
        assert looked_at(path, spec, before) == replace(before, modified_ns=2)

    def test_other_content_is_looked_at(self, spec: MotorSpec, tmp_path: Path) -> None:
        path = write(tmp_path / "a.csv", every_minute())
        before = looked_at(path, spec)
        write(path, every_minute(EVENING + DAY, 61))
        now = looked_at(path, spec, before)
        assert now.nights == ("2026-01-03",)
        assert now.sha256 != before.sha256

    @pytest.mark.parametrize("content", [b"", b"\0" * 5000, b"no log\n", b"PAR1" * 9])
    def test_no_log(self, spec: MotorSpec, tmp_path: Path, content: bytes) -> None:
        path = tmp_path / "a.csv"
        path.write_bytes(content)
        record = looked_at(path, spec)
        assert record.status == "failed"
        assert record.error_code
        assert "a.csv" in str(record.message)
        assert record.sha256 == content_hash(path)

    def test_file_that_may_not_be_read(
        self, spec: MotorSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """A row that says so, not an end of the whole motor; and it is tried again next time."""
        path = write(tmp_path / "a.csv", every_minute())

        def refuse(_: Path) -> str:
            raise PermissionError(13, "Permission denied")

        with monkeypatch.context() as patch:
            patch.setattr(logs, "content_hash", refuse)
            record = looked_at(path, spec)
        assert (record.status, record.error_code) == ("failed", "log_not_readable")
        assert "Permission denied" in str(record.message)
        assert record.sha256 is None
        assert looked_at(path, spec, record).status == "ok"

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

    def test_a_clock_set_right_at_half_time(self, spec: MotorSpec, tmp_path: Path) -> None:
        """As many stamps before as after: one side is taken, and the record says so."""
        for n in (1, 30):
            wrong = every_minute(EVENING - 10 * YEAR, n)
            path = write(tmp_path / "a.csv", [*wrong, *every_minute(n=n)])
            record = fully_read(path, spec)
            assert record.nights == (LABEL.isoformat(),)
            assert counted(n, "time stamp") in str(record.message)

    def test_a_log_that_claims_50_years(self, spec: MotorSpec, tmp_path: Path) -> None:
        """Its nights are bounded, whatever it says, and what is left out is told."""
        times = [EVENING - 30 * YEAR + number * dt.timedelta(days=7) for number in range(2600)]
        path = write(tmp_path / "a.csv", times)
        for record in (looked_at(path, spec), fully_read(path, spec)):
            assert 0 < len(record.nights) <= LONGEST_LOG_DAYS
            labels = labels_of(record)
            assert max(labels) - min(labels) <= LONGEST_LOG_DAYS * DAY
            assert "left out" in str(record.message)

    def test_only_nights_with_samples_count(self, spec: MotorSpec, tmp_path: Path) -> None:
        path = write(tmp_path / "a.csv", [*every_minute(), *every_minute(EVENING + 9 * DAY)])
        assert len(looked_at(path, spec).nights) == 10
        assert fully_read(path, spec).nights == ("2026-01-02", "2026-01-11")


class TestCovered:
    def test_what_was_left_out(self, spec: MotorSpec, tmp_path: Path) -> None:
        rows = ["200.0,50.0,30.0,1.0"] * 57 + ["x,50.0,30.0,1.0", "1,2,3", "y,50.0,30.0,1.0"]
        record = fully_read(write(tmp_path / "a.csv", every_minute(), rows), spec)
        assert record.rows == 59
        assert "2 cells of pressure_difference without a number" in str(record.message)
        assert "too few cells" in str(record.message)

    def test_a_clean_log_has_nothing_to_tell(self, spec: MotorSpec, tmp_path: Path) -> None:
        record = fully_read(write(tmp_path / "a.csv", every_minute()), spec)
        assert (record.rows, record.message) == (60, None)

    def test_log_without_samples(self, spec: MotorSpec) -> None:
        none = RawChannel(np.zeros(0, np.int64), np.zeros(0), np.zeros(0, np.bool_), 0)
        record = covered(
            FileRecord("a.csv", 1, 1, "x"), RawLog({"speed": none}, 0, None, None), spec
        )
        assert record.nights == ()
        assert record.message == "no samples"


class TestPlaceFailed:
    """A file that cannot be read costs the night that it would have been of, and no other."""

    def failed(self, name: str, modified: dt.datetime = EVENING + 9 * DAY) -> FileRecord:
        return FileRecord(name, 10, us(modified) * 1000, "x", status="failed", message="torn")

    def placed(
        self,
        spec: MotorSpec,
        *records: FileRecord,
        before: Sequence[FileRecord] = (),
        latest: dt.date = LATEST,
    ) -> dict[str, FileRecord]:
        by_name = {record.path: record for record in records}
        known = {record.path: record for record in before}
        return place_failed(by_name, known, spec, PlausibleNights.of((*records, *before), latest))

    def readable(self, name: str, *nights: str) -> FileRecord:
        return FileRecord(name, 10, 1, "y", nights=nights)

    def test_as_read_before(self, spec: MotorSpec) -> None:
        """A log that was cut after it had been read: the nights that it had."""
        name = "a_2026-02-20.csv"
        before = self.readable(name, "2026-01-05", "2026-01-06")
        record = self.placed(spec, self.failed(name), before=[before])[name]
        assert record.nights == ("2026-01-05", "2026-01-06")
        assert record.message == "torn (night told by what it held before)"

    def test_by_its_name_and_its_neighbours(self, spec: MotorSpec) -> None:
        """Files here are named after the evening on which they begin."""
        neighbours = [
            self.readable(f"m/2026010{day}.csv", f"2026-01-0{day + 1}") for day in (1, 2, 3)
        ]
        strange = self.readable("m/20260104.csv", "2026-01-09")
        name = "m/20260131.csv"
        record = self.placed(spec, *neighbours, strange, self.failed(name))[name]
        assert record.nights == ("2026-02-01",)
        assert str(record.message).endswith("(night told by its name)")

    def test_by_its_name_alone(self, spec: MotorSpec) -> None:
        for name in (
            "2026-03-04.csv",
            "M1_2026.03.04_220000.csv",
            "x/20260304T220000Z.mcap",
            "since_2020-01-01/2026-03-04.csv",  # the last date counts
        ):
            assert self.placed(spec, self.failed(name))[name].nights == ("2026-03-04",)

    @pytest.mark.parametrize(
        "name", ["log.csv", "1720101005.csv", "2026-02-30.csv", "M20.csv", "serial-120260304.csv"]
    )
    def test_by_when_it_was_written(self, spec: MotorSpec, name: str) -> None:
        """Digits within a longer number, such as seconds since 1970, are no date."""
        record = self.placed(spec, self.failed(name))[name]
        assert record.nights == ("2026-01-11",)
        assert str(record.message).endswith("(night told by when it was written)")

    def test_readable_and_placed_ones_stay(self, spec: MotorSpec) -> None:
        records = [
            self.readable("a.csv", "2026-01-05"),
            replace(self.failed("b.csv"), nights=("2026-01-06",)),
            self.readable("c.csv"),
        ]
        assert list(self.placed(spec, *records).values()) == records

    @pytest.mark.parametrize(
        ("name", "modified", "why"),
        [
            ("x_2099-01-01.csv", EVENING, "more than a day ahead"),
            ("x_2026-06-02.csv", EVENING, "more than a day ahead"),
            ("x.csv", dt.datetime(2099, 1, 1, tzinfo=dt.UTC), "more than a day ahead"),
            ("x_2026-02-10.csv", EVENING, "more than 31 days from those of the motor's other"),
            ("x_2025-11-30.csv", EVENING, "more than 31 days from those of the motor's other"),
            ("x.csv", dt.datetime(2026, 2, 9, 22, tzinfo=dt.UTC), "more than 31 days from"),
        ],
    )
    def test_a_night_far_off_is_none(
        self, spec: MotorSpec, name: str, modified: dt.datetime, why: str
    ) -> None:
        """The motor's readable logs are of 1 to 9 January."""
        others = [self.readable(f"{day}.csv", f"2026-01-0{day}") for day in (1, 5, 9)]
        record = self.placed(spec, *others, self.failed(name, modified))[name]
        assert record.nights == ()
        assert str(record.message).startswith("torn (told by ")
        assert why in str(record.message)
        # The next run finds it as this one left it.
        assert self.placed(spec, *others, record, before=[record])[name] == record

    @pytest.mark.parametrize("label", ["2025-12-01", "2025-12-31", "2026-01-10", "2026-02-09"])
    def test_a_night_near_the_others_is_one(self, spec: MotorSpec, label: str) -> None:
        others = [self.readable(f"{day}.csv", f"2026-01-0{day}") for day in (1, 9)]
        assert self.placed(spec, *others, self.failed(f"x_{label}.csv"))[
            f"x_{label}.csv"
        ].nights == (label,)

    def test_logs_of_before_are_the_motors_too(self, spec: MotorSpec) -> None:
        """The logger's folder may hold the newest log alone."""
        gone = self.readable("old.csv", "2026-01-01")
        for label, nights in (("2026-01-20", ("2026-01-20",)), ("2026-03-01", ())):
            name = f"x_{label}.csv"
            assert self.placed(spec, self.failed(name), before=[gone])[name].nights == nights

    def test_what_a_run_before_told_is_judged_anew(self, spec: MotorSpec) -> None:
        told = replace(
            self.failed("x_2099-01-01.csv"),
            nights=("2099-01-01",),
            message="torn (night told by its name)",
        )
        record = self.placed(spec, told, before=[told])[told.path]
        assert record.nights == ()
        assert record.message == (
            "torn (told by its name, its night would lie more than a day ahead: it is of none)"
        )

    def test_a_time_that_no_date_can_say(self, spec: MotorSpec) -> None:
        record = replace(self.failed("x.csv"), modified_ns=2**63 - 1)
        assert self.placed(spec, record)["x.csv"].nights == ()
        year_60_000 = replace(record, modified_ns=10**9 * 86_400 * 365 * 58_000)
        assert self.placed(spec, year_60_000)["x.csv"].nights == ()

    def test_one_that_did_not_answer_is_told_by_its_name(self, spec: MotorSpec) -> None:
        """Nobody knows when it was written."""
        for name, nights in (("x_2026-01-04.csv", ("2026-01-04",)), ("x.csv", ())):
            record = FileRecord(name, 0, 0, None, status="failed", error_code="log_no_answer")
            assert self.placed(spec, record)[name].nights == nights

    def test_one_that_vanished_is_of_no_night(self, spec: MotorSpec, tmp_path: Path) -> None:
        record = looked_at(tmp_path / "vanished.csv", spec)
        assert self.placed(spec, record)["vanished.csv"].nights == ()

    def test_an_unreadable_file_is_not_of_1970(self, spec: MotorSpec, tmp_path: Path) -> None:
        (tmp_path / "folder").mkdir()
        (tmp_path / "link").symlink_to(tmp_path / "gone")
        for name in ("folder", "link"):
            today = night_of(us(dt.datetime.now(dt.UTC)), Nights())
            placed = self.placed(spec, looked_at(tmp_path / name, spec), latest=today + DAY)
            (label,) = labels_of(placed[name])
            assert abs(label - today) <= DAY


class TestSliceNight:
    HERE = night(LABEL, Nights())

    def log(self, *times: int, value: float = 1.0, unparsed: int = 0) -> RawLog:
        time = np.array(times, np.int64)
        blank = time % 2 == 1
        some = RawChannel(time, np.where(blank, np.nan, value), blank, unparsed)
        return RawLog({"speed": some}, len(times), None, None)

    def test_half_open(self) -> None:
        start, end = self.HERE.start_us, self.HERE.end_us
        log = self.log(start - 1, start, end - 1, end)
        found = slice_night([log], self.HERE)["speed"]
        assert found.time_us.tolist() == [start, end - 1]
        assert found.missing.tolist() == [False, True]

    def test_file_after_file(self) -> None:
        """In the order given, nothing sorted: backward time is for cleaning to refuse."""
        start = self.HERE.start_us
        parts = [
            self.log(start + 20, start + 30, value=1.0, unparsed=2),
            self.log(start + 10, start + 20, value=2.0, unparsed=3),
        ]
        found = slice_night(iter(parts), self.HERE)["speed"]
        assert (found.time_us - start).tolist() == [20, 30, 10, 20]
        assert found.value.tolist() == [1.0, 1.0, 2.0, 2.0]
        assert found.unparsed == 5

    def test_no_logs_and_no_samples(self) -> None:
        assert slice_night([], self.HERE) == {}
        found = slice_night([self.log(5, 6)], self.HERE)["speed"]
        assert len(found.time_us) == len(found.value) == len(found.missing) == 0

    @given(st.lists(st.integers(0, 3 * 86_400), max_size=50))
    def test_every_sample_is_in_one_night(self, seconds: list[int]) -> None:
        time = [self.HERE.start_us + second * 1_000_000 for second in seconds]
        nights = [night(LABEL + number * DAY, Nights()) for number in range(4)]
        found = [moment for here in nights for moment in self.sliced(time, here)]
        assert sorted(found) == sorted(time)

    def sliced(self, time: list[int], here: Night) -> list[int]:
        found: list[int] = slice_night([self.log(*time)], here)["speed"].time_us.tolist()
        return found
