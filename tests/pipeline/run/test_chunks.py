"""A motor with many nights, done in chunks, gives what it gives in one."""

from __future__ import annotations

import datetime as dt
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import pipeline.run.motor_task
from pipeline.config import Execution, load_fleet
from pipeline.errors import EngineError
from pipeline.run.fleet import RunRequest, run_fleet
from pipeline.run.motor_task import run_motor
from pipeline.run.motors import run_motors, with_failures
from pipeline.run.tasks import MotorOutcome, MotorTask
from pipeline.schema import FITS
from pipeline.store.night_files import StagedRows
from pipeline.workers.engine import nights_a_chunk
from pipeline.workers.process import Loss
from tests.conftest import OwnFleet
from tests.pipeline.misbehaviour import Carried
from tests.pipeline.run.demo_runs import check_same_tables, rows
from tests.pipeline.simulated import write_log
from tests.pipeline.workshop import DAY, Workshop

FIRST = dt.date(2026, 1, 2)


def run(fleet_file: Path, output: Path, **execution: Any) -> Any:
    fleet = load_fleet(fleet_file)
    how = fleet.execution.model_copy(update=execution)
    return run_fleet(RunRequest(replace(fleet, execution=how, output=output)))


Outcomes = tuple[MotorOutcome, list[MotorOutcome]]


@pytest.mark.full  # over Dask, and without worker processes, among those that judge every change
def test_a_motor_in_chunks_of_a_night_has_the_rows_that_it_has_in_one(
    own_fleet: OwnFleet, fitted_output: Path, tmp_path: Path
) -> None:
    fleet = own_fleet("CB400-01")
    (outcome,) = run(fleet, tmp_path / "out", nights_a_part=1, backend="loky").outcomes
    check_same_tables(tmp_path / "out", fitted_output, "CB400-01")
    assert (outcome.counts, outcome.files) == ({"ok": 3}, {"read": 3})
    assert outcome.seconds["read_s"] > 0


def engine(before: Callable[[MotorTask], object] = lambda _: None) -> Any:
    """An engine that does the tasks here, each after something has happened; a `Loss` is one."""

    def run_tasks(function: Any, tasks: Sequence[Any], lost: Any) -> Iterator[Any]:
        for task in tasks:
            loss = before(task)
            yield lost(task, loss) if isinstance(loss, Loss) else function(task)

    return run_tasks


def outcomes(workshop: Workshop, staging: Path, size: int, engine: Any = engine()) -> Outcomes:  # noqa: B008
    """Outcome of the motor in chunks of so many nights, and those of its chunks."""
    staging.mkdir(exist_ok=True)
    task = replace(workshop.task(), staging=staging, nights_a_chunk=size)
    *chunks, outcome = run_motors(engine, run_motor, [task])
    assert not outcome.chunk
    assert all(one.chunk for one in chunks)
    return outcome, chunks


def logs_of_nights(workshop: Workshop, n: int = 5) -> list[Path]:
    return [workshop.log(FIRST + number * DAY, seed=number) for number in range(n)]


def log_over(workshop: Workshop, *labels: dt.date) -> None:
    """One log over some nights."""
    nights = [workshop.night(label, seed=number) for number, label in enumerate(labels)]
    write_log(
        workshop.logs / "long.parquet",
        np.concatenate([operation.time_us for operation, _ in nights]),
        {name: np.concatenate([values[name] for _, values in nights]) for name in nights[0][1]},
    )


def check_the_same(
    workshop: Workshop,
    tmp_path: Path,
    size: int = 1,
    engine: Any = engine(),  # noqa: B008
) -> MotorOutcome:
    """Chunks give the staged rows, and what is told and remembered of them, of one task."""
    whole, chunks = outcomes(workshop, tmp_path / "whole", 0, engine)
    assert chunks == []
    split, chunks = outcomes(workshop, tmp_path / "split", size, engine)
    assert len(chunks) > 1
    numbers = [one.chunks_done for one in chunks]
    assert numbers == [(number, len(chunks)) for number in range(1, len(chunks) + 1)]
    exempt: dict[str, Any] = {"seconds": {}, "peak_memory_mib": None}
    assert replace(split, **exempt) == replace(whole, **exempt)
    one, other = (
        {
            path.relative_to(tmp_path / name).as_posix(): path.read_bytes()
            for folder in ("nights", "ledger")
            for path in sorted((tmp_path / name / folder).rglob("*"))
            if path.is_file()
        }
        for name in ("whole", "split")
    )
    assert one == other
    assert ("nights/M1.arrow" in one) == bool(split.nights)
    return split


