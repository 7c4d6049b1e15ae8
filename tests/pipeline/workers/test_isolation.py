"""Isolation of tasks: one that raises, hangs, exhausts memory or dies is lost alone."""

from __future__ import annotations

import importlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from pipeline.config import Execution
from pipeline.workers import engine, process
from pipeline.workers.engine import HUGE_PAGES, Workers, memory_of, open_workers
from pipeline.workers.process import Loss
from tests.pipeline.misbehaviour import (
    count_beside_or_die,
    die_once,
    do,
    environment,
    hang_at_a_log,
    own_pid,
    slow_by,
    wait_until,
    workers_of,
)

LIMITS = Execution(workers=2, timeout_s=20.0)
HASTY = LIMITS.model_copy(update={"timeout_s": 2.0})
# By what a task does: the code of its loss, and words that say what it was and where.
EXPECTED = {
    "raise_error": ("internal", "ZeroDivisionError: not foreseen"),
    "panic": ("internal", "PanicException: not foreseen"),
    "hang_in_python": ("task_timeout", "not done within 2 s, at the third night"),
    "hang_in_c": ("task_timeout", "not done within 2 s"),
    "stop": ("task_timeout", "not done within 2 s, at a night"),
    "eat_with_numpy": ("task_memory", "MemoryError: Unable to allocate 512. MiB"),
    "eat_with_polars": ("task_memory", "SIGABRT(-6): memory allocation of 536870912 bytes failed"),
    "eat_at_once": ("task_memory", "memory allocation of 8796093022208 bytes failed"),
    "kill": ("worker_died", "its worker process ended with SIGKILL(-9)"),
    "segfault": ("worker_died", "SIGSEGV(-11)"),
}
ALL = [*((name, 2) for name in EXPECTED), ("kill", 1), ("hang_in_c", 1)]


def not_lost(_: object, loss: Loss) -> object:
    raise AssertionError(loss)


@pytest.fixture(scope="module")
def pool() -> Iterator[Workers]:
    """Two workers, which leave nothing of themselves behind."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("GLIBC_TUNABLES", "glibc.malloc.check=3")
        patched.setattr(engine, "memory_of", lambda _: 700 << 20)
        importlib.import_module("joblib")  # which sets a variable of its own
        before = dict(os.environ)
        with open_workers(LIMITS) as workers:
            yield workers
        assert workers_of(os.getpid()) == 0
        assert dict(os.environ) == before


def test_workers_stay_have_variables_of_their_own_and_are_heard(
    pool: Workers, capfd: pytest.CaptureFixture[str]
) -> None:
    """They begin here, so that what they write is captured."""
    # One of the two may do all of a call.
    pids = {pid for _ in range(3) for pid in pool.run(own_pid, range(6), not_lost)}
    assert len(pids) <= 2
    assert os.getpid() not in pids
    (variables,) = pool.run(environment, [None], not_lost)
    list(pool.run(do, ["raise_error"], lambda *_: None))
    assert variables["POLARS_MAX_THREADS"] == variables["OMP_NUM_THREADS"] == "1"
    assert variables["GLIBC_TUNABLES"] == f"glibc.malloc.check=3:{HUGE_PAGES}"
    err = capfd.readouterr().err
    assert "ZeroDivisionError: not foreseen" in err
    assert "in raise_error" in err


def check_losses(workers: Workers, *names: str) -> None:
    """Do tasks that misbehave among some that do not."""
    losses: dict[str, Loss] = {}
    done = set(workers.run(do, ["a", *names, *"bcd"], losses.__setitem__))
    assert done == {"a done", "b done", "c done", "d done", None}
    assert set(losses) == set(names)
    for name in names:
        code, words = EXPECTED[name]
        assert losses[name].code == code
        assert words in losses[name].how


def test_what_a_task_does_to_its_worker_costs_itself_alone(pool: Workers) -> None:
    """Of each kind that does not hang; the others in the full run."""
    check_losses(pool, "panic", "eat_with_polars")


@pytest.mark.full
@pytest.mark.parametrize(("name", "n_workers"), ALL)
def test_whatever_a_task_does_costs_itself_alone(name: str, n_workers: int) -> None:
    limits = HASTY if EXPECTED[name][0] == "task_timeout" else LIMITS
    with open_workers(limits.model_copy(update={"workers": n_workers})) as workers:
        check_losses(workers, name)


def test_a_log_that_a_task_waits_for_is_named() -> None:
    """And a task that hangs ends; each part of a task and each file has the whole time."""
    losses: dict[bool, Loss] = {}
    with open_workers(HASTY) as workers:
        list(workers.run(hang_at_a_log, [True], losses.__setitem__))
        assert sorted(workers.run(slow_by, ["items", "parts"], not_lost)) == ["items", "parts"]
    how = "a.csv did not answer within 0.2 s, at a night"
    assert losses == {True: Loss("log_no_answer", how, "a night", "a.csv")}


def test_a_log_that_has_answered_has_the_time_of_a_night() -> None:
    def limit_of_log(_: object) -> float:
        with process.reading("a.csv"):
            return process._mark.limit_s

    assert process.do(limit_of_log, None, HASTY)[1] == HASTY.timeout_s


@pytest.mark.skipif(sys.platform != "linux", reason="counts processes in /proc")
def test_a_task_that_is_lost_once_is_done_the_second_time_with_nothing_beside_it(
    pool: Workers, tmp_path: Path
) -> None:
    markers = [str(tmp_path / name) for name in "ab"]
    assert list(pool.run(count_beside_or_die, markers, not_lost)) == [0, 0]
    assert list(pool.run(die_once, markers, not_lost)) == ["done", "done"]


PARENT = """
import sys
from pipeline.config import Execution
from pipeline.workers.engine import open_workers
from tests.pipeline.misbehaviour import pid_and_wait

