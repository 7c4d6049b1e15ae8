"""The examples: real tools take them, and they call commands that there are.

The long ones run in environments of their own, each made once, below the folder of the variable
MOTOR_LEAKAGE_TEST_ENVIRONMENTS or of the session.
"""

from __future__ import annotations

import datetime as dt
import json
import os
import re
import runpy
import shutil
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import polars as pl
import pytest
import typer.main

from pipeline.cli import app
from pipeline.notification.outbox import Backlog
from pipeline.run.notification import metrics_text
from pipeline.schema import LATEST
from pipeline.trends.motor_states import MotorState
from tests.pipeline.simulated import NIGHT, motor_toml
from tests.pipeline.workshop import DAY, Workshop, check_same_figures
from tests.scenarios.command import run_command

EXAMPLES = Path(__file__).parent.parent / "examples"
UNITS = sorted((EXAMPLES / "systemd").iterdir())
SERVICES = [path for path in UNITS if path.suffix == ".service"]


def test_each_timer_has_its_service() -> None:
    timers = {path.stem for path in UNITS if path.suffix == ".timer"}
    assert timers == {path.stem for path in SERVICES} != set()


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd-analyze here")
def test_systemd_takes_the_units(tmp_path: Path) -> None:
    command = shutil.which("true")
    copies = []
    for unit in UNITS:
        text = re.sub(r"/opt/\S+/motor-leakage ", f"{command} ", unit.read_text("utf-8"))
        copies.append(tmp_path / unit.name)
        copies[-1].write_text(text, "utf-8")
    verify = ["systemd-analyze", "verify", "--man=no", *copies]
    done = subprocess.run(verify, capture_output=True, text=True, timeout=60)
    assert [line for line in done.stderr.splitlines() if "motor-leakage" in line] == []


OTHERS = [EXAMPLES / name for name in ("cron/motor-leakage", "kubernetes/cronjob.yaml")]


@pytest.mark.parametrize("path", [*SERVICES, *OTHERS], ids=lambda path: path.stem)
def test_schedulers_call_commands_and_options_that_there_are(path: Path) -> None:
    known = typer.main.get_command(app).commands
    text = path.read_text("utf-8")
    calls = re.findall(r"motor-leakage ([a-z]\S*)([^;&|>\n]*)", text)
    assert calls
    for command, rest in calls:
        options = {option for param in known[command].params for option in param.opts}
        assert set(re.findall(r"(?<=\s)--[a-z-]+", rest)) <= options
        assert path in OTHERS or "${FLEET}" in rest


def metrics() -> str:
    """All metrics, of a fleet of one motor of which every figure is known."""
    when = dt.datetime(2026, 3, 2, 6, tzinfo=dt.UTC)
    figures = {name: 1.0 for name, kind in LATEST.schema.items() if kind == pl.Float64}
    row = dict.fromkeys(LATEST.schema) | figures | {"motor_id": "M1", "state": "alarm"}
    outcome: Any = SimpleNamespace(motor_id="M1", n_standing=2)
    backlog = Backlog("hook", when, 3, when, None)
    states = [MotorState(row | {"last_sample": when})]
    fleet: Any = SimpleNamespace(name="mill")
    return metrics_text(fleet, states, [outcome], {"trends_s": 0.25}, [backlog], when)


def test_the_dashboard_asks_for_metrics_that_there_are() -> None:
    dashboard = json.loads((EXAMPLES / "grafana" / "dashboard.json").read_text("utf-8"))
    queries = [target["expr"] for panel in dashboard["panels"] for target in panel["targets"]]
    named = {name for query in queries for name in re.findall(r"motor_leakage_\w+", query)}
    assert named == set(re.findall(r"^# TYPE (\w+)", metrics(), re.MULTILINE))
    # The curve of a motor: a figure, and a band between the ends of its interval.
    curve = dashboard["panels"][0]
    assert curve["title"] == "Leakage of $motor against its baseline"
    ends = [f"leakage_change_{end}" for end in ("percent", "lower", "upper")]
    assert [target["expr"] for target in curve["targets"]] == [
        f'motor_leakage_{name}{{motor="$motor"}}'
        for name in (*ends, "alarm_level_percent", "detection_limit_percent")
    ]
    bands = {
        band["matcher"]["options"]: band["properties"] for band in curve["fieldConfig"]["overrides"]
    }
    assert {"id": "custom.fillBelowTo", "value": "lower"} in bands["upper"]
    assert {target["legendFormat"] for target in curve["targets"]} > bands.keys()


