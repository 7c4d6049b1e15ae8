"""Tasks over a real scheduler with workers in processes of their own."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pipeline.config import Execution
from pipeline.errors import EngineError
from pipeline.workers.dask_cluster import (
    _require_one_thread,
    _require_same_program,
    _require_same_protocol,
    connected,
)
from pipeline.workers.dask_engine import DaskEngine, _Flight
from pipeline.workers.dask_worker import CODE, Surroundings, differences, own_versions
from pipeline.workers.engine import open_engine
from pipeline.workers.process import Loss
from tests.pipeline.dask_processes import Processes, scheduler_with, wait_until
from tests.pipeline.dask_tasks import (
    Number,
    Wait,
    kill_workers_at_three,
    process_and_worker,
    square,
    wait_for_word,
)
from tests.pipeline.misbehaviour import do


def lost(task: Any, loss: Loss) -> str:
    return f"{task}: {loss.code}: {loss.how}"


def run(
    execution: Execution, function: Callable[[Any], Any], tasks: list[Any], *folders: Path
) -> list[Any]:
    with open_engine(execution, folders) as run_tasks:
        return list(run_tasks(function, tasks, lost))


def test_each_task_gives_its_result_once(two_workers: Processes) -> None:
    found = run(two_workers.execution(), abs, [-5, 3, -2, 0])
    assert sorted(found) == [0, 2, 3, 5]


def test_a_way_that_nobody_guards_is_warned_of_once(
    two_workers: Processes, caplog: pytest.LogCaptureFixture
) -> None:
    run(two_workers.execution(), abs, [-5, 3, -2, 0])
    (warning,) = (one.getMessage() for one in caplog.records if one.levelname == "WARNING")
    assert two_workers.address.startswith("tcp://")
    assert f"on the way to {two_workers.address}: whoever reaches it runs code" in warning


def test_what_a_task_stages_comes_back_with_its_result(
    two_workers: Processes, tmp_path: Path
) -> None:
    tasks = [Number(value, tmp_path) for value in range(6)]
    assert sorted(run(two_workers.execution(), square, tasks, tmp_path)) == [0, 1, 4, 9, 16, 25]
    staged = {path.name: path.read_text() for path in (tmp_path / "squares").iterdir()}
    assert staged == {f"{value}.txt": str(value**2) for value in range(6)}


def test_never_more_tasks_in_flight_than_stated(
    two_workers: Processes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    execution = two_workers.execution(tasks_in_flight=3)
    under_way: list[int] = []
    wait = _Flight._next

    def let_go(flight: _Flight) -> Any:
        client, first = flight.engine.client, not under_way
        # What was submitted is on its way to the scheduler.
        wait_until(lambda: not first or client.run_on_scheduler(tasks_of, "motor-leakage") >= 3)
        under_way.append(client.run_on_scheduler(tasks_of, "motor-leakage"))
        (tmp_path / "go").touch()
        return wait(flight)

    monkeypatch.setattr(_Flight, "_next", let_go)
    found = run(execution, wait_for_word, [Wait(number, tmp_path) for number in range(1, 10)])
    assert sorted(found) == list(range(1, 10))
    assert under_way[0] == max(under_way) == 3


def tasks_of(run: str, dask_scheduler: Any) -> int:
    """Number of unfinished tasks of a run on the scheduler; runs there."""
    tasks = [task for key, task in dask_scheduler.tasks.items() if str(key).startswith(run)]
    return sum(task.state not in ("memory", "erred", "released", "forgotten") for task in tasks)


@pytest.mark.full
def test_a_task_that_kills_every_worker_fails_alone(two_workers: Processes) -> None:
    found = run(two_workers.execution(), kill_workers_at_three, list(range(8)))
    # The scheduler of the tests gives a task up at the second death; Dask's own at the fourth.
    assert sorted(map(str, found)) == sorted(
        ["0", "1", "4", "16", "25", "36", "49", "3: worker_died: 2 workers died of it"]
    )


def test_what_a_task_does_to_its_process_costs_neither_a_worker_nor_another_task(
    two_workers: Processes,
) -> None:
    execution = two_workers.execution(timeout_s=2.0)
    losses: dict[str, Loss] = {}

    def lose(task: str, loss: Loss) -> None:
        losses[task] = loss

    bad = ["hang_in_python", "kill", "raise_error"]
    with open_engine(execution) as run_tasks:
        before = workers_of(execution)
        found = list(run_tasks(do, [*bad, *"abcd"], lose))
        assert workers_of(execution) == before
    assert {one for one in found if one} == {f"{name} done" for name in "abcd"}
    assert {task: (loss.code, loss.part) for task, loss in losses.items()} == {
        "hang_in_python": ("task_timeout", "the third night"),
        "kill": ("worker_died", ""),
        "raise_error": ("internal", ""),
    }
    assert "SIGKILL" in losses["kill"].how
    assert "in hang_in_python (misbehaviour.py, line" in losses["hang_in_python"].how


def workers_of(execution: Execution) -> dict[str, int]:
    """Process ids of the workers by address."""
    with connected(execution, Surroundings(own_versions())) as client:
        found: dict[str, int] = client.run(os.getpid)
        return found


@pytest.mark.full
def test_workers_that_nobody_starts_again_do_not_keep_a_run_waiting() -> None:
    with scheduler_with(1, "--no-nanny") as processes:
        processes.add_worker("--no-nanny")
        processes.wait_for(2)
        execution = processes.execution(scheduler_wait_s=1.0, tasks_in_flight=2)
        found = run(execution, kill_workers_at_three, list(range(8)))
        assert len(found) == 8
        told = {one.split(":")[0] for one in found if isinstance(one, str)}
        assert "3" in told
        assert {one for one in found if isinstance(one, int)} == {
            number**2 for number in range(8) if str(number) not in told
        }
        assert all("scheduler_lost: " in one for one in found if isinstance(one, str))
        assert all("no worker" in one for one in found if isinstance(one, str))
        # And the next run finds none at all.
        with pytest.raises(EngineError) as caught:
            run(execution, abs, [1])
        assert caught.value.code == "scheduler_no_workers"


def test_an_exception_of_a_task_is_told(two_workers: Processes) -> None:
    found = run(two_workers.execution(), abs, [-2, "three"])
    assert found[0] == 2
    assert found[1].startswith("three: internal: TypeError: bad operand type for abs()")


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_a_worker_killed_in_the_middle_costs_nothing(
    two_workers: Processes, tmp_path: Path
) -> None:
    execution = two_workers.execution()
    expected = Surroundings(own_versions())
    with connected(execution, expected) as client:
        engine = DaskEngine(client, execution, expected)
        # Each worker has one process for its tasks, and keeps it.
        processes = set(engine.run_tasks(process_and_worker, list(range(12)), lost))
        assert len(processes) == len({worker for _, worker in processes}) <= 2
        results = engine.run_tasks(wait_for_word, [Wait(n, tmp_path) for n in range(6)], lost)
        found = [next(results)]
        process, victim = min(processes)
        assert victim in client.run(os.getpid).values()
        os.kill(victim, signal.SIGKILL)
        wait_until(lambda: not Path(f"/proc/{process}").exists())
        (tmp_path / "go").touch()
        found += results
        assert found[0] == 0
        assert sorted(found) == list(range(6))


def test_a_scheduler_without_workers_and_one_that_is_gone(tmp_path: Path) -> None:
    with scheduler_with(0) as processes:
        error = code_of(processes.execution(scheduler_wait_s=0.5))
        assert error.code == "scheduler_no_workers"
        processes.add_worker("--no-nanny")
        with open_engine(processes.execution()) as run_tasks:
            results = run_tasks(wait_for_word, [Wait(n, tmp_path) for n in range(4)], lost)
            assert next(results) == 0
            os.killpg(processes.scheduler.pid, signal.SIGKILL)
            rest = list(results)
        assert len(rest) == 3
        assert all("scheduler_lost: " in one for one in rest)


def test_a_scheduler_that_does_not_answer_is_no_error_of_a_task(tmp_path: Path) -> None:
    def gone() -> None:
        raise OSError("timed out")

    client: Any = SimpleNamespace(nthreads=gone)
    engine = DaskEngine(client, Execution(backend="dask"), Surroundings({}))
    # How many tasks with much to carry may be in flight depends on how many workers there are.
    joining = SimpleNamespace(chunks=("a",), staging=tmp_path)
    flight = _Flight(engine, abs, {0: joining, 1: joining, 2: joining})
    flight.waiting.extend([0, 1, 2])
    assert [flight._may_send() for _ in range(3)] == [[0], [1], [2]]
    assert flight._most(0) == 2


def test_a_run_that_is_stopped_takes_its_tasks_back(two_workers: Processes, tmp_path: Path) -> None:
    execution = two_workers.execution()
    with connected(execution, Surroundings(own_versions())) as client:
        engine = DaskEngine(client, execution, Surroundings(own_versions()))
        results = engine.run_tasks(wait_for_word, [Wait(n, tmp_path) for n in range(6)], lost)
        assert next(results) == 0
        results.close()  # type: ignore[attr-defined]
        (tmp_path / "go").touch()
        wait_until(lambda: client.run_on_scheduler(tasks_of, "motor-leakage") == 0)
        assert {path.name for path in tmp_path.glob("started-*")} < {
            f"started-{number}" for number in range(6)
        }


def test_a_worker_that_joins_unfit_gets_no_task(two_workers: Processes) -> None:
    execution = two_workers.execution()
    with connected(execution, Surroundings(own_versions())) as client:
        unfit = min(client.nthreads())
        client.run(pretend_numpy, "0.1", workers=[unfit])
        try:
            engine = DaskEngine(client, execution, Surroundings(own_versions()))
            assert sorted(engine.run_tasks(abs, list(range(12)), lost)) == list(range(12))
        finally:
            client.run(pretend_numpy, own_versions()["numpy"], workers=[unfit])


def pretend_numpy(version: str) -> None:
    """Let a worker believe that it has another NumPy; runs there."""
    import pipeline.workers.dask_worker as worker

    true = {**own_versions(), "numpy": version}
    worker.own_versions = lambda: true


# What makes a cluster unfit


def code_of(execution: Execution, *folders: Path) -> EngineError:
    with pytest.raises(EngineError) as caught:
        run(execution, abs, [1], *folders)
    return caught.value


def test_no_scheduler_at_the_address() -> None:
    address = "tcp://127.0.0.1:1"
    error = code_of(Execution(backend="dask", scheduler=address, scheduler_wait_s=0.5))
    assert error.code == "scheduler_unreachable"
    assert address in error.message


@pytest.mark.parametrize("name", ["python", "numpy", "polars", "code of motor-leakage"])
def test_workers_of_other_versions_are_refused(
    two_workers: Processes, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    mine = own_versions() | {name: "0.0"}
    monkeypatch.setattr("pipeline.workers.dask_worker.own_versions", lambda: mine)
    error = code_of(two_workers.execution())
    assert error.code == "scheduler_versions"
    assert f"{name} is {own_versions_now()[name]} there and 0.0 here" in error.message


def own_versions_now() -> dict[str, str]:
    return own_versions()


def test_a_scheduler_of_another_protocol_is_refused() -> None:
    packages = {"distributed": "1.0", "msgpack": "1.0"}
    other = {
        "client": {"packages": packages},
        "scheduler": {"packages": packages | {"msgpack": "2"}},
    }
    with pytest.raises(EngineError, match=r"msgpack is 2 there and 1\.0 here") as caught:
        _require_same_protocol(SimpleNamespace(get_versions=lambda: other), "tcp://there:1")
    assert caught.value.code == "scheduler_versions"


def test_a_scheduler_with_other_code_is_refused(two_workers: Processes) -> None:
    execution = two_workers.execution()
    with connected(execution, Surroundings(own_versions())) as client:
        client.run_on_scheduler(pretend_code, "0123")
        try:
            error = code_of(execution)
        finally:
            client.run_on_scheduler(pretend_code, own_versions()[CODE])
    assert error.code == "scheduler_versions"
    assert "the scheduler at" in error.message
    assert f"code of motor-leakage is 0123 there and {own_versions()[CODE]} here" in error.message


def pretend_code(code: str) -> None:
    """Let the scheduler believe that it has loaded other code; runs there."""
    import pipeline.workers.dask_worker as worker

    worker._LOADED = code


def test_a_scheduler_without_the_program_is_refused() -> None:
    def absent(*_: object) -> None:
        raise ModuleNotFoundError("No module named 'pipeline'")

    client: Any = SimpleNamespace(run_on_scheduler=absent)
    with pytest.raises(EngineError, match="No module named 'pipeline'") as caught:
        _require_same_program(client, "tcp://there:1", Surroundings(own_versions()))
    assert caught.value.code == "scheduler_versions"


def test_a_worker_with_two_threads_is_refused() -> None:
    client = SimpleNamespace(nthreads=lambda: {"tcp://a:1": 1, "tcp://b:1": 2})
    with pytest.raises(EngineError, match=r"tcp://b:1 has 2 threads") as caught:
        _require_one_thread(client)
    assert caught.value.code == "scheduler_threads"


def test_workers_that_do_not_see_the_logs_are_refused(
    two_workers: Processes, tmp_path: Path
) -> None:
    error = code_of(two_workers.execution(), tmp_path / "nowhere")
    assert error.code == "scheduler_folders"
    assert str(tmp_path / "nowhere") in error.message


def test_workers_without_credentials_for_the_logs_are_refused(
    two_workers: Processes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("AZURE_STORAGE_ACCOUNT_KEY", "a2V5")
    with (
        pytest.raises(EngineError, match=r"expected one of AZURE_STORAGE_ACCOUNT_KEY") as caught,
        open_engine(two_workers.execution(), (), ["az://container/logs"]),
    ):
        pass
    assert caught.value.code == "scheduler_credentials"


def test_without_the_extra_the_message_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    error = code_of(Execution(backend="dask"))
    assert error.code == "dask_missing"
    assert "motor-leakage[dask]" in error.message


def test_the_same_process_differs_in_nothing(tmp_path: Path) -> None:
    assert differences(Surroundings(own_versions(), (tmp_path,))) == []
    (found,) = differences(Surroundings({"numpy": "0"}))
    assert found.endswith("there and 0 here")
