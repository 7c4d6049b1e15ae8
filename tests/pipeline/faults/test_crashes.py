"""A run or an acknowledgement that ends at any call that writes.

Killed, refused once, or on a disk that is full from there on: every file is as it was or as it
comes to be; the next run makes the tables that no crash disturbed; alarms are delivered at
least once, and what people said is not lost.

As SQLite is tested ("How SQLite Is Tested", crash and I/O error testing).
"""

from __future__ import annotations

import os
import shutil
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.config import load_fleet
from pipeline.report.build import build_report
from pipeline.schema import FITS, PREDICTIONS, TRENDS
from pipeline.store.published import verify_tables
from pipeline.trends.decisions import read_decisions
from tests.pipeline.calling import contents
from tests.pipeline.faults.conftest import say
from tests.pipeline.faults.crash import FAULTS, End, Fault, Victim
from tests.pipeline.faults.fleet import (
    LATER,
    MOTORS,
    TinyFleet,
    check_old_or_new,
    check_repaired,
    check_tables,
    remembered_fits,
    remove_aside,
    rot,
    rot_of_footer,
    temporary,
)
from tests.pipeline.notification.servers import delivered, keep
from tests.pipeline.simulated import NIGHT
from tests.pipeline.workshop import QUICK
from tests.pipeline.written import night_file

SLICES = 4


def run(folder: Path, output: Path) -> list[str]:
    """A run, one task at a time; the motors that failed."""
    return [motor.motor_id for motor in TinyFleet(folder).run(output, workers=1).failed]


def acknowledge(_: Path, output: Path) -> None:
    say(output)


@dataclass(frozen=True)
class Case:
    """A work on an output as it was before, and what holds after its crash, and after a run."""

    work: Callable[[Path, Path], object]
    fleet: TinyFleet
    before: Path
    crashed: Callable[[Path, End], None]
    repaired: Callable[[Path], None]


def check_published(output: Path, old: Path, new: Path, end: End) -> None:
    """Every file is old or new; of a motor that has failed alone some rows are, others are not."""
    if end.failed:
        assert list(verify_tables(output)) == []
    else:
        check_old_or_new(output, old, new)


def nightly(fleet: TinyFleet, _: Path) -> Case:
    """The next night comes, and a late log of the one before."""

    def crashed(output: Path, end: End) -> None:
        check_published(output, fleet.before, fleet.after, end)
        if end.how != "killed" and end.struck not in ("unlink", "rmdir", "open"):
            assert temporary(output) == []
        if end.how == "ok" and not end.failed:
            # A run that says that all went well has published all.
            check_tables(output, fleet.after)

    return Case(run, fleet, fleet.before, crashed, lambda out: check_repaired(out, fleet.after))


def first(fleet: TinyFleet, folder: Path) -> Case:
    """There is nothing yet."""
    (folder / "before").mkdir()
    with remembered_fits():
        fleet.run(folder / "whole")

    def crashed(output: Path, end: End) -> None:
        check_published(output, folder / "before", folder / "whole", end)

    def repaired(output: Path) -> None:
        check_repaired(output, folder / "whole")

    return Case(run, fleet, folder / "before", crashed, repaired)


def acknowledging(fleet: TinyFleet, folder: Path) -> Case:
    """Somebody says something: what was said is said for good."""
    before = shutil.copytree(fleet.after, folder / "before")
    said: list[int] = []

    def crashed(output: Path, end: End) -> None:
        said[:] = [len(read_decisions(output))]
        assert said == [3] if end.how == "ok" else said[0] <= 3
        assert list(verify_tables(output)) == []

    def repaired(output: Path) -> None:
        assert [len(read_decisions(output))] == said
        (output / "state.db").write_bytes(b"lost")
        fleet.run(output)
        assert [len(read_decisions(output))] == said

    return Case(acknowledge, fleet, before, crashed, repaired)


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


