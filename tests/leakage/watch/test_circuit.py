"""A motor beside its oil circuit, by the rules of model.md, 7c.5, written out by hand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from leakage.errors import EstimationError
from leakage.watch import Comparison, Estimate, Watch, WatchSettings, compare
from leakage.watch.circuit import circuit_change
from tests.leakage.watch.made_machine import CB560, Plant, grown, of_flow, watched

FIRST, BEGIN, N = 15, 25, 35


def test_change_is_the_median_of_the_others_and_an_own_part_each_with_its_error() -> None:
    """+12 % among +3, +4, +8 %: "tank 97 %" before."""
    others = [Estimate(value, 0.01) for value in (0.03, 0.08, 0.04)]
    asked = circuit_change(Estimate(0.12, 0.01), others)
    sd = 1.25 * 1.48 * 0.01 / math.sqrt(3)
    assert asked.of_circuit.value == pytest.approx(0.04)
    assert asked.of_circuit.sd == pytest.approx(math.hypot(sd, 0.01))
    assert asked.own.value == pytest.approx(0.08)
    assert asked.own.sd == pytest.approx(math.hypot(0.01, sd, 0.01, 0.1 * 0.04))
    assert not asked.own.holds_zero
    assert not asked.is_common


@pytest.mark.parametrize(
    ("others", "is_common"),
    [
        ([0.10, 0.11], True),
        ([0.10, 0.07, 0.14], True),
        ([0.10, 0.0, 0.0], False),
        ([0.10, 0.11, 0.0], True),
        ([-0.10, -0.10], False),
        ([0.005, 0.005], False),
    ],
)
def test_it_is_common_where_most_others_show_the_like(others: list[float], is_common: bool) -> None:
    asked = circuit_change(Estimate(0.10, 0.01), [Estimate(other, 0.01) for other in others])
    assert asked.is_common == is_common
    assert (asked.probability > 0.5) == is_common


@pytest.mark.parametrize(
    ("size", "other", "n_alike"),
    [
        # Within two standard deviations of their difference, 0.036, though two and a half times.
        (Estimate(0.02, 0.01), Estimate(0.05, 0.015), 2),
        (Estimate(0.02, 0.001), Estimate(0.05, 0.001), 0),
        # Half as much again, however well both are known.
        (Estimate(0.04, 0.001), Estimate(0.06, 0.001), 2),
    ],
)
def test_the_like_is_as_large_within_errors_or_nearly(
    size: Estimate, other: Estimate, n_alike: int
) -> None:
    asked = circuit_change(size, [other, other])
    assert asked is not None
    assert asked.n_alike == n_alike


def test_one_other_motor_is_no_vote() -> None:
    assert circuit_change(Estimate(0.1, 0.01), [Estimate(0.1, 0.01)]) is None


def together(*growths: object) -> list[list[Watch]]:
    """The watches of a circuit's motors, night by night, each knowing the others."""
    motors = [
        watched(Plant(growth=growth).nights(N, seed), first=FIRST)
        for seed, growth in enumerate(growths)
    ]
    return [
        [watch.beside([other for other in night if other is not watch]) for watch in night]
        for night in zip(*motors, strict=True)
    ]


def test_oil_of_a_tank_is_common_and_a_break_among_drifts_is_the_motors_own() -> None:
    oil = grown("all_flows", 0.12, BEGIN)
    settling = together(oil, oil, oil)[: BEGIN + 10 - FIRST]
    changes = [night[0].verdict().change for night in settling]
    causes = [change.cause for change in changes if change is not None]
    assert set(causes) == {"tank"}
    first, other, _ = settling[-1]
    assert first.beside([other]).verdict().change.cause == "tank"  # the third has changed again
    drifts = [grown("all_flows", by, BEGIN - 5 * place) for place, by in enumerate((0.03, 0.08))]
    break_ = grown("all_gaps", 0.15, BEGIN)
    last = together(break_, *drifts)[BEGIN + 5 - FIRST][0]
    assert last.verdict().change.cause != "tank"
    own = last.state.in_force.circuit.own
    assert own.lower > 0.0


# Nights compared


BEFORE, AFTER = 30, 12
SEEDS = (40,)
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
    assert n_held(found, 0.0) == len(found)


@pytest.mark.parametrize("after", [2, AFTER])
def test_a_change_is_sure_and_its_size_held(after: int) -> None:
    found = comparisons(Plant(film="slot", growth=grown("all_gaps", 0.1, BEFORE)), after)
    assert min(one.probability for one in found) > 0.95
    assert n_held(found, of_flow(GAPS, "slot")) == len(found)


def probability(size: float, nights: int) -> float:
    """Probability of a step of all flows with so many nights a side, to a millionth."""
    plant = Plant(film="slot", growth=grown("all_flows", size, nights))
    every = plant.nights(2 * nights, 50)
    return round(compare(CB560, every[:nights], every[nights:], WatchSettings()).probability, 6)


@pytest.mark.parametrize("size", [0.05, 0.5])
def test_a_step_is_surer_the_more_nights_stand_on_each_side(size: float) -> None:
    found = [probability(size, nights) for nights in (10, 14, 40)]
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
