"""The nightly run: what is new is done, once, and nothing that goes wrong takes others with it."""

from __future__ import annotations

import datetime as dt
import json
import os
import platform
import re
import shutil
import signal
import socket
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import polars as pl
import pyarrow.parquet as pq
import pytest
from polars.testing import assert_frame_equal

import pipeline.run.fleet
import pipeline.run.motors
import pipeline.store.publishing
from pipeline.config import load_fleet
from pipeline.errors import LockedError, StoreError
from pipeline.logs.ledger import Ledger, read_ledger
from pipeline.run.fleet import RunRequest, RunResult, run_fleet, staging_folder
from pipeline.run.motor_task import run_motor
from pipeline.run.tasks import MotorOutcome, MotorTask
from pipeline.schema import FITS, NIGHT_TABLES, TABLES
from pipeline.store.night_files import NightFile, prepare_night
from pipeline.store.tables import night_file, read_table
from tests.conftest import OwnFleet
from tests.pipeline.misbehaviour import MISBEHAVIOUR, Carried

FIRST = dt.date(2026, 1, 2)
NIGHTS = [FIRST, FIRST + dt.timedelta(days=1), FIRST + dt.timedelta(days=2)]
MOTORS = ["CB1120-01", "CB1120-02", "CB400-01", "CB400-02", "CB560-01", "CB560-02"]
EXCITED = [motor for motor in MOTORS if motor != "CB1120-02"]
CSV, PARQUET, MCAP = "CB400-01", "CB400-02", "CB560-01"
# Tables of a run itself: they say when and how long.
OF_RUNS = {"runs", "motor_outcomes"}


def run(
    fleet_file: Path,
    *motors: str,
    since: dt.date | None = None,
    until: dt.date | None = None,
    output: Path | None = None,
    **execution: Any,
) -> RunResult:
    fleet = load_fleet(fleet_file)
    how = fleet.execution.model_copy(update={"backend": "sequential"} | execution)
    fleet = replace(fleet, execution=how, output=output or fleet.output)
    return run_fleet(RunRequest(fleet, motors, since, until))


def status_of(result: RunResult) -> dict[str, str]:
    return {outcome.motor_id: outcome.status for outcome in result.outcomes}


def nights_of(result: RunResult) -> dict[str, list[dt.date]]:
    return {outcome.motor_id: list(outcome.nights) for outcome in result.outcomes}


def table_files(output: Path) -> dict[str, bytes]:
    """Every table file's bytes by its path, but for tables of the run itself, or that name it."""
    return {
        path.relative_to(output / "tables").as_posix(): path.read_bytes()
        for path in sorted((output / "tables").rglob("*"))
        if path.is_file()
        and path.relative_to(output / "tables").parts[0] not in {*OF_RUNS, "latest"}
    }


def rows(output: Path, table: str, *motors: str) -> pl.DataFrame:
    """A table as a reader sees it, but for the run that wrote each row."""
    (declared,) = (one for one in TABLES if one.name == table)
    found = pl.read_parquet(output / "tables" / table / "**" / "*.parquet", hive_partitioning=False)
    if motors:
        found = found.filter(pl.col("motor_id").is_in(motors))
    return found.drop("run_id", strict=False).sort([k for k in declared.key if k != "run_id"])


def check_same_tables(output: Path, other: Path, *motors: str) -> None:
    """All rows of all tables, whichever runs they came from."""
    for table in NIGHT_TABLES:
        if (other / "tables" / table.name).exists():
            here, there = rows(output, table.name, *motors), rows(other, table.name, *motors)
            assert_frame_equal(here, there, check_exact=True)


def log_file(fleet_file: Path, motor: str, night: dt.date) -> Path:
    (path,) = (fleet_file.parent.parent / "demo" / "logs" / motor).glob(f"{motor}_{night}.*")
    return path


def output_of(fleet_file: Path) -> Path:
    return fleet_file.parent.parent / "out"


# What a reader of the tables sees


