"""Runs by the command: exit codes, what goes to which stream, lines for programs."""

from __future__ import annotations

import contextlib
import json
import os
import pty
import re
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
from pipeline.store.atomic_files import Prepared, prepare
from tests.conftest import OwnFleet
from tests.pipeline.calling import CSV, PARQUET, Call, break_log, without_workers


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_130_and_143_while_publishing(
    call: Call,
    own_fleet: OwnFleet,
    monkeypatch: pytest.MonkeyPatch,
    number: signal.Signals,
    code: int,
) -> None:
    came: list[int] = []

    def interrupted(*arguments: Any) -> Prepared:
        if not came:
            came.append(number)
            os.kill(os.getpid(), number)
        return prepare(*arguments)

    fleet = without_workers(own_fleet(PARQUET))
    with monkeypatch.context() as patched:
        patched.setattr(pipeline.store.publishing, "prepare", interrupted)
        ended, out, err = call("fit-fleet", fleet)
    # What was begun is published whole, and nothing after it is begun.
    assert ended == code
    assert err.startswith(f"motor-leakage: interrupted: stopped by {number.name}")
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


def test_json_lines_of_a_run(call: Call, own_fleet: OwnFleet) -> None:
    fleet = without_workers(own_fleet(CSV, PARQUET))
    break_log(fleet, PARQUET)
    code, out, _ = call("fit-fleet", fleet, "--json")
    assert code == 1
    *motors, run = map(json.loads, out.splitlines())
    assert [motor["event"] for motor in motors] == ["motor", "motor"]
    line = {"event": "motor", "motor_id": CSV, "status": "ok", "error_code": None, "message": None}
    files = {"read": 3, "unchanged": 0, "growing": 0, "failed": 0, "left": 0}
    line |= {
        "nights": {"ok": 3},
        "files": files,
        "growing": [],
        "left_out": [],
        "stays": {},
        "findings": [],
    }
    assert motors[0] == line
    assert (motors[1]["status"], motors[1]["error_code"]) == ("failed", "log_not_parquet")
    assert motors[1]["nights"] == {"ok": 2, "failed": 1}
    assert run["event"] == "run"
    assert (run["n_motors"], run["n_failed"], run["n_nights"]) == (2, 1, 6)
    assert run["files"] == {"read": 5, "unchanged": 0, "growing": 0, "failed": 1, "left": 0}
    assert re.fullmatch(r"[0-9a-f]{16}", run["run_id"])
    assert (run["errors"], run["alarms"]) == ({"log_not_parquet": 1}, [])
    stages = run["seconds_by_stage"]
    assert all(stages[name] > 0 for name in ("read_s", "clean_s", "fit_s", "residuals_s"))
    whole = sum(stages[name] for name in ("motors_s", "publish_s", "trends_s"))
    assert whole == pytest.approx(run["seconds"], abs=0.01)
    assert run["interrupted"] is False
