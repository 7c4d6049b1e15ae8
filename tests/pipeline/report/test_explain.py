"""`explain`: what is said of a good night, a failed one, and one that is not there."""

from __future__ import annotations

import datetime as dt
from itertools import pairwise
from pathlib import Path

from pipeline.config import load_fleet
from pipeline.report.explain import explain
from pipeline.run.fleet import RunRequest, run_fleet
from tests.conftest import OwnFleet
from tests.pipeline.calling import refused
from tests.pipeline.report.conftest import change_table, rows_with

FIRST = dt.date(2026, 1, 2)


def test_a_good_night_is_told_from_its_log_to_its_verdicts(fitted_output: Path) -> None:
    lines = explain(fitted_output, "CB560-01", FIRST)
    told = "\n".join(lines)
    assert told.startswith("CB560-01, night of 2026-01-02: fitted")
    for words in (
        "log CB560-01/CB560-01_2026-01-02.mcap: ok",
        "of the running motor's samples",
        "validation",
        "at the reference (200 bar, 50.0 °C, 30.0 rpm): 1.4",
        "at the reference by the night's own fit: 1.4",
        "K_piston_ring: identified, ",
        "training errors: 0.0",
        "l/min (root mean square)",
        "training errors: autocorrelated, ",
        " of 25 lags outside the 99 % band",
        "Systematic errors\n  leakage at the reference ± 0.0",
        "l/min from stated tolerances; what constants do alike on all nights is not in the ± above",
        "oil temperature offset of 1 °C: -",
        "leakage flow offset of 0.02 l/min: +",
    ):
        assert words in told
    assert "_per_" not in told
    # The answer stands first, and each part under its title.
    titles = [line for before, line in pairwise(lines) if not before]
    others = ["Paths", "Systematic errors", "Fit", "Errors of the fit", "Data"]
    assert titles == ["Leakage", "State", *others]
    under = {line for line in lines if line.startswith("  ")}
    assert len(lines) == 1 + 2 * len(titles) + len(under)


def test_one_pressure_all_night_is_told_with_what_would_help(fitted_output: Path) -> None:
    told = "\n".join(explain(fitted_output, "CB1120-02", FIRST))
    assert "at the reference by the night's own fit: none, pressure 200 bar lies outside" in told
    assert "at the motor's own conditions (those of its baseline): none without a baseline" in told
    assert "identified" not in told


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


def test_a_night_that_is_not_there_says_what_to_do(fitted_output: Path) -> None:
    with refused("unknown_night", "run fit-fleet"):
        explain(fitted_output, "CB400-02", dt.date(2020, 1, 1))
