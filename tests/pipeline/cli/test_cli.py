"""Runs by the command: exit codes, what goes to which stream, lines for programs."""

from __future__ import annotations

import contextlib
import os
import pty
import shlex
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import polars as pl
import pytest

import pipeline.cli
import pipeline.run.fleet
import pipeline.store.publishing
from pipeline.cli.runs import RunProgress
from pipeline.store.atomic_files import prepare
from pipeline.workers.process import Mark
from tests.conftest import OwnFleet
from tests.pipeline.calling import CSV, PARQUET, Call, change, without_workers


def test_the_bar_counts_nights_and_for_motors_to_come_their_mean() -> None:
    progress = RunProgress(6, as_json=True)
    assert progress.nights == (0, 6)
    progress.n_finished, progress.nights_finished = 1, 75
    progress.watched(lambda: [Mark(1, n_done=30, n_left=45)])
    assert progress.nights == (105, 450)


def test_143_while_publishing(
    call: Call, own_fleet: OwnFleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    came: list[int] = []

    def interrupted(*arguments: Any) -> Path:
        if not came:
            came.append(signal.SIGTERM)
            os.kill(os.getpid(), signal.SIGTERM)
        return prepare(*arguments)

    fleet = without_workers(own_fleet(PARQUET))
    with monkeypatch.context() as patched:
        patched.setattr(pipeline.store.publishing, "prepare", interrupted)
        ended, out, err = call("fit-fleet", fleet)
    # What was begun is published whole, and nothing after it is begun.
    assert ended == 143
    assert err.startswith("motor-leakage: interrupted: stopped by SIGTERM")
    assert any(line.startswith("interrupted; 3 nights of 1 motor ") for line in out.splitlines())
    assert not (fleet.parent.parent / "out" / "tables" / "trends").exists()
    assert call("fit-fleet", fleet)[0] == 0
    assert (fleet.parent.parent / "out" / "tables" / "trends").exists()
    fits = pl.read_parquet(fleet.parent.parent / "out" / "tables" / "nights" / "**" / "*.parquet")
    assert fits["status"].to_list() == ["ok"] * 3


def test_130_where_the_signal_comes_while_a_class_is_made(tmp_path: Path) -> None:
    """Python compiles methods of a dataclass with exec: `python -m` died of an interrupt there."""
    tmp_path.joinpath("interrupted.py").write_text(
        "import os, signal, typer\n"
        "from pipeline.cli.runs import stoppable\n"
        "def interrupted():\n"
        "    with stoppable():\n"
        "        exec('os.kill(os.getpid(), signal.SIGINT)\\nwhile True: pass')\n"
        "typer.run(interrupted)\n"
    )
    command = [sys.executable, "-m", "interrupted"]
    path = {**os.environ, "PYTHONPATH": f"{tmp_path}:{Path.cwd()}"}
    assert subprocess.run(command, env=path, check=False).returncode == 130


def test_a_terminal_has_a_bar_of_nights_and_a_reader_that_goes_away_does_not_end_the_run(
    own_fleet: OwnFleet,
) -> None:
    """The bar is on standard error; nobody reads what comes on standard output."""
    fleet = without_workers(own_fleet(PARQUET, nights=1))
    main, terminal = pty.openpty()
    code = "import sys; from pipeline.cli import main; main()"
    command = [sys.executable, "-c", code, "fit-fleet", str(fleet)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=terminal)
    process.stdout.close()
    os.close(terminal)
    drawn = b""
    with contextlib.suppress(OSError):  # as the other end is closed
        while read := os.read(main, 4096):
            drawn += read
    os.close(main)
    assert process.wait(timeout=60) == 0
    for words in ("nights", "1/1"):
        assert words in drawn.decode()
    assert "Error" not in drawn.decode()
    fits = pl.read_parquet(fleet.parent.parent / "out" / "tables" / "nights" / "**" / "*.parquet")
    assert fits["status"].to_list() == ["ok"]


# What cannot be done


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
    call: Call, untouched: Path, monkeypatch: pytest.MonkeyPatch, line: str, code: int, words: str
) -> None:
    monkeypatch.chdir(untouched.parents[1])
    before = sorted(Path.cwd().rglob("*"))
    command, *options = shlex.split(line)
    ended, out, err = call(command, untouched, *options)
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