def query(output: Path, sql: str) -> list[Any]:
    """Rows of a DuckDB query; ``@name`` stands for all files of a table."""
    found = duckdb.sql(re.sub(r"@(\w+)", rf"'{output}/tables/\1/**/*.parquet'", sql))
    assert found is not None
    return found.fetchall()


def test_each_motor_and_night_once_where_primary(fitted_output: Path) -> None:
    found = query(
        fitted_output,
        "SELECT motor_id, night, status FROM @fits WHERE is_primary ORDER BY motor_id, night",
    )
    assert found == [(motor, night, "ok") for motor in MOTORS for night in NIGHTS]


def test_three_types_and_three_formats(fitted_output: Path) -> None:
    types = query(
        fitted_output,
        "SELECT motor_type, count(*) FROM @fits WHERE is_primary GROUP BY ALL ORDER BY ALL",
    )
    assert types == [("CB1120", 6), ("CB400", 6), ("CB560", 6)]
    formats = query(
        fitted_output,
        "SELECT format, status, count(*) FROM @input_files GROUP BY ALL ORDER BY ALL",
    )
    assert formats == [("csv", "ok", 6), ("mcap", "ok", 6), ("parquet", "ok", 6)]


def test_input_files_tell_what_was_read(fitted_output: Path, demo_folder: Path) -> None:
    for row in rows(fitted_output, "input_files").iter_rows(named=True):
        path = demo_folder / "demo" / "logs" / row["path"]
        assert row["size_bytes"] == path.stat().st_size
        assert str(row["night"]) in row["path"]
        assert row["first_time"] < row["last_time"]
        assert row["rows"] > 10_000


def test_a_run_records_what_made_it_and_how_long_it_took(fitted_output: Path) -> None:
    (run,) = rows(fitted_output, "runs").to_dicts()
    for name in ("polars", "pyarrow", "numpy", "scipy"):
        assert run[f"{name}_version"] == version(name)
    assert run["python_version"] == platform.python_version()
    assert run["version"] == version("motor-leakage")
    assert (run["seed"], len(run["config_hash"]) > 0) == (1, True)
    assert min(run["motors_s"], run["publish_s"], run["trends_s"]) > 0
    assert run["motors_s"] + run["publish_s"] + run["trends_s"] == pytest.approx(run["seconds"])
    outcomes = rows(fitted_output, "motor_outcomes")
    stages = ("read_s", "clean_s", "statistics_s", "fit_s", "residuals_s", "store_s")
    assert (outcomes.select(stages).to_numpy() > 0).all()
    # Motors are done one after another here, so theirs is no more than the run's.
    assert outcomes.select(stages).to_numpy().sum() <= run["motors_s"]


# Nothing is raised, frozen or said in three nights.
WITHOUT_ROWS = {"alarms", "baselines", "change_points", "decisions", "looks"}


@pytest.mark.parametrize("table", sorted({table.name for table in TABLES} - WITHOUT_ROWS))
def test_keys_stand_once_and_types_are_those_declared(fitted_output: Path, table: str) -> None:
    (declared,) = (one for one in TABLES if one.name == table)
    folder = fitted_output / "tables" / table
    found = pl.read_parquet(folder / "**" / "*.parquet", hive_partitioning=False)
    assert found.height
    assert found.select(declared.key).is_unique().all()
    assert dict(found.schema) == {
        name: kind if isinstance(kind, pl.DataType) else kind()
        for name, kind in declared.schema.items()
    }


def test_the_partition_of_a_month_is_that_of_its_nights(fitted_output: Path) -> None:
    for table in NIGHT_TABLES:
        for path in (fitted_output / "tables" / table.name).rglob("*.parquet"):
            nights = set(pq.read_table(path, partitioning=None)["night"].to_pylist())
            assert nights == {dt.date.fromisoformat(path.stem)}
            assert path.parent.name == f"month={path.stem[:7]}"


def test_nothing_but_tables_and_what_saves_work_is_left(fitted_output: Path) -> None:
    left = {"tables", "ledger", "manifest", "history", "lock", "heartbeat.json", "views.sql"}
    assert {path.name for path in fitted_output.iterdir()} == left
    assert not (fitted_output / "staging").exists()
    assert not list(fitted_output.rglob(".writing-*"))


