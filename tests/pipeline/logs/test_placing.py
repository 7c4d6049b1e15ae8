"""Nights of log files that cannot be read."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.config import MotorSpec, Nights
from pipeline.config.nights import DAY, night_of
from pipeline.logs.files import labels_of
from pipeline.logs.ledger import FileRecord
from pipeline.logs.told_nights import PlausibleNights, place_failed
from tests.pipeline.logs.looked_at import EVENING, looked_at, us

LATEST = dt.date(2026, 6, 1)


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
