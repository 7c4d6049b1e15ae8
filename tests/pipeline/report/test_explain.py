"""`explain`: what is said of a good night, a failed one, and one that is not there."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

from pipeline.config import load_fleet
from pipeline.report.explain import explain
from pipeline.run.fleet import RunRequest, run_fleet
from tests.conftest import OwnFleet
from tests.pipeline.report.conftest import change_table, rows_with

FIRST = dt.date(2026, 1, 2)


def test_a_poor_fit_is_called_one(output: Path) -> None:
    change_table(
        output, "nights", rows_with("CB560-01", validation_fit_percent=-1295.0), f"{FIRST}"
    )
    (told,) = [line for line in explain(output, "CB560-01", FIRST) if line.startswith("  fit: ")]
    assert "validation -1295.0 % (poor: worse than a constant flow)" in told
    assert told.count("poor") == 1


def test_a_broken_log_is_named(own_fleet: OwnFleet) -> None:
    fleet = load_fleet(own_fleet("CB400-02"))
    log = min((fleet.log_root / "CB400-02").iterdir())
    log.write_bytes(b"nonsense" * 1000)
    run_fleet(RunRequest(fleet))
    told = explain(fleet.output, "CB400-02", FIRST)
    assert told[0].startswith("CB400-02, night of 2026-01-02: failed (log_not_parquet)")
    assert told[1:] == ["", "Data", f"  log CB400-02/{log.name}: failed"]
    assert "\n".join(told).count("does not begin as Parquet does") == 1
