"""What a user may not read or write: one plain line, its exit code, and nothing else is lost."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import chdir, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from tests.scenarios.command import Result
from tests.scenarios.covering import covers
from tests.scenarios.fleets import ScenarioFleet, Simulated, make_fleet

NOBODY = 65534


@contextmanager
def other_user() -> Iterator[None]:
    """Be somebody for whom things are forbidden: root, for whom nothing is, becomes nobody."""
    is_root = not os.geteuid()
    if is_root:
        os.setegid(NOBODY)
        os.seteuid(NOBODY)
    yield
    if is_root:
        os.seteuid(0)
        os.setegid(0)


@pytest.fixture(scope="module")
def _fitted(tmp_path_factory: pytest.TempPathFactory) -> ScenarioFleet:
    """Two motors; the second night of both came after the run."""
    folder, motors = tmp_path_factory.mktemp("rights"), (Simulated("A"), Simulated("B"))
    fleet = make_fleet(folder, *motors, nights=2, minutes=30.0)
    late = {motor: fleet.log(motor, 2).read_bytes() for motor in fleet.motors}
    for motor in late:
        fleet.log(motor, 2).unlink()
    fleet.fitted()
    assert fleet.run("report").code == 0
    for motor, content in late.items():
        fleet.log(motor, 2).write_bytes(content)
    return fleet


@pytest.fixture
def fleet(_fitted: ScenarioFleet) -> Iterator[ScenarioFleet]:
    """The same, of a user for whom things may be forbidden, where that user can go."""
    with TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)
        own = _fitted.copy(Path(folder) / "fleet")
        if not os.geteuid():
            for path in (own.folder, *own.folder.rglob("*")):
                os.chown(path, NOBODY, NOBODY)
        yield own


def run(fleet: ScenarioFleet, command: str, *arguments: object) -> Result:
    with chdir(fleet.folder), other_user():
        return fleet.run(command, *arguments)


@pytest.mark.parametrize("place", ["logs/A/A_2026-01-03.parquet", "logs/A"])
def test_a_log_that_may_not_be_read_costs_its_motor_alone(fleet: ScenarioFleet, place: str) -> None:
    before = fleet.nights("A")[0]
    path = fleet.folder / place
    mode = path.stat().st_mode
    path.chmod(0)
    for command in ("check", "fit-fleet"):
        done = run(fleet, command)
        assert done.code == 1
        (line,) = [line for line in done.err.splitlines() if "as published" not in line]
        assert line.startswith("A: log_not_readable: ")
        assert "Permission denied" in line
    assert [row["status"] for row in fleet.nights("B")] == ["ok", "ok"]
    path.chmod(mode)
    assert run(fleet, "fit-fleet").code == 0
    rows = fleet.nights("A")
    assert [row["status"] for row in rows] == ["ok", "ok"]
    columns = ("rmse_l_per_min", "last_sample", "log_note")
    assert [rows[0][name] for name in columns] == [before[name] for name in columns]


@covers("fit-fleet", "report", "look", "status", "explain")
def test_an_output_that_may_not_be_written_is_still_read(fleet: ScenarioFleet) -> None:
    for path in (fleet.output, *fleet.output.rglob("*")):
        path.chmod(path.stat().st_mode & 0o555)
    for command in ("fit-fleet", "report", "look"):
        done = run(fleet, command)
        assert (done.code, done.out) == (4, "")
        (line,) = done.err.splitlines()
        assert line.startswith("motor-leakage: store_write: ")
        assert "cannot be written: Permission denied" in line
    assert "1 of 8 nights of a baseline" in run(fleet, "status", "--long").out
    assert "log A/A_2026-01-02.parquet: ok" in run(fleet, "explain", "A", fleet.label(1)).out


def test_a_folder_of_config_that_may_not_be_read_is_named(fleet: ScenarioFleet) -> None:
    (fleet.config.parent / "motors").chmod(0)
    done = run(fleet, "check")
    assert (done.code, done.out) == (2, "")
    assert "motors: cannot be read: Permission denied" in done.err


def test_an_output_that_cannot_be_made_is_named(fleet: ScenarioFleet) -> None:
    fleet.output.rename(fleet.folder / "elsewhere")
    fleet.folder.chmod(0o555)
    done = run(fleet, "fit-fleet")
    words = f"{fleet.output} cannot be written: Permission denied; choose another output"
    assert (done.code, done.err) == (4, f"motor-leakage: store_write: {words}\n")


@pytest.mark.parametrize(
    ("command", "error"),
    [("fit-fleet", "store_write"), ("status", "store_read"), ("report", "store_read")],
)
def test_an_output_that_may_not_be_read_is_named(
    fleet: ScenarioFleet, command: str, error: str
) -> None:
    fleet.output.chmod(0)
    done = run(fleet, command)
    assert (done.code, done.out) == (4, "")
    (line,) = done.err.splitlines()
    assert line.startswith(f"motor-leakage: {error}: {fleet.output}")
    assert "Permission denied" in line
