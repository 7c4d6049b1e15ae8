"""A motor's files and nights: which are new, which belong together, and what is remembered."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pipeline.logs.locations
import pipeline.logs.motor_logs
import pipeline.run.motor_task
from pipeline.ingest import read_log
from tests.pipeline.simulated import NIGHT, SECOND_US, write_log
from tests.pipeline.workshop import DAY, MINUTES, Workshop, check_same_figures, part


@pytest.fixture
def other(tmp_path_factory: pytest.TempPathFactory) -> Workshop:
    return Workshop.at(tmp_path_factory.mktemp("other"))


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
    check_same_figures(workshop, other, "log_files")
    assert other.rows("log_files").height == len(borders) + 1


def test_rows_that_two_files_share_count_once(workshop: Workshop, other: Workshop) -> None:
    workshop.log(NIGHT)
    workshop.run()
    operation, values = other.night(NIGHT)
    for name, rows in (("a", slice(0, 800)), ("b", slice(700, None))):
        write_log(other.logs / f"{name}.parquet", operation.time_us[rows], part(values, rows))
    assert other.run().status == "ok"
    check_same_figures(workshop, other, "log_files", "quality")


def test_a_file_over_the_end_of_a_night_is_two_nights_and_one_file(workshop: Workshop) -> None:
    operation, values = workshop.night(NIGHT)
    later = operation.time_us + int((8 * 3600 - MINUTES * 30) * SECOND_US)
    write_log(workshop.logs / "a.parquet", later, values)
    outcome = workshop.run()
    assert outcome.nights == (NIGHT, NIGHT + DAY)
    assert workshop.statuses() == dict.fromkeys((NIGHT, NIGHT + DAY), "ok")
    files = workshop.rows("log_files")
    assert files.select("path", "night").rows() == [("M1/a.parquet", NIGHT)]
    blocks = workshop.rows("quality").filter(channel="time_base", reason="any")
    assert blocks["n_samples"].to_list() == [720, 720]


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


def test_a_night_is_judged_with_the_last_model_however_far(workshop: Workshop) -> None:
    """Night 2 stood still, so night 3 looks back on night 1, also where that is corrected."""
    workshop.log(NIGHT)
    operation, values = workshop.night(NIGHT + DAY)
    values["speed"] = 0.1 + 1e-3 * np.sin(operation.pressure_bar)
    write_log(workshop.logs / f"{NIGHT + DAY}.parquet", operation.time_us, values)
    workshop.log(NIGHT + 2 * DAY)
    workshop.run()
    assert list(workshop.statuses().values()) == ["ok", "stood_still", "ok"]
    before = workshop.rows("nights")["previous_model_fit_percent"][2]
    # Another night 1, whose gap leaks three times as much.
    operation, values = workshop.night(NIGHT)
    values["leakage_flow"] = 3.0 * values["leakage_flow"]
    write_log(workshop.logs / f"{NIGHT}.parquet", operation.time_us, values)
    assert workshop.run().nights == (NIGHT,)
    after = workshop.rows("nights")["previous_model_fit_percent"][2]
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
    assert workshop.run(redo=(NIGHT + DAY, NIGHT + DAY)).nights == (NIGHT + DAY,)
    for path in sorted(workshop.logs.iterdir()):
        (other.logs / path.name).write_bytes(path.read_bytes())
    other.run()
    check_same_figures(workshop, other)


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


# The record of processed logs
