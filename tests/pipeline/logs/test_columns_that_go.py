"""A column that is gone, or has another unit in the header: the run says since when."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

from pipeline.clock import latest_us
from pipeline.logs.motor_logs import LogShelf
from tests.pipeline.simulated import load_motor, motor_toml, operate, write_log


def test_the_last_log_that_had_it_is_named_with_its_date(tmp_path: Path) -> None:
    spec = load_motor(tmp_path, motor_toml("M1"))
    for day, name in ((13, "speed"), (14, "speed"), (15, "n_motor")):
        operation = operate(dt.date(2026, 3, day), 1.0)
        values = operation.channels(operation.pressure_bar)
        values[name] = values.pop("speed")
        write_log(tmp_path / "logs" / "M1" / f"{day}.parquet", operation.time_us, values)
    shelf = LogShelf(spec, {}, latest_us(), {})
    assert [shelf.content(name) is None for name in sorted(shelf.files)] == [False, False, True]
    failed = shelf.files["M1/15.parquet"]
    assert failed.error_code == "log_column_missing"
    assert failed.message is not None
    assert "'n_motor'" in failed.message
    assert failed.message.endswith(
        "; M1/14.parquet, of 14 March 2026, was the last log that had them all"
    )


def test_a_unit_that_changes_in_the_header_is_remarked_with_the_date(tmp_path: Path) -> None:
    text = motor_toml("M1", files='"*.csv"').replace('"parquet"', '"csv"\nunit_rows = 1')
    spec = load_motor(tmp_path, text)
    header = "time,pressure_difference,oil_temperature,speed,leakage_flow\n,{},degC,rpm,l/min\n"
    for day, unit in ((13, "bar"), (14, "psi"), (15, "psi")):
        rows = [f"2026-03-{day}T20:00:0{i}Z,150.{i},50.5,30.5,1.2\n" for i in range(9)]
        log = tmp_path / "logs" / f"{day}.csv"
        log.write_text(header.format(unit) + "".join(rows), "utf-8")
    shelf = LogShelf(spec, {}, latest_us(), {})
    names = sorted(shelf.files)
    assert all(shelf.content(name) for name in names)
    assert [shelf.files[name].message for name in names] == [
        None,
        "the header gives pressure_difference in 'psi', that of 13.csv, of 14 March 2026, in 'bar'",
        None,
    ]
