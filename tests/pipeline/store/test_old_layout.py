"""An output of the version before, with a file a night: taken over once, with the same rows."""

from __future__ import annotations

import datetime as dt
import hashlib
import shutil
from collections import defaultdict
from pathlib import Path

import polars as pl
import pytest

from pipeline.run.verification import verify_tables
from pipeline.schema import LOOKS, MOTOR_OUTCOMES, QUALITY, RUNS
from pipeline.store.encoding import write_table
from pipeline.store.manifest import MONTH_PREFIX
from pipeline.store.old_layout import MONTHLY, take_over
from pipeline.store.publishing import Publisher
from pipeline.store.sealed import put_sealed
from pipeline.store.tables import files_of, month_file, name_of, read_table
from tests.pipeline.faults.disk import Disk, Killed, on
from tests.pipeline.store.test_tables import NIGHTS, contents, publish
from tests.pipeline.workshop import DAY, Workshop

MONTH = "2026-01"
STARTED = dt.datetime(2026, 1, 5, 3, tzinfo=dt.UTC)


def made_old(output: Path, joined: str = "") -> None:
    """Lay an output out as the version before did; all nights of a month may be joined."""
    for table in MONTHLY:
        for path in files_of(output, table):
            if table in (RUNS, MOTOR_OUTCOMES, LOOKS):
                name = "looks-2026-01-05" if table is LOOKS else f"{STARTED:%Y%m%dT%H%M%S%fZ}"
                path.rename(path.with_name(f"{name}.parquet"))
            elif path.stem != joined:
                rows = read_table(path, table)
                for (night,), part in rows.partition_by("night", as_dict=True).items():
                    write_table(path.with_name(f"{night}.parquet"), part.sort(table.key))
                path.unlink()
    shutil.rmtree(output / "manifest")
    manifests: defaultdict[tuple[str, str], dict[str, str]] = defaultdict(dict)
    for path in (output / "tables").rglob("*.parquet"):
        month = path.parent.name if path.parent.name.startswith(MONTH_PREFIX) else "month=whole"
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        manifests[month, path.stem][name_of(output, path)] = digest
    for (month, name), files in manifests.items():
        put_sealed(output / "manifest" / month / f"{name}.json", {"files": files, "coming": {}})


@pytest.fixture
def output(tmp_path: Path) -> Path:
    publisher = publish(tmp_path / "out", {"A": [*NIGHTS, dt.date(2026, 2, 1)], "B": NIGHTS})
    publisher.add(MONTH, {RUNS: [{"run_id": "r", "started_at": STARTED}]})
    looks = Publisher(publisher.output, publisher.output, "r")
    looks.add(MONTH, {LOOKS: [{"motor_id": "A", "time": STARTED, "to_state": "look_now"}]})
    return publisher.output


@pytest.mark.parametrize("joined", ["", MONTH])
def test_the_tables_are_those_that_this_version_writes(output: Path, joined: str) -> None:
    before, forgotten = contents(output), list[str]()
    made_old(output, joined)
    take_over(output, forgotten.extend)
    assert contents(output) == before
    assert forgotten == []
    assert list(verify_tables(output)) == []
    assert {path.name for path in (output / "manifest").iterdir()} == {
        *(f"{name}.json" for name in (MONTH, "2026-02", f"looks-{MONTH}"))
    }


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_killed_at_some_points_it_goes_on_where_it_was(output: Path, tmp_path: Path) -> None:
    before = contents(output)
    made_old(output)
    disk, point, copy = Disk("killed", 0), 1, tmp_path / "copy"
    while point == 1 or disk.struck:
        shutil.rmtree(copy, ignore_errors=True)
        shutil.copytree(output, copy)
        disk = Disk("killed", point)
        try:
            with on(disk):
                take_over(copy, lambda _: None)
        except Killed:
            take_over(copy, lambda _: None)
        shutil.rmtree(copy / "staging")
        for left in copy.rglob(".writing-*"):
            left.unlink()
        assert contents(copy) == before, point
        assert list(verify_tables(copy)) == [], point
        point += 17


def test_a_damaged_night_is_put_aside_and_forgotten_and_a_stranger_stays(output: Path) -> None:
    made_old(output)
    folder, forgotten = month_file(output, QUALITY, MONTH).parent, list[str]()
    bad, gone = (folder / f"{night}.parquet" for night in NIGHTS[:2])
    bad.write_bytes(bad.read_bytes()[:-9])
    gone.unlink()
    (folder / "mine.parquet").write_bytes(b"mine")
    take_over(output, forgotten.extend)
    assert set(forgotten) == {name_of(output, bad), name_of(output, gone)}
    assert {path.name for path in folder.iterdir()} == {
        *(f"{MONTH}.parquet", f"{NIGHTS[0]}.damaged", "mine.parquet")
    }
    rows = read_table(month_file(output, QUALITY, MONTH), QUALITY)
    assert set(rows["night"]) == set(NIGHTS[2:])


def test_a_run_takes_over_what_there_is_and_makes_what_is_new(tmp_path: Path) -> None:
    shop = Workshop.at(tmp_path)
    shop.log(NIGHTS[0])
    shop.run()
    before = shop.rows("fits")
    made_old(shop.output)
    assert shop.run().nights == ()
    assert shop.rows("fits").equals(before, null_equal=True)
    shop.log(NIGHTS[0] + DAY, seed=1)
    assert shop.run().nights == (NIGHTS[0] + DAY,)
    assert list(verify_tables(shop.output)) == []
    pattern = shop.output / "tables" / "runs" / "**" / "*.parquet"
    assert pl.read_parquet(pattern, hive_partitioning=False)["run_id"].n_unique() == 3
