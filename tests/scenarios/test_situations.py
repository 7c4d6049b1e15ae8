"""What people get wrong, and what happens around the program: it says so, and nothing is lost."""

from __future__ import annotations

import datetime as dt
import sys
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from pipeline.cli import main
from pipeline.cli.arguments import say
from tests.scenarios.fleets import ScenarioFleet, Simulated, make_fleet

OIL = 'oil = "vg68"'
LEAKAGE = 'source = "leakage_flow"\n'
MOTORS = {motor: Simulated(motor, format="csv") for motor in ("A", "B")}


@pytest.fixture(scope="module")
def _unfitted(tmp_path_factory: pytest.TempPathFactory) -> ScenarioFleet:
    """Two motors, two nights."""
    folder = tmp_path_factory.mktemp("situations")
    return make_fleet(folder, *MOTORS.values(), nights=2, minutes=20.0, rate_hz=0.5)


@pytest.fixture
def fleet(_unfitted: ScenarioFleet, tmp_path: Path) -> ScenarioFleet:
    """The same, to change at will."""
    return _unfitted.copy(tmp_path / "fleet")


def leave_hidden_files(fleet: ScenarioFleet) -> None:
    """Leave what macOS, rsync, a file server and Excel leave beside files."""
    for place in ("configs/motors/._A.toml", "logs/A/._A_2026-01-02.csv", "logs/A/~$A.csv"):
        (fleet.folder / place).write_bytes(b"\x00\x05\x16\x07")
    snapshot = fleet.folder / "logs" / "A" / ".snapshot"
    snapshot.mkdir()
    (snapshot / "A_2026-01-02.csv").write_text(fleet.log("A", 1).read_text("utf-8"), "utf-8")
    fleet.change("motors/A.toml", "A/*.csv", "A/**/*.csv")


def rename_folder(fleet: ScenarioFleet) -> None:
    """Give a folder of logs a name with brackets."""
    (fleet.folder / "logs" / "A").rename(fleet.folder / "logs" / "A[1]")
    fleet.change("motors/A.toml", "A/*.csv", "A[1]/*.csv")


def add_motor(fleet: ScenarioFleet) -> None:
    """Add a motor whose id differs by case alone."""
    text = (fleet.config.parent / "motors" / "A.toml").read_text("utf-8")
    other = text.replace('"A"', '"a"').replace("A/", "a/")
    (fleet.config.parent / "motors" / "a.toml").write_text(other, "utf-8")


def name_what_is_not_there(fleet: ScenarioFleet) -> None:
    """Date an overhaul and a training period by a wrong year, and name an absent program."""
    fleet.append("fleet.toml", '[alarms]\ncommand = ["/nowhere/mail"]')
    event = f'[[events]]\ndate = {dt.date.today().year + 1}-12-31\nkind = "overhaul"\n'
    fleet.append("motors/A.toml", event)
    period = "[2025-01-02T20:00:00Z, 2025-01-02T22:00:00Z]"
    fleet.append("motors/B.toml", f"[periods]\ntraining = [{period}]\n")


def cut_flows(fleet: ScenarioFleet) -> None:
    """State a range that the drain flow exceeds, and have a meter that ends within it."""
    fleet.change("motors/A.toml", LEAKAGE, f"{LEAKAGE}valid_range = [0.0, 1.0]\n")
    log = pl.read_csv(fleet.log("B", 2), infer_schema_length=None)
    flow = pl.col("leakage_flow").cast(pl.Float64, strict=False).clip(upper_bound=0.9)
    log.with_columns(flow).write_csv(fleet.log("B", 2))


def turn_log(fleet: ScenarioFleet) -> None:
    """Write a log's rows newest first."""
    pl.read_csv(fleet.log("A", 2), infer_schema_length=None).reverse().write_csv(fleet.log("A", 2))


def deliver_anothers_log(fleet: ScenarioFleet) -> None:
    """Put a motor's log into another's place."""
    fleet.log("B", 2).write_bytes(fleet.log("A", 2).read_bytes())


def name_circuits_by_case(fleet: ScenarioFleet) -> None:
    """Write the name of a circuit in two ways."""
    for motor, circuit in (("A", "press"), ("B", "Press")):
        fleet.change(f"motors/{motor}.toml", OIL, f'{OIL}\noil_circuit = "{circuit}"')


def misplace_key(fleet: ScenarioFleet) -> None:
    """Put a key of a motor type into a motor's file."""
    fleet.append("motors/A.toml", "[limits]\nalarm_l_per_min = 2.0")


def state_share(fleet: ScenarioFleet) -> None:
    """State a share where a percentage is asked for."""
    fleet.append("fleet.toml", "[alarms]\nalarm_percent = 0.3")


# By what is done: the command, its exit code and words of it.
ABSENT = ("and it chooses nothing", "alarms_command")
MAXIMUM = "read 0.9 l/min, its highest reading"
SITUATIONS: dict[Callable[[ScenarioFleet], None], tuple[Any, ...]] = {
    leave_hidden_files: ("check", 0, "A: CB400, csv, 2 files, 2 nights"),
    rename_folder: ("check", 1, "a name with a bracket is written [[]1]"),
    add_motor: ("check", 2, "motors/a.toml: motor_id"),
    name_what_is_not_there: ("check", 1, "changes nothing till then", *ABSENT),
    turn_log: ("check", 1, "fewer than two samples in this night (", "newest first"),
    cut_flows: ("check", 1, "of leakage_flow at work lie beyond 1 l/min", MAXIMUM),
    name_circuits_by_case: ("check", 2, "motors/B.toml: oil_circuit"),
    misplace_key: ("check", 2, "limits: is no key of this table; move it"),
    state_share: ("check", 2, "alarms.alarm_percent"),
    deliver_anothers_log: (
        "fit-fleet --since 2026-01-03 --redo 2026-01-20",
        0,
        "A and B: 1 night, 2026-01-03 to 2026-01-03, were made from the same logs",
        "no log covers a night of --redo",
    ),
}


@pytest.mark.parametrize("change", SITUATIONS, ids=lambda change: change.__name__)
def test_what_people_do_is_taken_or_named(
    fleet: ScenarioFleet, change: Callable[[ScenarioFleet], None]
) -> None:
    command, code, *words = SITUATIONS[change]
    change(fleet)
    done = fleet.run(command)
    assert [text for text in words if text not in done.out + done.err] == []
    assert done.code == code


def test_tables_are_not_exported_to_where_logs_are_looked_for(fleet: ScenarioFleet) -> None:
    for folder in ("logs", "logs/A"):
        done = fleet.run("export", "--csv", fleet.folder / folder)
        assert (done.code, done.out) == (2, "")
        assert "csv_folder" in done.err


def test_an_output_without_a_night_is_named(fleet: ScenarioFleet) -> None:
    """Mostly a folder that is misspelt."""
    assert f"published anything in {fleet.output}" in fleet.run("status").err
    done = fleet.run("baseline reset", "A", "2026-01-02", "--note", "worn")
    assert (done.code, done.out) == (2, "")
    assert not fleet.output.exists()


def test_words_that_cannot_be_written_end_nothing(
    fleet: ScenarioFleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    with (
        Path("/dev/full").open("w") as full,
        redirect_stdout(full),
        redirect_stderr(StringIO()) as err,
    ):
        say("first line")
        say("second line")
    assert err.getvalue() == "standard output cannot be written: No space left on device\n"
    monkeypatch.setattr(sys, "argv", ["motor-leakage", "status", str(fleet.config)])
    monkeypatch.setattr(sys, "stdout", None)
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 0