@pytest.mark.parametrize("motor", EXCITED)
def test_estimates_are_near_the_truth(fitted_output: Path, demo_folder: Path, motor: str) -> None:
    truth = json.loads((demo_folder / "demo" / "truth.json").read_text())["motors"][motor]["nights"]
    fits = {row["night"]: row for row in rows(fitted_output, "fits", motor).iter_rows(named=True)}
    for night in NIGHTS:
        true = truth[night.isoformat()]
        found = {
            row["parameter"]: row["value"]
            for row in rows(fitted_output, "parameters", motor).iter_rows(named=True)
            if row["night"] == night
        }
        for path, k in true["K_m3"].items():
            assert found[f"K_{path}"] == pytest.approx(k, rel=0.15), (night, path)
        assert found["C_f"] == pytest.approx(true["C_f_l_per_min"], abs=0.05)
        leakage = fits[night]["reference_leakage_l_per_min"]
        assert leakage == pytest.approx(true["reference_leakage_l_per_min"], rel=0.015)


def test_a_motor_at_one_pressure_has_its_own_leakage_only(
    fitted_output: Path, demo_folder: Path
) -> None:
    fits = rows(fitted_output, "fits", "CB1120-02")
    assert fits["own_conditions_leakage_l_per_min"].to_list() == pytest.approx(
        fits["mean_flow_l_per_min"].to_list(), rel=0.05
    )
    assert fits["outside_fitted_range"].all()


def test_no_start_ends_below_the_certificate(fitted_output: Path) -> None:
    ((lowest, count),) = query(
        fitted_output,
        "SELECT min(s.cost / f.cost) - 1, count(*) FROM @fits f JOIN @starts s"
        " USING (motor_id, night, flushing_mode)",
    )
    assert count == 18 * 10
    assert lowest > -1e-10


def test_the_first_night_alone_has_no_model_before(fitted_output: Path) -> None:
    judged = rows(fitted_output, "fits").select("night", "previous_model_fit_percent")
    assert judged.filter(pl.col("night") == FIRST)["previous_model_fit_percent"].is_null().all()
    later = judged.filter(pl.col("night") > FIRST)["previous_model_fit_percent"]
    assert later.is_not_null().all()


# The same bytes


def test_two_workers_write_the_same_bytes_as_one_after_the_other(
    demo_folder: Path, fitted_output: Path, tmp_path: Path
) -> None:
    result = run(demo_folder / "configs" / "fleet.toml", output=tmp_path, backend="loky")
    assert status_of(result) == dict.fromkeys(MOTORS, "ok")
    assert table_files(tmp_path) == table_files(fitted_output)


def test_one_worker_writes_the_same_bytes_wherever_it_lies(
    own_fleet: OwnFleet, tmp_path: Path
) -> None:
    fleet = own_fleet(PARQUET)
    run(fleet)
    run(fleet, output=tmp_path / "elsewhere", backend="loky", workers=1)
    (tmp_path / "moved").mkdir()
    for name in ("configs", "demo"):
        shutil.copytree(tmp_path / name, tmp_path / "moved" / name)
    run(tmp_path / "moved/configs/fleet.toml")
    first = table_files(output_of(fleet))
    assert first == table_files(tmp_path / "elsewhere") == table_files(tmp_path / "moved/out")
    assert len(first) > 6 * 3


def test_a_second_run_finds_nothing_new_and_changes_no_table(own_fleet: OwnFleet) -> None:
    fleet = own_fleet(*MOTORS, fitted=True)
    before = table_files(output_of(fleet))
    result = run(fleet)
    assert status_of(result) == dict.fromkeys(MOTORS, "no_new_data")
    assert (result.n_nights, result.failed) == (0, ())
    assert table_files(output_of(fleet)) == before


def test_touching_a_file_is_no_news(own_fleet: OwnFleet) -> None:
    fleet = own_fleet(PARQUET, fitted=True)
    run(fleet)  # its oil circuit has lost a motor: trends anew
    before = table_files(output_of(fleet))
    os.utime(log_file(fleet, PARQUET, NIGHTS[1]), ns=(1, 1))
    assert run(fleet).n_nights == 0
    assert table_files(output_of(fleet)) == before


