"""A column that is not in a log any more: the run says which log was the last that had it."""

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
