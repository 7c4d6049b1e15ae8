"""Logs in an object store: which are read, and those that change meanwhile."""

from __future__ import annotations

import datetime as dt
import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

import pipeline.run.motor_task
from pipeline.cli import app
from pipeline.config import load_fleet
from pipeline.errors import StoreError
from pipeline.logs.finding import FolderLogs, StoredLogs
from pipeline.setup.check import check_motor
from pipeline.store.object_store import ObjectStore
from tests.pipeline.s3_server import URL, Request, Server, never, upload
from tests.pipeline.workshop import DAY, QUICK, Workshop

FIRST = dt.date(2026, 1, 2)


def with_nights(folder: Path, n: int) -> Workshop:
    made = Workshop.at(folder)
    for number in range(n):
        made.log(FIRST + number * DAY, seed=number)
    return made


def stored(workshop: Workshop, **changed: Any) -> Any:
    """The workshop's motor with its logs in the bucket."""
    task = workshop.task()
    spec = replace(task.spec, log_url=URL)
    return replace(task, spec=spec, **changed)


def test_a_log_that_is_replaced_once_it_was_listed_waits(server: Server, tmp_path: Path) -> None:
    shop = with_nights(tmp_path, 2)
    store = ObjectStore.at(URL)
    upload(tmp_path / "logs", store.url)
    key = f"M1/{FIRST}.parquet"
    other = shop.log(FIRST, seed=9).read_bytes()

    def swap(asked: Request) -> None:
        # It has been listed; by now somebody has replaced it.
        if asked.method == "GET" and asked.path.endswith(key):
            server.before = never
            store.put(key, other)

    server.before = swap
    outcome = pipeline.run.motor_task.run_motor(stored(shop))
    assert outcome.files == {"growing": 1, "read": 1}
    assert outcome.nights == (FIRST + DAY,)
    assert "it was replaced or removed meanwhile" in outcome.growing[0]


def test_globs_and_names_are_those_of_folders(server: Server, tmp_path: Path) -> None:
    names = ["M1/a.csv", "M1/b.csv", "M1/old/c.csv", "M1/a[1].csv", "M10/a.csv", "M1/b.txt"]
    store = ObjectStore.at(URL)
    shop = Workshop.at(tmp_path)
    for name in names:
        store.put(name, b"x")
        (tmp_path / "logs" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "logs" / name).write_bytes(b"x")
    for patterns in (["M1/*.csv"], ["M1/**/*.csv"], ["M1/a[1].csv"], ["*/a.csv"], ["M1/[!a].csv"]):
        shop.configure(files=json.dumps(patterns)[1:-1])
        spec = stored(shop).spec
        here = FolderLogs(shop.task().spec)
        there = StoredLogs(spec)
        assert there.names == here.names
        assert here.names
    shop.configure(files='"M1/absent.csv"')
    assert StoredLogs(stored(shop).spec).absent == ["M1/absent.csv"]


@pytest.mark.parametrize(
    ("url", "has_key", "code"),
    [(URL, False, "object_store_credentials"), ("s3://absent/logs", True, "object_store_bucket")],
)
def test_a_run_whose_logs_cannot_be_listed_ends_with_4(
    server: Server,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    url: str,
    has_key: bool,
    code: str,
) -> None:
    shop = Workshop.at(tmp_path)
    shop.configure(fleet=QUICK.replace("../logs", url))
    if not has_key:
        monkeypatch.delenv("AWS_ACCESS_KEY_ID")
    ended = CliRunner().invoke(app, ["fit-fleet", str(shop.fleet)])
    assert isinstance(ended.exception, StoreError)  # for which the command ends with 4
    assert ended.exception.code == code
    assert not shop.output.exists()


# Check


def in_bucket(shop: Workshop) -> Any:
    """The workshop's fleet, its logs moved into the bucket."""
    upload(shop.folder / "logs", URL)
    shutil.rmtree(shop.folder / "logs")
    shop.configure(fleet=QUICK.replace("../logs", URL))
    return load_fleet(shop.fleet)


def test_check_says_of_a_bucket_what_it_says_of_a_folder(server: Server, tmp_path: Path) -> None:
    shop = with_nights(tmp_path, 2)
    (shop.logs / "broken.parquet").write_bytes(b"PAR1 and nothing of use")
    (spec,) = load_fleet(shop.fleet).motors
    here = check_motor(spec)
    (spec,) = in_bucket(shop).motors
    there = check_motor(spec)
    assert there.n_files == 3
    assert len(there.channels) == 4
    fault, unusual = there.faults
    assert "broken.parquet" in fault
    assert unusual.startswith("unit_unusual: leakage_flow: ")
    assert replace(there, faults=()) == replace(here, faults=())


def test_check_opens_the_first_and_the_newest_objects_alone(server: Server, tmp_path: Path) -> None:
    shop = with_nights(tmp_path, 5)
    (spec,) = in_bucket(shop).motors
    server.forget()
    checked = check_motor(spec)
    opened = {Path(path).stem for path in server.asked("GET") if path.endswith(".parquet")}
    assert opened == {str(FIRST + number * DAY) for number in (0, 3, 4)}
    assert (checked.n_files, checked.first, checked.last) == (5, str(FIRST), str(FIRST + 4 * DAY))
    ran, *_, note = checked.notes
    assert ran.startswith(f"in the night {FIRST + 4 * DAY} the motor ran ")
    assert note.startswith("3 of 5 objects were opened")
    ended = CliRunner().invoke(app, ["check", str(shop.fleet)])
    assert ended.exit_code == 0
    assert "M1: MINI, parquet, 5 files" in ended.output
    assert note in ended.output
