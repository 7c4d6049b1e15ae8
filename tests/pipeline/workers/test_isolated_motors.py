"""Isolation in a run: a night, a log or trends that take their worker along cost no others."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import nullcontext
from typing import Any

import pytest

import pipeline.logs.motor_logs
import pipeline.run.fleet
import pipeline.run.motor_task
import pipeline.run.publishing
from pipeline.config import Execution, load_fleet
from pipeline.run.fleet import RunRequest, RunResult, run_fleet
from pipeline.workers import engine, process
from pipeline.workers.engine import Workers
from pipeline.workers.process import Loss, Mark
from tests.pipeline.misbehaviour import Misbehaving, fit_with_pipes_as_files
from tests.pipeline.simulated import NIGHT
from tests.pipeline.workshop import DAY, QUICK, Workshop

BAD = NIGHT + DAY
MOTORS = ("M1", "M2")


def write_logs(workshop: Workshop, *motors: str) -> None:
    for motor in motors:
        for number in range(3):
            workshop.log(NIGHT + number * DAY, motor=motor)


class DeathError(BaseException):
    """In place of a worker's death: nothing in a task holds it up."""


class Dying:
    """Workers in this process, that die in a call of a night or of a log, each time."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, module: Any, name: str) -> None:
        self.call = getattr(module, name)
        self.marks: list[Mark] = []
        monkeypatch.setattr(module, name, self.die)
        workers = nullcontext(Workers(self.tried))
        monkeypatch.setattr(pipeline.run.fleet, "open_workers", lambda *_: workers)

    def die(self, *arguments: Any) -> Any:
        """Call, unless it is for the night in which workers die."""
        if str(BAD) in f"{arguments[0]} {getattr(arguments[1], 'date', '')}":
            self.marks.append(process._mark)
            raise DeathError
        return self.call(*arguments)

    def tried(
        self, function: Callable[[Any], Any], tasks: Iterable[Any]
    ) -> Iterator[tuple[Any, Any]]:
        """Do tasks; of a death is known what was marked last."""
        for task in tasks:
            _, outcome, _ = process.do(function, task, Execution())
            if self.marks:
                mark = self.marks.pop()
                outcome = Loss("worker_died", "it was killed", mark.part, mark.log)
            yield task, outcome


@pytest.mark.parametrize(
    ("module", "name", "words"),
    [
        pytest.param(pipeline.run.motor_task, "fit_night", "it was killed", id="fit"),
        pytest.param(
            pipeline.logs.motor_logs,
            "read_log",
            f"{BAD}.parquet: it was killed (night known by its name)",
            id="log",
        ),
    ],
)
def test_what_workers_die_of_costs_its_night_alone(
    workshop: Workshop, monkeypatch: pytest.MonkeyPatch, module: Any, name: str, words: str
) -> None:
    write_logs(workshop, "M1")
    with monkeypatch.context() as patched:
        Dying(patched, module, name)
        outcome = workshop.run()
    assert (outcome.status, outcome.error_code) == ("failed", "worker_died")
    assert outcome.message == f"night {BAD}: {words}"
    assert list(workshop.statuses().values()) == ["ok", "failed", "ok"]
    assert workshop.rows("nights")["error_code"].to_list() == [None, "worker_died", None]
    # A log is tried again by the next run, a night where that is asked for.
    is_night = name == "fit_night"
    if is_night:
        assert workshop.run().nights == ()
    assert workshop.run(retry=is_night).status == "ok"
    assert list(workshop.statuses().values()) == ["ok"] * 3


# With workers that die indeed: quick tests of what a task does to its worker are `test_isolation`.


def run_isolated(workshop: Workshop, limits: str) -> RunResult:
    """Run two motors in a worker process."""
    fleet = QUICK.replace("sequential", "loky") + f"workers = 1\n{limits}\n"
    workshop.configure(fleet=fleet, motors=MOTORS)
    return run_fleet(RunRequest(load_fleet(workshop.fleet)))


@pytest.mark.full
@pytest.mark.parametrize(
    ("what", "limits", "code"),
    [
        ("kill", "", "worker_died"),
        ("hang_in_c", "timeout_s = 15.0", "task_timeout"),
        ("eat_with_numpy", "", "task_memory"),
        ("panic", "", "internal"),
    ],
)
def test_a_night_that_takes_its_worker_along_costs_no_other_night(
    workshop: Workshop, monkeypatch: pytest.MonkeyPatch, what: str, limits: str, code: str
) -> None:
    write_logs(workshop, *MOTORS)
    monkeypatch.setattr(engine, "memory_of", lambda _: 1500 << 20)
    bad = Misbehaving("M2", what, str(BAD))
    monkeypatch.setattr(pipeline.run.fleet, "run_motor", bad.fit)
    run_isolated(workshop, limits)
    nights = workshop.rows("nights").sort("motor_id", "night")
    assert nights["error_code"].to_list() == [*[None] * 4, code, None]
    assert nights["reason"][4]


@pytest.mark.full
def test_trends_that_take_their_worker_along_cost_their_motor_alone(
    workshop: Workshop, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_logs(workshop, *MOTORS)
    bad = Misbehaving("M2", "segfault")
    monkeypatch.setattr(pipeline.run.publishing, "run_trends", bad.watch)
    (failed,) = run_isolated(workshop, "").failed
    assert (failed.motor_id, failed.error_code) == ("M2", "worker_died")
    assert failed.message is not None
    assert failed.message.startswith("trends: its worker process ended with SIGSEGV(-11), at M2")
    # Its fits are there, and the trends of the other.
    assert workshop.rows("nights")["status"].to_list() == ["ok"] * 6
    assert set(workshop.rows("trends")["motor_id"]) == {"M1"}


@pytest.mark.full
def test_a_log_that_does_not_answer_is_named_and_costs_its_night(
    workshop: Workshop, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_logs(workshop, *MOTORS)
    blocked = f"{NIGHT + 3 * DAY}.parquet"
    os.mkfifo(workshop.logs / blocked)
    monkeypatch.setattr(pipeline.run.fleet, "run_motor", fit_with_pipes_as_files)
    (failed,) = run_isolated(workshop, "timeout_s = 30.0").failed
    assert (failed.motor_id, failed.error_code) == ("M1", "log_no_answer")
    nights = workshop.rows("nights").filter(motor_id="M1")
    assert nights["status"].to_list() == [*["ok"] * 3, "failed"]
    (row,) = workshop.rows("log_files").filter(status="failed").to_dicts()
    assert (row["night"], row["error_code"]) == (NIGHT + 3 * DAY, "log_no_answer")
    assert row["message"] == f"{blocked}: did not answer within 3 s (night known by its name)"
