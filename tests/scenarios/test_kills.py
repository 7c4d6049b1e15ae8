"""A run that is killed at any moment of publishing or of the trends: all is as if it had not been.

By SIGKILL, some time after the heartbeat says that the stage began; the next run makes up for it.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass

import numpy as np
import polars as pl
import pytest
from polars.testing import assert_frame_equal

from pipeline.demo.fleet import SLEEVE
from pipeline.schema import TABLES
from tests.scenarios.command import ROOT
from tests.scenarios.fleets import ScenarioFleet, Simulated, make_fleet, step
from tests.scenarios.test_fit_fleet import stage_of

STAGES = ("publishing", "trends")
OF_RUNS = ("runs", "run_motors")
N_KILLS = 40
N, HELD_BACK = 13, (5, *range(10, 14))


@dataclass(frozen=True)
class Arriving:
    """A fleet to which nights come, what a run publishes of them, and how long its stages take."""

    fleet: ScenarioFleet
    tables: dict[str, pl.DataFrame]
    deliveries: list[str]
    seconds: dict[str, float]

    def restore(self) -> None:
        """Make all as it was before the run."""
        shutil.rmtree(self.fleet.output, ignore_errors=True)
        shutil.copytree(self.fleet.folder / "before", self.fleet.output)
        (self.fleet.folder / "told").unlink(missing_ok=True)

    def is_killed(self, stage: str, delay_s: float) -> bool:
        """Kill a run some time after it begins a stage; False where it was in none or another."""
        with started(self.fleet) as process:
            wait(self.fleet, process, stage)
            time.sleep(delay_s)
            process.kill()
        return process.returncode == -9 and stage_of(self.fleet) == stage


def started(fleet: ScenarioFleet) -> subprocess.Popen[bytes]:
    words = [sys.executable, "-m", "pipeline.cli", "fit-fleet", str(fleet.config)]
    return subprocess.Popen(words, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def wait(fleet: ScenarioFleet, process: subprocess.Popen[bytes], stage: str) -> float:
    """Wait until a run begins a stage, or has ended; the time of that."""
    while stage_of(fleet) != stage and process.poll() is None:
        time.sleep(0.0005)
    return time.perf_counter()


def published(fleet: ScenarioFleet) -> dict[str, pl.DataFrame]:
    """Rows of every table but those of runs."""
    tables = {}
    for table in TABLES:
        if table.name not in OF_RUNS:
            rows = fleet.table(table.name).drop("run_id", strict=False)
            tables[table.name] = rows.sort([name for name in table.key if name in rows.columns])
    return tables


def deliveries(fleet: ScenarioFleet) -> list[str]:
    """Deliveries that the receiver took, each once."""
    lines = (fleet.folder / "told").read_text("utf-8").splitlines()
    return sorted({json.loads(line)["id"] for line in lines})


@pytest.fixture(scope="module")
def arriving(tmp_path_factory: pytest.TempPathFactory) -> Arriving:
    """Nights come at once, one of them late; in the last ones a motor's sleeve is damaged."""
    folder = tmp_path_factory.mktemp("arriving")
    motors = Simulated("calm"), Simulated("broken", step(SLEEVE, at=10, gap=0.15))
    command = json.dumps(["/bin/sh", "-c", 'cat >> "$0"; echo >> "$0"', str(folder / "told")])
    settings = f"[alarms]\ncommand = {command}\n"
    fleet = make_fleet(folder, *motors, nights=N, minutes=30.0, settings=settings)
    logs = [fleet.log(motor, number) for motor in fleet.motors for number in HELD_BACK]
    contents = {path: path.read_bytes() for path in logs}
    for path in logs:
        path.unlink()
    fleet.fitted()
    (fleet.output / "heartbeat.json").unlink()
    fleet.output.rename(folder / "before")
    for path, content in contents.items():
        path.write_bytes(content)
    made = Arriving(fleet, {}, [], {})
    made.restore()
    with started(fleet) as process:
        begin = {stage: wait(fleet, process, stage) for stage in (*STAGES, "recording")}
    assert process.returncode == 0
    ends = (begin["trends"], begin["recording"])
    seconds = {name: end - begin[name] for name, end in zip(STAGES, ends, strict=True)}
    tables = published(fleet)
    assert "broken" in tables["alarms"].filter(pl.col("to_state") == "warning")["motor_id"]
    return Arriving(fleet, tables, deliveries(fleet), seconds)


# That a run dies at a call that writes is tried in the quick run, by `faults/test_crashes.py`.
@pytest.mark.full
@pytest.mark.parametrize("stage", STAGES)
def test_a_run_killed_at_a_random_moment_of_a_stage_is_made_up_for(
    arriving: Arriving, stage: str
) -> None:
    fleet, rng = arriving.fleet, np.random.default_rng([N_KILLS, STAGES.index(stage)])
    n_killed, moments = 0, iter(rng.uniform(0.0, arriving.seconds[stage], 10 * N_KILLS))
    while n_killed < N_KILLS:
        arriving.restore()
        if not arriving.is_killed(stage, next(moments)):
            continue
        n_killed += 1
        assert fleet.run("check", "--tables").code == 0
        assert fleet.run("fit-fleet").code == 0
        for name, rows in published(fleet).items():
            assert_frame_equal(rows, arriving.tables[name])
        assert deliveries(fleet) == arriving.deliveries
        assert fleet.run("check", "--tables").code == 0
