"""Nights that a run does again, and those it leaves: reading, fits, verdicts, or trends alone.

Each test states by design.md section 4 which nights a change touches. Reading is detected by first
overwriting all logs with zeros, with the same size and time: a run that opens one fails.
"""

from __future__ import annotations

import datetime as dt
import os
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from threading import Event

import polars as pl
import pytest

from pipeline.config import Execution, load_fleet
from pipeline.run.fleet import RunRequest, run_fleet, unchanged_motors
from pipeline.run.night_plan import plan_fleet
from pipeline.run.tasks import MotorTask, Work
from pipeline.store.state import open_state
from tests.pipeline.workshop import DAY, Workshop

FIRST = dt.date(2026, 3, 2)
States = Mapping[str, str]
BESIDE = Execution(backend="loky", workers=2)
NIGHTS = tuple(FIRST + number * DAY for number in range(4))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Workshop:
    workshop = Workshop.at(tmp_path_factory.mktemp("made"))
    for number, night in enumerate(NIGHTS):
        workshop.log(night, seed=number + 1)
    workshop.run()
    assert set(workshop.statuses().values()) == {"ok"}
    return workshop


@pytest.fixture
def workshop(made: Workshop, tmp_path: Path) -> Workshop:
    """Four nights that are fitted."""
    shutil.copytree(made.folder, tmp_path / "copy")
    return Workshop(tmp_path / "copy")


def blank(workshop: Workshop, *but: dt.date) -> None:
    """Make the logs of all nights but some unreadable, and unchanged to the eye."""
    for path in workshop.logs.iterdir():
        if path.stem not in map(str, but):
            state = path.stat()
            with path.open("r+b") as stream:
                stream.write(bytes(state.st_size))
            os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns))
    with open_state(workshop.output) as kept:  # the system would not take that time back
        for path in workshop.logs.iterdir():
            state, name = path.stat(), f"M1/{path.name}"
            seen = state.st_ctime_ns, state.st_ino
            kept.write("UPDATE logs SET changed_ns = ?, inode = ? WHERE path = ?", *seen, name)


def planned(workshop: Workshop) -> Mapping[dt.date, tuple[Work, str]]:
    ((_, plan),) = plan_fleet(RunRequest(load_fleet(workshop.fleet)))
    return {night: (step.work, step.reason) for night, step in plan.items()}


def files(workshop: Workshop, *tables: str) -> States:
    """Rows of each night by table, with the runs that made them, as text."""
    found = {}
    for table in tables:
        pattern = workshop.output / "tables" / table / "**" / "*.parquet"
        rows = pl.read_parquet(pattern, hive_partitioning=False)
        for (night,), part in rows.partition_by("night", as_dict=True).items():
            found[f"{table} {night}"] = part.write_json()
    return found


def written(before: States, after: States) -> set[str]:
    """Nights with rows that were made anew."""
    return {name.split()[1] for name in after if after[name] != before.get(name)}


def previous(workshop: Workshop) -> dict[dt.date, float | None]:
    """Fit of the model before by night."""
    return dict(workshop.rows("nights").select("night", "previous_model_fit_percent").iter_rows())


def test_a_corrected_night_is_read_and_no_other_is_fitted(workshop: Workshop) -> None:
    """Design.md section 4: later nights are judged anew by its model, from stored blocks."""
    touched, after, last = NIGHTS[1], NIGHTS[2], NIGHTS[3]
    path = workshop.log(touched, seed=9)
    blank(workshop, touched)
    assert planned(workshop) == {touched: (Work.READ, f"changed file M1/{path.name}")}
    tables = ("blocks", "predictions", "quality")
    before, fits = files(workshop, *tables), files(workshop, "fits")
    trends, percents = files(workshop, "trends"), previous(workshop)
    outcome = workshop.run()
    assert outcome.nights == (touched,)
    assert written(before, files(workshop, *tables)) == {str(touched)}
    assert written(fits, files(workshop, "fits")) == {str(touched)}
    changed = {night for night, percent in previous(workshop).items() if percent != percents[night]}
    assert changed == {touched, after}
    assert written(trends, files(workshop, "trends")) == {str(touched), str(after), str(last)}
    assert set(workshop.statuses().values()) == {"ok"}


def test_content_counts_and_not_the_time_of_a_file(workshop: Workshop) -> None:
    for path in workshop.logs.iterdir():
        os.utime(path, (1, 1))
    assert planned(workshop) == {}
    # A copy of the same size and time: seen by the number of the file.
    path = workshop.logs / f"{NIGHTS[0]}.parquet"
    copy = path.with_suffix(".copy")
    shutil.copy2(path, copy)
    copy.replace(path)
    assert planned(workshop) == {}


def unchanged(execution: Execution, *tasks: MotorTask) -> int:
    with open_state(tasks[0].output) as state:
        return len(list(unchanged_motors(tasks, execution, state)))


def test_a_run_with_nothing_new_starts_no_worker(
    workshop: Workshop, monkeypatch: pytest.MonkeyPatch
) -> None:
    def forbidden(*_: object, **__: object) -> None:
        raise AssertionError("a worker is started")

    workshop.run()  # the copies of the logs are other files
    monkeypatch.setattr("joblib.Parallel", forbidden)
    monkeypatch.setattr("pipeline.run.fleet.run_motor", forbidden)
    fleet = replace(load_fleet(workshop.fleet), execution=BESIDE)
    (outcome,) = run_fleet(RunRequest(fleet)).outcomes
    assert (outcome.status, outcome.nights) == ("no_new_data", ())
    assert outcome.files == {"unchanged": len(NIGHTS)}


def test_logs_that_do_not_answer_are_left_to_the_tasks(
    workshop: Workshop, monkeypatch: pytest.MonkeyPatch
) -> None:
    workshop.run()
    task, answered = workshop.task(), Event()
    assert unchanged(BESIDE, task, task) == 2
    monkeypatch.setattr("pipeline.run.fleet._stat_logs", lambda *_: answered.wait())
    hasty = BESIDE.model_copy(update={"timeout_s": 0.1})
    assert unchanged(hasty, task, task) == 0
    answered.set()
