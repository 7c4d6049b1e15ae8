"""A motor's log files: finding them, their records, and the samples of a night."""

from __future__ import annotations

import datetime as dt
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.clock import microseconds
from pipeline.config import Channel, MotorSpec, Nights, load_fleet
from pipeline.config.logs import Logs
from pipeline.config.nights import DAY, night
from pipeline.demo import shipped_configs
from pipeline.errors import LogError
from pipeline.ingest import RawChannel, RawLog, read_log
from pipeline.logs.files import (
    LONGEST_LOG_DAYS,
    dated_otherwise,
    labels_of,
    slice_night,
    with_coverage,
    with_known_nights,
)
from pipeline.logs.finding import FolderLogs, find_logs
from pipeline.logs.processed import (
    GONE,
    FileRecord,
    NightRecord,
    ProcessedChange,
    ProcessedLogs,
    forget_nights,
    read_processed,
    stay_lines,
    write_change,
)
from pipeline.store.state import open_state

UNITS = {
    "pressure_difference": "bar",
    "oil_temperature": "degC",
    "speed": "rpm",
    "leakage_flow": "l/min",
}
EVENING = dt.datetime(2026, 1, 1, 22, tzinfo=dt.UTC)
LABEL = dt.date(2026, 1, 2)
MINUTE = dt.timedelta(minutes=1)
YEAR = dt.timedelta(days=365)


@pytest.fixture(scope="module")
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


def inspected(path: Path, spec: MotorSpec, before: FileRecord | None = None) -> FileRecord:
    name = path.relative_to(spec.log_root).as_posix()
    return FolderLogs(with_files(spec, name)).stat_log(name, before)


def us(time: dt.datetime) -> int:
    return int(time.timestamp()) * 1_000_000


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
    return with_coverage(inspected(path, spec), log, spec)


# Finding


def test_globs_and_names(spec: MotorSpec, tmp_path: Path) -> None:
    for name in ("b.csv", "a.csv", "old/c.csv", "old/older/d.csv", "e.txt", "a[1].csv"):
        write(tmp_path / name, every_minute(n=1))
    patterns = ("[ab].csv", "old/c.csv", "old/**/d.csv", "e.txt", "a[1].csv")
    found, *missing = find_logs(with_files(spec, *patterns))
    assert list(found) == ["a.csv", "a[1].csv", "b.csv", "e.txt", "old/c.csv", "old/older/d.csv"]
    assert found["old/c.csv"] == tmp_path / "old" / "c.csv"
    assert missing == [[], []]
    # A glob without a match is no fault, and an absent name is.
    for root in (tmp_path, tmp_path / "nowhere"):
        motor = replace(with_files(spec, "*.mcap", "named.csv", "folder/*.csv"), log_root=root)
        assert find_logs(motor) == ({}, ["named.csv"], ["*.mcap", "folder/*.csv"])


@pytest.mark.parametrize("pattern", ["M1_*.csv", "*1_?.csv", "M[12]_a.csv", "*", "M1_a.csv*"])
def test_a_folder_of_many_motors_is_listed_once(
    spec: MotorSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pattern: str
) -> None:
    for name in ("M1_a.csv", "M1_b.csv", "M2_a.csv", ".M1_c.csv", "m1_a.csv"):
        write(tmp_path / name, every_minute(n=1))
    os.utime(tmp_path, (1, 1))
    listed, scandir = [], os.scandir
    monkeypatch.setattr(os, "scandir", lambda path: listed.append(path) or scandir(path))
    for _ in range(3):
        found, *_ = find_logs(with_files(spec, pattern))
    assert listed == [tmp_path]
    monkeypatch.undo()
    hidden = {tmp_path / ".M1_c.csv"}
    assert set(found.values()) == set(tmp_path.glob(pattern)) - hidden
    # One more is seen at once.
    write(tmp_path / "M1_x.csv", every_minute(n=1))
    found, *_ = find_logs(with_files(spec, pattern))
    assert set(found.values()) == set(tmp_path.glob(pattern)) - hidden


# Records


