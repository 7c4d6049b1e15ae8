"""A fleet's run whose logs and tables lie in an object store: as a run in a folder, byte for byte.

Whatever fails on the way, what is published is the run before or the run after, and nothing else.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import duckdb
import polars as pl
import pytest

import pipeline.store.working_copy
from pipeline.cli.arguments import load
from pipeline.config import load_fleet
from pipeline.errors import StoreError
from pipeline.notification.outbox import waiting
from pipeline.run.fleet import RunRequest, RunResult, refresh, run_fleet
from pipeline.schema import FITS, TRENDS
from pipeline.store.object_store import ObjectStore
from pipeline.store.published import MANIFEST_FILE
from pipeline.store.state import BACKUP_FILE, STATE_FILE, State, open_state
from pipeline.store.tables import night_file
from pipeline.store.working_copy import ROOT, Snapshot, key_of, pull, push, read_snapshot
from pipeline.trends.nights.decisions import Decision, read_decisions, record_decision
from tests.conftest import OwnFleet
from tests.pipeline.calling import change
from tests.pipeline.notification.fleet import keep, told, told_fleet
from tests.pipeline.run.demo_runs import CSV, PARQUET, status_of, table_files
from tests.pipeline.s3_server import BUCKET, URL, Request, Server, never, upload
from tests.pipeline.workshop import DAY, Workshop

FIRST = dt.date(2026, 1, 2)


@pytest.fixture
def shop(server: Server, tmp_path: Path) -> Workshop:
    """A motor with one night that is published."""
    made = Workshop.at(tmp_path)
    made.log(FIRST)
    run(made.fleet, made.output)
    return made


def run(fleet_file: Path, output: Path, **changed: Any) -> RunResult:
    fleet = load_fleet(fleet_file)
    how = fleet.execution.model_copy(update={"backend": "sequential"})
    changed = {"object_store": URL} | changed
    return run_fleet(RunRequest(replace(fleet, output=output, execution=how, **changed)))


def logs_at(fleet_file: Path, url: str) -> None:
    """Let a fleet's logs lie at a URL."""
    text = fleet_file.read_text("utf-8")
    assert 'logs = "../demo/logs"' in text
    fleet_file.write_text(text.replace("../demo/logs", url), "utf-8")


def published(url: str = URL) -> dict[str, bytes]:
    """Every table file that is published, by its path, but for `latest` and those of the run."""
    store = ObjectStore.at(url)
    found = {}
    for path, digest in read_snapshot(store).files.items():
        content = store.get(key_of(path, digest))
        assert content is not None
        assert hashlib.sha256(content[0]).hexdigest() == digest
        if path.startswith("tables/") and path.split("/")[1] not in (
            "runs",
            "motor_outcomes",
            "latest",
        ):
            found[path.removeprefix("tables/")] = content[0]
    return found


def test_logs_and_tables_in_a_bucket_give_the_bytes_of_a_folder(
    server: Server, own_fleet: OwnFleet, tmp_path: Path
) -> None:
    fleet = own_fleet(CSV, PARQUET)
    run(fleet, tmp_path / "folder", object_store="")
    upload(tmp_path / "demo" / "logs", f"s3://{BUCKET}/logs")
    shutil.rmtree(tmp_path / "demo" / "logs")
    logs_at(fleet, f"s3://{BUCKET}/logs")
    result = run(fleet, tmp_path / "work")
    assert status_of(result) == {CSV: "ok", PARQUET: "ok"}
    assert published() == table_files(tmp_path / "folder") == table_files(tmp_path / "work")
    # A second run opens no log, and reads and writes only what tells of the run itself.
    server.forget()
    again = run(fleet, tmp_path / "work")
    assert (again.n_nights, dict(again.files)) == (0, {"unchanged": 6})
    assert not [path for path in server.asked("GET") if "/logs/" in path]
    assert not [path for path in server.asked("GET") if "/files/" in path]
    assert not [path for path in server.asked("PUT") if "2026-01" in path]
    assert published() == table_files(tmp_path / "folder")
    # On another machine, with an empty folder: nothing is made anew.
    elsewhere = replace(load_fleet(fleet), output=tmp_path / "elsewhere", object_store=URL)
    assert refresh(elsewhere) == len(read_snapshot(ObjectStore.at(URL)).files)
    assert run(fleet, tmp_path / "elsewhere").n_nights == 0
    assert table_files(tmp_path / "elsewhere") == table_files(tmp_path / "folder")


