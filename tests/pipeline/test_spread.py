"""A motor with many nights in parts: what it gives is what it gives in one."""

from __future__ import annotations

import datetime as dt
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pipeline.motor_task
from pipeline.config import Execution, load_fleet
from pipeline.engine import nights_a_part
from pipeline.fleet import RunRequest, run_fleet
from pipeline.motor_task import (
    MotorOutcome,
    MotorTask,
    PartTask,
    SplitMotor,
    run_motor,
    run_part,
)
from pipeline.spread import run_motors
from tests.pipeline.simulated import write_log
from tests.pipeline.test_fleet import MOTORS, rows, status_of, table_files
from tests.pipeline.workshop import DAY, Workshop

FIRST = dt.date(2026, 1, 2)


def run(fleet_file: Path, output: Path, **execution: Any) -> Any:
    fleet = load_fleet(fleet_file)
    how = fleet.execution.model_copy(update=execution)
    return run_fleet(RunRequest(replace(fleet, execution=how, output=output)))


def one_after_the_other(
    function: Callable[[Any], Any], tasks: Sequence[Any], lost: Callable[[Any, str], Any]
) -> Iterator[Any]:
    yield from map(function, tasks)


def never_lost(task: MotorTask, how: str) -> MotorOutcome:
    raise AssertionError(how)


def test_motors_in_parts_of_a_night_write_the_same_bytes(
    demo_folder: Path, fitted_output: Path, tmp_path: Path
) -> None:
    result = run(demo_folder / "configs" / "fleet.toml", tmp_path, nights_a_part=1, backend="loky")
    assert status_of(result) == dict.fromkeys(MOTORS, "ok")
    assert table_files(tmp_path) == table_files(fitted_output)
    for outcome in result.outcomes:
        assert outcome.counts == {"ok": 3}
        assert outcome.files == {"read": 3}


def outcomes(workshop: Workshop, folder: Path, size: int) -> tuple[MotorOutcome, list[Any]]:
    """What comes of the motor in parts of so many nights, and the tasks that there were."""
    seen: list[Any] = []

    def watched(function: Any, tasks: Sequence[Any], lost: Any) -> Iterator[Any]:
        seen.extend(tasks)
        yield from map(function, tasks)

    folder.mkdir()
    task = replace(workshop.task(), staging=folder, nights_a_part=size)
    (outcome,) = run_motors(watched, run_motor, [task], never_lost)
    return outcome, seen


def log_over(workshop: Workshop, *labels: dt.date) -> None:
    """One log over some nights."""
    nights = [workshop.night(label, seed=number) for number, label in enumerate(labels)]
    write_log(
        workshop.logs / "long.parquet",
        np.concatenate([operation.time_us for operation, _ in nights]),
        {name: np.concatenate([values[name] for _, values in nights]) for name in nights[0][1]},
    )


def check_the_same(workshop: Workshop, tmp_path: Path, size: int = 1) -> MotorOutcome:
    """Parts give the staged rows, and what is told and remembered of them, of one task."""
    whole, tasks = outcomes(workshop, tmp_path / "whole", 0)
    assert len(tasks) == 1
    split, tasks = outcomes(workshop, tmp_path / "split", size)
    assert sum(isinstance(task, PartTask) for task in tasks) > 1
    exempt = {"seconds": {}, "peak_memory_mib": None}
    assert replace(split, **exempt) == replace(whole, **exempt)
    one, other = (
        {
            path.relative_to(tmp_path / name).as_posix(): path.read_bytes()
            for path in sorted((tmp_path / name).rglob("*.arrow"))
        }
        for name in ("whole", "split")
    )
    assert one == other
    assert "fits/M1.arrow" in one
    return split


@pytest.fixture
def workshop(tmp_path: Path) -> Workshop:
    (tmp_path / "staging").mkdir()
    return Workshop.at(tmp_path / "shop")


@pytest.mark.parametrize("size", [1, 2, 3])
def test_nights_of_which_one_has_no_log_and_one_is_damaged(
    workshop: Workshop, tmp_path: Path, size: int
) -> None:
    for number in (0, 1, 3, 4, 5):
        workshop.log(FIRST + number * DAY, seed=number)
    (workshop.logs / f"{FIRST + 3 * DAY}.parquet").write_bytes(b"PAR1 and nothing of use")
    outcome = check_the_same(workshop, tmp_path, size)
    assert outcome.counts == {"ok": 4, "no_new_data": 1, "failed": 1}
    assert outcome.error_code is not None


def test_a_log_over_the_border_of_two_parts(workshop: Workshop, tmp_path: Path) -> None:
    log_over(workshop, FIRST, FIRST + DAY)
    workshop.log(FIRST + 2 * DAY)
    outcome = check_the_same(workshop, tmp_path)
    assert outcome.files == {"read": 2}
    assert outcome.counts == {"ok": 3}


