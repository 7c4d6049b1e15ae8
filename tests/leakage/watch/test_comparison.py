"""Before and after a date, on made nights whose change is known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from leakage.errors import EstimationError
from leakage.watch import Comparison, WatchSettings, compare
from tests.leakage.watch.made_machine import CB560, Plant, grown, of_flow

BEFORE, AFTER = 30, 12
SEEDS = range(40, 43)
GAPS = np.array([0.1, 0.1, 0.1, 0.0])


def comparisons(plant: Plant, after: int = AFTER) -> list[Comparison]:
    """Comparisons of the same plant by seed."""
    found = []
    for seed in SEEDS:
        nights = plant.nights(BEFORE + after, seed)
        found.append(compare(CB560, nights[:BEFORE], nights[BEFORE:], WatchSettings()))
    return found


def n_held(found: list[Comparison], truth: float) -> int:
    return sum(one.change.lower <= truth <= one.change.upper for one in found)


@pytest.mark.parametrize(
    "what",
    [
        {},
        {"serial": 0.8, "wander": 0.009},
        {"warmer_c": lambda night: 10.0 * (night >= BEFORE)},
        {"load": lambda night: 0.6 if night >= BEFORE else 1.0},
        {"growth": grown("all_flows", 0.08, BEFORE, BEFORE + 1)},
    ],
    ids=["another film law", "wander with a memory", "10 K warmer", "less load", "one odd night"],
)
def test_nothing_has_changed(what: dict[str, Any]) -> None:
    found = comparisons(Plant(film="slot", **what))
    assert max(one.probability for one in found) < 0.5
    assert n_held(found, 0.0) >= len(found) - 1


@pytest.mark.parametrize("after", [2, AFTER])
def test_a_change_is_sure_and_its_size_held(after: int) -> None:
    found = comparisons(Plant(film="slot", growth=grown("all_gaps", 0.1, BEFORE)), after)
    assert min(one.probability for one in found) > 0.95
    assert n_held(found, of_flow(GAPS, "slot")) >= len(found) - 1


def probability(size: float, nights: int) -> float:
    """Probability of a step of all flows with so many nights a side, to a millionth."""
    plant = Plant(film="slot", growth=grown("all_flows", size, nights))
    every = plant.nights(2 * nights, 50)
    return round(compare(CB560, every[:nights], every[nights:], WatchSettings()).probability, 6)


@pytest.mark.parametrize("size", [0.05, 0.1, 0.2, 0.5])
def test_a_step_is_surer_the_more_nights_stand_on_each_side(size: float) -> None:
    found = [probability(size, nights) for nights in (10, 14, 30, 60)]
    assert found == sorted(found)
    assert found[-1] > 0.99
    assert size < 0.1 or found[0] > 0.99


@pytest.mark.parametrize("night", [0, 9])
def test_one_odd_night_among_ten_is_no_change(night: int) -> None:
    odd = grown("all_flows", 0.5, BEFORE + night, BEFORE + night + 1)
    assert (
        max(
            comparison.probability for comparison in comparisons(Plant(film="slot", growth=odd), 10)
        )
        < 0.5
    )


def test_a_worn_gap_is_named_where_the_model_is_right() -> None:
    found = comparisons(Plant(growth=grown("ring", 0.3, BEFORE)))
    assert {one.cause for one in found} == {"ring"}
    assert all(one.cause_probability >= 0.9 for one in found)


def test_another_operating_point_is_said_and_widens_the_interval() -> None:
    usual, other = (
        comparisons(Plant(film="slot", load=lambda night, to=to: to if night >= BEFORE else 1.0))
        for to in (1.0, 0.6)
    )
    assert not any(one.operates_otherwise for one in usual)
    assert all(one.operates_otherwise for one in other)
    assert min(one.change.sd for one in other) > 2.0 * max(one.change.sd for one in usual)


@pytest.mark.parametrize(("before", "after"), [(7, 5), (8, 0)])
def test_too_few_nights_are_refused(before: int, after: int) -> None:
    nights = Plant().nights(before + after, 1)
    with pytest.raises(EstimationError, match=f"{before} nights before and {after} after"):
        compare(CB560, nights[:before], nights[before:], WatchSettings())