def test_a_lost_or_damaged_ledger_costs_work_and_nothing_else(own_fleet: OwnFleet) -> None:
    fleet = own_fleet(CSV, PARQUET, fitted=True)
    before = table_files(output_of(fleet))
    shutil.rmtree(output_of(fleet) / "ledger" / CSV)
    (month,) = (output_of(fleet) / "ledger" / PARQUET).glob("*.json")
    month.write_text('{"files": [', "utf-8")
    assert run(fleet).n_nights == 6
    check_same_tables(output_of(fleet), output_of(fleet))
    assert table_files(output_of(fleet)).keys() == before.keys()


# New, late, corrected and broken logs


def test_a_late_file_fills_its_hole_and_judges_the_night_after_anew(
    own_fleet: OwnFleet, fitted_output: Path
) -> None:
    fleet = own_fleet(PARQUET)
    late = log_file(fleet, PARQUET, NIGHTS[1])
    kept = late.rename(fleet.parent / "late")
    assert nights_of(run(fleet)) == {PARQUET: NIGHTS}
    found = rows(output_of(fleet), "fits").select("night", "status", "is_primary", "reason")
    assert found.rows() == [
        (NIGHTS[0], "ok", True, None),
        (NIGHTS[1], "no_new_data", True, "no log covers this night"),
        (NIGHTS[2], "ok", True, None),
    ]
    untouched = {k: v for k, v in table_files(output_of(fleet)).items() if str(FIRST) in k}
    kept.rename(late)
    assert nights_of(run(fleet)) == {PARQUET: NIGHTS[1:]}
    check_same_tables(output_of(fleet), fitted_output, PARQUET)
    after = table_files(output_of(fleet))
    assert {k: v for k, v in after.items() if str(FIRST) in k} == untouched


def test_a_file_after_the_last_night_is_done_alone(
    own_fleet: OwnFleet, fitted_output: Path
) -> None:
    fleet = own_fleet(PARQUET)
    new = log_file(fleet, PARQUET, NIGHTS[2])
    kept = new.rename(fleet.parent / "new")
    assert nights_of(run(fleet)) == {PARQUET: NIGHTS[:2]}
    kept.rename(new)
    assert nights_of(run(fleet)) == {PARQUET: NIGHTS[2:]}
    check_same_tables(output_of(fleet), fitted_output, PARQUET)


def test_a_corrected_file_replaces_its_rows(own_fleet: OwnFleet, fitted_output: Path) -> None:
    fleet = own_fleet(PARQUET, fitted=True)
    path = log_file(fleet, PARQUET, FIRST)
    original, log = path.read_bytes(), pq.read_table(path)
    pq.write_table(log.slice(0, log.num_rows - 2000), path)
    # Its own night, and the next, which is judged with its model.
    assert nights_of(run(fleet)) == {PARQUET: NIGHTS[:2]}
    fits = rows(output_of(fleet), "fits", PARQUET)
    before = rows(fitted_output, "fits", PARQUET)
    assert fits.height == 3
    assert fits["n_training"][0] < before["n_training"][0]
    assert fits["previous_model_fit_percent"][1] != before["previous_model_fit_percent"][1]
    same = ["cost", "n_training", "validation_fit_percent"]
    assert_frame_equal(fits[1:].select(same), before[1:].select(same), check_exact=True)
    assert_frame_equal(fits[2:], before[2:], check_exact=True)
    # And corrected back: the very same tables.
    path.write_bytes(original)
    assert nights_of(run(fleet)) == {PARQUET: NIGHTS[:2]}
    check_same_tables(output_of(fleet), fitted_output, PARQUET)


def test_a_deleted_log_leaves_what_is_published(own_fleet: OwnFleet, fitted_output: Path) -> None:
    fleet = own_fleet(PARQUET, fitted=True)
    log_file(fleet, PARQUET, NIGHTS[1]).unlink()
    assert run(fleet).n_nights == 0
    check_same_tables(output_of(fleet), fitted_output, *MOTORS)


