"""`check`, and `fit` of one night."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.conftest import OwnFleet
from tests.pipeline.calling import CSV, PARQUET, Call, change


def test_check_is_1_where_there_is_no_log_at_all(call: Call, own_fleet: OwnFleet) -> None:
    """A wrong folder or pattern must not pass for a sound fleet."""
    fleet = own_fleet(CSV, PARQUET)
    logs = fleet.parent.parent / "demo" / "logs"
    for motor, words in (
        (PARQUET, f"{PARQUET}: no_logs: no log: no file matches {PARQUET}/*.parquet below {logs}"),
        (CSV, f"motor-leakage: no_logs: no log of any motor is below {logs}"),
    ):
        for path in (logs / motor).iterdir():
            path.unlink()
        code, _, err = call("check", fleet)
        assert code == 1
        assert words in err


def test_check_is_1_where_the_folder_of_the_metrics_is_missing(call: Call, fleet: Path) -> None:
    with fleet.open("a") as config:
        config.write('[metrics]\ntextfile = "../metrics/fleet.prom"\n')
    folder = fleet.parent.parent / "metrics"
    code, _, err = call("check", fleet)
    assert code == 1
    assert err.startswith("motor-leakage: metrics_file: ")
    assert "/metrics is no folder; make it" in err
    folder.mkdir()
    assert call("check", fleet)[0] == 0


@pytest.mark.parametrize(
    "command", [("check", "--tables"), ("prune", "--tables", "predictions", "--keep", "1")]
)
def test_2_where_there_are_no_tables(
    call: Call, own_fleet: OwnFleet, tmp_path: Path, command: tuple[str, ...]
) -> None:
    """A wrong folder must not pass for sound tables, and none is made."""
    elsewhere = tmp_path / "elsewhere"
    name, *options = command
    code, out, err = call(name, own_fleet(CSV), *options, "--output", elsewhere)
    assert (code, out) == (2, "")
    assert err.startswith(f"motor-leakage: no_tables: there are no tables in {elsewhere}")
    assert not elsewhere.exists()


def stamped(fleet: Path) -> dict[Path, int]:
    """Times of change of all files of a fleet."""
    files = (path for path in fleet.parent.parent.rglob("*") if path.is_file())
    return {path: path.stat().st_mtime_ns for path in files}


def test_fit_tells_of_a_night_and_publishes_nothing(call: Call, fleet: Path) -> None:
    before = stamped(fleet)
    code, out, err = call("fit", fleet, CSV, "2026-01-03")
    assert (code, err) == (0, "")
    assert out.startswith(f"{CSV}, night of 2026-01-03: fitted")
    assert stamped(fleet) == before
    # The audit: the search ends at the proven minimum, wherever h and e are on the way there.
    assert "\nAudit, flushing " in out
    assert re.search(r"search: 10 of 10 starts end at the proven minimum, the best [+-]\d", out)
    spreads = re.findall(r"  (\w+_balance_piston): (\S+) to (\S+) ", out)
    apart = {name: float(high) / float(low) - 1.0 for name, low, high in spreads}
    assert apart["h_balance_piston"] > 0.01
    assert apart["K_balance_piston"] < 1e-3
    assert re.search(r"FPE \S+ \(l/min\)², AIC \S+, AICc \S+, BIC \S+: \d+ training samples", out)


def test_fit_trains_on_one_period_and_validates_on_another(call: Call, fleet: Path) -> None:
    periods = ("--train", "2026-01-02..2026-01-03", "--validate", "2026-01-04..2026-01-04")
    code, out, err = call("fit", fleet, CSV, *periods)
    assert (code, err) == (0, "")
    assert out.startswith("CB")
    assert "\nvalidation: fit" in out
    for wrong in ((), ("--validate", "2026-01-02..2026-01-03"), ("2026-01-02", *periods)):
        code, out, err = call("fit", fleet, CSV, *wrong)
        assert (code, out) == (2, "")
        assert "expected a NIGHT, or --train" in err
    for nights, words in (
        ("monday", "write nights as"),
        ("2026-03-01T22:01..2026-03-01T22:02", "write nights as"),
        ("2026-01-03..2026-01-02", "ends before it begins"),
        ("2027-03-02..2027-03-03", f"no log of {CSV} covers 2027-03-02 to 2027-03-03"),
    ):
        code, out, err = call("fit", fleet, CSV, "--train", nights)
        assert (code, out) == (2, "")
        assert words in err


def test_fit_of_a_night_without_a_log_is_wrong_usage(call: Call, fleet: Path) -> None:
    code, out, err = call("fit", fleet, CSV, "2020-01-03")
    assert (code, out) == (2, "")
    assert f"no log of {CSV} covers the night of 2020-01-03: they cover 2026-01-02 to" in err
    change(fleet, f"motors/{CSV}.toml", f'"{CSV}/*.csv"', '"gone.csv"')
    code, out, err = call("fit", fleet, CSV, "2026-01-03")
    assert (code, out) == (1, "")
    assert err == f"{CSV}: log_missing: gone.csv: named in the config and absent\n"
