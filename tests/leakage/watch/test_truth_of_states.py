"""States that are true: odd nights, settling, own intervals, flushing, classes (model.md, 7c)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from leakage.watch import Machine, NightBlocks, Watch
from leakage.watch.adoption import in_force_of
from leakage.watch.attribution import attribute
from leakage.watch.events import across_event
from leakage.watch.odd_nights import odd_nights_are_single
from leakage.watch.state import nights_beyond
from tests.leakage.watch.made_machine import (
    CB560,
    COEFFICIENTS,
    PATHS,
    Array,
    Plant,
    drives,
    earlier_of,
    first_told,
    grown,
    of_flow,
    watched,
)

SEEDS = (1, 2)
FIRST, BEGIN = 15, 30
FLUSHED = Machine((*PATHS, "flushing"), PATHS[:3], CB560.oil)


def flushed(nights: Sequence[NightBlocks], flow: float) -> list[NightBlocks]:
    """Nights of a motor with a flushing of so many l/min, which is estimated."""
    return [
        replace(
            night,
            drives=np.column_stack([night.drives, np.ones(len(night.flow))]),
            flow=night.flow + flow,
        )
        for night in nights
    ]


@pytest.mark.parametrize("seed", SEEDS)
def test_a_flushing_does_not_dilute_a_change(seed: int) -> None:
    """7c.3: 3 l/min of flushing beside 1.4 of leakage; all gaps +30 %."""
    nights = Plant(growth=grown("all_gaps", 0.30, BEGIN)).nights(45, seed)
    truth = of_flow([0.3, 0.3, 0.3, 0.0])
    last = watched(flushed(nights, 3.0), FLUSHED, first=FIRST)[-1].verdict()
    assert last.newest_night.lower < truth < last.newest_night.upper
    assert last.present.value == pytest.approx(truth, abs=0.05)
    assert last.newest_night.upper - last.newest_night.lower < 0.2


@pytest.mark.parametrize("seed", SEEDS)
def test_a_step_stands_out_soon_and_one_odd_night_never_does(seed: int) -> None:
    """7c.1: +7 % is told by the third night; a single night of +30 % in any duty is not."""
    step = watched(Plant(growth=grown("all_gaps", 0.09, BEGIN)).nights(40, seed), first=FIRST)
    assert first_told(step).day <= BEGIN + 2
    for load in (lambda _: 1.0, lambda night: 0.5 if night >= 20 else 1.0):
        odd = Plant(growth=lambda night: 1.3 if night == BEGIN else 1.0, load=load)
        changes = [watch.verdict().change for watch in watched(odd.nights(45, seed), first=FIRST)]
        assert changes == [None] * len(changes)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_repair_while_wear_settles_is_told_at_once(seed: int) -> None:
    """7c.1: a sleeve that wears, and a repair that takes more than it had done."""
    worn, repaired = np.array([1.0, 1.0, 1.4, 1.0]), np.array([1.0, 1.0, 0.7, 1.0])
    plant = Plant(growth=lambda night: repaired if night >= 34 else worn if night >= BEGIN else 1.0)
    watches = watched(plant.nights(40, seed), first=FIRST)
    on_36 = watches[36 - FIRST].verdict()
    assert not on_36.change.is_rise
    assert on_36.change.since == 34
    assert on_36.present.value == pytest.approx(of_flow([0.0, 0.0, -0.3, 0.0]), abs=0.03)


@pytest.mark.parametrize("seed", SEEDS)
def test_no_change_in_force_contradicts_its_own_interval(seed: int) -> None:
    """7c.2, over all nights of motors to which something happens and goes again."""
    plants = (
        Plant(growth=grown("sleeve", 0.3, BEGIN, 36)),
        Plant(growth=grown("all_flows", 0.06, BEGIN, BEGIN + 3)),
        Plant(growth=grown("all_gaps", 0.05, BEGIN), load=lambda n: 0.5 if n >= 35 else 1.0),
    )
    for plant in plants:
        for watch in watched(plant.nights(55, seed), first=FIRST):
            verdict = watch.verdict()
            if verdict.change is None:
                assert verdict.evidence <= verdict.limit
            elif verdict.change.cause not in UNSIZED:
                assert not verdict.present.holds_zero


UNSIZED = ("odd_nights", "back_as_before", "temperature_effect")


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("left", "is_back"), [(0.01, True), (0.15, False)])
def test_what_a_repair_leaves_is_no_change_while_it_could_not_be_detected(
    *, left: float, is_back: bool, seed: int
) -> None:
    """All gaps +30 %, then a repair that leaves 1 %, or 15 %, of them."""

    def growth(night: int) -> Array | float:
        return grown("all_gaps", 0.3 if night < 50 else left, BEGIN)(night)

    watches = watched(Plant(growth=growth).nights(75, seed), first=FIRST)
    changes = [watch.verdict().change for watch in watches[52 - FIRST + 1 :]]
    causes = {None if change is None else change.cause for change in changes}
    assert (causes <= {None, "back_as_before"}) == is_back
    assert changes[0] is not None


@pytest.mark.parametrize("seed", SEEDS)
def test_parts_that_one_pressure_cannot_tell_apart_are_one_class(seed: int) -> None:
    """7c.4: the truth is the sleeve; its class has it, with nearly all of the probability."""
    plant = Plant(operating_point="one pressure", growth=grown("sleeve", 0.40, BEGIN))
    change = watched(plant.nights(45, seed), first=FIRST)[-1].verdict().change
    assert {"piston", "sleeve"} <= set(change.alike)
    told_apart = watched(Plant(growth=grown("sleeve", 0.40, BEGIN)).nights(45, seed), first=FIRST)
    assert told_apart[-1].verdict().change.alike == ()


def crossed(nights: Sequence[NightBlocks], event: int, spread: float) -> list[Watch]:
    """The watch of each night, with an event of the same motor on one."""
    watches = watched(nights[:event], first=FIRST)
    for last in range(event, len(nights)):
        state = watches[-1].state
        before = across_event(state, CB560, last, spread) if last == event else state
        watches.append(Watch(before).after(nights[last], earlier_of(nights[: last + 1])))
    return watches


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("standing", [0.0, 0.12])
def test_an_event_with_the_same_motor_keeps_its_change(standing: float, seed: int) -> None:
    """7c.6: the new oil moves all flows by 6 %, its own: the change stays, or silence."""

    def growth(night: int) -> float:
        return (1.0 + standing * (night >= BEGIN)) * (1.06 if night >= 50 else 1.0)

    watches = crossed(Plant(growth=growth).nights(75, seed), 50, 0.09)
    for watch in watches[50 - FIRST + 1 :]:
        verdict = watch.verdict()
        assert verdict.present.lower < standing < verdict.present.upper
        assert (verdict.change is not None) == (standing > 0.0)


def test_a_crossing_is_kept_and_resumes_to_the_same_bits() -> None:
    nights = Plant().nights(40, 1)
    watch = crossed(nights[:35], 30, 0.09)[-1]
    again = Watch.of_arrays(CB560, watch.state.settings, watch.arrays())
    first, second = (one.after(nights[35], earlier_of(nights[:36])) for one in (watch, again))
    assert first.verdict() == second.verdict()


@pytest.mark.parametrize("by", [0.15, -0.15])
def test_nights_beyond_the_detection_limit_are_counted_and_their_cause_is_open(by: float) -> None:
    """7c.8: until the evidence has reached its limit."""
    watches = watched(Plant(growth=grown("all_flows", by, BEGIN)).nights(34, 1), first=FIRST)
    for night, count in ((BEGIN - 1, 0), (BEGIN, 1), (BEGIN + 1, 2)):
        state = replace(watches[night - FIRST + 1].state, in_force=None)
        assert nights_beyond(state) == count
    evidence = state.evidence_now()
    found = attribute(evidence, state.baseline, np.arange(FIRST, len(state.window)))
    for reached, is_open in ((0.1, False), (-0.1, True)):
        asked = replace(state, evidence=state.settings.limit + reached)
        change = in_force_of(asked, evidence, found, state.day).change
        assert (change.cause == "not_identified" and not change.candidates) == is_open
        assert change.is_rise == (by > 0.0)


def test_leakage_of_a_flushed_motor_is_without_the_flushing() -> None:
    nights = flushed(Plant(growth=grown("sleeve", 0.3, BEGIN)).nights(45, 1), 3.0)
    watch = watched(nights, FLUSHED, first=FIRST)[-1]
    at = np.array([50.0, 200.0, 30.0])
    truth = float(drives(at) @ (COEFFICIENTS * [1.0, 1.0, 1.3, 1.0]))
    assert watch.leakage_at(np.append(drives(at), 0.0), at).value == pytest.approx(truth, rel=0.03)


def test_no_doubt_about_a_flushing_takes_a_change_away() -> None:
    """7c.3: one pressure hardly tells a flushing from the leakage; the drain flow rose by 10 %."""
    plant = Plant(operating_point="one pressure", growth=grown("all_flows", 0.15, BEGIN))
    watches = watched(flushed(plant.nights(36, 1), 1.5), FLUSHED, first=FIRST)
    assert watches[-1].state.baseline.leakage_share_error <= 0.51
    changes = [watch.verdict().change for watch in watches[BEGIN + 2 - FIRST :]]
    assert all(change is not None and change.cause != "odd_nights" for change in changes)
    assert not watches[-1].verdict().present.holds_zero


@pytest.mark.parametrize("seed", SEEDS)
def test_nights_alike_in_a_row_are_no_odd_nights(seed: int) -> None:
    """7c.1: the ordinary nights between odd ones are ordinary."""
    for growth, is_odd in (
        (lambda night: 1.1 if night >= BEGIN and night % 3 == 0 else 1.0, True),
        (grown("all_flows", 0.1, BEGIN), False),
    ):
        watches = watched(Plant(growth=growth).nights(45, seed), first=FIRST)
        state = watches[-1].state
        odd = np.where(state.window.days % 3 == 0, 3.0, 0.0) * (state.window.days >= BEGIN)
        state = replace(state, window=replace(state.window, odd=odd))
        assert odd_nights_are_single(state) == is_odd


@pytest.mark.parametrize("seed", SEEDS)
def test_a_change_at_other_operating_conditions_stands(seed: int) -> None:
    """7c.2: the nights before it share what the model misses at half of the load."""
    plant = Plant(
        growth=grown("all_gaps", 0.2, 45), load=lambda night: 0.5 if night >= BEGIN else 1.0
    )
    watches = watched(plant.nights(62, seed), first=FIRST)
    changes = [watch.verdict() for watch in watches[47 - FIRST :]]
    assert all(verdict.change is not None for verdict in changes)
    assert not any(verdict.present.holds_zero for verdict in changes)
    truth = of_flow([0.2, 0.2, 0.2, 0.0])
    assert changes[-1].present.value == pytest.approx(truth, abs=0.04)
