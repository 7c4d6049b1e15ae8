"""The nightly run: what is new is done, once, with the same bytes."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from tests.conftest import OwnFleet
from tests.pipeline.run.demo_runs import (
    CSV,
    FIRST,
    MCAP,
    MOTORS,
    NIGHTS,
    PARQUET,
    check_same_tables,
    log_file,
    nights_of,
    output_of,
    rows,
    run,
    status_of,
    table_files,
)

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
