"""Manifests prove every published file; the plan of a run names its work and the reasons."""

from __future__ import annotations

import datetime as dt
import hashlib
import json
import shutil
from pathlib import Path

import polars as pl
import pytest

import pipeline.store.encoding
from pipeline.config import load_fleet
from pipeline.errors import StoreError
from pipeline.run.fleet import RunRequest, run_fleet
from pipeline.run.plans import plan_fleet
from pipeline.run.tasks import Step, Work
from pipeline.run.verification import verify_tables
from pipeline.schema import PREDICTIONS, QUALITY
from pipeline.store.encoding import prepare_table, write_table
from pipeline.store.manifest import announce, update_manifest
from pipeline.store.tables import night_file
from tests.pipeline.simulated import NIGHT
from tests.pipeline.workshop import DAY, QUICK, Workshop


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Workshop:
    """Two nights, done; tests only read it."""
    made = Workshop.at(tmp_path_factory.mktemp("manifest"))
    for day in range(2):
        made.log(NIGHT + day * DAY, seed=day)
    made.run()
    return made


@pytest.fixture
def own(done: Workshop, tmp_path: Path) -> Workshop:
    """A copy of it."""
    shutil.copytree(done.folder, tmp_path / "copy")
    return Workshop(tmp_path / "copy")


def codes(output: Path) -> list[str]:
    return [fault.code for fault in verify_tables(output)]


def test_what_a_run_publishes_is_as_its_manifests_say(done: Workshop) -> None:
    assert codes(done.output) == []
    listed: set[str] = set()
    for path in (done.output / "manifest").rglob("*.json"):
        listed |= json.loads(path.read_text("utf-8"))["files"].keys()
    tables = done.output / "tables"
    assert listed == {path.relative_to(tables).as_posix() for path in tables.rglob("*.parquet")}


