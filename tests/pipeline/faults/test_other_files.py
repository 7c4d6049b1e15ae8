"""Files beside the tables: CSV exports and reports."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.config import load_fleet
from pipeline.export.csv import CsvRequest, export_csv
from pipeline.report.build import build_report
from pipeline.schema import FITS, PARAMETERS
from tests.pipeline.calling import contents
from tests.pipeline.faults.crash import FAULTS, Fault, Victim
from tests.pipeline.faults.fleet import TinyFleet

TABLES = CsvRequest(tables=(FITS, PARAMETERS))


def export(tables: Path, folder: Path) -> None:
    list(export_csv(tables, folder, TABLES))


def report(tables: Path, folder: Path) -> None:
    build_report(replace(load_fleet(TinyFleet(tables.parent).fleet), output=tables), folder)


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize(
    ("work", "n_points"),
    [
        (export, 8),
        (report, 1),
        pytest.param(report, 25, marks=pytest.mark.full),
    ],
)
def test_what_is_made_of_the_tables_is_made_whole_by_the_next(
    tiny_fleet: TinyFleet,
    victim: Victim,
    tmp_path: Path,
    fault: Fault,
    work: Callable[[Path, Path], None],
    n_points: int,
) -> None:
    """And an export is whole meanwhile, or as it was."""
    folder, tables = tmp_path / "made", tiny_fleet.after
    n = victim.crash_at(0, work, tables, folder, fault).seen
    new = contents(folder)
    for point in np.random.default_rng(n_points).choice(n, min(n, n_points), replace=False):
        if work is export:
            for name in new:
                (folder / name).write_bytes(b"old")
        else:
            shutil.rmtree(folder)
        end = victim.crash_at(int(point) + 1, work, tables, folder, fault)
        if work is export:
            for name, content in new.items():
                found = (folder / name).read_bytes()
                assert found in ((content,) if end.how == "ok" else (b"old", content))
        work(tables, folder)
        assert contents(folder) == new
