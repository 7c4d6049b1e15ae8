"""A motor with many nights in parts: what it gives is what it gives in one."""

from __future__ import annotations

import datetime as dt
import os
import signal
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import pipeline.run.motor_task
import pipeline.run.parts
from pipeline.config import Execution, load_fleet
from pipeline.errors import EngineError
from pipeline.run.fleet import RunRequest, _motors, run_fleet
from pipeline.run.motor_task import run_motor, run_part
from pipeline.run.parts import run_motors
from pipeline.run.tasks import MotorOutcome, PartTask, SplitMotor
from pipeline.workers.engine import nights_a_part
from pipeline.workers.process import Loss
from tests.conftest import OwnFleet
from tests.pipeline.run.test_fleet import check_same_tables, rows
from tests.pipeline.simulated import write_log
from tests.pipeline.workshop import DAY, Workshop

FIRST = dt.date(2026, 1, 2)


def run(fleet_file: Path, output: Path, **execution: Any) -> Any:
    fleet = load_fleet(fleet_file)
    how = fleet.execution.model_copy(update=execution)
    return run_fleet(RunRequest(replace(fleet, execution=how, output=output)))


@pytest.mark.full  # over Dask, and without worker processes, among those that judge every change
def test_a_motor_in_parts_of_a_night_has_the_rows_that_it_has_in_one(
    own_fleet: OwnFleet, fitted_output: Path, tmp_path: Path
) -> None:
    fleet = own_fleet("CB400-01")
    (outcome,) = run(fleet, tmp_path / "out", nights_a_part=1, backend="loky").outcomes
    check_same_tables(tmp_path / "out", fitted_output, "CB400-01")
    assert (outcome.counts, outcome.files) == ({"ok": 3}, {"read": 3})
    assert outcome.seconds["read_s"] > 0


def outcomes(workshop: Workshop, folder: Path, size: int) -> tuple[MotorOutcome, list[Any]]:
    """What comes of the motor in parts of so many nights, and the tasks that there were."""
    seen: list[Any] = []

    def watched(function: Any, tasks: Sequence[Any], lost: Any) -> Iterator[Any]:
        seen.extend(tasks)
        yield from map(function, tasks)

    folder.mkdir()
    task = replace(workshop.task(), staging=folder, nights_a_part=size)
    (outcome,) = run_motors(watched, run_motor, [task])
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
    exempt: dict[str, Any] = {"seconds": {}, "peak_memory_mib": None}
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
    outcomes(workshop, tmp_path / "parts", 2)
    (file,) = (tmp_path / "parts" / "fits").glob("*.arrow")
    found = pl.read_ipc(file).filter(pl.col("is_primary")).sort("night")
    judged = found["previous_model_fit_percent"].to_list()
    assert judged[0] is None
    assert len(judged) == 4
    assert None not in judged[1:]


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

    (outcome,) = run_motors(changing, run_motor, [task])
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

    (outcome,) = run_motors(losing, run_motor, [task])
    assert outcome.counts == {"ok": 2, "failed": 1}
    assert outcome.error_code == "log_missing"


