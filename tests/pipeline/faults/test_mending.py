"""Damage to what runs have left is seen by the next plain run, named, and repaired where it can be.

A bit flips here without a time stamp on it, as it does on a disk; what a program has written to has
one.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from pipeline.run.output import find_damage
from pipeline.schema import BLOCKS, FITS, LOG_FILES, PARAMETERS, PREDICTIONS, TRENDS, Table
from pipeline.store.published import VerifiedFile, note, verify_files, verify_tables
from pipeline.store.state import StateDatabase, open_state
from pipeline.store.tables import name_of, read_rows
from pipeline.trends.decisions import read_decisions
from tests.pipeline.calling import contents, refused
from tests.pipeline.faults.conftest import say
from tests.pipeline.faults.fleet import (
    MOTORS,
    TinyFleet,
    check_repaired,
    check_tables,
    codes_of,
    flip,
    remove_aside,
    rot,
    rot_of_footer,
)
from tests.pipeline.simulated import NIGHT
from tests.pipeline.written import LASTING, change, night_file, processed_of

pytestmark = pytest.mark.usefixtures("_quick")


@pytest.mark.parametrize(
    ("table", "damage", "code"),
    [
        (PREDICTIONS, Path.unlink, "table_missing"),
        (FITS, rot, "table_altered"),
        (TRENDS, rot_of_footer, "table_altered"),
    ]
    + [
        pytest.param(*case, marks=pytest.mark.full)
        for case in (
            (LOG_FILES, Path.unlink, "table_missing"),
            (TRENDS, Path.unlink, "table_missing"),
            (BLOCKS, rot, "table_altered"),
            (FITS, lambda path: os.truncate(path, 100), "table_altered"),
        )
    ],
)
def test_a_file_that_is_gone_or_damaged_is_named_and_made_anew_by_the_run_that_proves_it(
    tiny_fleet: TinyFleet,
    output: Path,
    table: Table,
    damage: Callable[[Path], None],
    code: str,
    caplog: pytest.LogCaptureFixture,
) -> None:
    path = night_file(output, table, NIGHT)
    damage(path)
    left_over = [path.read_bytes()] if path.exists() else []
    result = tiny_fleet.run(output, repair=True)
    assert codes_of(result.damage) == [(name_of(output, path), code)]
    assert (result.damage_left, result.failed) == ((), ())
    assert f"{code}: {name_of(output, path)}: " in caplog.text
    of_run = pl.read_parquet(max((output / "tables" / "runs").rglob("*.parquet")))["damage"]
    assert of_run.list.first().to_list()[-1].startswith(f"{code}: {name_of(output, path)}: ")
    assert [path.read_bytes() for path in output.rglob("*.damaged")] == left_over
    remove_aside(output)
    check_repaired(output, tiny_fleet.after)


def test_what_a_program_has_written_to_is_proven_in_the_next_run(
    tiny_fleet: TinyFleet, output: Path
) -> None:
    """Once it is proven, `--repair` alone reads it again."""
    path = night_file(output, PREDICTIONS, NIGHT)
    whole = path.read_bytes()
    path.write_bytes(whole)
    assert tiny_fleet.run(output).damage == ()
    rot(path)  # which keeps the time
    assert tiny_fleet.run(output).damage == ()
    path.write_bytes(whole[:-50] + bytes(50))
    assert codes_of(tiny_fleet.run(output).damage) == [(name_of(output, path), "table_altered")]


def test_a_file_published_while_a_run_proves_others_stays_as_noted_then(
    output: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An intraday check publishes beside a run."""
    name = name_of(output, night_file(output, FITS, NIGHT))

    def verified(state: StateDatabase, **_: object) -> Iterator[VerifiedFile]:
        yield from verify_files(state, every_file=True)
        note(state, {name: "of the check"})

    monkeypatch.setattr("pipeline.run.output.verify_files", verified)
    with open_state(output) as state:
        assert find_damage(state) == ()
        assert state.rows("SELECT sha256 FROM files WHERE name = ?", name) == [("of the check",)]


