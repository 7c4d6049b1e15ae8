"""A motor's files and nights: which are new, which belong together, and what is remembered."""

from __future__ import annotations

import datetime as dt
import os
import pickle
import shutil
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from polars.testing import assert_frame_equal

import pipeline.logs.locations
import pipeline.logs.motor_logs
import pipeline.run.motor_task
from pipeline.config import load_fleet
from pipeline.config.hashes import config_hash
from pipeline.ingest import RawLog, read_log
from pipeline.logs.files import find_logs, inspect_log, slice_night
from pipeline.logs.ledger import Ledger, NightRecord
from pipeline.logs.told_nights import PlausibleNights, place_failed
from pipeline.night.fit_night import NightOutcome, fit_night
from pipeline.run.motor_task import run_motor
from pipeline.run.plans import plan_fleet
from pipeline.run.request import RunRequest
from tests.pipeline.simulated import NIGHT, SECOND_US, night_of, raw, write_log
from tests.pipeline.workshop import DAY, MINUTES, QUICK, Workshop, check_same_figures


@pytest.fixture
def workshop(tmp_path: Path) -> Workshop:
    return Workshop.at(tmp_path)


@pytest.fixture
def other(tmp_path_factory: pytest.TempPathFactory) -> Workshop:
    return Workshop.at(tmp_path_factory.mktemp("other"))


def part(values: Mapping[str, Any], rows: slice) -> dict[str, Any]:
    return {name: value[rows] for name, value in values.items()}


# A night in several files


@pytest.mark.parametrize(
    "borders",
    [
        [731],  # inside a block
        [720],  # at its border
        [1, 1439],
        list(range(60, 1440, 60)),  # a file a minute
    ],
    ids=["inside-a-block", "at-a-border", "single-rows", "24-files"],
)
def test_a_night_in_several_files_is_the_same_night(
    workshop: Workshop, other: Workshop, borders: list[int]
) -> None:
    workshop.log(NIGHT)
    assert workshop.run().status == "ok"
    operation, values = other.night(NIGHT)
    for number, (first, last) in enumerate(zip([0, *borders], [*borders, 1440], strict=True)):
        rows = slice(first, last)
        # Names in another order than time.
        write_log(
            other.logs / f"{99 - number}.parquet", operation.time_us[rows], part(values, rows)
        )
    assert other.run().status == "ok"
    check_same_figures(workshop, other, "input_files")
    assert other.rows("input_files").height == len(borders) + 1


def test_a_file_that_comes_later_joins_its_night(workshop: Workshop, other: Workshop) -> None:
    workshop.log(NIGHT)
    workshop.run()
    operation, values = other.night(NIGHT)
    for name, rows in (("b", slice(700, None)), ("a", slice(0, 700))):
        write_log(other.logs / f"{name}.parquet", operation.time_us[rows], part(values, rows))
        outcome = other.run()
        assert outcome.nights == (NIGHT,)
    check_same_figures(workshop, other, "input_files")


def test_rows_that_two_files_share_count_once(workshop: Workshop, other: Workshop) -> None:
    workshop.log(NIGHT)
    workshop.run()
    operation, values = other.night(NIGHT)
    for name, rows in (("a", slice(0, 800)), ("b", slice(700, None))):
        write_log(other.logs / f"{name}.parquet", operation.time_us[rows], part(values, rows))
    assert other.run().status == "ok"
    check_same_figures(workshop, other, "input_files", "quality")


def test_the_same_content_twice_counts_once(workshop: Workshop, other: Workshop) -> None:
    workshop.log(NIGHT)
    workshop.run()
    other.log(NIGHT, "a.parquet")
    other.log(NIGHT, "copy of a.parquet")
    assert other.run().status == "ok"
    check_same_figures(workshop, other, "input_files", "quality")


def test_a_file_over_the_end_of_a_night_is_two_nights_and_one_file(workshop: Workshop) -> None:
    operation, values = workshop.night(NIGHT)
    later = operation.time_us + int((8 * 3600 - MINUTES * 30) * SECOND_US)
    write_log(workshop.logs / "a.parquet", later, values)
    outcome = workshop.run()
    assert outcome.nights == (NIGHT, NIGHT + DAY)
    assert workshop.statuses() == dict.fromkeys((NIGHT, NIGHT + DAY), "ok")
    files = workshop.rows("input_files")
    assert files.select("path", "night").rows() == [("M1/a.parquet", NIGHT)]
    blocks = workshop.rows("quality").filter(channel="time_base", reason="any")
    assert blocks["n_samples"].to_list() == [720, 720]