@pytest.fixture
def workshop(tmp_path: Path) -> Workshop:
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


def test_a_log_over_the_border_of_two_chunks(workshop: Workshop, tmp_path: Path) -> None:
    log_over(workshop, FIRST, FIRST + DAY)
    workshop.log(FIRST + 2 * DAY)
    outcome = check_the_same(workshop, tmp_path)
    assert outcome.files == {"read": 2}
    assert outcome.counts == {"ok": 3}


def test_the_model_before_is_the_one_of_another_chunk(workshop: Workshop, tmp_path: Path) -> None:
    logs_of_nights(workshop, 4)
    outcomes(workshop, tmp_path / "chunks", 2)
    (file,) = (tmp_path / "chunks" / "nights").glob("*.arrow")
    _, found = StagedRows(file).between(FITS, FIRST, FIRST + 3 * DAY)
    fits = pl.DataFrame(found).filter(pl.col("is_primary")).sort("night")
    judged = fits["previous_model_fit_percent"].to_list()
    assert judged[0] is None
    assert len(judged) == 4
    assert None not in judged[1:]


def test_a_log_that_changes_between_the_chunks_waits(workshop: Workshop, tmp_path: Path) -> None:
    paths = logs_of_nights(workshop, 3)

    def change(task: MotorTask) -> None:
        if task.nights == (FIRST + DAY,):
            os.utime(paths[1], ns=(1, 1))

    outcome, _ = outcomes(workshop, tmp_path / "staging", 1, engine(change))
    assert outcome.nights == (FIRST, FIRST + 2 * DAY)
    assert outcome.files == {"read": 2, "growing": 1}


def test_a_log_that_is_gone_before_its_chunk_fails_its_night(
    workshop: Workshop, tmp_path: Path
) -> None:
    paths = logs_of_nights(workshop, 3)

    def lose(task: MotorTask) -> None:
        if task.nights:
            paths[1].unlink(missing_ok=True)

    outcome, _ = outcomes(workshop, tmp_path / "staging", 1, engine(lose))
    assert outcome.counts == {"ok": 2, "failed": 1}
    assert outcome.error_code == "log_missing"