def block_of_scale(language: str, word: str, root: str) -> str:
    """An example of `scale.md`, of a bucket elsewhere."""
    page = (Path(__file__).parents[3] / "docs" / "scale.md").read_text("utf-8")
    blocks = [one.partition("```")[0] for one in page.split(f"```{language}\n")[1:]]
    (block,) = (one for one in blocks if word in one)
    return block.replace("s3://bucket/fleet", root)


def test_queries_by_the_list_of_files_see_each_row_once(server: Server, tmp_path: Path) -> None:
    shop, store = Workshop.at(tmp_path), ObjectStore.at(URL)
    for number in range(2):
        shop.log(FIRST + number * DAY, seed=number)
    run(shop.fleet, shop.output)
    shop.log(FIRST, seed=7)  # corrected: the night, and the judgement of the next
    run(shop.fleet, shop.output)
    names: dict[str, Any] = {}
    exec(block_of_scale("python", "scan_parquet", URL), names)  # noqa: S102 - our own page
    found: pl.DataFrame = names["fits"]
    assert sorted(found["night"].to_list()) == [FIRST, FIRST + DAY]
    # DuckDB, on a copy of the bucket on the disk.
    copy = tmp_path / "bucket"
    for one in store.list():
        (copy / one.key).parent.mkdir(parents=True, exist_ok=True)
        (copy / one.key).write_bytes((store.get(one.key) or (b"", ""))[0])
    with duckdb.connect() as connection:
        for statement in block_of_scale("sql", "read_json", str(copy)).split(";"):
            if statement.strip():
                rows = connection.execute(statement).fetchall()
    assert rows == [("M1", FIRST, "ok"), ("M1", FIRST + DAY, "ok")]
    # A glob sees what was replaced as well, for a while: that is why the list is there.
    document = json.loads((store.get(ROOT) or (b"", ""))[0])
    every = [one.key for one in store.list("files/tables/fits")]
    assert (len(every), len(document["tables"]["fits"])) == (2, 1)
    assert {key for key, _ in document["superseded"]} >= set(every) - {*document["tables"]["fits"]}


def test_puts_that_fail_leave_what_was_published(
    server: Server, shop: Workshop, tmp_path: Path
) -> None:
    before, tables = ObjectStore.at(URL).get(ROOT), published()
    shop.log(FIRST + DAY)
    for failing in ("files/", ROOT):
        server.fails = lambda asked, key=failing: asked.method == "PUT" and key in asked.path
        with pytest.raises(StoreError) as error:
            run(shop.fleet, shop.output)
        assert error.value.code == "store_write"
        server.fails = never
        assert ObjectStore.at(URL).get(ROOT) == before
        assert published() == tables
    # The next run, here or elsewhere, does it as if nothing had been.
    assert run(shop.fleet, shop.output).n_nights == 1
    run(shop.fleet, tmp_path / "folder", object_store="")
    assert [path for path in published() if "fits" in path] == [
        path for path in table_files(tmp_path / "folder") if "fits" in path
    ]
    assert table_files(shop.output) == published()


def test_of_two_runs_at_a_time_one_is_published(
    server: Server, shop: Workshop, tmp_path: Path
) -> None:
    shop.log(FIRST + DAY)
    raced: list[RunResult] = []

    def race(asked: Request) -> None:
        if asked.method == "PUT" and asked.path.endswith(ROOT) and not raced:
            raced.append(RunResult("", (), 0, interrupted=False, seconds=0.0))
            raced[0] = run(shop.fleet, tmp_path / "other")

    server.before = race
    with pytest.raises(StoreError) as error:
        run(shop.fleet, shop.output)
    assert error.value.code == "object_store_conflict"
    assert raced[0].n_nights == 1
    assert published() == table_files(tmp_path / "other")
    assert run(shop.fleet, shop.output).n_nights == 0
    assert table_files(shop.output) == published()