def test_random_bytes_fail_their_night_alone(own_fleet: OwnFleet, fitted_output: Path) -> None:
    fleet = own_fleet(CSV, PARQUET, MCAP)
    kept = {}
    for motor in (CSV, PARQUET, MCAP):
        path = log_file(fleet, motor, NIGHTS[1])
        kept[path] = path.read_bytes()
        path.write_bytes(np.random.default_rng(7).bytes(20_000))
    result = run(fleet)
    assert status_of(result) == dict.fromkeys((CSV, PARQUET, MCAP), "failed")
    for outcome in result.outcomes:
        assert dict(outcome.counts) == {"ok": 2, "failed": 1}
        assert outcome.message is not None
        assert f"{outcome.motor_id}_{NIGHTS[1]}" in outcome.message
    fits = rows(output_of(fleet), "fits")
    assert fits.filter(pl.col("is_primary")).height == 9
    failed = fits.filter(pl.col("night") == NIGHTS[1])
    assert failed["status"].to_list() == ["failed"] * 3
    assert failed["error_code"].str.starts_with("log_").all()
    assert failed["window_start"].is_null().all()
    for motor, reason in failed.select("motor_id", "reason").iter_rows():
        assert f"{motor}_{NIGHTS[1]}" in reason
    files = rows(output_of(fleet), "input_files").filter(pl.col("status") == "failed")
    assert files["night"].to_list() == [NIGHTS[1]] * 3
    assert files["sha256"].is_not_null().all()
    # The last night is then judged with the model of the first.
    assert (
        fits.filter(pl.col("night") == NIGHTS[2])["previous_model_fit_percent"].is_not_null().all()
    )
    # Whole again: as if nothing had been.
    for path, content in kept.items():
        path.write_bytes(content)
    result = run(fleet)
    assert nights_of(result) == dict.fromkeys((CSV, PARQUET, MCAP), NIGHTS[1:])
    check_same_tables(output_of(fleet), fitted_output, CSV, PARQUET, MCAP)


@pytest.mark.parametrize(("motor", "status"), [(CSV, "ok"), (PARQUET, "failed"), (MCAP, "failed")])
def test_a_log_that_is_still_written_is_done_again_when_whole(
    own_fleet: OwnFleet, fitted_output: Path, motor: str, status: str
) -> None:
    fleet = own_fleet(motor)
    path = log_file(fleet, motor, NIGHTS[2])
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) * 9 // 10 + 7])
    (outcome,) = run(fleet).outcomes
    assert outcome.status == status
    # Of a CSV the whole rows are taken; that its last one is not whole is told.
    files = rows(output_of(fleet), "input_files")
    assert files["message"].is_not_null().to_list() == [False, False, True]
    path.write_bytes(whole)
    assert nights_of(run(fleet)) == {motor: NIGHTS[2:]}
    check_same_tables(output_of(fleet), fitted_output, motor)


def test_a_log_named_and_absent_is_a_failure_and_a_glob_is_not(
    own_fleet: OwnFleet, fitted_output: Path
) -> None:
    fleet = own_fleet(CSV, PARQUET)
    for motor, files in ((CSV, f'"{CSV}/*.csv", "{CSV}/gone.csv"'), (PARQUET, '"none/*.parquet"')):
        file = fleet.parent / "motors" / f"{motor}.toml"
        text = file.read_text(encoding="utf-8")
        start, end = text.index("files = ["), text.index("]", text.index("files = ["))
        file.write_text(text[:start] + f"files = [{files}" + text[end:], encoding="utf-8")
    result = run(fleet)
    assert status_of(result) == {CSV: "failed", PARQUET: "no_new_data"}
    assert result.outcomes[0].error_code == "log_missing"
    assert "gone.csv" in (result.outcomes[0].message or "")
    assert dict(result.outcomes[0].counts) == {"ok": 3}
    assert rows(output_of(fleet), "fits", CSV).height == 3
    # It stays a failure for as long as it is absent.
    assert status_of(run(fleet))[CSV] == "failed"


