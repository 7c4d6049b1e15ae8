"""A checkpoint only saves work: the same rows come out without it, and in any order."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path

import polars as pl
import pytest
from polars.testing import assert_frame_equal

from pipeline.schema import ALARMS, NIGHTS, TREND_TABLES, Table
from pipeline.store.state import open_state
from pipeline.trends.tasks import read_checkpoint
from tests.pipeline.trends.nights import (
    OIL,
    Nights,
    copy_of,
    fleet_of,
    motor,
    named,
    night_of,
    part_of,
    publish,
    published_trends,
    run,
    step,
)
from tests.pipeline.written import change

N, AT = 14, 10
# M1's sleeve breaks; in a tank of three the oil is another one from the same night on.
WORN = (Nights(motor(), N, {"balance_sleeve": step(N, AT, 0.5)}),)
TANK = tuple(
    Nights(named(motor(), name, "mill"), N, {OIL: step(N, AT, 0.2)}, seed=number)
    for number, name in enumerate(("M1", "M2", "M3"))
)


def rows(output: Path, motor_id: str = "M1") -> dict[Table, pl.DataFrame]:
    return {table: published_trends(output, table, motor_id) for table in TREND_TABLES}


def check_same(made: Mapping[Table, pl.DataFrame], expected: Mapping[Table, pl.DataFrame]) -> None:
    for table in TREND_TABLES:
        assert_frame_equal(made[table], expected[table], check_exact=True)


def run_with(config: Path, output: Path, nights: tuple[Nights, ...], first: int, end: int) -> None:
    """A run to which the nights between two places have come."""
    publish(output, *(part_of(motor.frames, first, end) for motor in nights))
    run(config)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[Table, pl.DataFrame]:
    """Rows of the motor whose nights were all made in one run."""
    config, output = fleet_of(tmp_path_factory.mktemp("whole"), *WORN)
    run(config)
    return rows(output)


def test_night_by_night_gives_what_one_run_gives(tmp_path: Path) -> None:
    """Of a tank before the baseline is whole, across the step, and while the change settles."""
    made, expected = fleet_of(tmp_path / "whole", *TANK)
    run(made)
    config, output = fleet_of(tmp_path / "parts", *TANK, until=6)
    run(config)
    ends = [6, AT, AT + 1, N]
    for first, end in pairwise(ends):
        run_with(config, output, TANK, first, end)
    for name in ("M1", "M2", "M3"):
        check_same(rows(output, name), rows(expected, name))
    last = rows(output, "M2")[NIGHTS].filter(night=night_of(N - 1))
    assert last.select("state", "cause").rows() == [("common_cause", "tank")]
    assert rows(output)[ALARMS].height


def checkpoint_of(output: Path) -> bytes:
    with open_state(output) as state:
        return read_checkpoint(state, "M1") or b""


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, bytes]:
    """The worn motor up to the night of its step, and the checkpoint of the night before."""
    folder = tmp_path_factory.mktemp("until")
    config, output = fleet_of(folder, *WORN, until=AT)
    run(config)
    before = checkpoint_of(output)
    run_with(config, output, WORN, AT, AT + 1)
    return folder, before


@pytest.mark.parametrize("harm", ["gone", "changed", "of an earlier night"])
def test_without_what_was_kept_it_is_the_same_at_the_cost_of_time(
    fitted: tuple[Path, bytes], tmp_path: Path, whole: dict[Table, pl.DataFrame], harm: str
) -> None:
    folder, before = fitted
    config, output = copy_of(folder, tmp_path / "copy")
    content = checkpoint_of(output)
    middle = len(content) // 2
    # Of an earlier night: as a backup of one folder leaves it.
    left = {
        "gone": None,
        "changed": content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :],
        "of an earlier night": before,
    }
    change(output, "UPDATE trends SET checkpoint = ? WHERE motor_id = 'M1'", left[harm])
    run_with(config, output, WORN, AT + 1, N)
    check_same(rows(output), whole)