def test_what_a_folder_lacks_or_has_too_much_is_as_the_store_says(shop: Workshop) -> None:
    """After an interrupted run, and where a file is gone: a run took that for removed."""
    tables, fits = table_files(shop.output), night_file(shop.output, FITS, FIRST)

    def stopped() -> None:
        with pipeline.store.working_copy.working_copy(URL, shop.output):
            fits.write_bytes(b"half a run")
            (fits.parent / f"{FIRST + DAY}.parquet").write_bytes(b"and a file too many")
            night_file(shop.output, TRENDS, FIRST).unlink()
            (shop.output / STATE_FILE).write_bytes(b"no state" * 999)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stopped()
    result = run(shop.fleet, shop.output)
    assert (result.damage, result.n_nights) == ((), 0)
    assert table_files(shop.output) == published() == tables


def test_what_people_said_on_two_machines_is_kept(server: Server, tmp_path: Path) -> None:
    store = ObjectStore.at(URL)
    here, there = tmp_path / "here", tmp_path / "there"
    said = [
        Decision("M1", "", dt.datetime(2026, 1, day, tzinfo=dt.UTC), "baseline_reset", FIRST, None)
        for day in (1, 2, 3)
    ]
    record_decision(here, said[0])
    push(store, here, Snapshot())
    snapshot = pull(store, there)
    record_decision(there, said[1])
    push(store, there, snapshot)
    record_decision(here, said[2])
    push(store, here, pull(store, here))
    pull(store, there)
    assert read_decisions(here) == read_decisions(there) == tuple(said)


