"""The demo's report, and a copy of its tables to change at will."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import polars as pl
import pytest

from pipeline.config import Fleet, load_fleet
from pipeline.demo import shipped_configs
from pipeline.report.build import build_report
from pipeline.schema import TABLES
from pipeline.store.tables import read_table
from tests.conftest import made_once
from tests.pipeline.written import write_table
from tests.scenarios.command import run_command
from tests.scenarios.conftest import PLANT, fitted_once
from tests.scenarios.fleets import ScenarioFleet

if TYPE_CHECKING:
    from selenium.webdriver import Chrome

BY_NAME = {table.name: table for table in TABLES}
NOTE = "new sleeves <b>are ordered</b>"
Change = Callable[[pl.DataFrame], pl.DataFrame]


def demo_fleet(output: Path, *motors: str) -> Fleet:
    """The demo's fleet, or some of its motors, with an output of the test's own."""
    fleet = replace(load_fleet(shipped_configs() / "fleet.toml"), output=output)
    return replace(fleet, motors=tuple(map(fleet.motor, motors))) if motors else fleet


@pytest.fixture(scope="session")
def report(shared_folder: Path, fitted_output: Path) -> Path:
    """The report of the fitted demo; only to be read."""

    def make(folder: Path) -> None:
        build_report(demo_fleet(fitted_output), folder)

    return made_once(shared_folder / "report", make)


@pytest.fixture
def output(fitted_output: Path, tmp_path: Path) -> Path:
    """Tables of the demo of one's own."""
    shutil.copytree(fitted_output / "tables", tmp_path / "out" / "tables")
    return tmp_path / "out"


@pytest.fixture
def built(output: Path, report: Path) -> Path:
    """The same with their report."""
    shutil.copytree(report, output / "report")
    return output


def rows_with(motor: str, *which: pl.Expr, **values: object) -> Change:
    """Give a motor's rows, or some of them, other values."""
    mine = pl.all_horizontal(pl.col("motor_id") == motor, *which)
    return lambda rows: rows.with_columns(
        pl.when(mine).then(pl.lit(value, rows.schema[name])).otherwise(name).alias(name)
        for name, value in values.items()
    )


def rows_without(motor: str) -> Change:
    """Leave out a motor's rows."""
    return lambda rows: rows.filter(pl.col("motor_id") != motor)


def change_table(output: Path, name: str, change: Change, night: str = "*") -> None:
    """Write the files of a table anew with other rows, or those of a night; an empty file goes."""
    table = BY_NAME[name]
    for path in (output / "tables" / name).rglob("*.parquet"):
        rows = read_table(path, table)
        is_chosen = (
            pl.lit(value=True) if night == "*" else pl.col("night") == pl.lit(night).str.to_date()
        )
        rows = pl.concat([rows.filter(~is_chosen), change(rows.filter(is_chosen))])
        if rows.height:
            write_table(path, rows.select(table.schema.keys()))
        else:
            path.unlink()


@pytest.fixture(scope="session")
def chromium() -> Iterator[Chrome]:
    from tests.pipeline.report.browser import opened

    with opened() as browser:
        yield browser


@pytest.fixture
def browser(chromium: Chrome) -> Iterator[Chrome]:
    """A headless Chromium, which has nothing to complain of in the end."""
    from tests.pipeline.report.browser import complaints

    yield chromium
    assert complaints(chromium) == []


@pytest.fixture(scope="session")
def judged(shared_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> ScenarioFleet:
    """The scenarios' plant with a report of three nights, after the broken motor was opened."""
    plant = fitted_once(shared_folder / "scenario-plant", PLANT, 20)
    plant = plant.copy(tmp_path_factory.mktemp("judged"))
    opened = ("--opened", "2026-01-21", "--worn", "balance_sleeve", "--sound", "piston_ring")
    for words in (("--note", "scored", *opened), ("--note", NOTE)):
        assert plant.run("ack", "broken", *words).code == 0
    plant.append("fleet.toml", '[nights]\ntime_zone = "Europe/Stockholm"')
    words = ("report", "configs/fleet.toml", "--nights", 3)
    assert run_command(*words, folder=plant.folder).code == 0
    return plant