# Parts of a fleet


def test_parts_add_up_to_the_whole(own_fleet: OwnFleet, fitted_output: Path) -> None:
    fleet = own_fleet(CSV, PARQUET)
    # From the last night backwards: each night is judged with a model that was not there at first.
    assert nights_of(run(fleet, PARQUET, since=NIGHTS[2])) == {PARQUET: NIGHTS[2:]}
    assert nights_of(run(fleet, since=NIGHTS[1], until=NIGHTS[1])) == {
        CSV: NIGHTS[1:2],
        PARQUET: NIGHTS[1:2],
    }
    assert nights_of(run(fleet)) == {CSV: [NIGHTS[0], *NIGHTS[1:]], PARQUET: NIGHTS}
    check_same_tables(output_of(fleet), fitted_output, CSV, PARQUET)
    assert run(fleet).n_nights == 0


def test_nights_before_all_logs(own_fleet: OwnFleet) -> None:
    fleet = own_fleet(PARQUET)
    result = run(fleet, until=FIRST - dt.timedelta(days=1))
    assert status_of(result) == {PARQUET: "no_new_data"}
    assert nights_of(run(fleet)) == {PARQUET: NIGHTS}


def test_settings_that_shape_figures_make_everything_new(own_fleet: OwnFleet) -> None:
    fleet = own_fleet(PARQUET, fitted=True)
    fleet.write_text(fleet.read_text().replace("workers = 2", "workers = 7"), "utf-8")
    assert run(fleet).n_nights == 0
    fleet.write_text(
        fleet.read_text().replace("pressure_bar = 200.0", "pressure_bar = 190.0"), "utf-8"
    )
    assert run(fleet).n_nights == 3
    assert set(rows(output_of(fleet), "fits", PARQUET)["reference_pressure_bar"]) == {190.0}
    assert set(rows(output_of(fleet), "fits", CSV)["reference_pressure_bar"]) == {200.0}


# A worker that dies


