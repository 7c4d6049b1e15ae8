"""An output of an earlier clone is taken over once: its tables and decisions stay."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path

import polars as pl
import pytest

from pipeline.errors import LockedError
from pipeline.notification.outbox import open_outbox
from pipeline.run.old_layout import MONTHLY
from pipeline.schema import ALARMS, FITS
from pipeline.store.locks import locked
from pipeline.store.published import verify_tables
from pipeline.store.state import State
from pipeline.store.tables import files_of, night_file, read_table, write_table
from pipeline.trends.nights.decisions import read_decisions
from tests.pipeline.faults.conftest import say
from tests.pipeline.faults.damage import remove_aside
from tests.pipeline.faults.fleet import MOTORS, TinyFleet, check_tables
from tests.pipeline.remembered import LASTING, change
from tests.pipeline.simulated import NIGHT

pytestmark = pytest.mark.usefixtures("_quick")

N_NIGHTS = 2 * len(MOTORS)


def split(path: Path, rows: pl.DataFrame) -> Iterator[tuple[Path, pl.DataFrame]]:
    """Rows of a month as the files of its nights, or runs."""
    column = "night" if "night" in rows.columns else "started_at"
    for (label,), some in rows.partition_by(column, as_dict=True).items():
        name = f"{label:%Y%m%dT%H%M%S%fZ}" if column == "started_at" else str(label)
        yield path.with_name(f"{name}.parquet"), some


@pytest.fixture
def old(output: Path) -> Path:
    """An output of a clone from before: a file a night, and what is known in many files."""
    say(output)
    lines = [
        json.dumps(asdict(one) | {"sha256": "…"}, default=str) for one in read_decisions(output)
    ]
    said = json.loads(lines[0])
    damaged = [5, said | {"motor_id": []}, said | {"time": "2026-03-04T05:00:00", "note": "when?"}]
    lines += [lines[0][:-9], *map(json.dumps, damaged)]
    (output / "decisions.jsonl").write_text("\n".join(lines), "utf-8")
    for table in MONTHLY:
        for path in files_of(output, table):
            parts = dict(split(path, read_table(path, table)))
            path.unlink()
            for place, rows in parts.items():
                write_table(place, rows)
    for folder in ("manifest/month=2026-03", "ledger/M1", "history/M1", "look/M1"):
        (output / folder).mkdir(parents=True)
    for path in (*output.glob("state.*"), output / "manifest.json"):
        path.unlink()
    return output


def check_taken_over(output: Path, fleet: TinyFleet) -> None:
    assert len(read_decisions(output)) == 3
    for name in ("decisions/decisions.parquet", "latest/latest.parquet"):  # of what people said
        shutil.copy(fleet.after / "tables" / name, output / "tables" / name)
        change(output, "DELETE FROM files WHERE name = ?", name)
    check_tables(output, fleet.after)
    assert [one.code for one in verify_tables(output)] == ["table_unlisted"] * 2
    assert {path.name for path in output.iterdir()} == LASTING | {"look"}
    assert [path.name for path in (output / "look").iterdir()] == ["lock"]
    assert {len(path.stem) for path in files_of(output, FITS)} == {len("2026-03")}


def test_an_old_output_is_taken_over_and_nothing_is_told_again(
    tiny_fleet: TinyFleet, old: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[State] = []

    def opened(state: State, *_: object) -> None:
        open_outbox(state, ["command"], "Tests")
        assert state.rows("SELECT count(*) FROM taken_up") == [(len(files_of(old, ALARMS)),)]
        asked.append(state)

    monkeypatch.setattr("pipeline.run.fleet.open_outbox", opened)
    result = tiny_fleet.run(old)
    assert (result.n_nights, result.damage, result.failed) == (N_NIGHTS, (), ())
    assert asked
    check_taken_over(old, tiny_fleet)
    assert tiny_fleet.run(old).n_nights == 0


def test_rows_stay_where_logs_are_gone(
    without_logs: Callable[..., TinyFleet], tiny_fleet: TinyFleet, old: Path
) -> None:
    assert without_logs("M1").run(old).n_nights == N_NIGHTS // 2
    check_taken_over(old, tiny_fleet)


def test_a_damaged_night_of_it_is_made_anew(tiny_fleet: TinyFleet, old: Path) -> None:
    path = night_file(old, FITS, NIGHT).with_name(f"{NIGHT}.parquet")
    path.write_bytes(path.read_bytes()[:-99])
    assert tiny_fleet.run(old).n_nights == N_NIGHTS
    assert remove_aside(old) == 1
    check_taken_over(old, tiny_fleet)


def test_a_look_that_is_under_way_ends_the_run(tiny_fleet: TinyFleet, old: Path) -> None:
    with locked(old / "look"), pytest.raises(LockedError):
        tiny_fleet.run(old)
    tiny_fleet.run(old)
    check_taken_over(old, tiny_fleet)


@pytest.mark.parametrize("step", ["write_table", "put_back", "rmtree"])
def test_a_run_that_is_broken_off_meanwhile_costs_nothing(
    tiny_fleet: TinyFleet, old: Path, step: str
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(f"pipeline.run.old_layout.{step}", broken)
        with pytest.raises(KeyboardInterrupt):
            tiny_fleet.run(old)
    tiny_fleet.run(old)
    check_taken_over(old, tiny_fleet)
