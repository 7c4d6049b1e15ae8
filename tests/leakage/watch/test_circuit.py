"""A motor beside its oil circuit, by the rules of model.md, 7c.5, written out by hand."""

from __future__ import annotations

import math

import pytest

from leakage.watch import Estimate, Watch
from leakage.watch.circuit import circuit_change
from tests.leakage.watch.made_machine import Plant, grown, watched

FIRST, BEGIN, N = 15, 25, 45


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
    drifts = [grown("all_flows", by, BEGIN - 5 * place) for place, by in enumerate((0.03, 0.08))]
    break_ = grown("all_gaps", 0.15, BEGIN)
    last = together(break_, *drifts)[BEGIN + 5 - FIRST][0]
    assert last.verdict().change.cause != "tank"
    own = last.state.in_force.circuit.own
    assert own.lower > 0.0
