"""Isolation of tasks: one that raises, hangs, exhausts memory or dies is lost alone."""

from __future__ import annotations

import multiprocessing.process
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

import pipeline
from pipeline.config import Execution
from pipeline.workers.local import HUGE_PAGES, Crew, Worker, environment, run_tasks
from pipeline.workers.process import ITEMS_A_SIGN, Done, Loss, start
from tests.pipeline.misbehaviour import (
    MISBEHAVIOUR,
    count_beside_or_die,
    die_once,
    do,
    hang_at_a_log,
    own_pid,
    own_pid_slowly,
    slow_by_items,
    slow_by_parts,
    workers_of,
)
from tests.pipeline.workers.limits import execution, wait_until


def not_lost(_: object, loss: Loss) -> Any:
    raise AssertionError(loss)


def results(tasks: Sequence[str], how: Execution) -> tuple[set[str], dict[str, Loss]]:
    """Tasks that were done, and the losses by task."""
    losses: dict[str, Loss] = {}

    def lost(task: str, loss: Loss) -> None:
        losses[task] = loss

    done = list(run_tasks(do, tasks, lost, how))
    return {one for one in done if one is not None}, losses


# By what a task does: the code of its loss, and words that say what it was.
EXPECTED = {
    "raise_error": ("internal", "ZeroDivisionError: not foreseen"),
    "panic": ("internal", "PanicException: not foreseen"),
    "hang_in_python": (
        "task_timeout",
        "not done within 5 s, at the third night, in hang_in_python",
    ),
    "hang_in_c": ("task_timeout", "not done within 5 s, in hang_in_c (misbehaviour.py, line"),
    "hang_in_a_pattern": ("task_timeout", "not done within 5 s, in fullmatch"),
    "stop": ("task_timeout", "not done within 5 s"),
    "eat_with_numpy": ("task_memory", "MemoryError: Unable to allocate 512. MiB"),
    "eat_with_python": ("task_memory", "MemoryError"),
    "eat_with_polars": ("task_memory", "SIGABRT: memory allocation of 536870912 bytes failed"),
    "eat_with_arrow": ("task_memory", "ArrowMemoryError: malloc of size 536870912 failed"),
    "eat_at_once": ("task_memory", "memory allocation of 8796093022208 bytes failed"),
    "kill": ("worker_died", "SIGKILL, as the system does for want of memory"),
    "segfault": ("worker_died", "SIGSEGV, in string_at"),
    "abort": ("worker_died", "SIGABRT, in abort"),
    "leave": ("worker_died", "exit code 0"),
}
# One of each kind; the others in the full run.
QUICK = {"panic", "hang_in_c", "eat_with_polars", "segfault"}


def check(names: Sequence[str], how: Execution) -> None:
    tasks = [f"good {k}" for k in range(len(names))]
    mixed = [one for pair in zip(names, tasks, strict=True) for one in pair]
    done, losses = results(mixed, how)
    assert done == {f"{task} done" for task in tasks}
    assert set(losses) == set(names)
    for name, loss in losses.items():
        code, words = EXPECTED[name]
        assert loss.code == code, name
        assert words in loss.how, name


# One of each kind; the others in the full run.


def test_what_a_task_does_to_its_worker_costs_itself_alone() -> None:
    check(sorted(QUICK), execution())


@pytest.mark.full
@pytest.mark.parametrize("workers", [1, 3])
def test_all_that_a_task_may_do_costs_itself_alone(workers: int) -> None:
    assert set(EXPECTED) == set(MISBEHAVIOUR)
    check(list(EXPECTED), execution(workers))


def test_a_worker_is_heard_before_it_is_late() -> None:
    """Its time may have run out while another worker was waited for."""
    worker = Worker()
    try:
        worker.begin(own_pid, None, execution())
        assert worker.connection.poll(60.0)
        worker.due = 0.0
        assert worker.outcome(()) is None
        while (found := worker.outcome([worker.connection])) is None:
            worker.connection.poll(60.0)
        assert found == Done(worker.process.pid)
    finally:
        worker.kill()


