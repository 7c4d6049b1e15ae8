"""What cannot be done is refused with its exit code and what to do, and nothing is written."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from tests.pipeline.calling import CSV, PARQUET, Call, change

NOTHING = "no_tables: there are no tables in"
USAGE = "expected a NIGHT, or --train"
REFUSED = [
    ("fit-fleet --motors CB400-09", 2, "no motor CB400-09; there are CB400-01, CB400-02"),
    ("fit-fleet --motors 'CB400-01 x y'", 2, "no motor x, y"),
    ("fit-fleet --since yesterday", 2, "'--since': got 'yesterday'; expected YYYY-MM-DD"),
    ("fit-fleet --until 2026-02-30", 2, "'--until': got '2026-02-30'"),
    ("fit-fleet --since 2026-02-02 --until 2026-02-01", 2, "--since 2026-02-02 is after"),
    ("fit-fleet --jobs 0", 2, "--jobs"),
    ("fit-fleet --jobs two", 2, "--jobs"),
    ("fit-fleet --fast", 2, "--fast"),
    (f"fit-fleet --output {'x' * 300}", 2, "expected a folder: File name too long"),
    ("fit-fleet another.toml", 2, "another.toml"),
    ("fit-fleet --output demo/logs", 2, "expected another folder than that of the logs"),
    ("check --tables --output none", 2, NOTHING),
    ("prune --tables predictions --keep 1 --output none", 2, NOTHING),
    (f"fit {CSV}", 2, USAGE),
    (f"fit {CSV} --validate 2026-01-02..2026-01-03", 2, USAGE),
    (f"fit {CSV} 2026-01-02 --train 2026-01-02..2026-01-03", 2, USAGE),
    (f"fit {CSV} --train monday", 2, "write nights as"),
    (f"fit {CSV} --train 2026-03-01T22:01..2026-03-01T22:02", 2, "write nights as"),
    (f"fit {CSV} --train 2026-01-03..2026-01-02", 2, "ends before it begins"),
    (f"fit {CSV} --train 2027-03-02..2027-03-03", 2, f"no log of {CSV} covers 2027-03-02 to"),
    (f"fit {CSV} 2020-01-03", 2, "covers the night of 2020-01-03: they cover 2026-01-02 to"),
    ("export", 2, "Missing option '--csv'"),
    ("export --csv csv --decimal ,", 2, "csv_dialect: --decimal , needs another"),
    ("export --csv csv --separator .", 2, "'--separator': Value error, '.' is not one of"),
    ("export --csv csv --tables fit", 2, "unknown_table: --tables: no table fit"),
    ("export --csv csv --motors CB9", 2, "unknown_motor: no motor CB9"),
    ("export --csv csv --since x", 2, "'--since': got 'x'"),
    ("export --csv csv --since 2026-01-03 --until 2026-01-02", 2, "is after"),
    ("export --csv csv --output none", 2, NOTHING),
    ("export --csv configs/fleet.toml", 4, "store_write: nights.csv cannot be written"),
]


@pytest.mark.parametrize(("line", "code", "words"), REFUSED)
def test_wrong_usage_is_refused(
    call: Call, fleet: Path, monkeypatch: pytest.MonkeyPatch, line: str, code: int, words: str
) -> None:
    monkeypatch.chdir(fleet.parents[1])
    before = sorted(Path.cwd().rglob("*"))
    command, *options = shlex.split(line)
    ended, out, err = call(command, fleet, *options)
    assert (ended, out) == (code, "")
    assert words in err
    assert sorted(Path.cwd().rglob("*")) == before


def test_logs_that_are_not_there_are_no_fleet_without_new_logs(call: Call, fleet: Path) -> None:
    """A folder that is not mounted, a wrong pattern, a log that is named, and metrics."""
    logs = fleet.parents[1] / "demo" / "logs"
    with fleet.open("a") as config:
        config.write('[metrics]\ntextfile = "../metrics/fleet.prom"\n')
    code, _, err = call("check", fleet)
    assert code == 1
    assert err.startswith("motor-leakage: metrics_file: ")
    (fleet.parents[1] / "metrics").mkdir()
    assert call("check", fleet)[0] == 0
    for motor, words in (
        (PARQUET, f"{PARQUET}: no_logs: no log: no file matches {PARQUET}/*.parquet below {logs}"),
        (CSV, f"motor-leakage: no_logs: no log of any motor is below {logs}"),
    ):
        for path in (logs / motor).iterdir():
            path.unlink()
        code, _, err = call("check", fleet)
        assert code == 1
        assert words in err
    change(fleet, f"motors/{CSV}.toml", f'"{CSV}/*.csv"', '"gone.csv"')
    code, out, err = call("fit", fleet, CSV, "2026-01-03")
    assert (code, out) == (1, "")
    assert err == f"{CSV}: log_missing: gone.csv: named in the config and absent\n"
    logs.rename(logs.with_name("unmounted"))
    for command in ("fit-fleet", "check"):
        code, _, err = call(command, fleet)
        assert code == 2
        assert f"fleet.toml: folders.logs: expected a folder at {logs}" in err