def test_overlapping_globs_find_a_file_once(workshop: Workshop) -> None:
    workshop.configure(files='"M1/*.parquet", "**/*.parquet", "M1/2026-03-02.parquet"')
    workshop.log(NIGHT)
    assert workshop.run().status == "ok"
    assert workshop.rows("input_files").height == 1


def test_each_file_is_read_once(workshop: Workshop, monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[str] = []

    def counted(path: Path, *source: Any) -> Any:
        read.append(path.name)
        return read_log(path, *source)

    monkeypatch.setattr(pipeline.logs.motor_logs, "read_log", counted)
    operation, values = workshop.night(NIGHT)
    half = int((8 * 3600 - MINUTES * 30) * SECOND_US)
    for day in range(4):  # each over the end of a night
        stamps = operation.time_us + half + day * 86_400 * SECOND_US
        write_log(workshop.logs / f"{day}.parquet", stamps, values)
    workshop.run()
    assert sorted(read) == [f"{day}.parquet" for day in range(4)]
    workshop.run()
    assert len(read) == 4


# What a change touches


def test_a_plan_reads_no_log(workshop: Workshop, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> Any:
        raise AssertionError("a log was read")

    workshop.log(NIGHT)
    monkeypatch.setattr(pipeline.logs.motor_logs, "read_log", refuse)
    request = RunRequest(load_fleet(workshop.fleet))
    assert [list(plan) for _, plan in plan_fleet(request)] == [[NIGHT]]


def test_a_night_is_judged_with_the_last_model_however_far(workshop: Workshop) -> None:
    """Night 2 stood still, so night 3 looks back on night 1: a corrected night 1 redoes both."""
    workshop.log(NIGHT)
    operation, values = workshop.night(NIGHT + DAY)
    values["speed"] = 0.1 + 1e-3 * np.sin(operation.pressure_bar)
    write_log(workshop.logs / f"{NIGHT + DAY}.parquet", operation.time_us, values)
    workshop.log(NIGHT + 2 * DAY)
    workshop.run()
    assert list(workshop.statuses().values()) == ["ok", "stood_still", "ok"]
    before = workshop.rows("fits")["previous_model_fit_percent"][2]
    # Another night 1, whose gap leaks three times as much.
    operation, values = workshop.night(NIGHT)
    values["leakage_flow"] = 3.0 * values["leakage_flow"]
    write_log(workshop.logs / f"{NIGHT}.parquet", operation.time_us, values)
    assert workshop.run().nights == (NIGHT, NIGHT + 2 * DAY)
    after = workshop.rows("fits")["previous_model_fit_percent"][2]
    assert after < before - 50.0


def test_a_night_that_loses_its_fit_is_no_model_any_more(
    workshop: Workshop, other: Workshop
) -> None:
    for label in (NIGHT, NIGHT + DAY, NIGHT + 2 * DAY):
        workshop.log(label, seed=label.day)
    workshop.run()
    # Night 2 turns out to hold too little: night 3 is judged with night 1's model instead.
    operation, values = workshop.night(NIGHT + DAY)
    rows = slice(0, 300)
    write_log(workshop.logs / f"{NIGHT + DAY}.parquet", operation.time_us[rows], part(values, rows))
    assert workshop.run().nights == (NIGHT + DAY, NIGHT + 2 * DAY)
    for path in sorted(workshop.logs.iterdir()):
        (other.logs / path.name).write_bytes(path.read_bytes())
    other.run()
    check_same_figures(workshop, other)


def test_a_file_that_moves_to_another_night_leaves_the_first(
    workshop: Workshop, other: Workshop
) -> None:
    workshop.log(NIGHT, "log.parquet")
    workshop.run()
    workshop.log(NIGHT + DAY, "log.parquet")
    # Asked for the new night alone, the old one must not be forgotten.
    assert workshop.run(since=NIGHT + DAY).nights == (NIGHT + DAY,)
    assert workshop.run().nights == (NIGHT, NIGHT + DAY)
    assert workshop.statuses() == {NIGHT: "no_new_data", NIGHT + DAY: "ok"}
    assert workshop.rows("input_files")["night"].to_list() == [NIGHT + DAY]
    assert workshop.run().nights == ()


@pytest.mark.parametrize(
    "order",
    [
        (2, 0, 1),
        pytest.param((0, 1, 2), marks=pytest.mark.full),
        pytest.param((2, 1, 0), marks=pytest.mark.full),
        pytest.param((1, 2, 0), marks=pytest.mark.full),
    ],
)
def test_nights_in_any_order_come_to_the_same(
    workshop: Workshop, other: Workshop, order: tuple[int, ...]
) -> None:
    labels = [NIGHT + day * DAY for day in range(3)]
    for label in labels:
        workshop.log(label, seed=label.day)
        other.log(label, seed=label.day)
    workshop.run()
    for day in order:
        other.run(since=labels[day], until=labels[day])
    other.run()
    check_same_figures(workshop, other)
    assert other.run().nights == ()


@pytest.mark.parametrize(
    "order",
    [
        (1, 2, 0),
        pytest.param((0, 1, 2), marks=pytest.mark.full),
        pytest.param((2, 1, 0), marks=pytest.mark.full),
    ],
)
def test_logs_in_any_order_come_to_the_same(
    workshop: Workshop, other: Workshop, order: tuple[int, ...]
) -> None:
    labels = [NIGHT + day * DAY for day in range(3)]
    for label in labels:
        workshop.log(label, seed=label.day)
    workshop.run()
    for day in order:
        other.log(labels[day], seed=labels[day].day)
        other.run()
    check_same_figures(workshop, other)


# Holes


def test_nights_without_a_log_between_two_with_one(workshop: Workshop) -> None:
    workshop.log(NIGHT)
    workshop.log(NIGHT + 5 * DAY)
    outcome = workshop.run()
    assert dict(outcome.counts) == {"ok": 2, "no_new_data": 4}
    assert outcome.status == "ok"
    assert list(workshop.statuses().values()) == ["ok", *["no_new_data"] * 4, "ok"]
    # A log that follows fills what lies between, too; what is told is not told again.
    workshop.log(NIGHT + 7 * DAY)
    assert workshop.run().nights == (NIGHT + 6 * DAY, NIGHT + 7 * DAY)


def test_a_lost_clock_does_not_make_decades_of_holes(workshop: Workshop) -> None:
    workshop.log(dt.date(2000, 1, 3))
    workshop.log(NIGHT)
    outcome = workshop.run()
    assert outcome.nights == (dt.date(2000, 1, 3), NIGHT)
    workshop.log(NIGHT + DAY)
    assert workshop.run().nights == (NIGHT + DAY,)


def test_a_file_placed_by_guess_makes_no_holes(workshop: Workshop) -> None:
    workshop.log(NIGHT)
    broken = workshop.logs / "latest.parquet"
    broken.write_bytes(b"PAR1 nonsense")
    seconds = dt.datetime(2026, 3, 20, 3, tzinfo=dt.UTC).timestamp()
    os.utime(broken, (seconds, seconds))
    outcome = workshop.run()
    assert outcome.nights == (NIGHT, dt.date(2026, 3, 20))
    assert "by when it was written" in (outcome.message or "")
    workshop.log(NIGHT + DAY)
    assert workshop.run().nights == (NIGHT + DAY,)
    assert len(workshop.statuses()) == 3


# Why there is nothing


def test_patterns_that_match_no_file_are_told(workshop: Workshop) -> None:
    workshop.configure(files='"M1/*.parquet", "M1/old/*.csv"')
    outcome = workshop.run()
    below = f"below {workshop.folder / 'logs'}"
    told = f"no file matches M1/*.parquet {below}; no file matches M1/old/*.csv {below}"
    assert (outcome.status, outcome.error_code, outcome.message) == ("no_new_data", None, told)
    workshop.log(NIGHT)
    assert workshop.run().message is None


def test_the_reason_of_nights_without_enough_data_is_told(workshop: Workshop) -> None:
    for label in (NIGHT, NIGHT + DAY):
        operation, values = workshop.night(label)
        values["speed"][::2] = 9999.0
        write_log(workshop.logs / f"{label}.parquet", operation.time_us, values)
    outcome = workshop.run()
    assert (outcome.status, outcome.error_code) == ("insufficient_data", None)
    assert (outcome.message or "").startswith(f"night {NIGHT}: only ")
    workshop.log(NIGHT + 2 * DAY)
    outcome = workshop.run()
    assert (outcome.status, outcome.message) == ("ok", None)


# Files that cannot be read


@pytest.mark.parametrize("lag", [-1, 0, 1])
def test_an_unreadable_file_fails_the_night_of_its_name(workshop: Workshop, lag: int) -> None:
    labels = [NIGHT + day * DAY for day in range(4)]
    for label in labels[:3]:
        workshop.log(label, f"M1_{label + lag * DAY}.parquet")
    (workshop.logs / f"M1_{labels[3] + lag * DAY}.parquet").write_bytes(b"nonsense" * 100)
    outcome = workshop.run()
    assert (outcome.status, outcome.error_code) == ("failed", "log_not_parquet")
    assert list(workshop.statuses().values()) == ["ok", "ok", "ok", "failed"]
    assert list(workshop.statuses()) == labels
    assert (outcome.message or "").count(str(labels[3])) == 1 + (lag == 0)
    assert "(night told by its name)" in (outcome.message or "")
    assert f"M1_{labels[3] + lag * DAY}.parquet" in (outcome.message or "")


def test_a_broken_file_fails_its_night_though_another_can_be_read(workshop: Workshop) -> None:
    workshop.log(NIGHT, f"a_{NIGHT}.parquet")
    (workshop.logs / f"b_{NIGHT}.parquet").write_bytes(b"nonsense" * 100)
    assert workshop.run().status == "failed"
    assert workshop.statuses() == {NIGHT: "failed"}
    assert workshop.rows("input_files")["status"].to_list() == ["ok", "failed"]


def test_a_broken_file_keeps_the_night_as_which_it_was_read_before(workshop: Workshop) -> None:
    path = workshop.log(NIGHT, "log.parquet")
    workshop.run()
    path.write_bytes(path.read_bytes()[:2000])
    outcome = workshop.run()
    assert outcome.nights == (NIGHT,)
    assert "by what it held before" in (outcome.message or "")
    assert workshop.statuses() == {NIGHT: "failed"}
    assert workshop.rows("parameters").is_empty()


def make_pipe(path: Path) -> None:
    os.mkfifo(path)


def make_folder(path: Path) -> None:
    path.mkdir()


def make_dangling_link(path: Path) -> None:
    path.symlink_to(path.parent / "nowhere")


@pytest.mark.parametrize("make", [make_pipe, make_folder, make_dangling_link])
def test_what_is_no_file_is_told_and_waited_for_by_nobody(
    workshop: Workshop, make: Callable[[Path], None]
) -> None:
    workshop.configure(files=f'"M1/{NIGHT}.parquet", "M1/odd_{NIGHT + DAY}*"')
    workshop.log(NIGHT)
    odd = workshop.logs / f"odd_{NIGHT + DAY}.parquet"
    make(odd)
    if odd.is_dir():
        # A glob that meets a folder goes on; one that is named is a fault.
        assert workshop.run().status == "ok"
        workshop.configure(files=f'"M1/{NIGHT}.parquet", "M1/odd_{NIGHT + DAY}.parquet"')
    for _ in range(2):  # for as long as it lies there
        outcome = workshop.run()
        assert (outcome.status, outcome.error_code) == ("failed", "log_not_readable")
        assert odd.name in (outcome.message or "")
    assert workshop.statuses() == {NIGHT: "ok", NIGHT + DAY: "failed"}
    odd.rmdir() if odd.is_dir() else odd.unlink()
    workshop.log(NIGHT + DAY, odd.name)
    assert workshop.run().nights == (NIGHT + DAY,)
    assert workshop.statuses() == {NIGHT: "ok", NIGHT + DAY: "ok"}


def test_a_file_that_could_not_be_opened_is_tried_again(
    workshop: Workshop, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Permissions leave size and time as they are, so these alone do not say "read before"."""
    workshop.log(NIGHT)

    def refused(path: Path) -> str:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("pipeline.logs.files.content_hash", refused)
    for _ in range(2):
        outcome = workshop.run()
        assert (outcome.status, outcome.error_code) == ("failed", "log_not_readable")
        assert f"{NIGHT}.parquet: Permission denied" in (outcome.message or "")
    monkeypatch.undo()
    assert workshop.run().status == "ok"
    assert workshop.statuses() == {NIGHT: "ok"}


def test_a_file_that_vanishes_while_it_is_looked_at(
    workshop: Workshop, monkeypatch: pytest.MonkeyPatch
) -> None:
    workshop.log(NIGHT)
    gone = workshop.logs / "gone.parquet"

    def with_gone(spec: Any, silent: Any) -> tuple[dict[str, Path], list[str]]:
        paths, absent = find_logs(spec, silent)
        return paths | {"M1/gone.parquet": gone}, absent

    monkeypatch.setattr(pipeline.logs.locations, "find_logs", with_gone)
    outcome = workshop.run()
    assert (outcome.status, outcome.error_code) == ("failed", "log_not_readable")
    assert outcome.nights == (NIGHT,)
    monkeypatch.undo()
    assert workshop.run().status == "no_new_data"


@pytest.mark.parametrize("rows", [0, 1])
def test_a_log_with_hardly_a_row(workshop: Workshop, rows: int) -> None:
    operation, values = workshop.night(NIGHT)
    path = workshop.logs / f"{NIGHT}.parquet"
    write_log(path, operation.time_us[:rows], part(values, slice(0, rows)))
    workshop.log(NIGHT + DAY)
    outcome = workshop.run()
    assert outcome.nights == (NIGHT, NIGHT + DAY)
    statuses = workshop.statuses()
    assert statuses[NIGHT + DAY] == "ok"
    assert statuses[NIGHT] == ("failed" if rows == 0 else "insufficient_data")


def test_a_name_that_is_no_utf8_costs_its_night_alone(workshop: Workshop) -> None:
    workshop.log(NIGHT)
    broken = workshop.logs / os.fsdecode(b"\xff " + str(NIGHT + DAY).encode() + b".parquet")
    broken.write_bytes(b"nonsense" * 100)
    outcome = workshop.run()
    assert workshop.statuses() == {NIGHT: "ok", NIGHT + DAY: "failed"}
    assert f"\\udcff {NIGHT + DAY}.parquet" in (outcome.message or "")
    paths = workshop.rows("input_files")["path"].to_list()
    assert paths == [f"M1/{NIGHT}.parquet", f"M1/\\udcff {NIGHT + DAY}.parquet"]
    assert workshop.run().nights == ()


# Faults of our own


def test_a_fault_of_ours_in_one_night_costs_that_night(
    workshop: Workshop, monkeypatch: pytest.MonkeyPatch
) -> None:

    def faulty(spec: Any, night: Any, channels: Any, previous: Any) -> NightOutcome:
        if night.date == NIGHT + DAY:
            raise ZeroDivisionError("not foreseen")
        return fit_night(spec, night, channels, previous)

    for day in range(3):
        workshop.log(NIGHT + day * DAY)
    monkeypatch.setattr(pipeline.run.motor_task, "fit_night", faulty)
    outcome = workshop.run()
    assert (outcome.status, outcome.error_code) == ("failed", "internal")
    assert f"night {NIGHT + DAY}: ZeroDivisionError: not foreseen" in (outcome.message or "")
    assert list(workshop.statuses().values()) == ["ok", "failed", "ok"]


def test_a_task_that_cannot_stage_is_lost_as_a_whole(workshop: Workshop) -> None:
    workshop.log(NIGHT)
    task = workshop.task()
    task.staging.rmdir()
    task.staging.write_text("in the way")
    outcome = run_motor(task)
    assert (outcome.status, outcome.error_code) == ("failed", "store_write")
    assert outcome.nights == ()


def test_tasks_and_outcomes_are_small_plain_data(workshop: Workshop) -> None:
    workshop.log(NIGHT)
    task = workshop.task()
    sent = pickle.dumps(task)
    assert len(sent) < 20_000
    assert config_hash(pickle.loads(sent).spec) == config_hash(task.spec)  # noqa: S301
    outcome = run_motor(task)
    returned = pickle.dumps(outcome)
    assert len(returned) < 5_000
    assert pickle.loads(returned) == outcome  # noqa: S301
    assert outcome.seconds.keys() >= {"read_s", "clean_s", "statistics_s", "fit_s", "store_s"}
    assert all(seconds >= 0.0 for seconds in outcome.seconds.values())


def test_a_task_writes_into_its_staging_and_nowhere_else(workshop: Workshop) -> None:
    workshop.log(NIGHT)
    before = {path for path in workshop.folder.rglob("*") if path.is_file()}
    task = workshop.task()
    run_motor(task)
    new = {path for path in workshop.folder.rglob("*") if path.is_file()} - before
    assert new
    assert all(path.is_relative_to(task.staging) for path in new)
    assert all("M1" in (path.stem, path.parent.name) for path in new)


# The ledger


def test_the_model_before_is_the_last_that_there_is() -> None:
    nights = {
        NIGHT: NightRecord("ok", {"none": (1.0,)}),
        NIGHT + DAY: NightRecord("stood_still"),
        NIGHT + 3 * DAY: NightRecord("ok", {"none": (2.0,)}),
    }
    ledger = Ledger({}, nights)
    found = [ledger.model_before(NIGHT + day * DAY) for day in range(5)]
    assert found == [{}, *[{"none": (1.0,)}] * 3, {"none": (2.0,)}]


def test_tables_that_somebody_removed_are_made_anew(workshop: Workshop) -> None:
    """The ledger stands beside the tables; it must not speak for tables that are gone."""
    for day in range(3):
        workshop.log(NIGHT + day * DAY, seed=day)
    workshop.run()
    before = workshop.rows("fits")
    for path in (workshop.output / "tables").rglob(f"{NIGHT + DAY}.parquet"):
        path.unlink()
    # Its fit is the same again, so nothing that looks back on it has to be done.
    assert workshop.run().nights == (NIGHT + DAY,)
    assert_frame_equal(workshop.rows("fits"), before, check_exact=True)
    shutil.rmtree(workshop.output / "tables")
    assert len(workshop.run().nights) == 3
    assert_frame_equal(workshop.rows("fits"), before, check_exact=True)


def test_settings_hash_is_of_what_shapes_figures(workshop: Workshop) -> None:
    before = config_hash(workshop.task().spec)
    (workshop.folder / "configs" / "fleet.toml").write_text(
        QUICK.replace("Tests", "Others").replace("sequential", "loky"), "utf-8"
    )
    assert config_hash(workshop.task().spec) == before
    moved = replace(workshop.task().spec, log_root=Path("/elsewhere"))
    assert config_hash(moved) == before
    for fleet in (QUICK + "[windows]\nblock_s = 60.0\n", QUICK + "[reference]\nspeed_rpm = 31.0\n"):
        workshop.configure(fleet=fleet)
        assert config_hash(workshop.task().spec) != before


def test_an_override_that_says_what_the_fleet_says_is_no_change(workshop: Workshop) -> None:
    before = config_hash(workshop.task().spec)
    workshop.configure(more="[override.windows]\nblock_s = 120.0\n")
    assert config_hash(workshop.task().spec) == before


# Single steps


def test_an_unchanged_file_is_not_even_hashed(
    workshop: Workshop, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, spec = workshop.log(NIGHT), workshop.task().spec
    record = inspect_log("M1/a", path, None, spec)
    assert (record.status, record.nights) == ("ok", (NIGHT.isoformat(),))

    def forbidden(_: Path) -> str:
        raise AssertionError

    monkeypatch.setattr("pipeline.logs.files.content_hash", forbidden)
    assert inspect_log("M1/a", path, record, spec) is record
    os.utime(path, ns=(5, 5))
    with pytest.raises(AssertionError):
        inspect_log("M1/a", path, record, spec)
    monkeypatch.undo()
    assert inspect_log("M1/a", path, record, spec) == replace(record, modified_ns=5)


def test_failed_files_are_placed_by_what_most_names_say(workshop: Workshop) -> None:
    spec = workshop.task().spec
    records = {}
    for day in range(3):
        label = NIGHT + day * DAY
        path = workshop.log(label, f"log-{label - DAY:%Y%m%d}.parquet")
        records[path.name] = inspect_log(path.name, path, None, spec)
    name = f"log-{NIGHT + 5 * DAY:%Y%m%d}.parquet"
    (workshop.logs / name).write_bytes(b"x")
    records[name] = inspect_log(name, workshop.logs / name, None, spec)
    placed = place_failed(records, {}, spec, PlausibleNights.of(records.values(), NIGHT + 9 * DAY))[
        name
    ]
    assert placed.nights == ((NIGHT + 6 * DAY).isoformat(),)


def test_a_night_is_cut_at_its_very_borders(workshop: Workshop) -> None:
    here = night_of(NIGHT)
    time_us = np.array([here.start_us - 1, here.start_us, here.end_us - 1, here.end_us])
    channel = raw(time_us, {"speed": np.arange(4.0)})
    log = RawLog(channel, 4, int(time_us[0]), int(time_us[-1]))
    assert slice_night([log], here)["speed"].value.tolist() == [1.0, 2.0]
    assert slice_night([log, log], here)["speed"].value.tolist() == [1.0, 2.0, 1.0, 2.0]