def test_a_process_imports_from_where_the_program_began(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A relative path of modules is not of the folder that somebody went to."""
    root = str(Path(pipeline.__file__).parents[1])
    others = [one for one in sys.path if one not in ("", root)]
    monkeypatch.setattr(sys, "path", [tmp_path, "", *others])
    monkeypatch.setattr(multiprocessing.process, "ORIGINAL_DIR", root)
    monkeypatch.chdir(tmp_path)
    process, connection = start("pipeline.logs.finding.answer")
    connection.send((tmp_path, []))
    assert connection.recv() == {}
    connection.close()
    assert process.wait(60.0) == 0


def test_tunables_of_the_c_library_that_are_set_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GLIBC_TUNABLES", "glibc.malloc.check=3")
    assert environment()["GLIBC_TUNABLES"] == f"glibc.malloc.check=3:{HUGE_PAGES}"


def test_a_single_task_and_a_single_worker_are_isolated_too() -> None:
    done, losses = results(["kill"], execution(workers=1))
    assert (done, {task: loss.code for task, loss in losses.items()}) == (
        set(),
        {"kill": "worker_died"},
    )


def test_each_part_has_the_whole_time() -> None:
    assert list(run_tasks(slow_by_parts, [2], not_lost, execution())) == [2]


@pytest.mark.parametrize(
    ("asked", "how"),
    [
        (True, "a.csv did not answer within 0.5 s"),
        (False, "a.csv did not come to its end within 1"),
    ],
)
def test_a_log_that_a_task_waits_for_is_named(asked: bool, how: str) -> None:
    """And not asked a second time."""
    found: list[Loss] = []
    limits = execution(timeout_s=1.0).model_copy(update={"answer_s": 0.5})
    list(run_tasks(hang_at_a_log, [asked], lambda _, loss: found.append(loss), limits))
    assert found == [Loss("log_no_answer", found[0].how, "a night", "a.csv")]
    assert found[0].how.startswith(how)


def test_the_first_time_nobody_is_waited_for() -> None:
    losses: list[Loss] = []
    limits = execution(timeout_s=60.0).model_copy(update={"answer_s": 0.5})
    with Crew(limits) as crew:
        tasks = ["hang_in_python", "kill", "good"]
        done = crew.run_tasks(do, tasks, lambda _, loss: losses.append(loss), first=True)
        assert [one for one in done if one is not None] == ["good done"]
    assert sorted(loss.code for loss in losses) == ["task_timeout", "worker_died"]
    assert (
        "not done within 0.5 s, at the third night"
        in {loss.code: loss.how for loss in losses}["task_timeout"]
    )


def test_many_files_take_as_long_as_they_take() -> None:
    """Each answers; together they take longer than one task may be silent."""
    limits = execution().model_copy(update={"answer_s": 2.0})
    with Crew(limits) as crew:
        done = crew.run_tasks(slow_by_items, [3 * ITEMS_A_SIGN], not_lost, first=True)
        assert list(done) == [3 * ITEMS_A_SIGN]


def test_a_task_that_is_lost_once_is_done_the_second_time(tmp_path: Path) -> None:
    assert list(run_tasks(die_once, [str(tmp_path / "died")], not_lost, execution())) == ["done"]
    assert (tmp_path / "died").exists()


def test_workers_stay_for_the_tasks_that_follow() -> None:
    with Crew(execution()) as crew:
        first = set(crew.run_tasks(own_pid, range(6), not_lost))
        assert set(crew.run_tasks(own_pid, range(6), not_lost)) <= first
        assert len(first) <= 2
        # One that nobody waits for any more is ended, and there is another for what follows.
        slow = crew.run_tasks(own_pid_slowly, [0.0, 60.0], not_lost)
        next(slow)
        slow.close()  # type: ignore[attr-defined]
        assert len(list(crew.run_tasks(own_pid, range(6), not_lost))) == 6


@pytest.mark.skipif(sys.platform != "linux", reason="counts processes in /proc")
def test_the_second_time_it_is_alone(tmp_path: Path) -> None:
    markers = [str(tmp_path / name) for name in "ab"]

    # Other tests may have left idle workers to this process.
    idle = workers_of(os.getpid())
    beside = list(run_tasks(count_beside_or_die, markers, not_lost, execution()))
    assert len(beside) == 2
    assert max(beside) <= idle


def test_what_a_worker_says_reaches_stderr(capfd: pytest.CaptureFixture[str]) -> None:
    results(["raise_error"], execution(workers=1))
    err = capfd.readouterr().err
    assert err.count("ZeroDivisionError: not foreseen") >= 2
    assert "in raise_error" in err


def test_sequential_has_the_same_outcomes_for_what_is_raised() -> None:
    how = Execution(backend="sequential")
    done, losses = results(["good", "raise_error", "panic"], how)
    assert done == {"good done"}
    assert {task: loss.code for task, loss in losses.items()} == {
        "raise_error": "internal",
        "panic": "internal",
    }


PARENT = """
import sys
from pipeline.config import Execution
from pipeline.workers.local import run_tasks
from tests.pipeline.misbehaviour import pid_and_hang

print("begun", flush=True)
list(run_tasks(pid_and_hang, [sys.argv[1]] * 2, print, Execution(workers=2)))
"""


def is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (ProcessLookupError, FileNotFoundError):
        return False
    return state != "Z"


# Workers end with the run, however that ends


@pytest.mark.skipif(sys.platform != "linux", reason="the kernel's help is Linux's")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_no_worker_outlives_the_run(tmp_path: Path, number: signal.Signals) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", PARENT, str(tmp_path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        cwd=Path(__file__).parents[3],
    )
    try:
        wait_until(lambda: len(list(tmp_path.iterdir())) == 2)
        workers = [int(path.name) for path in tmp_path.iterdir()]
        assert all(map(is_running, workers))
        os.kill(process.pid, number)
        process.wait(timeout=60)
        wait_until(lambda: not any(map(is_running, workers)))
    finally:
        process.kill()
        process.communicate()