def test_nights_of_a_database_are_fitted_as_logs_are(tmp_path: Path) -> None:
    """As the page on logs says: the script on an SQLite file, then `check` and the run."""
    logged, queried = (Workshop.at(tmp_path / name) for name in ("logged", "queried"))
    for workshop in (logged, queried):
        workshop.take(motor_toml("M1"))
    with closing(sqlite3.connect(tmp_path / "plant.db")) as database, database:
        for seed, night in enumerate((NIGHT - DAY, NIGHT, NIGHT + DAY)):
            rows = pl.read_parquet(logged.log(night, seed=seed))
            time = rows["time"].cast(pl.Datetime("us")).dt.to_string("%F %T%.6f+00:00")
            rows = rows.with_columns(time, motor=pl.lit("M1"))
            if not seed:
                names = ", ".join(rows.columns)
                database.execute(f"CREATE TABLE log ({names})")
            database.executemany(
                f"INSERT INTO log VALUES ({', '.join('?' * rows.width)})", rows.rows()
            )
    script = EXAMPLES / "database" / "nights_to_parquet.py"

    def write(*days: str) -> set[str]:
        words = [script.name, str(tmp_path / "plant.db"), str(queried.logs.parent), *days]
        with patch.object(sys, "argv", words):
            runpy.run_path(str(script), run_name="__main__")
        return {path.name for path in queried.logs.iterdir()}

    assert write() == set()  # the newest nights have no rows
    asked = write("--since", str(NIGHT - DAY), "--until", str(NIGHT))
    assert asked == {f"{NIGHT - DAY}.parquet", f"{NIGHT}.parquet"}
    (seen,) = run_command("check", queried.fleet, "--json").lines
    assert (seen["n_nights"], seen["faults"]) == (2, [])
    assert run_command("fit-fleet", queried.fleet).code == 0
    (logged.logs / f"{NIGHT + DAY}.parquet").unlink()
    logged.run()
    check_same_figures(queried, logged, "log_files")
    # The same rows again are no news.
    write("--since", str(NIGHT - DAY), "--until", str(NIGHT))
    assert queried.run().nights == ()


@pytest.fixture(scope="session")
def environments(tmp_path_factory: pytest.TempPathFactory) -> Path:
    named = os.environ.get("MOTOR_LEAKAGE_TEST_ENVIRONMENTS")
    return Path(named) if named else tmp_path_factory.mktemp("environments")


def run_in(environments: Path, package: str, command: list[str], folder: Path) -> str:
    """What a command of an environment with a package says; it ends well."""
    place = environments / package
    if not (place / "ready").exists():
        subprocess.run([sys.executable, "-m", "venv", place], check=True)
        subprocess.run([place / "bin" / "pip", "install", "--quiet", package], check=True)
        (place / "ready").touch()
    command = [str(place / "bin" / command[0]), *command[1:]]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.full
def test_kubernetes_takes_the_job(environments: Path, tmp_path: Path) -> None:
    job = str(EXAMPLES / "kubernetes" / "cronjob.yaml")
    command = ["kubernetes-validate", "--strict", job]
    assert "failed" not in run_in(environments, "kubernetes-validate", command, tmp_path)


@pytest.mark.full
def test_grafana_s_own_package_makes_and_reads_the_dashboard(
    environments: Path, tmp_path: Path
) -> None:
    shutil.copy(EXAMPLES / "grafana" / "dashboard.py", tmp_path)
    code = """
import json, dashboard
from grafana_foundation_sdk.cog.plugins import register_default_plugins
from grafana_foundation_sdk.models.dashboard import Dashboard
register_default_plugins()
dashboard.main()
made = json.load(open("dashboard.json"))
read = [(one.title, one.targets[0].expr) for one in Dashboard.from_json(made).panels]
assert read == [(one["title"], one["targets"][0]["expr"]) for one in made["panels"]]
"""
    run_in(environments, "grafana-foundation-sdk", ["python", "-c", code], tmp_path)
    made = (tmp_path / "dashboard.json").read_bytes()
    assert made == (EXAMPLES / "grafana" / "dashboard.json").read_bytes()