def test_parts_are_made_once_and_joined_without_a_log(
    workshop: Workshop, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in range(4):
        workshop.log(FIRST + number * DAY, seed=number)
    fitted: list[tuple[str, dt.date]] = []
    fit = pipeline.run.motor_task.fit_night

    def counted(spec: Any, night: Any, *rest: Any) -> Any:
        fitted.append((where[-1], night.date))
        return fit(spec, night, *rest)

    where = ["plan"]
    monkeypatch.setattr(pipeline.run.motor_task, "fit_night", counted)

    def watched(function: Any, tasks: Sequence[Any], lost: Any) -> Iterator[Any]:
        for one in tasks:
            where.append("part" if function is run_part else "join")
            yield function(one)

    task = replace(workshop.task(), staging=tmp_path / "staging", nights_a_part=2)
    (outcome,) = run_motors(watched, run_motor, [task])
    assert outcome.counts == {"ok": 4}
    assert fitted == [("part", FIRST + number * DAY) for number in range(4)]


def lossy(nights: Collection[dt.date], named: bool = True, parts: bool = True) -> Any:
    """An engine whose workers are lost in some nights: of parts, or of tasks of whole motors."""

    def engine(function: Any, tasks: Sequence[Any], lost: Any) -> Iterator[Any]:
        for one in tasks:
            is_part = isinstance(one, PartTask)
            motor = one.motor if is_part else one
            theirs = one.nights if is_part else [night for night in nights if not parts]
            left = sorted(set(theirs) & set(nights) - motor.given_up.keys())
            if left:
                yield lost(one, Loss("worker_died", "it died", str(left[0]) if named else ""))
            else:
                yield function(one)

    return engine


def given_up(workshop: Workshop, folder: Path, engine: Any, size: int) -> MotorOutcome:
    folder.mkdir()
    task = replace(workshop.task(), staging=folder, nights_a_part=size)
    (outcome,) = run_motors(engine, run_motor, [task])
    return outcome


@pytest.mark.parametrize("size", [1, 3])
def test_a_night_that_kills_the_workers_of_its_part_costs_no_other(
    workshop: Workshop, tmp_path: Path, size: int
) -> None:
    log_over(workshop, FIRST, FIRST + DAY)
    for number in range(2, 5):
        workshop.log(FIRST + number * DAY, seed=number)
    nights = {FIRST + DAY, FIRST + 2 * DAY}
    whole = given_up(workshop, tmp_path / "whole", lossy(nights, parts=False), 0)
    split = given_up(workshop, tmp_path / "split", lossy(nights), size)
    assert split.counts == {"ok": 3, "failed": 2}
    assert (split.error_code, split.message) == (
        "worker_died",
        f"night {FIRST + DAY}: it died",
    )
    exempt: dict[str, Any] = {"seconds": {}, "peak_memory_mib": None}
    assert replace(split, **exempt) == replace(whole, **exempt)
    for path in sorted((tmp_path / "whole").rglob("*.arrow")):
        other = tmp_path / "split" / path.relative_to(tmp_path / "whole")
        assert other.read_bytes() == path.read_bytes()


def test_a_motor_of_which_too_many_nights_kill_workers_fails_as_one_that_is_not_split(
    workshop: Workshop, tmp_path: Path
) -> None:
    nights = [FIRST + number * DAY for number in range(5)]
    for number, label in enumerate(nights):
        workshop.log(label, seed=number)
    whole = given_up(workshop, tmp_path / "whole", lossy(nights[:4], parts=False), 0)
    split = given_up(workshop, tmp_path / "split", lossy(nights[:4]), 1)
    assert (split.status, split.error_code, split.nights) == ("failed", "worker_died", ())
    assert split == whole


def test_a_part_that_is_lost_nobody_knows_where_fails_its_motor(
    workshop: Workshop, tmp_path: Path
) -> None:
    for number in range(3):
        workshop.log(FIRST + number * DAY, seed=number)
    outcome = given_up(workshop, tmp_path / "split", lossy({FIRST + DAY}, named=False), 1)
    assert (outcome.error_code, outcome.message) == ("worker_died", "it died")


@pytest.mark.full
def test_a_night_of_a_part_that_kills_its_worker_process_costs_no_other(
    own_fleet: OwnFleet,
    fitted_output: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fleet = own_fleet("CB400-02")

    def run_or_die(task: PartTask) -> Any:
        import pipeline.run.motor_task as module

        fit_night = module.fit_night

        def fit_or_die(spec: Any, here: Any, *arguments: Any) -> Any:
            if str(here.date) == "2026-01-03":
                os.kill(os.getpid(), signal.SIGKILL)
            return fit_night(spec, here, *arguments)

        module.fit_night = fit_or_die
        return module.run_part(task)

    monkeypatch.setattr(pipeline.run.parts, "run_part", run_or_die)
    (outcome,) = run(fleet, tmp_path / "out", nights_a_part=2, backend="loky").outcomes
    assert dict(outcome.counts) == {"ok": 2, "failed": 1}
    assert outcome.error_code == "worker_died"
    assert (outcome.message or "").startswith("night 2026-01-03: its worker process ended")
    found = rows(tmp_path / "out", "fits").filter(pl.col("is_primary")).sort("night")
    assert found["error_code"].to_list() == [None, "worker_died", None]


def test_an_engine_that_is_gone_before_the_parts_costs_the_motors_that_are_left(
    workshop: Workshop, tmp_path: Path
) -> None:
    for number in range(2):
        workshop.log(FIRST + number * DAY, seed=number)

    def dying(function: Any, tasks: Sequence[Any], lost: Any) -> Iterator[Any]:
        if isinstance(tasks[0], PartTask):
            raise EngineError("scheduler_lost", "it is gone")
        yield from map(function, tasks)

    (tmp_path / "parts").mkdir()
    split = replace(workshop.task(), staging=tmp_path / "parts", nights_a_part=1)
    with pytest.raises(EngineError):
        list(_motors(dying, [split]))
    spec = replace(split.spec, file=split.spec.file.model_copy(update={"motor_id": "M2"}))
    other = replace(split, spec=spec, nights_a_part=0)
    found = {one.motor_id: one for one in _motors(dying, [split, other])}
    assert found["M2"].counts == {"ok": 2}
    assert (found["M1"].status, found["M1"].error_code) == ("failed", "scheduler_lost")


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
        ({"backend": "sequential", "workers": 9}, 0),
        ({"backend": "loky", "workers": 3}, 0),
        ({"backend": "loky", "workers": 4}, 14),
        ({"backend": "loky", "workers": 4, "nights_a_part": 0}, 0),
        ({"backend": "dask", "workers": 3}, 0),
        ({"backend": "dask", "workers": 4}, 14),
        ({"backend": "dask", "workers": 1, "scheduler": "tcp://a:1"}, 14),
    ],
)
def test_nothing_is_split_where_each_worker_has_a_motor(
    settings: dict[str, Any], expected: int
) -> None:
    assert nights_a_part(Execution.model_validate(settings), n_motors=3) == expected
