"""The intraday check on a growing log: a step is reported at once and once, a healthy day never."""

from __future__ import annotations

import json
from pathlib import Path

import polars as pl
import pytest

from tests.pipeline.faults.crash import FAULTS, Fault, victim_in
from tests.pipeline.notification.servers import delivered, hook, keep
from tests.pipeline.notification.test_mail import serving
from tests.scenarios.command import run_command
from tests.scenarios.covering import covers
from tests.scenarios.fleets import ScenarioFleet, Simulated, make_fleet

NIGHTS, TODAY = 9, 10
# Minutes of the log: the motor is warm after 20.
BREAK, END = 30, 40
CIRCUIT = tuple(Simulated(name, format="csv", circuit="press") for name in ("M1", "M2"))


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> ScenarioFleet:
    """Two motors of one circuit in their first night behind a baseline of eight nights."""
    folder = tmp_path_factory.mktemp("intraday") / "fleet"
    return make_fleet(folder, *CIRCUIT, nights=NIGHTS).fitted()


@pytest.fixture
def fleet(published: ScenarioFleet, tmp_path: Path) -> ScenarioFleet:
    return published.copy(tmp_path / "fleet")


def grow(fleet: ScenarioFleet, minute: float = END, rise: float = 0.3, night: int = TODAY) -> None:
    """Both logs of a night up to a minute; the first motor's flow rises at `BREAK`."""
    for motor, by in (("M1", rise), ("M2", 0.0)):
        fleet.write_night(motor, night, until=minute, rise=by, rise_at=BREAK)


def states(fleet: ScenarioFleet) -> list[tuple[str, str, str]]:
    rows = fleet.table("intraday")
    if not rows.height:
        return []
    return rows.sort("time").select("motor_id", "from_state", "to_state").rows()


@covers("look --json", "status")
def test_a_step_of_30_percent_is_reported_once_within_5_minutes_by_command_web_hook_and_mail(
    fleet: ScenarioFleet,
) -> None:
    reported, minute = [], BREAK - 4
    with hook() as receiver, serving() as mail:
        fleet.append(
            "fleet.toml",
            f'[alarms]\nwebhook_url = "{receiver.url()}"\n'
            f'[alarms.email]\nto = ["shift@plant.example"]\nsender = "leakage@plant.example"\n'
            f'server = "smtp://127.0.0.1:{mail.port}"\n',
        )
        while not reported and minute < END:
            minute += 1
            grow(fleet, minute)
            checks = fleet.run("look", "--json").events("look")
            reported = [row for check in checks for row in check["rows"]]
        again = fleet.run("look")
    assert BREAK < minute <= BREAK + 5
    (row,) = reported
    assert (row["motor_id"], row["to_state"]) == ("M1", "risen")
    assert 5.0 <= row["change_lower"] < 30.0
    assert "0 of 1 other motors of its oil circuit" in row["reason"]
    # The same minutes once more change nothing, and nobody is told twice.
    assert "2 motors checked: 1 clear, 1 risen" in again.out
    (delivered,) = [
        change for post in receiver.posts for change in json.loads(post.body)["changes"]
    ]
    assert delivered["reason"] == row["reason"]
    (message,) = mail.mails
    assert message["Subject"] == "Scenario: M1 risen"
    first = fleet.run("status").out.splitlines()[1]
    assert first.startswith("M1\t")
    assert row["reason"] in first


@covers("look")
def test_a_healthy_day_is_silent_and_a_stopped_log_is_not_judged(fleet: ScenarioFleet) -> None:
    for minute in (10, 19, 28, 37):
        grow(fleet, minute, rise=0.0)
        done = fleet.run("look")
        said = "2 clear" if minute > 25 else "2 not judged"
        assert f"2 motors checked: {said}" in done.out
    fleet.run("fit-fleet")
    assert "no new samples since the nightly run" in fleet.run("look").out
    assert states(fleet) == []


