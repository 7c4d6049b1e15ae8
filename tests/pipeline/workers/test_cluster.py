"""Tasks over a real Dask scheduler with workers in processes of their own."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pipeline.config import Execution
from pipeline.errors import EngineError
from pipeline.workers import engine
from pipeline.workers.engine import CODE, do_on_worker, open_workers, own_versions
from pipeline.workers.process import Loss
from tests.pipeline.dask_processes import Processes, scheduler_with
from tests.pipeline.misbehaviour import (
    Number,
    Wait,
    do,
    kill_workers_at_three,
    square,
    wait_for_word,
    wait_until,
)


def lost(task: Any, loss: Loss) -> str:
    return f"{task}: {loss.code}: {loss.how}"


def run(
    execution: Execution, function: Callable[[Any], Any], tasks: list[Any], *folders: Path
) -> list[Any]:
    with open_workers(execution, folders) as workers:
        return list(workers.run(function, tasks, lost))


def code_of(execution: Execution, *folders: Path) -> EngineError:
    with pytest.raises(EngineError) as caught:
        run(execution, abs, [1], *folders)
    return caught.value


def tasks_of(run: str, dask_scheduler: Any) -> int:
    """Number of unfinished tasks on the scheduler; runs there."""
    tasks = [task for key, task in dask_scheduler.tasks.items() if str(key).startswith(run)]
    return sum(task.state not in ("memory", "erred", "released", "forgotten") for task in tasks)


def test_what_a_task_stages_comes_back_with_its_result(
    two_workers: Processes, tmp_path: Path
) -> None:
    tasks = [Number(value, tmp_path) for value in range(6)]
    assert sorted(run(two_workers.execution(), square, tasks, tmp_path)) == [0, 1, 4, 9, 16, 25]
    staged = {path.name: path.read_text() for path in (tmp_path / "squares").iterdir()}
    assert staged == {f"{value}.txt": str(value**2) for value in range(6)}


def test_what_a_task_does_to_its_worker_costs_no_other(two_workers: Processes) -> None:
    execution = two_workers.execution(timeout_s=2.0)
    found = run(execution, do, ["hang_in_c", "a", "raise_error", "b"])
    assert sorted(found) == [
        "a done",
        "b done",
        "hang_in_c: worker_died: 1 worker died of it",
        "raise_error: internal: ZeroDivisionError: not foreseen",
    ]


@pytest.mark.full
def test_workers_that_nobody_starts_again_do_not_keep_a_run_waiting(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(engine, "WAIT_S", 1.0)
    monkeypatch.setattr(engine, "TASKS_IN_FLIGHT", 1)
    with scheduler_with(1, "--no-nanny") as processes:
        execution = processes.execution()
        results = run(execution, kill_workers_at_three, list(range(6)))
        lost = [result for result in results if isinstance(result, str)]
        assert [result for result in results if isinstance(result, int)] == [0, 1, 4]
        assert len(lost) == 3
        gone = "scheduler_lost: the scheduler or its workers are gone for"
        assert all(gone in message for message in lost)
        # And the next run finds none at all.
        assert code_of(execution).code == "scheduler_unreachable"


@pytest.mark.full
def test_a_scheduler_without_workers_and_one_that_is_gone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with scheduler_with(0) as processes:
        with monkeypatch.context() as patch:
            patch.setattr(engine, "WAIT_S", 0.5)
            assert code_of(processes.execution()).code == "scheduler_unreachable"
        processes.add_worker("--no-nanny")
        with open_workers(processes.execution()) as workers:
            results = workers.run(wait_for_word, [Wait(n, tmp_path) for n in range(4)], lost)
            assert next(results) == 0
            os.killpg(processes.scheduler.pid, signal.SIGKILL)
            rest = list(results)
        assert len(rest) == 3
        assert all("scheduler_lost: " in message for message in rest)


def test_few_tasks_are_in_flight_and_a_stopped_run_takes_its_own_back(
    two_workers: Processes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from distributed import Client

    monkeypatch.setattr(engine, "TASKS_IN_FLIGHT", 3)
    with (
        open_workers(two_workers.execution()) as workers,
        Client(two_workers.address, set_as_default=False) as client,
    ):
        results = workers.run(wait_for_word, [Wait(n, tmp_path) for n in range(9)], lost)
        assert next(results) == 0
        wait_until(lambda: client.run_on_scheduler(tasks_of, "do_on_worker") == 2)
        results.close()  # type: ignore[attr-defined]
        wait_until(lambda: client.run_on_scheduler(tasks_of, "do_on_worker") == 0)
        (tmp_path / "go").touch()
    begun = {path.name for path in tmp_path.glob("started-*")}
    assert begun <= {"started-0", "started-1", "started-2"}


@pytest.mark.parametrize("name", ["python", "numpy", CODE])
def test_a_cluster_of_other_versions_is_refused(
    two_workers: Processes, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    mine = {**own_versions(), name: "0.0"}
    monkeypatch.setattr("pipeline.workers.engine.own_versions", lambda: mine)
    error = code_of(two_workers.execution())
    assert error.code == "scheduler_unfit"
    assert f"{name} is " in error.message
    assert " there and 0.0 here" in error.message


def test_a_worker_that_joins_later_with_other_code_makes_nothing(tmp_path: Path) -> None:
    outcome, staged = do_on_worker(
        square, Number(2, tmp_path), Execution(), {**own_versions(), CODE: "other"}
    )
    assert (outcome.code, staged) == ("scheduler_unfit", {})


def test_workers_without_the_logs_or_with_two_threads_are_refused(
    two_workers: Processes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    error = code_of(two_workers.execution(), tmp_path / "nowhere")
    assert error.code == "scheduler_unfit"
    assert f"there is no folder {tmp_path / 'nowhere'} there" in error.message
    monkeypatch.setattr("distributed.Client.nthreads", lambda _: {"tcp://a": 2})
    error = code_of(two_workers.execution(), tmp_path)
    assert error.code == "scheduler_unfit"
    assert "it has 2 threads" in error.message