def test_nights_are_those_of_the_fleet_s_zone(spec: MotorSpec, tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", every_minute(EVENING.replace(hour=5)))
    assert inspected(path, spec).nights == ("2026-01-01",)
    oslo = spec.settings.model_copy(update={"nights": Nights(time_zone="Europe/Oslo")})
    assert inspected(path, replace(spec, settings=oslo)).nights == ("2026-01-02",)


@pytest.mark.parametrize("at", [0, 1, 58, 59])
@pytest.mark.parametrize("off", [-30 * YEAR, 30 * YEAR, 100 * YEAR])
def test_a_clock_that_was_wrong_for_a_moment_makes_no_nights(
    spec: MotorSpec, tmp_path: Path, at: int, off: dt.timedelta
) -> None:
    times = every_minute()
    times[at] += off
    path = write(tmp_path / "a.csv", times)
    record = fully_read(path, spec)
    assert inspected(path, spec).nights == record.nights == (LABEL.isoformat(),)
    assert record.status == "ok"
    true = sorted(set(every_minute()) & set(times))
    assert (record.first_us, record.last_us) == (us(true[0]), us(true[-1]))
    ahead = "1 row with a time more than a day in the future"
    assert ("1 time stamp over a year" if off.days < 0 else ahead) in str(record.message)


def test_the_nights_of_a_log_that_claims_50_years_are_bounded(
    spec: MotorSpec, tmp_path: Path
) -> None:
    times = [EVENING - 30 * YEAR + number * dt.timedelta(days=7) for number in range(2600)]
    path = write(tmp_path / "a.csv", times)
    for record in (inspected(path, spec), fully_read(path, spec)):
        labels = labels_of(record)
        assert 0 < len(labels) <= LONGEST_LOG_DAYS
        assert max(labels) - min(labels) <= LONGEST_LOG_DAYS * DAY
        assert "left out" in str(record.message)


def test_only_nights_with_samples_count(spec: MotorSpec, tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", [*every_minute(), *every_minute(EVENING + 9 * DAY)])
    assert len(inspected(path, spec).nights) == 10
    assert fully_read(path, spec).nights == ("2026-01-02", "2026-01-11")
    empty = with_coverage(FileRecord("a.csv", 1, 1, "x"), RawLog({}, 0), spec)
    header = inspected(write(tmp_path / "b.csv", []), spec)
    for record in (empty, header):
        assert (record.status, record.nights, record.message) == ("ok", (), "no samples")


def test_what_was_left_out(spec: MotorSpec, tmp_path: Path) -> None:
    rows = ["200.0,50.0,30.0,1.0"] * 57 + ["x,50.0,30.0,1.0", "1,2,3", "y,50.0,30.0,1.0"]
    record = fully_read(write(tmp_path / "a.csv", every_minute(), rows), spec)
    assert record.rows == 59
    assert "2 cells of pressure_difference without a number, such as 'x'" in str(record.message)
    assert "too few cells" in str(record.message)
    record = fully_read(write(tmp_path / "b.csv", every_minute(n=5), ["2,,30,1"] * 5), spec)
    assert (record.status, record.message) == ("ok", "all 5 cells of oil_temperature are blank")
    with pytest.raises(LogError, match="all 5 cells of leakage_flow are blank") as raised:
        fully_read(write(tmp_path / "c.csv", every_minute(n=5), [",,,"] * 5), spec)
    assert (raised.value.code, raised.value.place) == ("log_empty", "pressure_difference")


@pytest.mark.parametrize(("days", "is_odd"), [(0, False), (5, False), (7305, True)])
def test_names_may_all_be_days_beside_their_stamps_and_not_years(days: int, is_odd: bool) -> None:
    records = {}
    for at in range(3):
        name, stamp_us = f"2026-01-0{at + 1}.csv", microseconds(EVENING + (at - days) * DAY)
        records[name] = FileRecord(name, 1, 1, "x", first_us=stamp_us, last_us=stamp_us)
    assert list(dated_otherwise(records)) == (list(records) if is_odd else [])


# Samples of a night

HERE = night(LABEL, Nights())


def log_at(*times: int, value: float = 1.0, unparsed: int = 0) -> RawLog:
    time = np.array(times, np.int64)
    blank = time % 2 == 1
    some = RawChannel(time, np.where(blank, np.nan, value), blank, unparsed)
    return RawLog({"speed": some}, len(times))


def test_a_night_is_half_open() -> None:
    start, end = HERE.start_us, HERE.end_us
    found = slice_night([log_at(start - 1, start, end - 1, end)], HERE, {})["speed"]
    assert found.time_us.tolist() == [start, end - 1]
    assert found.missing.tolist() == [False, True]


def test_a_forgotten_night_is_forgotten_with_its_files(tmp_path: Path) -> None:
    """But for one with a fit, whose log may be gone."""
    nights = {LABEL: NightRecord("ok"), LABEL + DAY: NightRecord("stood_still")}
    file = FileRecord("A/1.csv", 2**60, 17, "ab" * 32, nights=("2026-01-02",), message="a\nb'%")
    known = ProcessedLogs({file.path: file}, nights, {"reference": {"leakage": 0.1 + 0.2}})
    with open_state(tmp_path) as state:
        write_change(state, "A", ProcessedChange.between(read_processed(state, "A"), known))
        assert read_processed(state, "A") == known
        assert forget_nights(state, set(nights)) == {"A": {LABEL}}
        left = ProcessedLogs({}, {LABEL: nights[LABEL]}, known.settings)
        assert read_processed(state, "A") == left


# Nights of files that cannot be read


LATEST = dt.date(2026, 6, 1)


def failed(name: str) -> FileRecord:
    return FileRecord(name, 10, 1, "x", status="failed", message="torn")


def readable(name: str, *nights: str) -> FileRecord:
    return FileRecord(name, 10, 1, "y", nights=nights)


def placed(*records: FileRecord, before: Sequence[FileRecord] = ()) -> dict[str, FileRecord]:
    known = {record.path: record for record in before}
    return with_known_nights({record.path: record for record in records}, known, LATEST)


def test_as_read_before() -> None:
    """A log that was cut after it had been read: the nights that it had, whatever its name."""
    name = "a_2026-02-20.csv"
    before = readable(name, "2026-01-05", "2026-01-06")
    record = placed(failed(name), before=[before])[name]
    assert record.nights == ("2026-01-05", "2026-01-06")
    assert record.message == "torn (night known by what it held before)"
    # The next run finds it as this one left it.
    assert placed(record, before=[record])[name] == record


@pytest.mark.parametrize(
    ("name", "date"),
    [
        ("2026-03-04.csv", "2026-03-04"),
        ("M1_2026.03.04_220000.csv", "2026-03-04"),
        ("x/20260304T220000Z.mcap", "2026-03-04"),
        ("since_2020-01-01/2026-03-04.csv", "2026-03-04"),  # the last date counts
        # Digits within a longer number, such as seconds since 1970, are no date.
        *((name, None) for name in ("log.csv", "1720101005.csv", "2026-02-30.csv", "M20.csv")),
        ("serial-120260304.csv", None),
        ("2026-06-01.csv", "2026-06-01"),
        ("2026-06-02.csv", None),  # after the latest
    ],
)
def test_dates_in_names(name: str, date: str | None) -> None:
    assert placed(failed(name))[name].nights == ((date,) if date else ())


@pytest.mark.parametrize(
    ("night", "is_plausible"),
    [("2025-11-30", False), ("2025-12-01", True), ("2026-02-10", True), ("2026-02-11", False)],
)
def test_a_night_is_near_the_others(night: str, is_plausible: bool) -> None:
    """Within 31 days of the motor's readable logs, present or remembered, of 1 to 10 January.

    Files here are named after the evening on which they begin, but for one.
    """
    evening = dt.date.fromisoformat(night) - dt.timedelta(days=1)
    name = f"x_{evening}.csv"
    neighbours = [readable(f"m/2026010{day}.csv", f"2026-01-0{day + 1}") for day in (1, 2, 3)]
    strange, before = readable("m/20260104.csv", "2026-01-01"), readable("9", "2026-01-10")
    record = placed(*neighbours, strange, failed(name), before=[before])[name]
    assert record.nights == ((night,) if is_plausible else ())
    assert (record.message == "torn (night known by its name)") == is_plausible


def test_nights_that_stay_for_like_reasons_take_a_line() -> None:
    nights = [dt.date(2026, 1, day) for day in range(1, 5)]
    held = "its logs hold {} samples now, and held {}"
    whys = [held.format(480, 2400), held.format(479, 2395), GONE, held.format(480, 2400)]
    first, second = stay_lines(dict(zip(nights, whys, strict=True)))
    assert first == f"as published 3 nights, {nights[0]} to {nights[3]}: {whys[0]} ({nights[0]})"
    assert second == f"as published 1 night, {nights[2]}: {GONE}"