def mending(fleet: TinyFleet, folder: Path) -> Case:
    """A run that mends."""

    def check(output: Path) -> None:
        assert len(read_decisions(output)) == 3
        remove_aside(output)
        for name in ("decisions/decisions.parquet", "latest/latest.parquet"):
            shutil.copy(fleet.after / "tables" / name, output / "tables" / name)
        check_tables(output, fleet.after)

    return Case(run, fleet, harmed(fleet, folder), lambda *_: None, check)


def notification(fleet: TinyFleet, folder: Path) -> Case:
    """Alarms are delivered: at least once, and what comes twice says so by its id.

    By the limit of their type both motors are in alarm from their first night on.
    """
    limited = TinyFleet(folder / "limited")
    shutil.copytree(fleet.folder / "logs", limited.folder / "logs")
    limits = "[limits]\nalarm_l_per_min = 0.0001\n"
    receiver = f"{QUICK}[alarms]\n{keep(folder / 'told')}\n"
    limited.configure(fleet=receiver, motors=MOTORS, limits=limits)

    def check(output: Path) -> None:
        found = delivered(folder)
        assert len({delivery["id"] for delivery in found}) == 1
        assert [change["to_state"] for change in found[0]["changes"]] == ["alarm", "alarm"]
        (folder / "told").write_text("")
        with remembered_fits():
            limited.run(output)
            (output / "state.db").unlink()
            limited.run(output)
        assert delivered(folder) == []

    return Case(run, limited, fleet.after, lambda *_: None, check)


CASES = (nightly, first, acknowledging, mending, notification)
WORKS = [(nightly, "full"), (mending, "killed"), (notification, "killed")]
WORKS += [
    pytest.param(made, fault, marks=pytest.mark.full)
    for made in CASES
    for fault in FAULTS
    if (made, fault) not in WORKS and (fault == "killed" or made in (nightly, first, notification))
]


# Without a part: a point by chance; the parts together are all.
PARTS = [None, *(pytest.param(part, marks=pytest.mark.full) for part in range(SLICES))]


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize(("made", "fault"), WORKS)
def test_a_work_that_is_broken_off_is_made_up_for(
    tiny_fleet: TinyFleet,
    victim: Victim,
    tmp_path: Path,
    made: Callable[[TinyFleet, Path], Case],
    fault: Fault,
    part: int | None,
) -> None:
    case, output = made(tiny_fleet, tmp_path), tmp_path / "crashed" / "out"
    shutil.copytree(case.before, output)
    n = victim.crash_at(0, case.work, case.fleet.folder, output, fault).seen
    assert n > 10
    rng = np.random.default_rng(len(f"{made.__name__}{fault}"))
    some = rng.choice(n, 1) if part is None else np.arange(part, n, SLICES)
    ends: Counter[str] = Counter()
    for point in some.tolist():
        shutil.rmtree(output)
        shutil.copytree(case.before, output)
        (tmp_path / "told").unlink(missing_ok=True)
        end = victim.crash_at(point + 1, case.work, case.fleet.folder, output, fault)
        case.crashed(output, end)
        with remembered_fits():
            case.fleet.run(output)  # nobody holds the lock any more
        case.repaired(output)
        ends[f"{end.how} {end.struck}"] += 1
    sys.stdout.write(f"{made.__name__}, {fault}: {n} points, tried {dict(ends)}\n")


def report(tables: Path, folder: Path) -> None:
    build_report(replace(load_fleet(TinyFleet(tables.parent).fleet), output=tables), folder)


@pytest.mark.parametrize(
    ("fault", "n_points"),
    [("killed", 1), *(pytest.param(fault, 25, marks=pytest.mark.full) for fault in FAULTS)],
)
def test_a_report_that_is_broken_off_is_made_whole_by_the_next(
    tiny_fleet: TinyFleet, victim: Victim, tmp_path: Path, fault: Fault, n_points: int
) -> None:
    folder, tables = tmp_path / "made", tiny_fleet.after
    n = victim.crash_at(0, report, tables, folder, fault).seen
    whole = contents(folder)
    for point in np.random.default_rng(n_points).choice(n, min(n, n_points), replace=False):
        shutil.rmtree(folder)
        victim.crash_at(int(point) + 1, report, tables, folder, fault)
        report(tables, folder)
        assert contents(folder) == whole
