"""Manifests, a run's own files and the journal of decisions are mended like tables."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import polars as pl
import pyarrow.parquet as pq
import pytest

from pipeline.run.fleet import run_fleet
from pipeline.run.mending import mend_output, rebuild_manifests
from pipeline.run.verification import verify_tables
from pipeline.schema import FITS, PARAMETERS, PREDICTIONS, QUALITY
from pipeline.store.encoding import write_table
from pipeline.store.manifest import manifest_file
from pipeline.store.tables import night_file, read_rows
from pipeline.trends.nights.decisions import Decision, journal_file, read_decisions, record_decision
from tests.pipeline.faults.damage import MONTH, codes, found, name_of, remove_aside, rot
from tests.pipeline.faults.fleet import LATER, MOTORS, TinyFleet, check_repaired
from tests.pipeline.simulated import NIGHT

pytestmark = pytest.mark.usefixtures("_quick")


def manifests(output: Path) -> dict[str, bytes]:
    folder = output / "manifest"
    return {path.name: path.read_bytes() for path in folder.rglob("*.json")}


def test_a_deleted_folder_of_manifests_is_rebuilt(tiny_fleet: TinyFleet, output: Path) -> None:
    before = manifests(output)
    shutil.rmtree(output / "manifest")
    assert set(codes(output)) == {"manifest_missing"}
    result = tiny_fleet.run(output)
    assert {fault.code for fault in result.damage} == {"manifest_missing"}
    assert "13 files proven to the last byte" in result.damage[0].message
    assert result.damage_left == ()
    name = f"{MONTH}.json"  # the others list what tells of the run
    assert manifests(output)[name] == before[name]
    check_repaired(output, tiny_fleet)


def test_a_damaged_manifest_is_rebuilt(tiny_fleet: TinyFleet, output: Path) -> None:
    path = manifest_file(output, MONTH)
    before = path.read_bytes()
    path.write_bytes(before.replace(b"fits", b"tifs"))
    assert codes(output) == ["manifest_damaged"]
    result = tiny_fleet.run(output)
    assert found(result) == [(path.relative_to(output).as_posix(), "manifest_damaged")]
    assert path.read_bytes() == before
    check_repaired(output, tiny_fleet)


def test_a_manifest_that_is_published_damaged_is_rebuilt(output: Path) -> None:
    """Or one of an older version: the object store has no better one."""
    path = manifest_file(output, MONTH)
    path.write_bytes(b'{"files": {}, "sha256": "0"}')
    (fault,) = rebuild_manifests(output, lambda _: True)
    assert (fault.code, fault.message[:9]) == ("manifest_damaged", "made anew")
    assert codes(output) == []


def test_a_manifest_takes_in_what_is_proven_alone(tiny_fleet: TinyFleet, output: Path) -> None:
    """Neither a damaged file nor one of another night; what other libraries wrote has its pages."""
    manifest_file(output, MONTH).unlink()
    rot(night_file(output, FITS, NIGHT))
    shutil.copy(night_file(output, PREDICTIONS, LATER), night_file(output, PREDICTIONS, NIGHT))
    older, other = (night_file(output, table, NIGHT) for table in (QUALITY, PARAMETERS))
    write_table(older, pl.read_parquet(older).drop("n_samples"))
    pq.write_table(pq.read_table(other), other, write_page_checksum=True)
    mine = shutil.copy(older, older.with_name("mine.parquet"))
    result = tiny_fleet.run(output)
    told = {fault.path: fault for fault in result.damage}
    assert "10 files proven to the last byte, 1 of other libraries by the checksums of their " in (
        told[f"manifest/{MONTH}.json"].message
    )
    altered = [path for path, code in found(result) if code == "table_altered"]
    bad = (night_file(output, table, NIGHT) for table in (FITS, PREDICTIONS))
    assert altered == [name_of(path, output) for path in bad]
    mine.unlink()
    assert result.damage_left == ()
    remove_aside(output)
    tiny_fleet.run(output)
    check_repaired(output, tiny_fleet)


LEDGER = (f"ledger/M1/{MONTH}.json", "ledger/M1/settings", "ledger/M1/trends")


@pytest.mark.parametrize("name", [*LEDGER, "history/M1/watch"])
def test_own_files_are_named_and_mended_by_the_next_run(
    tiny_fleet: TinyFleet, output: Path, name: str, caplog: pytest.LogCaptureFixture
) -> None:
    rot(output / name)
    code = "history_damaged" if "history" in name else "ledger_damaged"
    assert [(fault.path, fault.code) for fault in verify_tables(output)] == [(name, code)]
    # Trends are read where a night is made.
    run_fleet(replace(tiny_fleet.request(output), force="history" in name))
    assert f"{name} is damaged" in caplog.text
    check_repaired(output, tiny_fleet)


@pytest.mark.parametrize(
    "name", [f"ledger/M9/{MONTH}.json", "ledger/M9/settings", "history/M9/watch"]
)
def test_own_files_of_a_motor_that_there_is_no_more_are_mended_by_the_command(
    tiny_fleet: TinyFleet, output: Path, name: str
) -> None:
    """No run reads or writes them: `check` was red for good."""
    for folder in ("ledger", "history"):
        shutil.copytree(output / folder / "M1", output / folder / "M9")
    rot(output / name)
    tiny_fleet.run(output)
    assert len(codes(output)) == 1
    before, after = mend_output(output, lambda _: False)
    assert [fault.path for fault in before] == [name]
    assert after == ()
    assert not (output / name).exists()


def test_a_damaged_ledger_of_nights_without_logs_is_mended_by_the_command(
    output: Path, without_logs: Callable[..., TinyFleet]
) -> None:
    fleet = without_logs()
    rot(output / "ledger" / "M1" / f"{MONTH}.json")
    fleet.run(output)
    assert codes(output) == ["ledger_damaged"]
    assert mend_output(output, lambda _: False)[1] == ()
    kept = read_rows(output, FITS, MOTORS)
    assert fleet.run(output).damage == ()
    assert read_rows(output, FITS, MOTORS).equals(kept, null_equal=True)


def test_a_damaged_line_of_the_journal_is_put_back_from_the_table(
    tiny_fleet: TinyFleet, output: Path, said: tuple[Decision, ...]
) -> None:
    path = journal_file(output)
    damaged = path.read_bytes().replace(b"nothing, 1", b"nothing, 7")
    path.write_bytes(damaged)
    assert len(read_decisions(output)) == 2
    tiny_fleet.run(output)
    assert read_decisions(output) == said
    assert codes(output) == ["journal_damaged"]
    assert mend_output(output, lambda _: False)[1] == ()
    assert read_decisions(output) == said
    (line,) = path.with_suffix(".damaged").read_bytes().splitlines()
    assert line in damaged.splitlines()
    record_decision(output, replace(said[0], note="and one more"))
    assert len(read_decisions(output)) == 4


def test_a_journal_that_is_gone_is_put_back_and_a_line_that_people_took_out_stays_out(
    tiny_fleet: TinyFleet, output: Path, said: tuple[Decision, ...]
) -> None:
    path = journal_file(output)
    path.unlink()
    tiny_fleet.run(output)
    assert read_decisions(output) == said
    path.write_bytes(b"".join(path.read_bytes().splitlines(keepends=True)[1:]))
    tiny_fleet.run(output)
    assert read_decisions(output) == said[1:]


def test_a_damaged_table_puts_nothing_back(
    tiny_fleet: TinyFleet, output: Path, said: tuple[Decision, ...]
) -> None:
    path = journal_file(output)
    path.write_bytes(path.read_bytes().replace(b"nothing, 1", b"nothing, 7"))
    rot(output / "tables" / "decisions" / "decisions.parquet")
    tiny_fleet.run(output)
    assert read_decisions(output) == (said[0], said[2])