def test_where_trends_meet_damage_it_is_named_and_the_next_run_is_well(
    tiny_fleet: TinyFleet, output: Path
) -> None:
    """A bit of a footer, in a night that they read as nothing is kept of it.

    Before, all motors of the fleet failed of it in each run for good.
    """
    path = night_file(output, FITS, NIGHT)
    rot_of_footer(path)
    change(output, "UPDATE trends SET checkpoint = NULL")
    change(output, "DELETE FROM trends WHERE motor_id = 'M1'")
    result = tiny_fleet.run(output)
    assert {outcome.error_code for outcome in result.failed} == {"store_read"}
    assert codes_of(result.damage) == [(name_of(output, path), "table_altered")]
    result = tiny_fleet.run(output)
    assert (result.failed, result.damage_left) == ((), ())
    remove_aside(output)
    check_repaired(output, tiny_fleet.after)


def test_a_flipped_bit_of_any_file_is_detected(output: Path) -> None:
    rng = np.random.default_rng(1)
    for path in sorted((output / "tables").rglob("*.parquet")):
        whole = path.read_bytes()
        flip(path, int(rng.integers(len(whole))))
        assert [table.path for table in verify_tables(output)] == [name_of(output, path)]
        path.write_bytes(whole)


def test_a_file_that_may_not_be_read_is_named_and_left_alone(
    tiny_fleet: TinyFleet, output: Path
) -> None:
    """A folder in its place cannot be read by anybody, whatever rights they have."""
    path = night_file(output, PREDICTIONS, NIGHT)
    path.unlink()
    path.mkdir()
    result = tiny_fleet.run(output)
    assert result.damage == result.damage_left
    assert codes_of(result.damage) == [(name_of(output, path), "table_unreadable")]
    assert path.is_dir()


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
    assert list(verify_tables(output)) == []


def test_rows_of_a_motor_whose_logs_are_gone_are_named_and_made_once_they_are_back(
    tiny_fleet: TinyFleet, output: Path, without_logs: Callable[..., TinyFleet]
) -> None:
    fleet, path = without_logs("M1"), night_file(output, BLOCKS, NIGHT)
    fits = read_rows(output, FITS, MOTORS)
    path.unlink()
    result = fleet.run(output)
    assert codes_of(result.damage_left) == [(name_of(output, path), "rows_lost")]
    assert result.damage_left[0].message.startswith("rows of M2 are not made anew: ")
    assert pl.read_parquet(path)["motor_id"].unique().to_list() == ["M1"]
    # Of other tables nothing is made anew for it, and what is known of its night still is.
    assert read_rows(output, FITS, ["M2"]).equals(fits.filter(motor_id="M2"), null_equal=True)
    assert NIGHT in processed_of(output, "M2").nights
    assert fleet.run(output).damage == ()
    assert tiny_fleet.run(output).damage_left == ()
    check_repaired(output, tiny_fleet.after)


def test_damage_is_named_and_made_anew_where_the_state_is_lost_too(
    tiny_fleet: TinyFleet, output: Path
) -> None:
    path = night_file(output, PREDICTIONS, NIGHT)
    rot(path)
    for state in output.glob("state.*"):
        state.unlink()
    assert codes_of(tiny_fleet.run(output).damage) == [(name_of(output, path), "table_altered")]
    remove_aside(output)
    check_repaired(output, tiny_fleet.after)


def test_files_of_a_newer_program_are_kept_where_the_state_is_lost(
    tiny_fleet: TinyFleet, output: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for state in output.glob("state.*"):
        state.unlink()
    before = contents(output / "tables")
    monkeypatch.setattr("pipeline.store.tables.SCHEMA_VERSION", 0)
    with refused("store_newer"):
        tiny_fleet.run(output)
    assert contents(output / "tables") == before


def test_an_output_of_an_earlier_version_is_put_aside_and_made_anew(
    tiny_fleet: TinyFleet, output: Path, caplog: pytest.LogCaptureFixture
) -> None:
    say(output)
    change(output, "PRAGMA user_version = 1")
    with refused("store_older", "makes it anew from the logs"):
        read_decisions(output)
    result = tiny_fleet.run(output)
    assert "put aside in old-1" in caplog.text
    assert (result.n_nights, result.damage, result.failed) == (2 * len(MOTORS), (), ())
    check_tables(output, tiny_fleet.after)
    assert read_decisions(output) == ()
    assert {path.name for path in output.iterdir()} == LASTING | {"old-1"}
    assert {"tables", "views.sql"} < {path.name for path in (output / "old-1").iterdir()}
    assert tiny_fleet.run(output).n_nights == 0
    assert not (output / "old-2").exists()
