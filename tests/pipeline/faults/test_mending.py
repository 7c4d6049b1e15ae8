"""Damage to what runs have left is seen by the next plain run, named, and mended where it can be.

A bit flips here without a time stamp on it, as it does on a disk; what a program has written to has
one.
"""

from __future__ import annotations

import datetime as dt
import json
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pyarrow.parquet as pq
import pytest

from pipeline.errors import StoreError
from pipeline.logs.ledger import read_ledger
from pipeline.run.fleet import RunResult, run_fleet
from pipeline.run.mending import mend_output, rebuild_manifests, share_due
from pipeline.run.verification import verify_tables
from pipeline.schema import (
    BLOCK_STATISTICS,
    FITS,
    INPUT_FILES,
    PARAMETERS,
    PREDICTIONS,
    QUALITY,
    RUNS,
    TRENDS,
    Table,
)
from pipeline.store.manifest import manifest_file
from pipeline.store.tables import night_file, read_rows, run_file, write_table
from pipeline.trends.nights.decisions import Decision, journal_file, read_decisions, record_decision
from pipeline.trends.nights.from_tables import FIT_COLUMNS
from tests.pipeline.cli.test_cli import Call
from tests.pipeline.cli.test_cli import call as call  # a fixture
from tests.pipeline.faults.disk import Disk, Killed, on
from tests.pipeline.faults.fleet import (
    LATER,
    MOTORS,
    TinyFleet,
    check_repaired,
    check_tables,
    remembered_fits,
)
from tests.pipeline.simulated import NIGHT

MONTH = f"{NIGHT:%Y-%m}"
# Of a file: all of it is due in the next run.
EVERY_RUN = {"prove_within_days": 1}


@pytest.fixture
def output(tiny_fleet: TinyFleet, tmp_path: Path) -> Path:
    """All that a run leaves; what is copied keeps its times."""
    return shutil.copytree(tiny_fleet.after, tmp_path / "out")


@pytest.fixture
def said(output: Path, tiny_fleet: TinyFleet) -> tuple[Decision, ...]:
    """Decisions made by people, in the journal and in the table of the next run."""
    moment = dt.datetime(2026, 3, 4, 5, tzinfo=dt.UTC)
    for number in range(3):
        note = f"heard nothing, {number}"
        record_decision(output, Decision("M1", "", moment, "finding", NIGHT, "not_confirmed", note))
        moment += dt.timedelta(hours=1)
    tiny_fleet.run(output)
    return read_decisions(output)


@pytest.fixture(autouse=True)
def _quick() -> Iterator[None]:
    with remembered_fits():
        yield


@pytest.fixture
def without_logs(tiny_fleet: TinyFleet, tmp_path: Path) -> Callable[..., TinyFleet]:
    """The fleet with the logs of some motors alone."""

    def keep(*motors: str) -> TinyFleet:
        folder = tmp_path / "others"
        shutil.copytree(tiny_fleet.folder / "configs", folder / "configs")
        (folder / "logs").mkdir()
        for motor in motors:
            shutil.copytree(tiny_fleet.folder / "logs" / motor, folder / "logs" / motor)
        return TinyFleet(folder)

    return keep


@pytest.fixture
def _nothing_due(monkeypatch: pytest.MonkeyPatch) -> None:
    """Proofs of a run do not depend on the day on which the test is run."""
    monkeypatch.setattr("pipeline.run.fleet.share_due", lambda *_: lambda _: False)


def flip(path: Path, place: int) -> None:
    """Flip a bit of a byte of a file; its time stays."""
    state = path.stat()
    content = bytearray(path.read_bytes())
    content[place] ^= 4
    path.write_bytes(content)
    os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns))


