"""A night's rows hang on no later night: night after night says what all nights at once say."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from typing import Any

import numpy as np
import polars as pl
import pytest

from pipeline.trends.figures.filtered_nights import with_filter
from pipeline.trends.nights.decisions import Decision
from pipeline.trends.nights.history import History
from pipeline.trends.rows.alarm_rows import alarm_rows
from pipeline.trends.rows.baseline_rows import baseline_rows, change_point_rows
from pipeline.trends.rows.trend_rows import trend_rows
from pipeline.trends.states.standing import Standing
from tests.pipeline.trends.blocks import POOR, blocks_of, with_blocks
from tests.pipeline.trends.nights import (
    PATHS,
    Nights,
    event,
    histories,
    motor,
    named,
    ramp,
    reset,
    standings,
    step,
)

N = 84
SPEC = motor()


def all_rows(found: Standing, places: Sequence[int]) -> list[tuple[str, dict[str, Any]]]:
    return [
        *(("trends", row) for row in trend_rows(found, places)),
        *(("alarms", row) for row in alarm_rows(found, places)),
        *(("baselines", row) for row in baseline_rows(found, places)),
        *(("change_points", row) for row in change_point_rows(found, places)),
    ]


def tank(seed: int) -> tuple[list[Nights], list[Decision]]:
    """Motors on one tank, and whatever happens to motors, drawn."""
    draw = np.random.default_rng(seed)

    def place() -> int:
        return int(draw.integers(5, N - 5))

    motors = []
    for number in range(int(draw.integers(1, 4))):
        shapes = {path: draw.choice([0, 1, 2]) for path in PATHS}
        wear = {
            path: (step, ramp)[shape - 1](N, place(), float(draw.choice([-0.4, -0.2, 0.1, 0.5])))
            for path, shape in shapes.items()
            if shape
        }
        silent, poor = place(), range(place(), N, int(draw.choice([1, 2, N])))
        events = [event(place(), "overhaul")] if draw.random() < 0.4 else []
        zeros = {
            "flow_zero_l_per_min": 0.02 * (np.arange(N) >= place()) + 0.001 * np.cos(np.arange(N)),
            "pressure_zero_bar": 0.1 * np.sin(np.arange(N)),
        }
        motors.append(
            Nights(
                named(SPEC, f"M{number + 1}", "tank", events),
                N,
                wear,
                seed=seed + number,
                changes=dict.fromkeys(poor, POOR),
                absent=frozenset(range(silent, silent + int(draw.choice([0, 3, 12])))),
                operation=zeros,
            )
        )
    said = [reset(place(), str(draw.choice(["", "K_piston_ring"])))]
    return motors, said if draw.random() < 0.5 else []


def stand(
    motors: Sequence[Nights], said: Sequence[Decision], blocks: pl.DataFrame, until: int
) -> dict[str, Standing]:
    def followed(history: History) -> History:
        own = blocks.filter(motor_id=history.spec.motor_id)
        return with_filter(with_blocks(history, own), dt.date.min)

    return standings(histories(*motors, until=until, tonight=until), said, followed)


@pytest.mark.parametrize(
    "seed", [0, 4, 7, *(pytest.param(one, marks=pytest.mark.full) for one in (1, 2, 3, 5, 6))]
)
def test_no_row_of_a_night_hangs_on_a_later_one(seed: int) -> None:
    motors, said = tank(seed)
    blocks = pl.concat([blocks_of(one) for one in motors])
    at_once = stand(motors, said, blocks, N - 1)
    for cut in np.random.default_rng(seed).integers(28, N - 1, size=3).tolist():
        for name, found in stand(motors, said, blocks, cut).items():
            later, last = at_once[name], len(found.history) - 1
            for indicator, states in found.states.items():
                assert states[:] == later.states[indicator][: last + 1], (name, indicator, cut)
            for then, now in zip(all_rows(found, [last]), all_rows(later, [last]), strict=True):
                assert then == now, (name, cut)
