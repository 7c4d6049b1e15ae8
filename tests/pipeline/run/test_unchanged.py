"""A motor with nothing new is told without a worker; all others are left to their tasks."""

from __future__ import annotations

import datetime as dt
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from threading import Event

import pytest

from pipeline.config import Execution, load_fleet
from pipeline.run.fleet import RunRequest, run_fleet
from pipeline.run.motors import unchanged_motors
from pipeline.run.tasks import MotorTask
from pipeline.store.state import open_state
from tests.pipeline.workshop import DAY, Workshop

NIGHT = dt.date(2026, 3, 2)
HERE = Execution(backend="sequential")
BESIDE = Execution(backend="loky", workers=2)


@pytest.fixture(scope="module")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Workshop:
    made = Workshop.at(tmp_path_factory.mktemp("made"))
    made.log(NIGHT)
    made.log(NIGHT + DAY, seed=2)
    made.run()
    return made


def unchanged(execution: Execution, *tasks: MotorTask) -> int:
    with open_state(tasks[0].output) as state:
        return len(list(unchanged_motors(tasks, execution, state)))


def test_a_run_with_nothing_new_starts_no_worker(
    workshop: Workshop, monkeypatch: pytest.MonkeyPatch
) -> None:
    def forbidden(*_: object, **__: object) -> None:
        raise AssertionError("a worker is started")

    monkeypatch.setattr("joblib.Parallel", forbidden)
    monkeypatch.setattr("pipeline.run.motors.run_motor", forbidden)
    fleet = replace(load_fleet(workshop.fleet), execution=BESIDE)
    (outcome,) = run_fleet(RunRequest(fleet)).outcomes
    assert (outcome.status, outcome.nights) == ("no_new_data", ())
    assert outcome.files == {"unchanged": 2}


def of_another_size(workshop: Workshop) -> None:
    with (workshop.logs / f"{NIGHT}.parquet").open("ab") as log:
        log.write(b"more")


def of_another_time(workshop: Workshop) -> None:
    os.utime(workshop.logs / f"{NIGHT}.parquet", ns=(1, 1))


def another_of_the_same_name(workshop: Workshop) -> None:
    path = workshop.logs / f"{NIGHT}.parquet"
    shutil.copy2(path, workshop.logs / "copy")
    (workshop.logs / "copy").replace(path)


def one_more(workshop: Workshop) -> None:
    (workshop.logs / "new.parquet").touch()


def a_pipe(workshop: Workshop) -> None:
    os.mkfifo(workshop.logs / "pipe.parquet")


def one_that_is_named_and_absent(workshop: Workshop) -> None:
    workshop.configure(files='"M1/*.parquet", "M1/absent.parquet"')


def no_log_at_all(workshop: Workshop) -> None:
    shutil.rmtree(workshop.logs)


def another_setting(workshop: Workshop) -> None:
    text = workshop.fleet.read_text("utf-8")
    workshop.fleet.write_text(text + "[reference]\npressure_bar = 210.0\n", "utf-8")


@pytest.mark.parametrize(
    "change",
    [
        of_another_size,
        of_another_time,
        another_of_the_same_name,
        one_more,
        a_pipe,
        one_that_is_named_and_absent,
        no_log_at_all,
        another_setting,
    ],
)
def test_a_motor_with_news_is_left_to_its_task(
    workshop: Workshop, tmp_path: Path, change: Callable[[Workshop], None]
) -> None:
    shutil.copytree(workshop.folder, tmp_path / "copy")
    other = Workshop(tmp_path / "copy")
    other.run()  # the copies of the logs are other files
    assert unchanged(HERE, other.task()) == 1
    change(other)
    assert unchanged(HERE, other.task()) == 0


def test_logs_that_do_not_answer_are_left_to_the_tasks(
    workshop: Workshop, monkeypatch: pytest.MonkeyPatch
) -> None:
    task, answered = workshop.task(), Event()
    assert unchanged(BESIDE, task, task) == 2
    monkeypatch.setattr("pipeline.run.motors._look", lambda *_: answered.wait())
    hasty = BESIDE.model_copy(update={"answer_s": 0.01})
    assert unchanged(hasty, task, task) == 0
    answered.set()
