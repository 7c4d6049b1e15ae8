"""Files beside the tables: what people said, CSV exports, reports. Each call fails in turn."""

from __future__ import annotations

import datetime as dt
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import StoreError
from pipeline.export.csv import Selection, export_csv
from pipeline.report.build import build_report
from pipeline.run.fleet import run_fleet
from pipeline.run.tasks import MotorOutcome
from pipeline.schema import FITS, PARAMETERS
from tests.pipeline.calling import contents
from tests.pipeline.faults.disk import KINDS, Disk, Killed, Kind, on
from tests.pipeline.faults.fleet import ENVIRONMENT, TinyFleet, check_tables

DEAD = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
MOMENT = dt.datetime(2026, 3, 4, 5, tzinfo=dt.UTC)


def points(kind: Kind, act: Callable[[], object]) -> int:
    """Number of calls of an act that can fail."""
    with on(Disk(kind, 0)) as disk:
        act()
    return disk.seen


def fails(kind: Kind, point: int, act: Callable[[], object]) -> bool:
    """True if an act reports its failure, or dies, when one of its calls fails."""
    with on(Disk(kind, point)) as disk:
        try:
            act()
        except (StoreError, Killed):
            return True
        finally:
            assert disk.struck
    return False


@DEAD
@pytest.mark.parametrize("kind", KINDS)
def test_an_export_is_whole_or_as_it_was(tiny_fleet: TinyFleet, tmp_path: Path, kind: Kind) -> None:
    folder = tmp_path / "csv"

    def export() -> None:
        list(export_csv(tiny_fleet.after, folder, Selection(tables=(FITS, PARAMETERS))))

    export()
    n = points(kind, export)
    new = contents(folder)
    for point in range(1, n + 1):
        for name in new:
            (folder / name).write_bytes(b"old")
        failed = fails(kind, point, export)
        for name, content in new.items():
            assert (folder / name).read_bytes() in ((b"old", content) if failed else (content,))
        export()
        assert contents(folder) == new


@DEAD
@pytest.mark.parametrize(
    "n_points", [pytest.param(1, id="some"), pytest.param(25, marks=pytest.mark.full, id="many")]
)
@pytest.mark.parametrize("kind", ["EIO", "ENOSPC"])
def test_a_report_is_made_whole_by_the_next(
    tiny_fleet: TinyFleet, tmp_path: Path, kind: Kind, n_points: int
) -> None:
    folder = tmp_path / "report"

    def make() -> None:
        build_report(tiny_fleet.request(tiny_fleet.after).fleet, folder)

    n = points(kind, make)
    new = contents(folder)
    chosen = np.random.default_rng(KINDS.index(kind)).choice(n, min(n, n_points), replace=False)
    for point in chosen:
        shutil.rmtree(folder)
        fails(kind, int(point) + 1, make)
        make()
        assert contents(folder) == new


def test_a_second_run_is_turned_away_by_code_3(tiny_fleet: TinyFleet, tmp_path: Path) -> None:
    """While the first one runs; it loses nothing by it."""
    output = tiny_fleet.copy(tmp_path / "out")
    program = "from pipeline.cli import main; main()"
    command = [sys.executable, "-c", program, "fit-fleet", str(tiny_fleet.fleet)]
    ends = []

    def second(_: MotorOutcome) -> None:
        if not ends:
            plain = {"capture_output": True, "text": True, "env": ENVIRONMENT}
            done = subprocess.run([*command, "--output", output], **plain)
            ends.append((done.returncode, done.stderr))

    run_fleet(tiny_fleet.request(output), second)
    ((code, told),) = ends
    assert code == 3
    assert f"process {os.getpid()} on " in told
    check_tables(output, tiny_fleet)