def test_an_unchanged_bucket_replaces_nothing_and_no_table_is_read(
    shop: Workshop, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, elsewhere = ObjectStore.at(URL), tmp_path / "elsewhere"
    done: list[str] = []
    read, take = pipeline.store.working_copy._read, State.replace

    def reads(path: Path) -> bytes:
        done.append(path.name)
        return read(path)

    def takes(state: State, content: bytes) -> None:
        done.append("taken")
        take(state, content)

    def pulled() -> list[str]:
        done.clear()
        pull(store, elsewhere)
        assert table_files(elsewhere) == published()
        return done

    monkeypatch.setattr(pipeline.store.working_copy, "_read", reads)
    monkeypatch.setattr(State, "replace", takes)
    assert pulled() == ["taken"]
    assert pulled() == [MANIFEST_FILE]  # which the state does not list
    night_file(elsewhere, FITS, FIRST).write_bytes(b"rot")
    assert "2026-01.parquet" in pulled()
    assert pulled() == [MANIFEST_FILE]
    shop.log(FIRST + DAY)
    run(shop.fleet, shop.output)
    assert pulled() == [MANIFEST_FILE, "taken"]
    assert pulled() == [MANIFEST_FILE]
    record_decision(elsewhere, SAID)
    assert pulled() == [MANIFEST_FILE, "taken"]
    assert read_decisions(elsewhere) == (SAID,)


def test_a_table_that_cannot_be_read_says_so(shop: Workshop) -> None:
    fits = night_file(shop.output, FITS, FIRST)
    fits.unlink()
    fits.symlink_to("/proc/self/mem")  # which cannot be read from its beginning
    with pytest.raises(StoreError, match="cannot be read") as error:
        pull(ObjectStore.at(URL), shop.output)
    assert error.value.code == "store_read"


def test_what_people_said_is_put_back_where_no_state_is_published(shop: Workshop) -> None:
    """By an older version of the program."""
    record_decision(shop.output, SAID)
    run(shop.fleet, shop.output)
    store = ObjectStore.at(URL)
    content, tag = store.get(ROOT) or (b"", "")
    document = json.loads(content)
    del document["files"][STATE_FILE]
    store.replace(ROOT, json.dumps(document).encode(), tag)
    for name in (STATE_FILE, BACKUP_FILE):
        (shop.output / name).write_bytes(b"no state" * 999)
    run(shop.fleet, shop.output)
    assert read_decisions(shop.output) == (SAID,)


def test_objects_that_nobody_needs_are_removed_after_a_week(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, path = ObjectStore.at(URL), tmp_path / "tables" / "fits" / "a.parquet"
    path.parent.mkdir(parents=True)
    path.write_bytes(b"old")
    snapshot = push(store, tmp_path, Snapshot())
    path.write_bytes(b"new")
    snapshot = push(store, tmp_path, snapshot)
    assert len(list(store.list("files/tables"))) == 2
    monkeypatch.setattr(pipeline.store.working_copy, "KEEP", dt.timedelta(days=-1))
    push(store, tmp_path, snapshot)
    (left,) = store.list("files/tables")
    assert store.get(left.key) is not None
    assert (store.get(left.key) or (b"", ""))[0] == b"new"


def test_a_folder_with_tables_of_its_own_is_no_copy(server: Server, tmp_path: Path) -> None:
    store = ObjectStore.at(URL)
    for name, content in (("one", b"1"), ("two", b"2")):
        file = tmp_path / name / "tables" / "fits" / "a.parquet"
        file.parent.mkdir(parents=True)
        file.write_bytes(content)
    push(store, tmp_path / "one", Snapshot())
    with pytest.raises(StoreError, match=r"tables/fits/a\.parquet") as error:
        pull(store, tmp_path / "two")
    assert error.value.code == "store_copy"
    assert (tmp_path / "two" / "tables" / "fits" / "a.parquet").read_bytes() == b"2"
    with pytest.raises(StoreError, match="working copy of s3://") as error:
        pull(ObjectStore.at(f"s3://{BUCKET}/other"), tmp_path / "one")
    assert error.value.code == "store_copy"


def test_a_damaged_object_is_not_believed(shop: Workshop, tmp_path: Path) -> None:
    store = ObjectStore.at(URL)
    path = "tables/fits/month=2026-01/2026-01.parquet"
    key = key_of(path, read_snapshot(store).files[path])
    found = store.get(key)
    assert found is not None
    store.replace(key, b"rot", found[1])
    with pytest.raises(StoreError, match="is not what was published") as error:
        run(shop.fleet, tmp_path / "elsewhere")
    assert error.value.code == "store_read"


# A run that is not published


def test_a_run_into_another_output_is_private(
    server: Server, shop: Workshop, tmp_path: Path
) -> None:
    shop.log(FIRST + DAY)
    url = f'[folders]\nobject_store = "{URL}"\n'
    shop.fleet.write_text(shop.fleet.read_text("utf-8").replace("[folders]\n", url), "utf-8")
    server.forget()
    private = load(shop.fleet, tmp_path / "private", None)
    assert run_fleet(RunRequest(private)).n_nights == 2
    assert not server.requests
    # The config's own output by its name is the working copy, as ever.
    assert load(shop.fleet, shop.output, None).object_store == URL
    assert run_fleet(RunRequest(load(shop.fleet, shop.output, None))).n_nights == 1
    assert published().keys() == table_files(tmp_path / "private").keys()


# Those who are told of alarms


def test_what_is_told_is_published_and_known_on_every_machine(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def denied(*_: object) -> Snapshot:
        raise StoreError("object_store_denied", "cannot be written")

    fleet = told_fleet(tmp_path, keep(tmp_path / "none" / "told"))
    run(fleet, tmp_path / "out")
    change(fleet, "fleet.toml", "/none/told", "/told")
    with monkeypatch.context() as patched:
        patched.setattr(pipeline.store.working_copy, "push", denied)
        with pytest.raises(StoreError):
            run(fleet, tmp_path / "out")
    assert not (tmp_path / "told").exists()
    for machine in ("second", "third", "out"):
        run(fleet, tmp_path / machine)
        assert len(told(tmp_path)) == 1
        with open_state(tmp_path / machine) as state:
            assert waiting(state, "command") == []


SAID = Decision(
    "M1",
    "leakage",
    dt.datetime(2026, 3, 1, tzinfo=dt.UTC),
    "acknowledged",
    dt.date(2026, 3, 1),
    None,
    "mine",
)


def test_decisions_of_its_own_are_not_given_up_for_those_of_the_store(
    server: Server, tmp_path: Path
) -> None:
    """Entered before the first run."""
    store = ObjectStore.at(URL)
    (tmp_path / "one").mkdir()
    record_decision(tmp_path / "one", replace(SAID, motor_id="M2"))
    push(store, tmp_path / "one", Snapshot())
    own = tmp_path / "three"
    own.mkdir()
    record_decision(own, SAID)
    with pytest.raises(StoreError, match=STATE_FILE) as error:
        pull(store, own)
    assert error.value.code == "store_copy"
    assert read_decisions(own) == (SAID,)