def rot(path: Path) -> None:
    """Flip a bit of the content; of a table, in its first pages."""
    flip(path, min(path.stat().st_size // 3, 200))


def rot_of_footer(path: Path) -> None:
    flip(path, path.stat().st_size - 100)


def cut_off(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:100])


def name_of(path: Path, output: Path) -> str:
    return path.relative_to(output).as_posix().removeprefix("tables/")


def codes(output: Path) -> list[str]:
    return [fault.code for fault in verify_tables(output)]


def found(result: RunResult) -> list[tuple[str, str]]:
    return [(fault.path, fault.code) for fault in result.damage]


def left(result: RunResult) -> list[tuple[str, str]]:
    return [(fault.path, fault.code) for fault in result.damage_left]


def remove_aside(output: Path) -> int:
    """Remove what was put aside, which people look at; how many files it were."""
    aside = list(output.rglob("*.damaged"))
    for path in aside:
        path.unlink()
    return len(aside)


# Table files


@pytest.mark.parametrize("table", [PREDICTIONS, BLOCK_STATISTICS, INPUT_FILES, TRENDS])
def test_a_file_that_is_gone_is_made_anew_by_the_next_run(
    tiny_fleet: TinyFleet, output: Path, table: Table, caplog: pytest.LogCaptureFixture
) -> None:
    path = night_file(output, table, NIGHT)
    path.unlink()
    result = tiny_fleet.run(output)
    assert found(result) == [(name_of(path, output), "table_missing")]
    assert result.damage_left == ()
    assert f"table_missing: {name_of(path, output)}: the file is gone" in caplog.text
    check_repaired(output, tiny_fleet)
    told = pl.read_parquet(max((output / "tables" / "runs").rglob("*.parquet")))["damage"]
    assert told.list.first().to_list()[0].startswith(f"table_missing: {name_of(path, output)}: ")


@pytest.mark.parametrize("table", [FITS, PREDICTIONS, TRENDS])
@pytest.mark.parametrize("damage", [rot, rot_of_footer, cut_off])
def test_a_damaged_file_is_put_aside_and_made_anew_by_the_run_that_proves_it(
    tiny_fleet: TinyFleet, output: Path, table: Table, damage: Callable[[Path], None]
) -> None:
    path = night_file(output, table, NIGHT)
    damage(path)
    damaged = path.read_bytes()
    result = tiny_fleet.run(output, **EVERY_RUN)
    assert found(result) == [(name_of(path, output), "table_altered")]
    assert result.damage_left == ()
    assert not result.failed
    assert path.with_suffix(".damaged").read_bytes() == damaged
    remove_aside(output)
    check_repaired(output, tiny_fleet)


@pytest.mark.usefixtures("_nothing_due")
def test_what_a_program_has_written_to_is_proven_in_the_next_run(
    tiny_fleet: TinyFleet, output: Path
) -> None:
    """Whenever its turn would be; and once its files are proven, they wait for their turn again."""
    path = night_file(output, PREDICTIONS, NIGHT)
    whole = path.read_bytes()
    path.write_bytes(whole)
    manifest = manifest_file(output, MONTH, NIGHT.isoformat())
    assert path.stat().st_mtime_ns > manifest.stat().st_mtime_ns
    assert tiny_fleet.run(output).damage == ()
    assert path.stat().st_mtime_ns <= manifest.stat().st_mtime_ns
    path.write_bytes(whole[:-50] + bytes(50))
    assert found(tiny_fleet.run(output)) == [(name_of(path, output), "table_altered")]


def test_bits_of_old_nights_are_found_by_and_by(tiny_fleet: TinyFleet, output: Path) -> None:
    """Of several runs on a day each takes the next share."""
    path = night_file(output, PREDICTIONS, NIGHT)
    rot(path)
    results = [tiny_fleet.run(output, prove_within_days=4) for _ in range(4)]
    seen = [one for result in results for one in found(result)]
    assert seen == [(name_of(path, output), "table_altered")]
    remove_aside(output)
    check_repaired(output, tiny_fleet)


def test_every_manifest_has_its_turn_within_the_days_whenever_a_run_takes_place(
    tmp_path: Path,
) -> None:
    keys = [("2026-01", f"2026-01-{day:02}") for day in range(1, 32)]
    begin = dt.datetime(2026, 5, 1, 6, tzinfo=dt.UTC)

    def turns(*days: int) -> list[int]:
        """Of each run, how many manifests had their turn, after a run on the day before."""
        counts, due_at = [], []
        for number, day in enumerate((-1, *days)):
            started = begin + dt.timedelta(days=day, minutes=number)
            due = share_due(tmp_path, 30, started)
            due_at.append({key for key in keys if due(key)})
            counts.append(len(due_at[-1]))
            write_table(run_file(tmp_path, RUNS, started), pl.DataFrame({"a": [1]}))
        assert set().union(*due_at[1:]) == set(keys)
        shutil.rmtree(tmp_path / "tables")
        return counts[1:]

    # Every night, each once; after a pause, all of it; several times a day, as often as needed.
    assert sum(turns(*range(30))) == len(keys)
    assert turns(29) == [len(keys)]
    assert sum(turns(0, 1, 5, 6, 29)) == len(keys)
    assert sum(turns(*[0] * 30)) == len(keys)


@pytest.mark.usefixtures("_nothing_due")
def test_a_night_that_a_run_touches_is_proven_though_it_is_not_due(
    tiny_fleet: TinyFleet, tmp_path: Path
) -> None:
    """A corrected log has the night after judged anew, which writes `fits` alone."""
    for name in ("configs", "logs"):
        shutil.copytree(tiny_fleet.folder / name, tmp_path / name)
    own, output = TinyFleet(tmp_path), shutil.copytree(tiny_fleet.after, tmp_path / "after")
    path = night_file(output, PREDICTIONS, LATER)
    rot(path)
    own.log("M2", NIGHT, seed=8)
    result = own.run(output)
    assert found(result) == [(name_of(path, output), "table_altered")]
    assert left(result) == [(name_of(path, output), "table_missing")]
    assert "the next run makes it anew" in result.damage_left[0].message
    result = own.run(output)
    assert left(result) == []
    remove_aside(output)
    assert codes(output) == []


@pytest.mark.usefixtures("_nothing_due")
def test_where_trends_meet_damage_it_is_named_and_the_next_run_is_well(
    tiny_fleet: TinyFleet, output: Path
) -> None:
    """A bit of a footer, in a night that they read as nothing is kept of it, and that is not due.

    Before, all motors of the fleet failed of it in each run for good.
    """
    path = night_file(output, FITS, NIGHT)
    rot_of_footer(path)
    shutil.rmtree(output / "history")
    (output / "ledger" / "M1" / "trends").unlink()
    result = tiny_fleet.run(output)
    assert {outcome.error_code for outcome in result.failed} == {"store_read"}
    assert found(result) == [(name_of(path, output), "table_altered")]
    result = tiny_fleet.run(output)
    assert (result.failed, result.damage_left) == ((), ())
    remove_aside(output)
    check_repaired(output, tiny_fleet)


@pytest.mark.usefixtures("_nothing_due")
def test_damage_that_is_met_where_a_night_is_published_is_kept_as_well(
    tiny_fleet: TinyFleet, output: Path
) -> None:
    """Trends of a night are made anew, and with them those of later nights."""
    gone, damaged = (night_file(output, TRENDS, night) for night in (NIGHT, LATER))
    gone.unlink()
    rot(damaged)
    result = tiny_fleet.run(output)
    expected = [
        (name_of(gone, output), "table_missing"),
        (name_of(damaged, output), "table_altered"),
    ]
    assert found(result) == expected
    assert result.damage_left == ()
    remove_aside(output)
    check_repaired(output, tiny_fleet)


def test_no_flipped_bit_of_a_footer_is_read_as_other_rows(output: Path) -> None:
    """Page checksums do not cover it: a damaged name was a column of nulls, and no error."""
    path = night_file(output, FITS, NIGHT)
    whole = path.read_bytes()
    sound = read_rows(output, FITS, MOTORS, FIT_COLUMNS, nights=[NIGHT])
    footer = 8 * (len(whole) - 8 - int.from_bytes(whole[-8:-4], "little"))
    for bit in np.random.default_rng(6).choice(np.arange(footer, 8 * len(whole)), 200):
        flipped = bytearray(whole)
        flipped[bit // 8] ^= 1 << bit % 8
        path.write_bytes(flipped)
        with pytest.raises(StoreError, match=f"{NIGHT}.parquet of fits is damaged"):
            read_rows(output, FITS, MOTORS, FIT_COLUMNS, nights=[NIGHT])
    path.write_bytes(whole)
    assert sound.equals(read_rows(output, FITS, MOTORS, FIT_COLUMNS, nights=[NIGHT]))


def test_a_file_that_may_not_be_read_is_named_and_left_alone(
    tiny_fleet: TinyFleet, output: Path
) -> None:
    """A folder in its place cannot be read by anybody, whatever rights they have."""
    path = night_file(output, PREDICTIONS, NIGHT)
    path.unlink()
    path.mkdir()
    result = tiny_fleet.run(output)
    assert found(result) == left(result) == [(name_of(path, output), "table_unreadable")]
    assert path.is_dir()


# What cannot be made anew


def test_without_logs_it_is_named_in_each_run_until_people_give_it_up(
    output: Path, without_logs: Callable[..., TinyFleet]
) -> None:
    fleet, path = without_logs(), night_file(output, PREDICTIONS, NIGHT)
    kept = read_rows(output, FITS, MOTORS)
    path.unlink()
    for _ in range(2):
        result = fleet.run(output)
        assert left(result) == [(name_of(path, output), "table_missing")]
    # Of other tables nothing is made anew for it.
    assert read_rows(output, FITS, MOTORS).equals(kept, null_equal=True)
    before, after = mend_output(output, lambda _: False)
    assert [fault.code for fault in before] == ["table_missing"]
    assert after == ()
    assert fleet.run(output).damage == ()
    assert codes(output) == []


def test_logs_that_come_back_mend_it(
    tiny_fleet: TinyFleet, output: Path, without_logs: Callable[..., TinyFleet]
) -> None:
    fleet = without_logs()
    night_file(output, PREDICTIONS, NIGHT).unlink()
    assert fleet.run(output).damage_left
    assert tiny_fleet.run(output).damage_left == ()
    check_repaired(output, tiny_fleet)


def test_parameters_are_made_anew_from_stored_blocks(
    output: Path, without_logs: Callable[..., TinyFleet]
) -> None:
    path = night_file(output, PARAMETERS, NIGHT)
    columns = ["motor_id", "parameter", "value", "lower", "upper", "verdict"]
    before = pl.read_parquet(path).select(columns)
    path.unlink()
    result = without_logs().run(output)
    assert result.damage_left == ()
    pl.testing.assert_frame_equal(pl.read_parquet(path).select(columns), before, rel_tol=1e-9)
    assert codes(output) == []


def test_rows_of_a_motor_whose_logs_are_gone_are_named(
    output: Path, without_logs: Callable[..., TinyFleet]
) -> None:
    fleet, path = without_logs("M1"), night_file(output, BLOCK_STATISTICS, NIGHT)
    path.unlink()
    result = fleet.run(output)
    assert left(result) == [(name_of(path, output), "rows_lost")]
    assert result.damage_left[0].message.startswith("rows of M2 are not made anew: ")
    assert pl.read_parquet(path)["motor_id"].unique().to_list() == ["M1"]
    # What is known of its night still is: the night after is not judged anew.
    assert NIGHT in read_ledger(output, "M2").nights
    assert fleet.run(output).damage == ()


def test_a_file_of_a_run_is_named_and_given_up(tiny_fleet: TinyFleet, output: Path) -> None:
    path = min((output / "tables" / "runs").rglob("*.parquet"))
    path.unlink()
    result = tiny_fleet.run(output)
    assert found(result) == [(name_of(path, output), "table_missing")]
    assert result.damage_left == ()
    assert codes(output) == []


# Manifests


def manifests(output: Path) -> dict[str, bytes]:
    folder = output / "manifest"
    return {path.name: path.read_bytes() for path in folder.rglob("*.json")}


def test_a_deleted_folder_of_manifests_is_rebuilt(tiny_fleet: TinyFleet, output: Path) -> None:
    before = manifests(output)
    shutil.rmtree(output / "manifest")
    assert set(codes(output)) == {"manifest_missing"}
    result = tiny_fleet.run(output)
    assert {fault.code for fault in result.damage} == {"manifest_missing"}
    assert "10 files are proven to the last byte" in result.damage[0].message
    assert result.damage_left == ()
    del before["latest.json"]  # its rows name the run
    assert manifests(output).items() >= before.items()
    check_repaired(output, tiny_fleet)


def test_a_damaged_manifest_is_rebuilt(tiny_fleet: TinyFleet, output: Path) -> None:
    path = manifest_file(output, MONTH, NIGHT.isoformat())
    before = path.read_bytes()
    path.write_bytes(before.replace(b"fits", b"tifs"))
    assert codes(output) == ["manifest_damaged"]
    result = tiny_fleet.run(output)
    assert found(result) == [(path.relative_to(output).as_posix(), "manifest_damaged")]
    assert path.read_bytes() == before
    check_repaired(output, tiny_fleet)


def test_a_manifest_that_is_published_damaged_is_rebuilt(output: Path) -> None:
    """Or one of an older version: the object store has no better one."""
    path = manifest_file(output, MONTH, NIGHT.isoformat())
    path.write_bytes(b'{"files": {}, "sha256": "0"}')
    (fault,) = rebuild_manifests(output, lambda _: True)
    assert (fault.code, fault.message[:9]) == ("manifest_damaged", "made anew")
    assert codes(output) == []


def test_a_manifest_takes_in_what_is_proven_alone(tiny_fleet: TinyFleet, output: Path) -> None:
    """Neither a damaged file nor one of another night; what other libraries wrote has its pages."""
    (output / "manifest" / f"month={MONTH}" / f"{NIGHT}.json").unlink()
    rot(night_file(output, FITS, NIGHT))
    shutil.copy(night_file(output, PREDICTIONS, LATER), night_file(output, PREDICTIONS, NIGHT))
    older, other = (night_file(output, table, NIGHT) for table in (QUALITY, PARAMETERS))
    write_table(older, pl.read_parquet(older).drop("n_samples"))
    pq.write_table(pq.read_table(other), other, write_page_checksum=True)
    mine = shutil.copy(older, older.with_name("mine.parquet"))
    result = tiny_fleet.run(output)
    told = {fault.path: fault for fault in result.damage}
    assert (
        "7 files are proven to the last byte, 1 of other libraries by the checksums of their "
        in (told[f"manifest/month={MONTH}/{NIGHT}.json"].message)
    )
    altered = [path for path, code in found(result) if code == "table_altered"]
    assert altered == [f"{one}/month={MONTH}/{NIGHT}.parquet" for one in ("fits", "predictions")]
    mine.unlink()
    assert result.damage_left == ()
    remove_aside(output)
    tiny_fleet.run(output)
    check_repaired(output, tiny_fleet)


# A run's own files


@pytest.mark.parametrize(
    "name",
    [
        f"ledger/M1/{MONTH}.json",
        "ledger/M1/settings",
        "ledger/M1/trends",
        f"history/M1/{MONTH}.lz4",
    ],
)
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
    "name", [f"ledger/M9/{MONTH}.json", "ledger/M9/settings", f"history/M9/{MONTH}.lz4"]
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


# What people said


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


def test_a_journal_that_is_gone_is_put_back_from_the_table(
    tiny_fleet: TinyFleet, output: Path, said: tuple[Decision, ...]
) -> None:
    journal_file(output).unlink()
    tiny_fleet.run(output)
    assert read_decisions(output) == said


def test_a_line_that_people_took_out_stays_out(
    tiny_fleet: TinyFleet, output: Path, said: tuple[Decision, ...]
) -> None:
    path = journal_file(output)
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


# Killed on the way


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize(
    "step", [pytest.param(290, id="some"), pytest.param(7, marks=pytest.mark.full, id="many")]
)
def test_a_run_that_mends_may_be_killed_anywhere(
    tiny_fleet: TinyFleet, tmp_path: Path, step: int
) -> None:
    point, disk = 20, Disk("killed", 0)
    while point == 20 or disk.struck:
        output = tmp_path / "out"
        shutil.rmtree(output, ignore_errors=True)
        shutil.copytree(tiny_fleet.after, output)
        night_file(output, PREDICTIONS, NIGHT).unlink()
        rot_of_footer(night_file(output, FITS, LATER))
        rot(night_file(output, TRENDS, NIGHT))
        manifest_file(output, "whole", "data_dictionary").unlink()
        disk = Disk("killed", point)
        with on(disk), suppress(Killed):
            tiny_fleet.run(output, **EVERY_RUN)
        assert tiny_fleet.run(output, **EVERY_RUN).damage_left == ()
        assert remove_aside(output) == 2
        check_repaired(output, tiny_fleet)
        point += step


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize(
    "step", [pytest.param(110, id="some"), pytest.param(11, marks=pytest.mark.full, id="many")]
)
def test_the_command_may_be_killed_anywhere(
    tiny_fleet: TinyFleet, tmp_path: Path, output: Path, said: tuple[Decision, ...], step: int
) -> None:
    point, disk = 0, Disk("killed", 0)
    copy = tmp_path / "copy"
    while point == 0 or disk.struck:
        point += step
        shutil.rmtree(copy, ignore_errors=True)
        shutil.copytree(output, copy)
        night_file(copy, PREDICTIONS, NIGHT).unlink()
        rot(night_file(copy, FITS, LATER))
        rot(copy / "ledger" / "M1" / "settings")
        journal = journal_file(copy)
        journal.write_bytes(journal.read_bytes().replace(b"nothing, 1", b"nothing, 7"))
        disk = Disk("killed", point)
        with on(disk), suppress(Killed):
            mend_output(copy, lambda _: False)
        for _ in range(2):
            after = mend_output(copy, lambda _: False)[1]
        assert after == ()
        assert read_decisions(copy) == said
        tiny_fleet.run(copy)
        check_tables_but_decisions(copy, tiny_fleet)


def check_tables_but_decisions(output: Path, fleet: TinyFleet) -> None:
    """Check the tables other than those which also hold what people said."""
    for name in ("decisions/decisions.parquet", "latest/latest.parquet"):
        shutil.copy(fleet.after / "tables" / name, output / "tables" / name)
    check_tables(output, fleet)


# As people see it


def test_the_commands_tell_and_mend(
    tiny_fleet: TinyFleet, output: Path, without_logs: Callable[..., TinyFleet], call: Call
) -> None:
    config = without_logs().fleet
    path = night_file(output, PREDICTIONS, NIGHT)
    name = name_of(path, output)
    cut_off(path)
    code, out, err = call("status", config, "--output", output)
    assert code == 0
    assert f"1 published files are damaged or missing, such as {name}: table_altered" in err
    code, out, err = call("fit-fleet", config, "--output", output, "--dry-run")
    assert code == 0
    assert f"table_altered: {name}: " in err
    code, out, err = call("fit-fleet", config, "--output", output)
    assert code == 1
    assert f"motor-leakage: table_missing: {name}: not made anew: the logs of that night are" in err
    assert "damage: 1 files were damaged or missing, 1 are not repaired" in out
    code, out, err = call("fit-fleet", config, "--output", output, "--json")
    run = json.loads(out.splitlines()[-1])
    assert [one["code"] for one in run["damage_left"]] == ["table_missing"]
    code, out, err = call("check", "--tables", config, "--output", output)
    assert code == 1
    assert out.endswith(" table files, 2 faults\n")
    code, out, err = call("check", "--tables", "--mend", config, "--output", output)
    assert (code, out.endswith(" table files, 2 faults, 0 left\n")) == (0, True)
    code, out, err = call("check", "--tables", config, "--output", output)
    assert (code, err) == (0, "")
    code, out, err = call("fit-fleet", config, "--output", output)
    assert code == 0
