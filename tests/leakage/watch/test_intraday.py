"""The night so far as the newest night: a step within the day is reported, a healthy day is not."""

from __future__ import annotations

from dataclasses import replace

import pytest

from leakage.watch import NightBlocks, Watch
from leakage.watch.intraday import Rise, is_going_on, rises_so_far, sudden_rise
from leakage.watch.nights import Estimate
from tests.leakage.watch.made_machine import BLOCK_S, Plant, watched

NIGHTS, BLOCKS, BREAK = 12, 60, 40
SEEDS = range(70, 72)
RISEN = Rise(20.0, Estimate(0.3, 0.03))


def risen(plant: Plant, seed: int, rise: float) -> tuple[Watch, NightBlocks]:
    """A watch, and a day after it whose flow is larger by a share from a block on."""
    nights = plant.nights(NIGHTS + 1, seed)
    flow = nights[-1].flow.copy()
    flow[BREAK:] *= 1.0 + rise
    return watched(nights[:-1])[-1], replace(nights[-1], flow=flow)


def until(night: NightBlocks, n: int) -> NightBlocks:
    """The night so far, of its first blocks."""
    parts = (night.middle_s, night.drives, night.flow, night.conditions)
    return NightBlocks(night.day, *(part[:n] for part in parts))


@pytest.mark.parametrize("film", ["barus", "slot"])
def test_a_step_of_30_percent_is_reported_within_10_minutes_and_not_before(film: str) -> None:
    for seed in SEEDS:
        watch, night = risen(Plant(film=film, blocks=BLOCKS), seed, 0.3)  # type: ignore[arg-type]
        reported = next(
            n for n in range(2, BLOCKS) if sudden_rise(rises_so_far(watch, until(night, n), 1))
        )
        assert BREAK < reported <= BREAK + 600.0 / BLOCK_S
        whole = sudden_rise(rises_so_far(watch, night, 1))
        assert whole is not None
        assert whole.change.lower < 0.3 < whole.change.upper


@pytest.mark.parametrize(
    "plant",
    [
        Plant(film="slot", blocks=BLOCKS),
        Plant(film="slot", blocks=BLOCKS, operating_point="one pressure"),
        Plant(film="slot", blocks=BLOCKS, load=lambda night: 0.6 if night == NIGHTS else 1.0),
    ],
    ids=["usual", "one pressure", "less load"],
)
def test_a_healthy_day_is_silent(plant: Plant) -> None:
    watch, night = risen(plant, 80, 0.0)
    for n in range(2, BLOCKS, 3):
        assert sudden_rise(rises_so_far(watch, until(night, n), 1)) is None


def test_what_is_over_is_not_reported() -> None:
    over = Rise(0.0, Estimate(0.02, 0.02))
    assert sudden_rise([RISEN, RISEN]) == RISEN
    assert sudden_rise([over, RISEN]) is None
    assert not is_going_on([over], 0.3)


def test_neither_little_evidence_nor_a_small_rise_is_reported() -> None:
    assert sudden_rise([Rise(5.0, Estimate(0.3, 0.01))]) is None
    assert sudden_rise([Rise(50.0, Estimate(0.06, 0.01))]) is None
