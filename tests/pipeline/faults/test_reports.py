"""A report that is broken off is made whole by the next one."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.config import load_fleet
from pipeline.report.build import build_report
from tests.pipeline.calling import contents
from tests.pipeline.faults.crash import FAULTS, Fault, Victim
from tests.pipeline.faults.fleet import TinyFleet


def report(tables: Path, folder: Path) -> None:
    build_report(replace(load_fleet(TinyFleet(tables.parent).fleet), output=tables), folder)


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("n_points", [1, pytest.param(25, marks=pytest.mark.full)])
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
