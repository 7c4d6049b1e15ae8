"""Fleets that scenarios share, and the check that what a scenario declares it has done."""

from __future__ import annotations

import datetime as dt
import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from pipeline.config import load_fleet
from pipeline.demo import shipped_configs
from pipeline.demo.fleet import (
    DEMO_FLEET,
    PISTON,
    SLEEVE,
    DemoNight,
    Plan,
    record_night,
    truth_document,
)
from pipeline.demo.writing import write_log
from tests.conftest import made_once
from tests.pipeline.calling import without_workers
from tests.scenarios.command import CALLS, run_command
from tests.scenarios.covering import declared_by, items_of
from tests.scenarios.fleets import DAY, FIRST, ScenarioFleet, Simulated, make_fleet, ramp, step

# Of the demo's nights those are made and fitted that show a motor's wear from its begin on.
DEMO_NIGHTS = 54
FIRST_FITTED = dict.fromkeys((motor.motor_id for motor in DEMO_FLEET), 20)
FIRST_FITTED |= {"CB400-01": 32, "CB560-01": 34, "CB1120-01": 16}


@pytest.fixture(autouse=True)
def _declared(request: pytest.FixtureRequest) -> Iterator[None]:
    """What a scenario declares it has run, and read more of it than an exit code."""
    CALLS.clear()
    yield
    done = {item for call in CALLS if call.is_examined for item in items_of(call)}
    left = declared_by(request.function) - done
    assert not left, f"declared, but not run, or nothing of it read: {sorted(left)}"


@pytest.fixture(autouse=True)
def _no_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    """Receivers that refuse are tried again at once."""
    monkeypatch.setattr("pipeline.notification.outbox.PAUSES_S", (0.0, 0.0))


@pytest.fixture(scope="session")
def _demo(shared_folder: Path) -> ScenarioFleet:
    plan = Plan(DEMO_NIGHTS, 30.0, 1.0, 1, FIRST)

    def make(folder: Path) -> None:
        shutil.copytree(shipped_configs(), folder / "configs")
        for file in (folder / "configs" / "motors").iterdir():  # MCAP takes long to write
            file.write_text(file.read_text("utf-8").replace("mcap", "parquet"), "utf-8")
        specs = load_fleet(folder / "configs" / "fleet.toml").motor
        nights = [
            DemoNight(motor, specs(motor.motor_id), plan, number)
            for motor in DEMO_FLEET
            for number in range(FIRST_FITTED[motor.motor_id], DEMO_NIGHTS + 1)
        ]
        for night in nights:
            motor = night.spec.file
            logs = folder / "demo" / "logs" / motor.motor_id
            logs.mkdir(parents=True, exist_ok=True)
            log = logs / f"{motor.motor_id}_{night.label}.{motor.logs.format}"
            write_log(log, record_night(night), motor)
        truth = json.dumps(truth_document(plan, nights))
        (folder / "demo" / "truth.json").write_text(truth, "utf-8")
        config = without_workers(folder / "configs" / "fleet.toml")
        for command, *more in (("fit-fleet",), ("report", "--nights", 1)):
            done = run_command(command, config, *more, folder=folder)
            assert done.code == 0, done.err

    folder = made_once(shared_folder / "scenario-demo", make)
    return ScenarioFleet(folder, {}, plan, "demo/logs")


@pytest.fixture(scope="session")
def demo(_demo: ScenarioFleet) -> ScenarioFleet:
    """The demo after `fit-fleet` and `report`; only to be read."""
    return _demo


# A healthy motor, a sleeve that is damaged at once, balance pistons that wear; two motors on one
# oil circuit. None is in MCAP, which takes long to write.
PLANT = (
    Simulated("calm", format="csv", circuit="press"),
    Simulated("broken", step(SLEEVE, at=14, gap=0.15)),
    Simulated("worn", ramp(PISTON, begin=11, end=20, gap=0.25), circuit="press"),
)


CHANGE = 10  # night from which on the motors of `OTHERS` are changed
# Unstated oil of a tank, a stated change of it, a meter, one that is late, all gaps, an overhaul.
OTHERS = (
    *(Simulated(f"thinner_{n}", unstated_oil=(CHANGE, "vg46"), circuit="tank") for n in (1, 2)),
    Simulated(
        "refilled",
        lines=f'[[events]]\ndate = {FIRST + 9 * DAY}\nkind = "oil_change"\noil = "vg46"\n',
    ),
    Simulated("metered", misread={"leakage_flow": (CHANGE, 1.25, 0.0)}),
    Simulated("late", late_flow=(CHANGE, 60)),
    Simulated("aged", step(at=CHANGE, gap=0.06)),
    Simulated(
        "overhauled",
        step(SLEEVE, at=1, gap=0.15, repaired_on=6),
        lines=f'[[events]]\ndate = {FIRST + 5 * DAY}\nkind = "overhaul"\nnote = "new sleeves"\n',
    ),
)


def fitted_once(folder: Path, motors: tuple[Simulated, ...], nights: int) -> ScenarioFleet:
    """A fleet, fitted by whichever worker comes first."""
    made_once(folder, lambda place: make_fleet(place, *motors, nights=nights).fitted())
    by_name = {motor.motor_id: motor for motor in motors}
    return ScenarioFleet(folder, by_name, Plan(nights, 40.0, 1.0, 1, FIRST))


@pytest.fixture(scope="session")
def shared_plant(shared_folder: Path) -> ScenarioFleet:
    """The fitted plant, only to be read."""
    return fitted_once(shared_folder / "scenario-plant", PLANT, 20)


@pytest.fixture(scope="session")
def others(shared_folder: Path) -> ScenarioFleet:
    """Fitted motors whose change is no wear of a part; only to be read."""
    return fitted_once(shared_folder / "scenario-others", OTHERS, 14)


@pytest.fixture
def plant(shared_plant: ScenarioFleet, tmp_path: Path) -> ScenarioFleet:
    """A fitted fleet of three motors and twenty nights of one's own."""
    return shared_plant.copy(tmp_path / "plant")


@pytest.fixture
def turn_clock(monkeypatch: pytest.MonkeyPatch) -> Callable[[dt.timedelta], None]:
    """Turn this machine's clock forward by some time, as the command sees it."""

    def turn(by: dt.timedelta) -> None:
        class Turned(dt.datetime):
            @classmethod
            def now(cls, tz: dt.tzinfo | None = None) -> dt.datetime:  # type: ignore[override]
                return dt.datetime.now(tz) + by

        shown = SimpleNamespace(datetime=Turned, timedelta=dt.timedelta, UTC=dt.UTC)
        monkeypatch.setattr("pipeline.clock.dt", shown)

    return turn
