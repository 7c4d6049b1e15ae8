"""Months as one file: the same rows by every reader, at every moment, wherever a run is killed."""

from __future__ import annotations

import datetime as dt
import shutil
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import duckdb
import polars as pl
import pytest

from pipeline.errors import StoreError
from pipeline.run.mending import Damage
from pipeline.run.verification import verify_tables
from pipeline.schema import BLOCK_STATISTICS, INPUT_FILES, QUALITY, RUNS, Table
from pipeline.store import atomic_files, months
from pipeline.store.heartbeat import last_good_run
from pipeline.store.manifest import manifest_keys, read_manifest
from pipeline.store.months import join_months, last_month_over, part_month, settle
from pipeline.store.night_files import stage
from pipeline.store.publishing import Publisher
from pipeline.store.retention import old_files, prune
from pipeline.store.state import open_state
from pipeline.store.tables import (
    files_of,
    month_file,
    night_file,
    night_paths,
    night_stamps,
    nights_back,
    read_rows,
    read_table,
    table_folder,
)
from pipeline.store.verification import Proof, prove
from tests.pipeline.faults.disk import Disk, Killed, on
from tests.pipeline.store.made_rows import row

Step = Callable[[Path], object]

MONTH = "2026-01"
NIGHTS = tuple(dt.date(2026, 1, day) for day in (3, 4, 9))
OPEN = dt.date(2026, 2, 2)
TABLES = (QUALITY, INPUT_FILES, BLOCK_STATISTICS)


def publish(output: Path, *nights: dt.date, refused: int = 1) -> Publisher:
    """Publish nights of two motors, with a log of no night in the first."""
    publisher = Publisher(output, output / "staging" / "run", f"run{refused}")
    for motor in ("A", "B"):
        rows = {
            QUALITY: {n: [row(motor, refused=refused, night=n)] * bool(refused) for n in nights},
            INPUT_FILES: {
                n: [{"motor_id": motor, "path": str(n), "night": n if n.day != 3 else None}]
                for n in nights
            },
            BLOCK_STATISTICS: {n: [{"motor_id": motor, "night": n}] for n in nights},
        }
        stage(publisher.staging / "nights" / f"{motor}.arrow", rows)
    publisher.nights("nights", TABLES, ("A", "B"), lambda *_: None)
    return publisher