def test_a_worker_that_dies_costs_its_motor_alone_and_nothing_if_it_dies_once(
    own_fleet: OwnFleet, fitted_output: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fleet, died = own_fleet(CSV, PARQUET, MCAP), tmp_path / "died"

    def run_or_die(task: MotorTask) -> MotorOutcome:
        if task.spec.motor_id == CSV:
            MISBEHAVIOUR["segfault"]()
        if task.spec.motor_id == PARQUET and not died.exists():
            died.touch()
            MISBEHAVIOUR["kill"]()
        return run_motor(task)

    monkeypatch.setattr(pipeline.run.motors, "run_motor", Carried(run_or_die))
    result = run(fleet, backend="loky")
    assert died.exists()
    assert status_of(result) == {CSV: "failed", PARQUET: "ok", MCAP: "ok"}
    (lost,) = result.failed
    assert lost.error_code == "worker_died"
    assert read_ledger(output_of(fleet), CSV) == Ledger()
    check_same_tables(output_of(fleet), fitted_output, PARQUET, MCAP)
    assert rows(output_of(fleet), "fits", CSV).is_empty()
    last = rows(output_of(fleet), "motor_outcomes", CSV).sort("started_at").row(-1, named=True)
    assert (last["status"], last["error_code"]) == ("failed", "worker_died")
    assert "SIGSEGV, in string_at" in last["message"]
    # The next run has it all to do.
    monkeypatch.undo()
    assert nights_of(run(fleet, CSV)) == {CSV: NIGHTS}
    check_same_tables(output_of(fleet), fitted_output, CSV, PARQUET, MCAP)


def test_a_fault_of_ours_costs_its_motor_alone(
    own_fleet: OwnFleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> object:
        raise ZeroDivisionError("not foreseen")

    fleet = own_fleet(CSV, PARQUET)
    monkeypatch.setattr("pipeline.logs.locations.find_logs", broken)
    result = run(fleet)
    assert status_of(result) == {CSV: "failed", PARQUET: "failed"}
    assert {outcome.error_code for outcome in result.outcomes} == {"internal"}
    assert "ZeroDivisionError: not foreseen" in (result.outcomes[0].message or "")


# The lock, and outputs that cannot be written


def test_two_runs_never_write_at_once(own_fleet: OwnFleet) -> None:
    fleet = own_fleet(PARQUET)
    seen: list[str] = []

    def second(_: MotorOutcome) -> None:
        with pytest.raises(LockedError) as caught:
            run(fleet)
        seen.append(str(caught.value))

    sequential = load_fleet(fleet).execution.model_copy(update={"backend": "sequential"})
    run_fleet(RunRequest(replace(load_fleet(fleet), execution=sequential)), second)
    (message,) = seen
    assert f"process {os.getpid()} on {socket.gethostname()} since 20" in message
    # It is free again, and the first run's tables are whole.
    assert run(fleet).n_nights == 0
    assert rows(output_of(fleet), "fits").height == 3


@pytest.mark.parametrize("place", ["out", "out/tables", "out/staging", "out/lock", "out/ledger"])
def test_an_output_that_cannot_be_written(own_fleet: OwnFleet, place: str) -> None:
    fleet = own_fleet(PARQUET)
    blocked = fleet.parent.parent / place
    blocked.parent.mkdir(exist_ok=True)
    if place == "out/lock":
        blocked.mkdir()
    else:
        blocked.write_text("in the way")
    with pytest.raises(StoreError) as caught:
        run(fleet)
    assert caught.value.code == "store_write"
    assert blocked.exists()
    # Once it is out of the way all is done.
    blocked.rmdir() if blocked.is_dir() else blocked.unlink()
    assert run(fleet).n_nights == 3


def test_nobody_else_may_enter_the_folder_of_staged_rows(tmp_path: Path) -> None:
    """Parts of a split motor are unpickled from there."""
    before = os.umask(0)
    try:
        with staging_folder(tmp_path / "out") as folder:
            assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    finally:
        os.umask(before)


# Signals. The run is a process of its own; one of its motors waits for ever.

WAITING = """
import signal, sys
import pipeline.run.fleet
import pipeline.run.motors
from pipeline.cli import main
from pipeline.run.motor_task import run_motor

waits = sys.argv.pop()

def run_or_wait(task):
    while task.spec.motor_id == waits:
        signal.pause()
    return run_motor(task)

pipeline.run.motors.run_motor = run_or_wait
main()
"""


@pytest.fixture
def waiting_run(
    own_fleet: OwnFleet,
) -> Iterator[Callable[[int], tuple[Path, subprocess.Popen[str]]]]:
    """Starts a run that has done one motor and waits in another."""
    processes = []

    def start(jobs: int) -> tuple[Path, subprocess.Popen[str]]:
        fleet = own_fleet(CSV, PARQUET)
        process = subprocess.Popen(
            [sys.executable, "-c", WAITING, "fit-fleet", str(fleet), f"--jobs={jobs}", PARQUET],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        processes.append(process)
        assert process.stdout is not None
        assert process.stdout.readline() == f"{CSV}: ok (3 ok)\n"
        return fleet, process

    yield start
    for process in processes:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


@pytest.mark.parametrize(
    ("jobs", "number", "to_all", "code"),
    [
        pytest.param(1, signal.SIGINT, False, 130, marks=pytest.mark.full),
        (2, signal.SIGINT, True, 130),
        (2, signal.SIGTERM, False, 143),
    ],
)
def test_a_signal_keeps_what_is_done(
    waiting_run: Callable[[int], tuple[Path, subprocess.Popen[str]]],
    fitted_output: Path,
    jobs: int,
    number: signal.Signals,
    to_all: bool,
    code: int,
) -> None:
    fleet, process = waiting_run(jobs)
    # A second run is turned away at once, and told by whom.
    with pytest.raises(LockedError, match=rf"process {process.pid} on \S+ since"):
        run(fleet)
    (os.killpg if to_all else os.kill)(process.pid, number)
    out, err = process.communicate(timeout=60)
    assert process.returncode == code
    assert out.startswith("interrupted; 3 nights of 1 motor ")
    assert "Traceback" not in err or to_all  # a worker may tell of its own interruption
    check_same_tables(output_of(fleet), fitted_output, CSV)
    assert rows(output_of(fleet), "fits", PARQUET).is_empty()
    assert rows(output_of(fleet), "runs")["status"].to_list() == ["interrupted"]
    assert nights_of(run(fleet)) == {CSV: [], PARQUET: NIGHTS}
    check_same_tables(output_of(fleet), fitted_output, CSV, PARQUET)


def test_a_killed_run_leaves_nothing_that_the_next_cannot_mend(
    waiting_run: Callable[[int], tuple[Path, subprocess.Popen[str]]], fitted_output: Path
) -> None:
    fleet, process = waiting_run(1)
    os.kill(process.pid, signal.SIGKILL)
    process.communicate(timeout=60)
    (output_of(fleet) / "tables" / "fits" / "month=2026-01").mkdir(parents=True)
    leftover = output_of(fleet) / "tables" / "fits" / "month=2026-01" / ".writing-abc"
    leftover.write_bytes(b"half a table")
    assert nights_of(run(fleet)) == {CSV: NIGHTS, PARQUET: NIGHTS}
    assert not leftover.exists()
    assert not (output_of(fleet) / "staging").exists()
    check_same_tables(output_of(fleet), fitted_output, CSV, PARQUET)


@pytest.mark.parametrize(
    "after", [4, 15, *(pytest.param(one, marks=pytest.mark.full) for one in (1, 9))]
)
def test_an_interrupt_while_publishing_is_mended_by_the_next_run(
    own_fleet: OwnFleet, fitted_output: Path, monkeypatch: pytest.MonkeyPatch, after: int
) -> None:
    fleet = own_fleet(PARQUET)
    calls = 0

    def interrupted(*arguments: Any) -> NightFile:
        nonlocal calls
        calls += 1
        if calls > after:
            raise KeyboardInterrupt
        return prepare_night(*arguments)

    monkeypatch.setattr(pipeline.store.publishing, "prepare_night", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run(fleet)
    monkeypatch.undo()
    assert nights_of(run(fleet)) == {PARQUET: NIGHTS}
    check_same_tables(output_of(fleet), fitted_output, PARQUET)


def test_a_damaged_night_is_made_anew_for_all_motors_by_the_run_after(
    own_fleet: OwnFleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Damage that is found only when the night is made, as the file keeps its time stamp."""
    monkeypatch.setattr("pipeline.run.fleet.share_due", lambda *_: lambda _: False)
    config = own_fleet("CB400-01", "CB400-02", fitted=True)
    fleet, night = load_fleet(config), FIRST
    before = read_table(night_file(fleet.output, FITS, night), FITS).drop("run_id")
    state = night_file(fleet.output, FITS, night).stat()
    night_file(fleet.output, FITS, night).write_bytes(b"junk")
    os.utime(night_file(fleet.output, FITS, night), ns=(state.st_atime_ns, state.st_mtime_ns))
    log = min((fleet.log_root / "CB400-01").iterdir())
    log.write_text(log.read_text("utf-8").rsplit("\n", 2)[0] + "\n", "utf-8")
    run(config)
    alone = read_table(night_file(fleet.output, FITS, night), FITS)
    assert alone["motor_id"].to_list() == ["CB400-01"]
    run(config)
    after = read_table(night_file(fleet.output, FITS, night), FITS).drop("run_id")
    assert after["motor_id"].to_list() == ["CB400-01", "CB400-02"]
    other = pl.col("motor_id") == "CB400-02"
    assert after.filter(other).equals(before.filter(other))


def test_a_fleet_whose_logs_are_gone_says_so(
    own_fleet: OwnFleet, caplog: pytest.LogCaptureFixture
) -> None:
    fleet = own_fleet(PARQUET, fitted=True)
    run(fleet)
    assert "is the folder mounted" not in caplog.text
    shutil.rmtree(log_file(fleet, PARQUET, NIGHTS[1]).parent)
    assert run(fleet).n_nights == 0
    assert "no log of any motor is below" in caplog.text
