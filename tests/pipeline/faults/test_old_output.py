"""An output as versions up to 0.9 have left it is taken over once, and nothing of it is lost."""

from __future__ import annotations

import datetime as dt
import hashlib
import json
import shutil
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from pipeline.errors import LockedError
from pipeline.notification.outbox import open_outbox, waiting
from pipeline.schema import FITS, NIGHTLY_TABLES, TABLES, WHOLE_TABLES
from pipeline.store.locks import locked
from pipeline.store.old_layout import MONTHLY
from pipeline.store.published import verify_tables
from pipeline.store.state import open_state
from pipeline.store.tables import files_of, name_of, night_file, read_table, write_table
from pipeline.trends.nights.decisions import read_decisions
from tests.pipeline.faults.conftest import say
from tests.pipeline.faults.damage import remove_aside
from tests.pipeline.faults.fleet import MOTORS, TinyFleet, check_tables
from tests.pipeline.remembered import LASTING, change, processed_of, record_of
from tests.pipeline.simulated import NIGHT

pytestmark = pytest.mark.usefixtures("_quick")


def put_sealed(path: Path, document: dict[str, Any]) -> None:
    """JSON with its own SHA-256, as older versions kept what they knew."""
    plain = json.loads(json.dumps(document, default=str))
    sha256 = hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", encoding="utf-8") as stream:
        stream.write(json.dumps(plain | {"sha256": sha256}) + "\n")


def split(path: Path, rows: pl.DataFrame) -> Iterator[tuple[Path, pl.DataFrame]]:
    """Rows of a month as the files of its nights, or runs."""
    column = "night" if "night" in rows.columns else "started_at"
    for (label,), some in rows.partition_by(column, as_dict=True).items():
        name = f"{label:%Y%m%dT%H%M%S%fZ}" if column == "started_at" else str(label)
        yield path.with_name(f"{name}.parquet"), some


def make_old(output: Path) -> None:
    """Turn an output into one of version 0.9: a file a night, and what is known in many files."""
    manifests: defaultdict[tuple[str, str], dict[str, str]] = defaultdict(dict)
    for table in TABLES:
        for path in files_of(output, table):
            parts = {path: read_table(path, table)}
            if table in MONTHLY:
                path.unlink()
                parts = dict(split(path, parts[path]))
            for place, rows in parts.items():
                month = "whole" if table in WHOLE_TABLES else place.parent.name[6:]
                digest = write_table(place, rows)
                manifests[month, place.stem][name_of(output, place)] = digest
    for (month, label), files in manifests.items():
        place = output / "manifest" / f"month={month}" / f"{label}.json"
        put_sealed(place, {"files": files, "coming": {}})
    write_records(output)
    for path in (*output.glob("state.*"), output / "manifest.json"):
        path.unlink()


def write_records(output: Path) -> None:
    """What is known of motors, what people said, and what waits, in the files of version 0.9."""
    for motor in MOTORS:
        folder, processed = output / "ledger" / motor, processed_of(output, motor)
        files = {name: asdict(one) for name, one in processed.files.items()}
        for one in files.values():
            del one["changed_ns"]  # which they did not know
        nights = {str(night): asdict(one) for night, one in processed.nights.items()}
        put_sealed(folder / f"{NIGHT:%Y-%m}.json", {"files": files, "nights": nights})
        put_sealed(folder / "settings", dict(processed.settings or {}))
        record = record_of(output, motor)
        assert record is not None
        put_sealed(folder / "trends", asdict(record))
    for one in read_decisions(output):
        put_sealed(output / "decisions.jsonl", asdict(one))
    waits = {"id": "msg_1", "since": dt.datetime.now(dt.UTC), "changes": [{"id": "a"}], "kind": ""}
    queue = {"told_since": dt.datetime.now(dt.UTC), "fault": "deaf", "waiting": [waits]}
    for name in ("outbox.json", "outbox.copy.json"):
        document = {"queues": {"command": queue}, "known": ["key-said-0"], "stamps": {}}
        put_sealed(output / name, document)
    (output / "history" / "M1").mkdir(parents=True)
    put_sealed(output / "look" / "M1" / "state.json", {"state": "high"})