@pytest.fixture
def output(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    output = tmp_path / "out"
    (output / "staging" / "run").mkdir(parents=True)
    publisher = publish(output, *NIGHTS, OPEN)
    publish(output, NIGHTS[1], refused=0)  # its file stays, without a row
    for day in (5, 6):
        started = dt.datetime(2026, 1, day, tzinfo=dt.UTC)
        run = {"run_id": "r", "started_at": started, "finished_at": started, "status": "ok"}
        publisher.of_run(started, {RUNS: [run]})
    return output


def join(output: Path, last: str = MONTH) -> None:
    join_months(output, output / "staging" / "run", last)


def part(output: Path) -> list[Table]:
    return part_month(output, output / "staging" / "run", TABLES, MONTH)


def rows(output: Path, table: Table) -> list[tuple[object, ...]]:
    """Rows by an analyst's plain glob."""
    pattern = (table_folder(output, table) / "**" / "*.parquet").as_posix()
    found = pl.read_parquet(pattern, hive_partitioning=False).sort(table.key, nulls_last=True)
    return found.rows()


def everything(output: Path) -> list[list[tuple[object, ...]]]:
    return [rows(output, table) for table in (*TABLES, RUNS)]


def names(output: Path, table: Table) -> list[str]:
    return [path.name for path in files_of(output, table)]


def test_a_month_is_one_file_and_every_reader_sees_the_same(output: Path) -> None:
    before, nights = everything(output), list(nights_back(output, QUALITY))
    join(output)
    assert names(output, QUALITY) == ["2026-01.parquet", f"{OPEN}.parquet"]
    assert names(output, RUNS) == ["2026-01.parquet"]
    assert names(output, BLOCK_STATISTICS) == [f"{night}.parquet" for night in (*NIGHTS, OPEN)]
    assert everything(output) == before
    pattern = (table_folder(output, QUALITY) / "**" / "*.parquet").as_posix()
    with duckdb.connect() as analyst:
        query = f"SELECT motor_id, night FROM '{pattern}' ORDER BY ALL"
        assert analyst.sql(query).fetchall() == [one[:2] for one in before[0]]
    assert list(nights_back(output, QUALITY)) == nights
    assert night_stamps(output, QUALITY, MONTH).keys() == {str(night) for night in NIGHTS}
    assert read_rows(output, QUALITY, ["A"], nights=NIGHTS[:2])["night"].to_list() == [NIGHTS[0]]
    assert read_rows(output, QUALITY, ["A"]).height == 3
    assert last_good_run(output) == dt.datetime(2026, 1, 6, tzinfo=dt.UTC)
    assert list(verify_tables(output)) == []
    # Of each night's manifest only what stays a night's file is left.
    assert read_manifest(output, MONTH, str(NIGHTS[0])).names == {  # type: ignore[union-attr]
        f"block_statistics/month={MONTH}/{NIGHTS[0]}.parquet"
    }


def test_nights_come_back_byte_for_byte(output: Path) -> None:
    before = {path: path.read_bytes() for path in output.glob("tables/*/*/*.parquet")}
    join(output)
    assert part(output) == []
    after = {path: path.read_bytes() for path in output.glob("tables/*/*/*.parquet")}
    assert {path: after[path] for path in before if "runs" not in path.parts} == {
        path: content for path, content in before.items() if "runs" not in path.parts
    }
    assert list(verify_tables(output)) == []


def test_a_late_night_parts_its_month_and_a_later_run_joins_it(output: Path) -> None:
    join(output)
    late = dt.date(2026, 1, 7)
    publisher = publish(output, late, NIGHTS[2], refused=5)
    nights = sorted({*NIGHTS, late})
    assert names(output, QUALITY)[:-1] == [f"{night}.parquet" for night in nights]
    assert publisher.months == {MONTH}
    after = everything(output)
    assert {one[5] for one in after[0] if one[1] in (late, NIGHTS[2])} == {5}
    join(output)
    assert names(output, QUALITY)[0] == "2026-01.parquet"
    assert everything(output) == after
    assert list(verify_tables(output)) == []


def test_a_run_of_a_joined_month_is_taken_up(output: Path) -> None:
    join(output)
    started = dt.datetime(2026, 1, 30, tzinfo=dt.UTC)
    run = {"run_id": "r", "started_at": started, "finished_at": started, "status": "ok"}
    Publisher(output, output / "staging" / "run", "r").of_run(started, {RUNS: [run]})
    join(output)
    assert names(output, RUNS) == ["2026-01.parquet"]
    assert len(rows(output, RUNS)) == 3
    assert list(verify_tables(output)) == []


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("every", [29, pytest.param(1, marks=pytest.mark.full)])
@pytest.mark.parametrize("step", [join, part])
def test_killed_at_each_point(output: Path, tmp_path: Path, step: Step, every: int) -> None:
    before = everything(output)
    if step is part:
        join(output)
    for point in range(1, 9999, every):
        copy = tmp_path / "copy"
        shutil.rmtree(copy, ignore_errors=True)
        shutil.copytree(output, copy)
        try:
            with on(Disk("killed", point)) as disk:
                step(copy)
        except Killed:
            pass
        # Nothing twice, nothing gone; and no file that its manifest does not know.
        assert everything(copy) == before, point
        assert [fault for fault in verify_tables(copy) if "writing" not in fault.path] == [], point
        settle(copy, MONTH)
        assert not any(read_manifest(copy, *key).coming for key in manifest_keys(copy))  # type: ignore[union-attr]
        join(copy)
        assert names(copy, QUALITY)[0] == "2026-01.parquet"
        assert everything(copy) == before
        if not disk.struck:
            break
    assert point > every


def test_readers_see_each_key_once_and_whole_meanwhile(output: Path) -> None:
    """A listing from before the exchange finds its files gone: an error, and never other rows."""
    over, found, refused = threading.Event(), list[int](), list[str]()
    pattern = (table_folder(output, QUALITY) / "**" / "*.parquet").as_posix()

    def read() -> Iterator[int]:
        yield pl.scan_parquet(pattern, hive_partitioning=False).select(pl.len()).collect().item()
        with duckdb.connect() as analyst:
            yield analyst.execute("SELECT count(*) FROM read_parquet(?)", [pattern]).fetchall()[0][
                0
            ]
        yield read_rows(output, QUALITY, ["A", "B"]).height

    def look() -> None:
        while not over.is_set():
            try:
                found.extend(read())
            except (OSError, pl.exceptions.PolarsError, duckdb.Error) as error:
                refused.append(str(error))

    reader = threading.Thread(target=look)
    reader.start()
    for _ in range(5):
        join(output)
        part(output)
    over.set()
    reader.join()
    assert set(found) == {6}
    assert all("2026-01" in words for words in refused)


def test_where_folders_cannot_be_exchanged_nights_stay(
    output: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    before, files = everything(output), names(output, QUALITY)

    def not_here(folder: Path, place: Path) -> None:
        raise StoreError("store_write", "Invalid argument")

    monkeypatch.setattr(months, "exchange", not_here)
    with pytest.raises(StoreError):
        join(output)
    monkeypatch.setattr(atomic_files, "exchange", not_here)
    join(output)
    assert (everything(output), names(output, QUALITY)) == (before, files)
    assert list(verify_tables(output)) == []


def test_exchange_keeps_the_folder_s_permissions(tmp_path: Path) -> None:
    new, place = tmp_path / "new", tmp_path / "place"
    for folder, mode in ((new, 0o700), (place, 0o755)):
        folder.mkdir(mode)
        folder.chmod(mode)
        (folder / folder.name).touch()
    atomic_files.exchange(new, place)
    assert [path.name for path in place.iterdir()] == ["new"]
    assert [path.name for path in new.iterdir()] == ["place"]
    assert place.stat().st_mode & 0o777 == 0o755


def test_a_folder_with_anything_else_stays(output: Path) -> None:
    (month_file(output, QUALITY, MONTH).parent / "2026-01-03.damaged").write_bytes(b"x")
    join(output)
    assert names(output, QUALITY)[0] == f"{NIGHTS[0]}.parquet"
    assert names(output, INPUT_FILES)[0] == "2026-01.parquet"


def test_a_damaged_night_is_not_joined(output: Path) -> None:
    path = night_file(output, QUALITY, NIGHTS[0])
    path.write_bytes(path.read_bytes()[:-9])
    join(output)
    assert names(output, QUALITY)[0] == path.name
    assert [fault.code for fault in verify_tables(output)] == ["table_altered"]


def test_a_damaged_month_is_put_aside_and_its_nights_are_forgotten(output: Path) -> None:
    join(output)
    path = month_file(output, QUALITY, MONTH)
    path.write_bytes(b"junk")
    forgotten: list[dt.date] = []
    publisher = Publisher(output, output / "staging" / "run", "r")
    new = {QUALITY: {NIGHTS[0]: [row("A", refused=9)]}}
    stage(publisher.staging / "nights" / "A.arrow", new)
    publisher.nights("nights", [QUALITY], ["A"], lambda nights, _: forgotten.extend(nights))
    assert len(set(forgotten)) == 31
    assert publisher.damaged == [f"quality/month={MONTH}/2026-01.parquet"]
    assert path.with_suffix(".damaged").exists()
    assert read_table(night_file(output, QUALITY, NIGHTS[0]), QUALITY).height == 1
    # The check at the begin of a run does the same.
    month_file(output, INPUT_FILES, MONTH).unlink()
    with open_state(output) as state:
        damage = Damage(state)
        damage.look_around(lambda _: True)
        assert {fault.code for fault in damage.found.values()} == {"table_missing"}
        assert list(damage.left({})) == []
    assert {fault.code for fault in verify_tables(output)} == {"table_unlisted"}


def test_a_joined_file_proves_itself(output: Path) -> None:
    join(output)
    assert prove(month_file(output, QUALITY, MONTH), QUALITY)[1] is Proof.WHOLE


def test_a_month_is_pruned_when_its_last_night_is_old(output: Path) -> None:
    publish(output, dt.date(2026, 2, 3))
    join(output)
    table, kept = BLOCK_STATISTICS.name, {BLOCK_STATISTICS.name: 30}
    (old,) = old_files(output, kept, OPEN)
    assert old.nights == (NIGHTS[0],)
    assert old.names == (f"{table}/month={MONTH}/{NIGHTS[0]}.parquet",)
    prune(output, [old])
    assert list(verify_tables(output)) == []
    assert next(iter(night_paths(output, BLOCK_STATISTICS))) == NIGHTS[1]


@pytest.mark.parametrize(
    ("tonight", "nights", "expected"),
    [("2026-02-14", 14, "2026-01"), ("2026-02-13", 14, "2025-12"), ("2026-01-31", 0, "2026-01")],
)
def test_a_month_is_over(tonight: str, nights: int, expected: str) -> None:
    assert last_month_over(dt.date.fromisoformat(tonight), nights) == expected