with open_workers(Execution(workers=2)) as workers:
    list(workers.run(pid_and_wait, [sys.argv[1]] * 2, print))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the kernel's help is Linux's")
@pytest.mark.parametrize(
    ("number", "to_all"),
    [
        (signal.SIGKILL, False),
        pytest.param(signal.SIGINT, True, marks=pytest.mark.full),
        pytest.param(signal.SIGINT, False, marks=pytest.mark.full),
    ],
)
def test_no_worker_outlives_the_run(tmp_path: Path, number: signal.Signals, to_all: bool) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", PARENT, str(tmp_path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        cwd=Path(__file__).parents[3],
        start_new_session=True,
    )
    try:
        wait_until(lambda: len(list(tmp_path.iterdir())) == 2)
        workers = [int(path.name) for path in tmp_path.iterdir()]
        assert all(map(is_running, workers))
        (os.killpg if to_all else os.kill)(process.pid, number)
        _, err = process.communicate(timeout=60)
        wait_until(lambda: not any(map(is_running, workers)))
        # Workers say nothing of what the terminal sends to all processes.
        assert err.count(b"Traceback") <= 1
    finally:
        process.kill()
        process.communicate()


def is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (ProcessLookupError, FileNotFoundError):
        return False
    return state != "Z"


@pytest.mark.parametrize(
    ("machine_gib", "n_workers", "limit_gib"), [(4, 2, 4), (24, 3, 8), (512, 2, 16)]
)
def test_a_worker_has_its_share_of_the_machine_within_limits(
    monkeypatch: pytest.MonkeyPatch, machine_gib: int, n_workers: int, limit_gib: int
) -> None:
    sizes = {"SC_PHYS_PAGES": machine_gib << 18, "SC_PAGE_SIZE": 1 << 12}
    monkeypatch.setattr(os, "sysconf", sizes.__getitem__)
    assert memory_of(n_workers) == limit_gib << 30