@pytest.fixture
def old(output: Path) -> Path:
    say(output)
    make_old(output)
    return output


def check_taken_over(output: Path, fleet: TinyFleet) -> None:
    for name in ("decisions/decisions.parquet", "latest/latest.parquet"):  # of what people said
        shutil.copy(fleet.after / "tables" / name, output / "tables" / name)
        change(output, "DELETE FROM files WHERE name = ?", name)
    check_tables(output, fleet.after)
    assert len(read_decisions(output)) == 3
    assert [one.code for one in verify_tables(output)] == ["table_unlisted"] * 2
    assert {path.name for path in output.iterdir()} == LASTING | {"look"}
    assert [path.name for path in (output / "look").iterdir()] == ["lock"]
    with open_state(output) as state:
        assert state.rows("SELECT * FROM looks") == [("M1", '{"state": "high"}')]
        assert state.rows("SELECT key, said, times FROM queued") == [("key", "said", 0)]


def test_an_old_output_is_taken_over(
    tiny_fleet: TinyFleet, old: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = {motor: processed_of(tiny_fleet.after, motor) for motor in MOTORS}
    waited: list[Any] = []

    def opened(state: Any, *_: Any) -> None:
        waited.extend(waiting(state, "command"))
        open_outbox(state, ["command"], "Tests")

    with monkeypatch.context() as patch:
        patch.setattr("pipeline.run.fleet.open_outbox", opened)
        result = tiny_fleet.run(old)
    assert (result.n_nights, result.damage, result.failed) == (0, (), ())
    assert [(one.id, list(one.changes)) for one in waited] == [("msg_1", [{"id": "a"}])]
    check_taken_over(old, tiny_fleet)
    for motor in MOTORS:
        assert processed_of(old, motor) == before[motor]
        assert record_of(old, motor) == record_of(tiny_fleet.after, motor)
    names = {name_of(old, path) for one in TABLES for path in files_of(old, one)}
    assert all("/month=2026-03/2026-03.parquet" in n for n in names if n.startswith("fits/"))
    assert any(name.startswith(f"{NIGHTLY_TABLES[0].name}/") for name in names)
    assert tiny_fleet.run(old).n_nights == 0


def test_a_damaged_night_of_it_is_made_anew(tiny_fleet: TinyFleet, old: Path) -> None:
    path = night_file(old, FITS, NIGHT).with_name(f"{NIGHT}.parquet")
    path.write_bytes(path.read_bytes()[:-99])
    result = tiny_fleet.run(old)
    assert result.n_nights == len(MOTORS)
    remove_aside(old)
    check_taken_over(old, tiny_fleet)


def test_a_look_that_is_under_way_keeps_what_is_of_looks(
    tiny_fleet: TinyFleet, old: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with locked(old / "look"):
        assert tiny_fleet.run(old).n_nights == 0
        assert "the next run takes the looks over" in caplog.text
        assert (old / "look" / "M1" / "state.json").exists()
        with pytest.raises(LockedError), locked(old / "look"):
            pass
    assert tiny_fleet.run(old).n_nights == 0
    check_taken_over(old, tiny_fleet)


@pytest.mark.parametrize("step", ["_take_records", "_take_month", "rmtree"])
def test_a_run_that_is_broken_off_meanwhile_costs_nothing(
    tiny_fleet: TinyFleet, old: Path, step: str
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(f"pipeline.store.old_layout.{step}", broken)
        with pytest.raises(KeyboardInterrupt):
            tiny_fleet.run(old)
    assert tiny_fleet.run(old).n_nights == 0
    check_taken_over(old, tiny_fleet)
