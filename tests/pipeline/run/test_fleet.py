"""The nightly run: what is new is done, once, with the same bytes."""

from __future__ import annotations

import shutil
from pathlib import Path

from tests.conftest import OwnFleet
from tests.pipeline.run.demo_runs import (
    CSV,
    MOTORS,
    NIGHTS,
    PARQUET,
    check_same_tables,
    log_file,
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
    assert len(first) >= 6 * 3


# New, late, corrected and broken logs


def test_a_deleted_log_leaves_what_is_published(own_fleet: OwnFleet, fitted_output: Path) -> None:
    fleet = own_fleet(PARQUET, fitted=True)
    log_file(fleet, PARQUET, NIGHTS[1]).unlink()
    assert run(fleet).n_nights == 0
    check_same_tables(output_of(fleet), fitted_output, *MOTORS)


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
