"""A checkpoint only saves work: the same rows come out without it, and in any order."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

import polars as pl
import pytest
from polars.testing import assert_frame_equal

from pipeline.schema import ALARMS, NIGHTS, TRENDS, Table
from pipeline.store.state import open_state
from pipeline.trends.nights.trend_record import note_touched, read_checkpoint
from tests.pipeline.remembered import change
from tests.pipeline.trends.nights import (
    OIL,
    Frames,
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

N, AT = 34, 22
TABLES = (NIGHTS, TRENDS, ALARMS)
TANK = dict.fromkeys(("M1", "M2", "M3"), 'oil_circuit = "mill"\n')
# M1's sleeve breaks; in a tank of three the oil is another one from the same night on.
WORN = Nights(motor(), N, {"balance_sleeve": step(N, AT, 0.5)})
TANK_NIGHTS = tuple(
    Nights(named(motor(), name, "mill"), N, {OIL: step(N, AT, 0.2)}, seed=number)
    for number, name in enumerate(TANK)
)


def rows(output: Path, motor_id: str = "M1") -> dict[Table, pl.DataFrame]:
    return {table: published_trends(output, table, motor_id) for table in TABLES}


def check_same(found: Mapping[Table, pl.DataFrame], expected: Mapping[Table, pl.DataFrame]) -> None:
    for table, one in expected.items():
        assert_frame_equal(found[table], one, check_exact=True)


def new_night(config: Path, output: Path, *frames: Frames, place: int) -> None:
    publish(output, *(part_of(frame, place, place + 1) for frame in frames))
    run(config)


MADE = TemporaryDirectory()


def fleet_until(folder: Path, nights: tuple[Nights, ...], end: int) -> tuple[Path, Path]:
    """A fleet with the trends of its first nights: a copy of one that is made once."""
    made = Path(MADE.name, f"{len(nights)}_{end}")
    if not made.exists():
        config, _ = fleet_of(made, *nights, until=end)
        run(config)
    return copy_of(made, folder / "copy")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[Table, pl.DataFrame]:
    """Rows of the motor whose nights were all made in one run."""
    config, output = fleet_of(tmp_path_factory.mktemp("whole"), WORN)
    run(config)
    return rows(output)


def test_night_by_night_gives_what_one_run_gives(tmp_path: Path) -> None:
    """Of a tank before the baseline is whole, across the step, and while the change settles."""
    made, _ = fleet_of(tmp_path / "whole", *TANK_NIGHTS)
    run(made)
    config, output = fleet_until(tmp_path, TANK_NIGHTS, 6)
    frames = [one.frames() for one in TANK_NIGHTS]
    for place in (6, 7, 8, 9):
        new_night(config, output, *frames, place=place)
    publish(output, *(part_of(frame, 10, AT - 1) for frame in frames))
    run(config)
    for place in range(AT - 1, AT + 4):
        new_night(config, output, *frames, place=place)
    publish(output, *(part_of(frame, AT + 4, N) for frame in frames))
    run(config)
    for name in TANK:
        check_same(rows(output, name), rows(tmp_path / "whole" / "out", name))
    last = rows(output, "M2")[NIGHTS].filter(night=night_of(N - 1))
    assert last.select("state", "cause").rows() == [("common_cause", "tank")]


def checkpoint_of(output: Path) -> bytes:
    with open_state(output) as state:
        return read_checkpoint(state, "M1")


def flip(content: bytes) -> bytes:
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]


@pytest.mark.parametrize("harm", ["gone", "cut", "changed", "of an earlier night"])
def test_without_what_was_kept_it_is_the_same_at_the_cost_of_time(
    tmp_path: Path, whole: dict[Table, pl.DataFrame], harm: str
) -> None:
    config, output = fleet_until(tmp_path, (WORN,), AT)
    before = checkpoint_of(output)
    new_night(config, output, WORN.frames(), place=AT)
    content = checkpoint_of(output)
    # As a backup of one folder leaves it.
    left = {
        "gone": None,
        "cut": content[:-9],
        "changed": flip(content),
        "of an earlier night": before,
    }
    change(output, "UPDATE trends SET checkpoint = ? WHERE motor_id = 'M1'", left[harm])
    publish(output, part_of(WORN.frames(), AT + 1, N))
    run(config)
    check_same(rows(output), whole)


@pytest.mark.parametrize("place", [3, AT - 1, N - 1])
def test_a_late_log_gives_what_it_would_have_given_in_time(
    tmp_path: Path, whole: dict[Table, pl.DataFrame], place: int
) -> None:
    """Of a night of the baseline, of one before the change, and of the last one."""
    config, output = fleet_of(tmp_path, Nights(WORN.spec, N, WORN.wear, absent=frozenset({place})))
    run(config)
    with open_state(output) as state:
        note_touched(state, [("M1", night_of(place))])
    new_night(config, output, WORN.frames(), place=place)
    found = rows(output)
    for table in (NIGHTS, TRENDS):
        assert_frame_equal(found[table], whole[table], check_exact=True)
