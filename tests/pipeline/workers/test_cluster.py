"""Tasks over a real Dask scheduler with workers in processes of their own."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pipeline.config import Execution
from pipeline.errors import EngineError
from pipeline.workers.cluster import (
    CODE,
    Surroundings,
    _require,
    differences,
    own_versions,
)
from pipeline.workers.engine import open_workers
from pipeline.workers.process import Loss
from tests.pipeline.dask_processes import Processes, scheduler_with, wait_until
from tests.pipeline.dask_tasks import Number, Wait, kill_workers_at_three, square, wait_for_word
from tests.pipeline.misbehaviour import do, own_pid


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
    two_workers: Processes, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    tasks = [Number(value, tmp_path) for value in range(6)]
    assert sorted(run(two_workers.execution(), square, tasks, tmp_path)) == [0, 1, 4, 9, 16, 25]
    staged = {path.name: path.read_text() for path in (tmp_path / "squares").iterdir()}
    assert staged == {f"{value}.txt": str(value**2) for value in range(6)}
    # A way that nobody guards is warned of once.
    (warning,) = (one.getMessage() for one in caplog.records if one.levelname == "WARNING")
    assert f"on the way to {two_workers.address}: whoever reaches it runs code" in warning


def test_what_a_task_does_to_its_worker_costs_no_other(two_workers: Processes) -> None:
    execution = two_workers.execution(timeout_s=2.0, scheduler_wait_s=20.0)
    found = run(execution, do, ["hang_in_c", "a", "raise_error", "b"])
    assert sorted(found) == [
        "a done",
        "b done",
        "hang_in_c: worker_died: 2 workers died of it",
        "raise_error: internal: ZeroDivisionError: not foreseen",
    ]


@pytest.mark.full
def test_a_task_that_kills_every_worker_fails_alone(two_workers: Processes) -> None:
    found = run(two_workers.execution(), kill_workers_at_three, list(range(8)))
    # The scheduler of the tests gives a task up at the second death; Dask's own at the fourth.
    assert sorted(map(str, found)) == sorted(
        ["0", "1", "4", "16", "25", "36", "49", "3: worker_died: 2 workers died of it"]
    )


@pytest.mark.full
def test_workers_that_nobody_starts_again_do_not_keep_a_run_waiting() -> None:
    with scheduler_with(1, "--no-nanny") as processes:
        execution = processes.execution(scheduler_wait_s=1.0, tasks_in_flight=1)
        found = run(execution, kill_workers_at_three, list(range(6)))
        told = [one for one in found if isinstance(one, str)]
        assert [one for one in found if isinstance(one, int)] == [0, 1, 4]
        assert len(told) == 3
        assert all("scheduler_lost: the scheduler has had no worker" in one for one in told)
        # And the next run finds none at all.
        assert code_of(execution).code == "scheduler_no_workers"


@pytest.mark.full
def test_a_worker_killed_in_the_middle_costs_nothing(
    two_workers: Processes, tmp_path: Path
) -> None:
    with open_workers(two_workers.execution()) as workers:
        pids = set(workers.run(own_pid, range(12), lost))
        results = workers.run(wait_for_word, [Wait(n, tmp_path) for n in range(6)], lost)
        found = [next(results)]
        os.kill(min(pids), signal.SIGKILL)
        (tmp_path / "go").touch()
        found += results
    assert sorted(found) == list(range(6))


def test_a_scheduler_without_workers_and_one_that_is_gone(tmp_path: Path) -> None:
    with scheduler_with(0) as processes:
        assert code_of(processes.execution(scheduler_wait_s=0.5)).code == "scheduler_no_workers"
        processes.add_worker("--no-nanny")
        with open_workers(processes.execution()) as workers:
            results = workers.run(wait_for_word, [Wait(n, tmp_path) for n in range(4)], lost)
            assert next(results) == 0
            os.killpg(processes.scheduler.pid, signal.SIGKILL)
            rest = list(results)
        assert len(rest) == 3
        assert all("scheduler_lost: " in one for one in rest)


def test_no_more_tasks_in_flight_than_stated_and_a_stopped_run_takes_its_own_back(
    two_workers: Processes, tmp_path: Path
) -> None:
    from distributed import Client

    with (
        open_workers(two_workers.execution(tasks_in_flight=3)) as workers,
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


def test_no_scheduler_at_the_address() -> None:
    address = "tcp://127.0.0.1:1"
    error = code_of(Execution(backend="dask", scheduler=address, scheduler_wait_s=0.5))
    assert error.code == "scheduler_unreachable"
    assert address in error.message


@pytest.mark.parametrize("name", ["python", "numpy", CODE])
def test_workers_of_other_versions_are_refused(
    two_workers: Processes, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    mine = {**own_versions(), name: "0.0"}
    monkeypatch.setattr("pipeline.workers.cluster.own_versions", lambda: mine)
    error = code_of(two_workers.execution())
    assert error.code == "scheduler_versions"
    # Found at the scheduler first, where that has to read a task.
    assert f"{name} is " in error.message
    assert " there and 0.0 here" in error.message


@pytest.mark.parametrize(
    ("found", "code"),
    [
        (ModuleNotFoundError("No module named 'pipeline'"), "scheduler_versions"),
        ([Loss("scheduler_folders", "there is no folder /logs there")], "scheduler_folders"),
    ],
)
def test_who_has_not_the_program_or_the_logs_is_refused(found: Any, code: str) -> None:
    with pytest.raises(EngineError, match=r"the worker tcp://a:1 is unfit: .*[Nn]o ") as caught:
        _require("the worker tcp://a:1", found)
    assert caught.value.code == code


def test_a_worker_with_two_threads_is_refused() -> None:
    with scheduler_with(0) as processes:
        processes.add_worker("--nthreads", "2")
        error = code_of(processes.execution())
    assert error.code == "scheduler_threads"
    assert "has 2 threads" in error.message


def test_workers_that_do_not_see_the_logs_are_refused(
    two_workers: Processes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    error = code_of(two_workers.execution(), tmp_path / "nowhere")
    assert error.code == "scheduler_folders"
    assert str(tmp_path / "nowhere") in error.message
    monkeypatch.setenv("AZURE_STORAGE_ACCOUNT_KEY", "a2V5")
    with (
        pytest.raises(EngineError, match=r"expected one of AZURE_STORAGE_ACCOUNT_KEY") as caught,
        open_workers(two_workers.execution(), (), ["az://container/logs"]),
    ):
        pass
    assert caught.value.code == "scheduler_credentials"


def test_without_the_extra_the_message_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    error = code_of(Execution(backend="dask", scheduler="tcp://127.0.0.1:1"))
    assert error.code == "dask_missing"
    assert "motor-leakage[dask]" in error.message


def test_the_same_process_differs_in_nothing(tmp_path: Path) -> None:
    assert differences(Surroundings(own_versions(), (tmp_path,))) == []
    (found,) = differences(Surroundings({"numpy": "0"}))
    assert found.code == "scheduler_versions"
    assert found.how.endswith("there and 0 here")