def test_chunks_are_made_once_and_joined_without_a_log(
    workshop: Workshop, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    logs_of_nights(workshop, 4)
    fitted: list[tuple[str, dt.date]] = []
    tasks: list[MotorTask] = []
    fit = pipeline.run.motor_task.fit_night

    def counted(spec: Any, night: Any, *rest: Any) -> Any:
        fitted.append((tasks[-1].chunk, night.date))
        return fit(spec, night, *rest)

    monkeypatch.setattr(pipeline.run.motor_task, "fit_night", counted)
    outcome, chunks = outcomes(workshop, tmp_path / "staging", 2, engine(tasks.append))
    assert outcome.counts == {"ok": 4}
    names = [f"chunks/M1@{FIRST}", f"chunks/M1@{FIRST + 2 * DAY}"]
    assert [one.chunk for one in chunks] == names
    assert fitted == [(names[number // 2], FIRST + number * DAY) for number in range(4)]


def lossy(*nights: dt.date, named: bool = True) -> Any:
    """An engine whose workers are lost in some nights, wherever these are fitted."""

    def lose(task: MotorTask) -> Loss | None:
        is_fitted = task.nights or (() if task.nights_a_chunk else nights)
        left = sorted(set(is_fitted) & set(nights) - task.lost_nights.keys())
        return Loss("worker_died", "it died", str(left[0]) if named else "") if left else None

    return engine(lose)


@pytest.mark.parametrize("size", [1, 3])
def test_a_night_that_kills_the_workers_of_its_chunk_costs_no_other(
    workshop: Workshop, tmp_path: Path, size: int
) -> None:
    log_over(workshop, FIRST, FIRST + DAY)
    for number in range(2, 5):
        workshop.log(FIRST + number * DAY, seed=number)
    nights = (FIRST + DAY, FIRST + 2 * DAY)
    outcome = check_the_same(workshop, tmp_path, size, lossy(*nights))
    assert outcome.counts == {"ok": 3, "failed": 2}
    assert (outcome.error_code, outcome.message) == ("worker_died", f"night {nights[0]}: it died")


def test_a_motor_of_which_too_many_nights_kill_workers_fails_as_one_that_is_not_split(
    workshop: Workshop, tmp_path: Path
) -> None:
    logs_of_nights(workshop)
    lost = lossy(*(FIRST + number * DAY for number in range(4)))
    outcome = check_the_same(workshop, tmp_path, 1, lost)
    assert (outcome.status, outcome.error_code, outcome.nights) == ("failed", "worker_died", ())


def test_a_chunk_that_is_lost_nobody_knows_where_fails_its_motor(
    workshop: Workshop, tmp_path: Path
) -> None:
    logs_of_nights(workshop, 3)
    lost = lossy(FIRST + DAY, named=False)
    outcome, chunks = outcomes(workshop, tmp_path / "split", 1, lost)
    assert (outcome.error_code, outcome.message) == ("worker_died", "it died")
    assert [one.status for one in chunks] == ["ok", "failed", "ok"]


@pytest.mark.full
def test_a_night_of_a_chunk_that_kills_its_worker_process_costs_no_other(
    own_fleet: OwnFleet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fleet = own_fleet("CB400-02")

    def run_or_die(task: MotorTask) -> Any:
        import pipeline.run.motor_task as module

        fit_night = module.fit_night

        def fit_or_die(spec: Any, here: Any, *arguments: Any) -> Any:
            if str(here.date) == "2026-01-03":
                os.kill(os.getpid(), signal.SIGKILL)
            return fit_night(spec, here, *arguments)

        module.fit_night = fit_or_die
        return run_motor(task)

    monkeypatch.setattr("pipeline.run.motors.run_motor", Carried(run_or_die))
    (outcome,) = run(fleet, tmp_path / "out", nights_a_part=2, backend="loky").outcomes
    assert dict(outcome.counts) == {"ok": 2, "failed": 1}
    assert outcome.error_code == "worker_died"
    assert (outcome.message or "").startswith("night 2026-01-03: its worker process ended")
    found = rows(tmp_path / "out", "fits").filter(pl.col("is_primary")).sort("night")
    assert found["error_code"].to_list() == [None, "worker_died", None]


def test_an_engine_that_is_gone_before_the_chunks_costs_the_motors_that_are_left(
    workshop: Workshop, tmp_path: Path
) -> None:
    logs_of_nights(workshop, 2)

    def die(task: MotorTask) -> None:
        if task.nights:
            raise EngineError("scheduler_lost", "it is gone")

    split = replace(workshop.task(), staging=tmp_path, nights_a_chunk=1)
    with pytest.raises(EngineError):
        list(with_failures(engine(die), [split]))
    spec = replace(split.spec, file=split.spec.file.model_copy(update={"motor_id": "M2"}))
    other = replace(split, spec=spec, nights_a_chunk=0)
    found = {one.motor_id: one for one in with_failures(engine(die), [split, other])}
    assert found["M2"].counts == {"ok": 2}
    assert (found["M1"].status, found["M1"].error_code) == ("failed", "scheduler_lost")


def test_few_nights_are_not_split(workshop: Workshop, tmp_path: Path) -> None:
    logs_of_nights(workshop, 3)
    task = replace(workshop.task(), staging=tmp_path, nights_a_chunk=3)
    assert run_motor(task).to_do == ()
    split = run_motor(replace(task, nights_a_chunk=2))
    assert [one.nights for one in split.to_do] == [(FIRST, FIRST + DAY), (FIRST + 2 * DAY,)]


def test_a_log_that_did_not_answer_the_plan_is_not_asked_by_a_chunk(
    workshop: Workshop, tmp_path: Path
) -> None:
    logs_of_nights(workshop, 3)
    silence = Loss("log_no_answer", "it did not answer", "", f"M1/{FIRST}.parquet")

    def lose(task: MotorTask) -> Loss | None:
        return None if task.silent else silence

    asked = engine(lose)
    outcome, chunks = outcomes(workshop, tmp_path / "staging", 1, asked)
    assert [one.status for one in chunks] == ["ok", "ok", "ok"]
    assert (outcome.counts, outcome.error_code) == ({"ok": 2, "failed": 1}, "log_no_answer")


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
    assert nights_a_chunk(Execution.model_validate(settings), n_motors=3) == expected
