"""Mending may be killed anywhere; the commands tell of it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from pipeline.schema import FITS, PREDICTIONS, TRENDS
from pipeline.store.manifest import manifest_file
from pipeline.store.tables import night_file
from pipeline.trends.nights.decisions import Decision, read_decisions
from tests.pipeline.calling import Call
from tests.pipeline.faults.damage import (
    EVERY_RUN,
    cut_off,
    mended,
    name_of,
    remove_aside,
    rot,
    rot_of_footer,
)
from tests.pipeline.faults.disk import Disk, Killed, on
from tests.pipeline.faults.fleet import LATER, TinyFleet, check_repaired, check_tables
from tests.pipeline.simulated import NIGHT

pytestmark = pytest.mark.usefixtures("_quick")


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize(
    "step", [pytest.param(290, id="some"), pytest.param(7, marks=pytest.mark.full, id="many")]
)
def test_a_run_that_mends_may_be_killed_anywhere(
    tiny_fleet: TinyFleet, tmp_path: Path, step: int
) -> None:
    point, disk = 20, Disk("killed", 0)
    while point == 20 or disk.struck:
        output = tmp_path / "out"
        shutil.rmtree(output, ignore_errors=True)
        shutil.copytree(tiny_fleet.after, output)
        night_file(output, PREDICTIONS, NIGHT).unlink()
        rot_of_footer(night_file(output, FITS, LATER))
        rot(night_file(output, TRENDS, NIGHT))
        manifest_file(output, "whole").unlink()
        disk = Disk("killed", point)
        with on(disk), suppress(Killed):
            tiny_fleet.run(output, **EVERY_RUN)
        assert tiny_fleet.run(output, **EVERY_RUN).damage_left == ()
        assert remove_aside(output) == 2
        check_repaired(output, tiny_fleet)
        point += step


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize(
    "step", [pytest.param(110, id="some"), pytest.param(11, marks=pytest.mark.full, id="many")]
)
def test_the_command_may_be_killed_anywhere(
    tiny_fleet: TinyFleet, tmp_path: Path, output: Path, said: tuple[Decision, ...], step: int
) -> None:
    point, disk = 0, Disk("killed", 0)
    copy = tmp_path / "copy"
    while point == 0 or disk.struck:
        point += step
        shutil.rmtree(copy, ignore_errors=True)
        shutil.copytree(output, copy)
        night_file(copy, PREDICTIONS, NIGHT).unlink()
        rot(night_file(copy, FITS, LATER))
        disk = Disk("killed", point)
        with on(disk), suppress(Killed):
            mended(copy)
        for _ in range(2):
            after = mended(copy)[1]
        assert after == ()
        assert read_decisions(copy) == said
        tiny_fleet.run(copy)
        check_tables_but_decisions(copy, tiny_fleet)


def check_tables_but_decisions(output: Path, fleet: TinyFleet) -> None:
    """Check the tables other than those which also hold what people said."""
    for name in ("decisions/decisions.parquet", "latest/latest.parquet"):
        shutil.copy(fleet.after / "tables" / name, output / "tables" / name)
    check_tables(output, fleet)


def test_the_commands_tell_and_mend(
    tiny_fleet: TinyFleet, output: Path, without_logs: Callable[..., TinyFleet], call: Call
) -> None:
    config = without_logs().fleet
    path = night_file(output, PREDICTIONS, NIGHT)
    name = name_of(path, output)
    cut_off(path)
    code, out, err = call("status", config, "--output", output)
    assert code == 0
    assert f"damaged or missing: 1 published file, such as {name}: table_altered" in err
    code, out, err = call("fit-fleet", config, "--output", output, "--dry-run")
    assert code == 0
    assert f"table_altered: {name}: " in err
    code, out, err = call("fit-fleet", config, "--output", output)
    assert code == 1
    assert f"motor-leakage: table_missing: {name}: not made anew: the logs of that night are" in err
    assert "damaged or missing: 1 file, of which not repaired: 1" in out
    code, out, err = call("fit-fleet", config, "--output", output, "--json")
    run = json.loads(out.splitlines()[-1])
    assert [one["code"] for one in run["damage_left"]] == ["table_missing"]
    code, out, err = call("check", "--tables", config, "--output", output)
    assert code == 1
    assert out.endswith(" table files, 2 faults\n")
    code, out, err = call("check", "--tables", "--mend", config, "--output", output)
    assert (code, out.endswith(" table files, 2 faults, 0 left\n")) == (0, True)
    code, out, err = call("check", "--tables", config, "--output", output)
    assert (code, err) == (0, "")
    code, out, err = call("fit-fleet", config, "--output", output)
    assert code == 0
