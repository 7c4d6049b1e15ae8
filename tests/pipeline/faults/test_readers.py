"""Who reads while a run publishes sees each file as it was or as it is, and each key once.

Engines open a file twice, for its footer and for its pages (Polars 2.1, DuckDB 2; pyarrow 26 the
first one). Where it is replaced in between they refuse it, and have to be asked again; they must
never give an answer that is neither old nor new. Who opens a file once is always answered.
"""

from __future__ import annotations

import hashlib
import shutil
import threading
from collections.abc import Callable
from pathlib import Path

import duckdb
import polars as pl
import pytest

from pipeline.schema import FITS, LOG_FILES, PARAMETERS, QUALITY, TRENDS, Table
from pipeline.store.published import verify_tables
from tests.pipeline.faults.fleet import LATER, TinyFleet, remembered_fits
from tests.pipeline.simulated import NIGHT

READ = (FITS, PARAMETERS, QUALITY, TRENDS, LOG_FILES)
Rows = pl.DataFrame
Answer = dict[tuple[str, object], str]


def with_polars(pattern: str) -> Rows:
    return pl.read_parquet(pattern, hive_partitioning=False)


def opened_once(pattern: str) -> Rows:
    files = sorted(Path(pattern.split("**")[0]).glob("**/*.parquet"))
    return pl.concat(
        [pl.read_parquet(path.read_bytes(), hive_partitioning=False) for path in files]
    )


def with_duckdb(pattern: str) -> Rows:
    with duckdb.connect() as analyst:
        return analyst.read_parquet(pattern, hive_partitioning=False).pl()


def answer(rows: Rows, table: Table) -> Answer:
    """Hash of what is said of each night; each key once."""
    assert rows.select(table.key).is_unique().all(), table.name
    columns = [name for name in table.schema if name != "run_id"]
    nights = rows.select(columns).sort(table.key).partition_by("night", as_dict=True)
    return {
        (table.name, night): hashlib.sha256(part.write_json().encode()).hexdigest()
        for (night,), part in nights.items()
    }


def pattern_of(output: Path, table: Table) -> str:
    return (output / "tables" / table.name / "**" / "*.parquet").as_posix()


def published(output: Path) -> Answer:
    found: Answer = {}
    for table in READ:
        found |= answer(with_polars(pattern_of(output, table)), table)
    return found


class Reader(threading.Thread):
    """Asks all the time, and keeps its answers and what went wrong."""

    def __init__(self, output: Path, read: Callable[[str], Rows]) -> None:
        super().__init__()
        self.output, self.read = output, read
        self.seen: dict[tuple[str, object], set[str]] = {}
        self.faults: list[str] = []
        self.n_answers = 0
        self.stopped = threading.Event()

    def _files(self, table: Table) -> dict[str, int]:
        folder = self.output / "tables" / table.name
        return {path.name: path.stat().st_ino for path in folder.rglob("*.parquet")}

    def run(self) -> None:
        while not self.stopped.wait(0.005):  # or else they leave the run no time
            for table in READ:
                before = self._files(table)
                try:
                    rows = self.read(pattern_of(self.output, table))
                except BaseException as fault:  # a panic of a reader is one, too
                    if self.read is opened_once or self._files(table) == before:
                        self.faults.append(f"{table.name}: {fault!r}")
                    continue
                try:
                    found = answer(rows, table)
                except AssertionError as fault:
                    self.faults.append(f"{table.name}: {fault!r}")
                    continue
                self.n_answers += 1
                for key, said in found.items():
                    self.seen.setdefault(key, set()).add(said)


@pytest.mark.parametrize("n_runs", [2, pytest.param(40, marks=pytest.mark.full)])
def test_two_states_are_published_in_turn_under_the_eyes_of_readers(
    tiny_fleet: TinyFleet, tmp_path: Path, n_runs: int
) -> None:
    for name in ("configs", "logs", "after"):
        shutil.copytree(tiny_fleet.folder / name, tmp_path / name)
    own = TinyFleet(tmp_path)
    output = own.after
    path = own.folder / "logs" / "M1" / f"{NIGHT}.parquet"
    states = [path.read_bytes(), own.log(NIGHT, seed=8).read_bytes()]
    with remembered_fits():
        states_published = []
        for state in (1, 0):
            path.write_bytes(states[state])
            own.run(output)
            states_published.append(published(output))
        assert states_published[0] != states_published[1]
        readers = [Reader(output, read) for read in (opened_once, with_polars, with_duckdb)]
        for reader in readers:
            reader.start()
        try:
            for number in range(n_runs):
                path.write_bytes(states[1 - number % 2])
                assert not own.run(output).failed
                # A run may be publishing while somebody checks, too.
                assert list(verify_tables(output)) == []
        finally:
            for reader in readers:
                reader.stopped.set()
            for reader in readers:
                reader.join()
    for reader in readers:
        assert reader.faults == []
        assert reader.n_answers >= n_runs
        for key, said in reader.seen.items():
            assert said <= {state[key] for state in states_published}, key
    changed = ("fits", NIGHT)
    assert states_published[0][changed] != states_published[1][changed]
    assert states_published[0]["log_files", LATER] == states_published[1]["log_files", LATER]
