"""The demo fleet as loggers of many makes write it: the whole run comes to the same tables."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import polars as pl
import pytest
from polars.testing import assert_frame_equal

from pipeline.config import Fleet
from pipeline.demo import write_demo
from pipeline.run.fleet import RunRequest, run_fleet
from pipeline.schema import FITS, PARAMETERS, QUALITY, Table
from tests.conftest import made_once
from tests.dialects.catalogue import DIALECTS, OVER_A_CLOCK_CHANGE
from tests.dialects.dialect import Dialect
from tests.dialects.fleet import demo_fleet, first_nights, fleet_of_one

END_OF_SUMMER_TIME = dt.date(2025, 10, 26)
SEARCH = 1e-6
"""Where a start ends that creeps along a flat valley; a hundredth of what counts as the minimum."""


def each(dialects: Sequence[Dialect]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("dialect", dialects, ids=lambda dialect: dialect.name)


def fit(fleet: Fleet, output: Path) -> None:
    execution = fleet.execution.model_copy(update={"backend": "sequential"})
    run_fleet(RunRequest(replace(fleet, execution=execution, output=output)))


def rows_of(output: Path, table: Table, motor_id: str) -> pl.DataFrame:
    """Figures that follow from the samples, without what hashes the config or is a difference."""
    files = sorted((output / "tables" / table.name).glob("*/*.parquet"))
    rows = pl.concat([pl.read_parquet(path) for path in files])
    left_out = {"run_id", "model_hash", "dual_residual", "within_block_inflation"}
    kept = [
        name
        for name, kind in rows.schema.items()
        if name not in left_out and "mean_error" not in name and not isinstance(kind, pl.List)
    ]
    keys = [name for name in table.key if name in kept]
    return rows.filter(pl.col("motor_id") == motor_id).select(kept).sort(keys)


def assert_the_same(
    demo: Path, output: Path, motor_id: str, dialect: Dialect, folder: Path
) -> None:
    fleet = fleet_of_one(demo, motor_id, folder / "logs", dialect, first_nights(demo))
    fit(fleet, folder / "out")
    for table in (FITS, PARAMETERS, QUALITY):
        one, other = (rows_of(at, table, motor_id) for at in (output, folder / "out"))
        assert one.height
        tolerance = max(dialect.precision, SEARCH)
        assert_frame_equal(one, other, rel_tol=tolerance, abs_tol=1e-12)


@pytest.fixture(scope="session")
def fitted(shared_folder: Path) -> Path:
    """The first night of all six motors, with what a run over their own logs has written."""

    def make(folder: Path) -> None:
        write_demo(folder / "demo", nights=1, minutes=40, rate_hz=2.0, workers=1)
        fit(demo_fleet(folder / "demo"), folder / "out")

    return made_once(shared_folder / "first_night", make)


# Sample by sample, any dialect is read in `tests/pipeline/ingest/test_any_dialect.py`.
@each(DIALECTS[1::2])
def test_a_motor_in_some_dialects_comes_to_the_same_tables(
    fitted: Path, dialect: Dialect, tmp_path: Path
) -> None:
    nights = first_nights(fitted / "demo")
    motors = [one for one, logs in sorted(nights.items()) if all(map(dialect.holds, logs.values()))]
    motor_id = motors[DIALECTS.index(dialect) // 2 % len(motors)]
    assert_the_same(fitted / "demo", fitted / "out", motor_id, dialect, tmp_path)


@pytest.fixture(scope="module")
def clock_change(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The demo in the night in which summer time ends."""
    demo = tmp_path_factory.mktemp("clock_change")
    write_demo(demo, nights=1, minutes=300, rate_hz=1.0, workers=1, first_night=END_OF_SUMMER_TIME)
    return demo


@each(OVER_A_CLOCK_CHANGE)
def test_a_night_in_which_an_hour_comes_twice(
    clock_change: Path, dialect: Dialect, tmp_path: Path
) -> None:
    fleet = demo_fleet(clock_change)
    spec = fleet.motors[OVER_A_CLOCK_CHANGE.index(dialect)]
    fit(replace(fleet, motors=(spec,)), tmp_path / "own")
    (log,) = first_nights(clock_change)[spec.motor_id].values()
    first, last = (dialect.wall_clock(int(log.time_us[at])) for at in (0, -1))
    assert first.utcoffset() != last.utcoffset()
    assert_the_same(clock_change, tmp_path / "own", spec.motor_id, dialect, tmp_path / "other")