def test_every_flipped_bit_is_seen_the_footer_included(own: Workshop) -> None:
    path = night_file(own.output, QUALITY, NIGHT)
    whole = path.read_bytes()
    for place in range(0, 8 * len(whole), 8 * len(whole) // 40):
        flipped = bytearray(whole)
        flipped[place // 8] ^= 1 << place % 8
        path.write_bytes(flipped)
        assert codes(own.output) == ["table_altered"]
    path.write_bytes(whole)
    assert codes(own.output) == []


def test_files_that_are_gone_or_strange_are_named(own: Workshop) -> None:
    path = night_file(own.output, QUALITY, NIGHT)
    path.rename(path.with_name("2001-01.parquet"))
    assert sorted(codes(own.output)) == ["table_missing", "table_unlisted"]


def test_a_damaged_manifest_is_named(own: Workshop) -> None:
    (manifest,) = (own.output / "manifest").rglob(f"{NIGHT:%Y-%m}.json")
    manifest.write_text(manifest.read_text("utf-8").replace("fits", "tifs"), "utf-8")
    assert "manifest_damaged" in codes(own.output)


def test_a_night_that_is_made_anew_has_its_manifest_made_anew(own: Workshop) -> None:
    own.log(NIGHT, seed=8)
    own.run()
    assert codes(own.output) == []


def test_what_reads_back_otherwise_is_not_published(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A disk that does not keep what was written to it."""
    path = tmp_path / "table.parquet"
    write_table(path, pl.DataFrame({"a": [1.0, float("nan"), None]}))
    before = path.read_bytes()
    sound = pl.DataFrame({"a": [1.0, 2.0, 3.0], "b": [[1.0], None, [2.0, 3.0]]})
    others = [
        sound.head(2),
        sound.reverse(),
        sound.with_columns(pl.lit(None, pl.Float64).alias("a")),
        sound.with_columns(b=pl.Series([[1.0], None, [2.0, 3.0 + 1e-15]])),
        sound.with_columns(b=pl.Series([[1.0], [], [2.0, 3.0]])),
        sound.select("b", "a"),
    ]
    for other in others:
        read_back = lambda _, other=other: iter([other])  # noqa: E731
        monkeypatch.setattr(pipeline.store.encoding, "row_groups", read_back)
        with pytest.raises(StoreError, match="not what was written"):
            prepare_table(path, [sound])
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_what_is_announced_may_be_there_and_nothing_else(own: Workshop) -> None:
    """Between the announcement and its end a file is the old one or the new one."""
    path = night_file(own.output, QUALITY, NIGHT)
    name, old = path.relative_to(own.output / "tables").as_posix(), path.read_bytes()
    before, after = (hashlib.sha256(content).hexdigest() for content in (old, b"new"))
    announce(own.output, {name: (before, after)})
    assert codes(own.output) == []
    path.write_bytes(b"new")
    assert codes(own.output) == []
    path.write_bytes(b"neW")
    assert codes(own.output) == ["table_altered"]
    path.unlink()
    assert codes(own.output) == ["table_missing"]
    path.write_bytes(b"new")
    update_manifest(own.output, {name: after})
    assert codes(own.output) == []
    path.write_bytes(old)
    assert codes(own.output) == ["table_altered"]


def test_a_new_file_that_is_announced_may_be_absent(own: Workshop) -> None:
    path = night_file(own.output, PREDICTIONS, NIGHT + 5 * DAY)
    name = path.relative_to(own.output / "tables").as_posix()
    digest = hashlib.sha256(b"new").hexdigest()
    announce(own.output, {name: (None, digest)})
    assert codes(own.output) == []
    path.write_bytes(b"new")
    assert codes(own.output) == []
    path.write_bytes(b"neW")
    assert codes(own.output) == ["table_altered"]


# The plan


def plan(workshop: Workshop, *, force: bool = False) -> dict[dt.date, Step]:
    request = RunRequest(load_fleet(workshop.fleet), force=force)
    ((motor_id, found),) = plan_fleet(request)
    assert motor_id == "M1"
    return dict(found)


def test_a_plan_reads_and_writes_nothing(tmp_path: Path) -> None:
    workshop = Workshop.at(tmp_path)
    workshop.log(NIGHT)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    assert plan(workshop) == {NIGHT: Step(Work.READ, f"new file M1/{NIGHT}.parquet")}
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")} == before


def test_nothing_new_nothing_to_do_unless_forced(done: Workshop) -> None:
    assert plan(done) == {}
    step = Step(Work.READ, "asked for")
    assert plan(done, force=True) == {NIGHT: step, NIGHT + DAY: step}


def test_a_plan_names_the_setting_that_changed(own: Workshop) -> None:
    own.configure(fleet=QUICK + "[reference]\nspeed_rpm = 31.0\n")
    why = Step(Work.REFIT, "changed setting reference.speed_rpm")
    assert plan(own) == {NIGHT: why, NIGHT + DAY: why}
    own.configure(fleet=QUICK + "[cleaning]\nhampel_threshold = 6.0\n")
    why = Step(Work.READ, "changed setting cleaning.hampel_threshold")
    assert plan(own) == {NIGHT: why, NIGHT + DAY: why}


def test_a_changed_log_is_planned(own: Workshop) -> None:
    path = own.log(NIGHT, seed=8)
    assert plan(own) == {NIGHT: Step(Work.READ, f"changed file M1/{path.name}")}


def test_forced_nights_come_out_the_same(own: Workshop) -> None:
    before = own.rows("fits")
    (outcome,) = run_fleet(RunRequest(load_fleet(own.fleet), force=True)).outcomes
    assert len(outcome.nights) == 2
    assert own.rows("fits").equals(before, null_equal=True)


def test_what_failed_is_tried_again_when_asked(own: Workshop) -> None:
    """A log that cannot be read stays failed while unchanged; `retry` looks at it again."""
    path = own.logs / f"{NIGHT + 2 * DAY}.parquet"
    path.write_bytes(b"no Parquet")
    assert own.run().status == "failed"
    assert own.run().status != "failed"
    (outcome,) = run_fleet(RunRequest(load_fleet(own.fleet), retry=True)).outcomes
    assert (outcome.status, outcome.nights) == ("failed", (NIGHT + 2 * DAY,))