@covers("look --every --output")
def test_checked_again_and_again_a_step_is_reported_when_it_comes(
    fleet: ScenarioFleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    grow(fleet, BREAK)
    minutes = iter((BREAK + 5, END))

    def wait(_: float) -> None:
        """In place of waiting the log grows; behind its end, Ctrl-C."""
        minute = next(minutes, None)
        if minute is None:
            raise KeyboardInterrupt
        grow(fleet, minute)

    monkeypatch.setattr("pipeline.cli.checking.time.sleep", wait)
    done = fleet.run("look", "--every", "5min", "--output", fleet.output)
    assert done.code == 130
    states_said = [
        line.split("checked: ")[1] for line in done.out.splitlines() if "checked" in line
    ]
    assert states_said == ["2 clear", "1 clear, 1 risen", "1 clear, 1 risen"]
    assert done.out.count("M1: risen: drain flow +") == 1


@pytest.mark.parametrize(("stays", "verdict"), [(True, "confirmed"), (False, "withdrawn")])
@covers("look")
def test_the_nightly_run_confirms_or_withdraws_a_rise(
    fleet: ScenarioFleet, stays: bool, verdict: str
) -> None:
    grow(fleet, BREAK + 5)
    assert "1 risen" in fleet.run("look").out
    # The log is written on, or anew: the rise was air in the line.
    grow(fleet, rise=0.3 if stays else 0.0)
    assert fleet.run("fit-fleet").code == 0
    assert states(fleet) == [("M1", "clear", "risen"), ("M1", "risen", verdict)]
    row = fleet.table("intraday").sort("time").to_dicts()[-1]
    assert row["confirmed_by"] == fleet.label(TODAY)
    assert (row["change_lower"] < 30.0 < row["change_upper"]) is stays
    words = f"reported 1, confirmed {int(stays)}, withdrawn {int(not stays)}"
    assert words in fleet.run("status").err
    # The next day goes on as the night ended, and nobody is told again.
    for motor in ("M1", "M2"):
        by = 0.3 if stays and motor == "M1" else 0.0
        fleet.write_night(motor, TODAY + 1, rise=by)
    assert f"{1 + (not stays)} clear" in fleet.run("look").out
    assert len(states(fleet)) == 2


def test_an_overhaul_ends_a_rise_that_no_night_has_settled(fleet: ScenarioFleet) -> None:
    grow(fleet, BREAK + 5)
    assert fleet.run("look").code == 0
    for motor in fleet.motors:
        fleet.write_night(motor, TODAY + 1)
    begin = fleet.label(TODAY + 1)
    fleet.append("motors/M1.toml", f'[[events]]\ndate = {begin}\nkind = "overhaul"')
    assert fleet.run("fit-fleet").code == 0
    assert states(fleet) == [("M1", "clear", "risen"), ("M1", "risen", "clear")]


@covers("look --motors")
def test_columns_that_change_places_are_no_rise(fleet: ScenarioFleet) -> None:
    path = fleet.write_night("M1", TODAY)
    header, *rows = path.read_text("utf-8").splitlines(keepends=True)
    names = header.strip().split(",")
    one, other = names.index("pressure_difference"), names.index("speed")
    names[one], names[other] = names[other], names[one]
    path.write_text("".join([",".join(names) + "\n", *rows]), "utf-8")
    assert (
        "columns changed? pressure difference and speed" in fleet.run("look", "--motors", "M1").out
    )
    assert states(fleet) == []


def test_too_few_nights_and_changed_settings_are_said(tmp_path: Path) -> None:
    young = make_fleet(tmp_path / "young", nights=7, format="csv").fitted()
    young.write_night("M1", 8, until=BREAK)
    assert "7 of 8 nights of a baseline" in young.run("look").out
    young.append("fleet.toml", "[cleaning]\nwarm_up_minutes = 1.0")
    assert "settings, events or resets have changed" in young.run("look").out


@covers("look --motors")
def test_motors_whose_rollers_scale_is_estimated_are_judged(
    plant: ScenarioFleet,
) -> None:
    fits = plant.table("fits").filter(pl.col("is_primary")).sort("night")
    is_free = pl.col("coefficient_names").list.contains("scale_cam_roller")
    free = dict(fits.group_by("motor_id").agg(is_free.last()).rows())
    assert any(free.values())
    for motor in plant.motors:
        plant.write_night(motor, plant.plan.nights + 1, until=BREAK + 5, rise=0.3, rise_at=BREAK)
    done = plant.run("look", "--motors", "calm broken worn")
    assert "3 motors checked: 3 risen" in done.out, (free, done.out)


@pytest.mark.full
def test_a_growing_log_of_mcap_is_judged(tmp_path: Path) -> None:
    fleet = make_fleet(tmp_path, format="mcap", nights=NIGHTS).fitted()
    fleet.write_night("M1", TODAY, until=BREAK + 5, rise=0.3, rise_at=BREAK)
    assert "1 motor checked: 1 risen" in fleet.run("look").out


def check(folder: Path, _: Path) -> None:
    """A check in a process that ends within it."""
    run_command("look", folder / "configs" / "fleet.toml")


EVERY = [
    pytest.param(fault, every, marks=pytest.mark.full)
    for fault, every in [("full", 197), *((fault, 1) for fault in FAULTS)]
]


@pytest.mark.parametrize(("fault", "every"), [("killed", 197), *EVERY])
def test_a_check_that_is_broken_off_anywhere_is_made_up_for(
    fleet: ScenarioFleet, tmp_path: Path, fault: Fault, every: int
) -> None:
    """Reported by the next check on a sound disk, and delivered as the same message."""
    grow(fleet)

    def copied(name: str) -> ScenarioFleet:
        other = fleet.copy(tmp_path / name)
        other.append("fleet.toml", f"[alarms]\n{keep(other.folder / 'told')}")
        return other

    whole = copied("whole")
    with victim_in(tmp_path) as victim:
        n_writes = victim.crash_at(0, check, whole.folder, whole.output, fault).seen
        (message,) = delivered(whole.folder)
        for point in range(every, n_writes + 1, every):
            other = copied(str(point))
            victim.crash_at(point, check, other.folder, other.output, fault)
            other.run("look")
            assert other.table("intraday").equals(whole.table("intraday"))
            assert {one["id"] for one in delivered(other.folder)} == {message["id"]}