def test_the_model_before_is_the_one_of_another_part(workshop: Workshop, tmp_path: Path) -> None:
    for number in range(4):
        workshop.log(FIRST + number * DAY, seed=number)
    run(workshop.fleet, tmp_path / "out", backend="loky", nights_a_part=2)
    found = rows(tmp_path / "out", "fits")["previous_model_fit_percent"].to_list()
    assert found[0] is None
    assert None not in found[1:]


def test_a_log_that_changes_between_the_parts_waits(
    workshop: Workshop, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = [workshop.log(FIRST + number * DAY, seed=number) for number in range(3)]
    task = replace(workshop.task(), staging=tmp_path / "staging", nights_a_part=1)

    def changing(function: Any, tasks: Sequence[Any], lost: Any) -> Iterator[Any]:
        for one in tasks:
            if isinstance(one, PartTask) and one.nights == (FIRST + DAY,):
                os.utime(paths[1], ns=(1, 1))
            yield function(one)

    (outcome,) = run_motors(changing, run_motor, [task], never_lost)
    assert outcome.nights == (FIRST, FIRST + 2 * DAY)
    assert outcome.files == {"read": 2, "growing": 1}


def test_a_log_that_is_gone_before_its_part_fails_its_night(
    workshop: Workshop, tmp_path: Path
) -> None:
    paths = [workshop.log(FIRST + number * DAY, seed=number) for number in range(3)]
    task = replace(workshop.task(), staging=tmp_path / "staging", nights_a_part=1)

    def losing(function: Any, tasks: Sequence[Any], lost: Any) -> Iterator[Any]:
        for one in tasks:
            if isinstance(one, PartTask):
                paths[1].unlink(missing_ok=True)
            yield function(one)

    (outcome,) = run_motors(losing, run_motor, [task], never_lost)
    assert outcome.counts == {"ok": 2, "failed": 1}
    assert outcome.error_code == "log_missing"


def test_parts_are_made_once_and_joined_without_a_log(
    workshop: Workshop, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in range(4):
        workshop.log(FIRST + number * DAY, seed=number)
    fitted: list[tuple[str, dt.date]] = []
    fit = pipeline.motor_task.fit_night

    def counted(spec: Any, night: Any, *rest: Any) -> Any:
        fitted.append((where[-1], night.date))
        return fit(spec, night, *rest)

    where = ["plan"]
    monkeypatch.setattr(pipeline.motor_task, "fit_night", counted)

    def watched(function: Any, tasks: Sequence[Any], lost: Any) -> Iterator[Any]:
        for one in tasks:
            where.append("part" if function is run_part else "join")
            yield function(one)

    task = replace(workshop.task(), staging=tmp_path / "staging", nights_a_part=2)
    (outcome,) = run_motors(watched, run_motor, [task], never_lost)
    assert outcome.counts == {"ok": 4}
    assert fitted == [("part", FIRST + number * DAY) for number in range(4)]


def test_a_part_that_kills_its_workers_fails_the_motor(workshop: Workshop, tmp_path: Path) -> None:
    for number in range(3):
        workshop.log(FIRST + number * DAY, seed=number)
    task = replace(workshop.task(), staging=tmp_path / "staging", nights_a_part=1)

    def dying(function: Any, tasks: Sequence[Any], lost: Any) -> Iterator[Any]:
        for one in tasks:
            dies = isinstance(one, PartTask) and one.nights == (FIRST + DAY,)
            yield lost(one, "it died") if dies else function(one)

    def failed(one: MotorTask, how: str) -> MotorOutcome:
        return MotorOutcome(one.spec.motor_id, "failed", "worker_died", how)

    (outcome,) = run_motors(dying, run_motor, [task], failed)
    assert (outcome.error_code, outcome.message) == ("worker_died", "it died")


def test_few_nights_are_not_split(workshop: Workshop, tmp_path: Path) -> None:
    for number in range(3):
        workshop.log(FIRST + number * DAY)
    task = replace(workshop.task(), staging=tmp_path, nights_a_part=3)
    assert isinstance(run_motor(task), MotorOutcome)
    split = run_motor(replace(task, nights_a_part=2))
    assert isinstance(split, SplitMotor)
    assert split.parts == ((FIRST, FIRST + DAY), (FIRST + 2 * DAY,))


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"backend": "sequential"}, 0),
        ({"backend": "loky", "workers": 1}, 0),
        ({"backend": "loky", "workers": 2}, 14),
        ({"backend": "loky", "workers": 2, "nights_a_part": 0}, 0),
        ({"backend": "dask", "workers": 1}, 0),
        ({"backend": "dask", "workers": 1, "scheduler": "tcp://a:1"}, 14),
    ],
)
def test_one_worker_splits_nothing(settings: dict[str, Any], expected: int) -> None:
    assert nights_a_part(Execution.model_validate(settings)) == expected
