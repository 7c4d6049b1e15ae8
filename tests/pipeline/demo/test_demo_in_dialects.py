"""The demo fleet as loggers of many makes write it: the whole run comes to the same tables."""

from __future__ import annotations

import datetime as dt
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from pipeline.config import load_fleet
from pipeline.demo import write_demo
from pipeline.run.fleet import RunRequest, RunResult, run_fleet
from tests.conftest import made_once
from tests.dialects.catalogue import DIALECTS, OVER_A_CLOCK_CHANGE
from tests.dialects.comparison import compare
from tests.dialects.dialect import Dialect
from tests.dialects.fleet import Nights, first_nights, write_fleet

END_OF_SUMMER_TIME = dt.date(2025, 10, 26)
SEARCH = 1e-6
"""Where a start ends that creeps along a flat valley; a hundredth of what counts as the minimum."""


def each(dialects: Sequence[Dialect]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("dialect", dialects, ids=lambda dialect: dialect.name)


@dataclass(frozen=True)
class Fitted:
    """A demo, what was recorded in its nights, and what a run over its own logs has written."""

    demo: Path
    nights: Nights
    output: Path


def fit(config: Path, output: Path, *motors: str) -> RunResult:
    fleet = load_fleet(config)
    execution = fleet.execution.model_copy(update={"backend": "sequential"})
    return run_fleet(RunRequest(replace(fleet, execution=execution, output=output), motors))


@pytest.fixture(scope="session")
def fitted(shared_folder: Path) -> Fitted:
    """The first night of all six motors."""

    def make(folder: Path) -> None:
        write_demo(folder / "demo", nights=1, minutes=40, rate_hz=2.0, workers=1)
        fit(folder / "demo" / "configs" / "fleet.toml", folder / "out")

    folder = made_once(shared_folder / "first_night", make)
    return Fitted(folder / "demo", first_nights(folder / "demo"), folder / "out")


def assert_the_same(
    fitted: Fitted, dialect: Dialect, motors: Collection[str], folder: Path
) -> None:
    nights = {motor: fitted.nights[motor] for motor in motors}
    config = write_fleet(fitted.demo, folder, dialect, nights)
    result = fit(config, folder / "out")
    assert [outcome.motor_id for outcome in result.outcomes] == sorted(motors)
    found = compare(fitted.output, folder / "out", tuple(motors))
    files = sum(path.is_file() for path in (folder / "demo" / "logs").rglob("*"))
    assert (found.n_read, found.n_failed) == (files, 0)
    assert set(found.largest) == {"fits", "parameters", "sensitivities"}
    for table, largest in found.largest.items():
        allowed = max(dialect.precision, SEARCH if table == "starts" else 0.0)
        assert largest <= allowed, found.where[table]
    assert set(found.others.values()) == {0}, found.others
    assert set(found.rows.values()) == {0}, found.rows


# Sample by sample, any dialect is read in `tests/pipeline/ingest/test_any_dialect.py`.
@each(DIALECTS[1::2])
def test_a_motor_in_some_dialects_comes_to_the_same_tables(
    fitted: Fitted, dialect: Dialect, tmp_path: Path
) -> None:
    motors = [
        motor
        for motor, logs in sorted(fitted.nights.items())
        if all(map(dialect.holds, logs.values()))
    ]
    turn = DIALECTS.index(dialect) // 2 % len(motors)
    assert_the_same(fitted, dialect, motors[turn : turn + 1], tmp_path)


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
    demo = clock_change
    fleet = load_fleet(demo / "configs" / "fleet.toml")
    motor = fleet.motors[OVER_A_CLOCK_CHANGE.index(dialect)].motor_id
    fit(demo / "configs" / "fleet.toml", tmp_path / "out", motor)
    nights = first_nights(demo)
    (log,) = nights[motor].values()
    clock = dialect.wall_clock(int(log.time_us[0])), dialect.wall_clock(int(log.time_us[-1]))
    assert clock[0].utcoffset() != clock[1].utcoffset()
    assert_the_same(Fitted(demo, nights, tmp_path / "out"), dialect, [motor], tmp_path / "fleet")
