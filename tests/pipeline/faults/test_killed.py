"""SIGKILL at each point at which something is written: the next run leaves what no kill disturbed.

Points are the calls of our one door to the disk, and the begin and end of each transaction.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np
import pytest

from pipeline.schema import FITS, PREDICTIONS, TRENDS
from pipeline.store.tables import night_file
from pipeline.trends.nights.decisions import read_decisions
from tests.pipeline.faults.conftest import say
from tests.pipeline.faults.damage import remove_aside, repaired, rot, rot_of_footer
from tests.pipeline.faults.fleet import (
    ENVIRONMENT,
    LATER,
    TinyFleet,
    check_old_or_new,
    check_repaired,
    check_tables,
    remembered_fits,
    tables_in,
)
from tests.pipeline.simulated import NIGHT
from tests.pipeline.telling.fleet import keep, told, told_fleet

SLICES = 4
# Tried in every run of the tests, of each work.
SOME = 3


class Victim:
    """A process that works and dies as it is told."""

    def __init__(self, stdin: IO[str], stdout: IO[str]) -> None:
        self._stdin, self._stdout = stdin, stdout

    def ask(self, **request: object) -> int:
        self._stdin.write(json.dumps({name: str(one) for name, one in request.items()}) + "\n")
        self._stdin.flush()
        return int(self._stdout.readline())


@pytest.fixture(scope="module")
def victim() -> Iterator[Victim]:
    command = [sys.executable, "-m", "tests.pipeline.faults.victim"]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=ENVIRONMENT
    ) as process:
        yield Victim(process.stdin, process.stdout)
        process.stdin.close()
        assert process.wait(60) == 0


@dataclass(frozen=True)
class Case:
    """A work on an output as it was before, and what holds when it was killed, and after a run."""

    work: str
    fleet: TinyFleet
    before: Path
    killed: Callable[[Path], None]
    repaired: Callable[[Path], None]


def nightly(fleet: TinyFleet, _: Path) -> Case:
    """A night is corrected, the next one comes."""
    return Case(
        "run",
        fleet,
        fleet.before,
        lambda output: check_old_or_new(output, fleet),
        lambda output: check_repaired(output, fleet),
    )


def first(fleet: TinyFleet, folder: Path) -> Case:
    """There is nothing yet."""
    (folder / "before").mkdir()

    def check(output: Path) -> None:
        whole = {name: rows for name, rows in tables_in(fleet.after).items() if "fits/" in name}
        found = tables_in(output)
        assert all(found[name].equals(rows) for name, rows in whole.items())

    return Case("run", fleet, folder / "before", lambda _: None, check)


def harmed(fleet: TinyFleet, folder: Path) -> Path:
    """An output with damaged and missing files, and with what people said."""
    before = shutil.copytree(fleet.after, folder / "before")
    say(before)
    night_file(before, PREDICTIONS, NIGHT).unlink()
    rot_of_footer(night_file(before, FITS, LATER))
    rot(night_file(before, TRENDS, NIGHT))
    for path in before.rglob("*.parquet"):  # all are looked at
        os.utime(path)
    return before


def check_mended(fleet: TinyFleet, output: Path) -> None:
    assert len(read_decisions(output)) == 3
    remove_aside(output)
    for name in ("decisions/decisions.parquet", "latest/latest.parquet"):
        shutil.copy(fleet.after / "tables" / name, output / "tables" / name)
    check_tables(output, fleet)


def mending(fleet: TinyFleet, folder: Path) -> Case:
    """A run that mends."""
    before = harmed(fleet, folder)
    return Case("run", fleet, before, lambda _: None, lambda output: check_mended(fleet, output))


def repairing(fleet: TinyFleet, folder: Path) -> Case:
    """The command that repairs, done again."""
    before = harmed(fleet, folder)

    def killed(output: Path) -> None:
        assert repaired(output)[1] == ()

    return Case("repair", fleet, before, killed, lambda output: check_mended(fleet, output))


def telling(_: TinyFleet, folder: Path) -> Case:
    """Somebody is told of an alarm: at least once, and what comes twice says so by its id."""
    told_fleet(folder, keep(folder / "told"))
    fleet = TinyFleet(folder)
    (folder / "told").touch()
    before = shutil.copytree(folder / "out", folder / "before")

    def check(output: Path) -> None:
        found = told(folder)
        assert len({one["id"] for one in found}) == 1
        assert [one["to_state"] for one in found[0]["changes"]] == ["alarm"]
        (folder / "told").write_text("")
        fleet.run(output)
        assert told(folder) == []

    return Case("run", fleet, before, lambda _: None, check)


CASES = [nightly, first, mending, repairing, telling]


def kill_at(case: Case, victim: Victim, output: Path, point: int) -> None:
    shutil.rmtree(output, ignore_errors=True)
    shutil.copytree(case.before, output)
    request = {"work": case.work, "folder": case.fleet.folder, "output": output}
    assert victim.ask(**request, point=point) == -signal.SIGKILL, point
    case.killed(output)
    with remembered_fits():
        case.fleet.run(output)  # nobody holds the lock any more
    case.repaired(output)


def points_of(case: Case, victim: Victim, output: Path) -> int:
    request = {"work": case.work, "folder": case.fleet.folder, "output": output}
    return victim.ask(**request, before=case.before)


@pytest.mark.parametrize("made", CASES)
def test_killed_at_some_points(
    tiny_fleet: TinyFleet,
    victim: Victim,
    tmp_path: Path,
    made: Callable[[TinyFleet, Path], Case],
) -> None:
    case, output = made(tiny_fleet, tmp_path), tmp_path / "killed" / "out"
    n = points_of(case, victim, output)
    assert n > 20
    for point in np.random.default_rng(len(made.__name__)).choice(n, SOME, replace=False):
        kill_at(case, victim, output, int(point) + 1)


@pytest.mark.full
@pytest.mark.parametrize("part", range(SLICES))
@pytest.mark.parametrize("made", CASES)
def test_killed_at_every_point(
    tiny_fleet: TinyFleet,
    victim: Victim,
    tmp_path: Path,
    made: Callable[[TinyFleet, Path], Case],
    part: int,
) -> None:
    case, output = made(tiny_fleet, tmp_path), tmp_path / "killed" / "out"
    points = range(1 + part, points_of(case, victim, output) + 1, SLICES)
    for point in points:
        kill_at(case, victim, output, point)
    sys.stdout.write(f"{made.__name__}, {part + 1} of {SLICES}: {len(points)} points survived\n")


@pytest.mark.full
def test_killed_at_any_moment(tiny_fleet: TinyFleet, tmp_path: Path) -> None:
    """From outside, also within a write of SQLite."""
    case, output = nightly(tiny_fleet, tmp_path), tmp_path / "out"
    program = (
        "import sys; from tests.pipeline.faults.victim import *; run(*map(Path, sys.argv[1:]))"
    )
    command = [sys.executable, "-c", program, str(tiny_fleet.folder), str(output)]
    tiny_fleet.copy(output)
    begin = time.perf_counter()
    subprocess.run(command, env=ENVIRONMENT, check=True)
    taken = time.perf_counter() - begin
    for share in np.random.default_rng(11).uniform(0.2, 1.0, 30):
        tiny_fleet.copy(output)
        with subprocess.Popen(command, env=ENVIRONMENT) as process:
            try:
                process.wait(share * taken)
            except subprocess.TimeoutExpired:
                process.kill()
        case.killed(output)
        with remembered_fits():
            tiny_fleet.run(output)
        case.repaired(output)
