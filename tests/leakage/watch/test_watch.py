"""The watch as a whole, on made nights whose changes are known."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from leakage.watch import (
    Change,
    Machine,
    NightBlocks,
    Watch,
    WatchSettings,
    choices,
    wander,
)
from leakage.watch.adoption import with_evidence, with_new_wander
from tests.leakage.watch.made_machine import (
    CB560,
    COEFFICIENTS,
    VG_46,
    VG_68,
    Plant,
    drives,
    earlier_of,
    first_told,
    grown,
    of_flow,
    watched,
)

Array = NDArray[np.float64]

SEEDS = (1, 2)
FIRST, BEGIN = 15, 30
# Shares of ring, piston, sleeve and roller in the flow of the fitted machine.
SHARES = np.array([of_flow(path) for path in np.eye(4)])


@cache
def story(plant: Plant, n: int, seed: int) -> tuple[Watch, ...]:
    return tuple(watched(plant.nights(n, seed), first=FIRST))


def told_of(plant: Plant, n: int, seed: int) -> tuple[Watch, Change, Change]:
    """The watch when a change was detected, that change, and the one in force at the end."""
    watches = story(plant, n, seed)
    told = first_told(watches)
    first, last = told.verdict().change, watches[-1].verdict().change
    return told, first, last


# Plants are the keys of stories: one object each.
GAPS_10, GAPS_20 = (Plant(growth=grown("all_gaps", by, BEGIN)) for by in (0.10, 0.20))
FALL = Plant(growth=grown("all_gaps", -0.15, BEGIN))
METER = Plant(growth=grown("all_flows", 0.10, BEGIN))
OIL = Plant(oil=lambda night: VG_46 if night >= BEGIN else VG_68)
SENSOR = Plant(offset_c=lambda night: -3.0 if night >= BEGIN else 0.0)
SLEEVE = Plant(growth=grown("sleeve", 0.30, BEGIN))
REPAIRED = Plant(growth=grown("sleeve", 0.30, BEGIN, 50))
RING = Plant(growth=lambda night: np.array([1.0 + 0.03 * max(0, night - 29), 1.0, 1.0, 1.0]))
THIRD = Plant(growth=lambda night: 1.1 if night >= 25 and night % 3 == 0 else 1.0)
ONCE = Plant(growth=lambda night: 1.3 if night == 25 else 1.0)
TWO = Plant(growth=lambda n: 1.0 + 0.3 * np.array([0, n >= 60, n >= BEGIN, 0]))
# In eight nights to half as much again.
QUICK = Plant(growth=lambda night: 1.0 + 0.5 * min(max(night - 29, 0), 8) / 8)
FASTER = Plant(growth=lambda night: 1.0 + 0.001 * max(0, night - 29) ** 2)
# Twelve degrees in 90 nights; the pistons' flow grows by 1 % a kelvin, the others' does not.
UNALIKE = Plant(
    warmer_c=lambda night: 12.0 * min(night / 90, 1.0) - 6.0, by_warmth=(0.0, 0.01, 0.0, 0.0)
)
ERA = Plant(growth=lambda night: (1.0 + 0.4 * (night >= BEGIN)) * (1.0 + 0.1 * (night >= 60)))
HEALTHY, LIGHTER = Plant(), Plant(load=lambda night: 0.5 if night >= BEGIN else 1.0)
SMALL = Machine(("gap",), ("gap",))


def small_nights(n: int, seed: int, growth: Callable[[int], float]) -> list[NightBlocks]:
    """A cheap machine of one path and five blocks at one operating conditions."""
    generator = np.random.default_rng(seed)
    middle_s, made = 120.0 * np.arange(5.0) + 60.0, []
    conditions = np.tile([50.0, 180.0, 30.0], (5, 1))
    for night in range(n):
        moved = growth(night) * (1.0 + 0.01 * generator.standard_normal())
        drive = generator.uniform(0.9, 1.1, (5, 1))
        flow = 2.0 * drive[:, 0] * moved * (1.0 + 0.003 * generator.standard_normal(5))
        warm = conditions + generator.normal(0.0, 1.0, 3) * [1.0, 0.1, 0.01]
        made.append(NightBlocks(night + night // 100, middle_s, drive, flow, warm))
    return made


def assert_resumes(nights: Sequence[NightBlocks], machine: Machine, first: int) -> list[Watch]:
    """Kept every night and taken up again, the watch is the same to the last bit."""
    settings = WatchSettings(baseline_nights=first)
    straight = watched(nights, machine, settings)
    kept = straight[0].arrays()
    for night, watch in zip(range(first, len(nights)), straight[1:], strict=True):
        before = {name: array.copy() for name, array in kept.items()}
        resumed = Watch.of_arrays(machine, settings, kept)
        resumed = resumed.after(nights[night], earlier_of(nights[: night + 1]))
        # Neither the arrays nor what is known of a night depends on what comes after it.
        assert all(np.array_equal(kept[name], before[name], equal_nan=True) for name in kept)
        kept, ours = resumed.arrays(), watch.arrays()
        assert kept.keys() == ours.keys()
        for name, array in ours.items():
            assert np.array_equal(kept[name], array, equal_nan=True), (night, name)
        assert resumed.verdict() == watch.verdict()
    return straight


def test_kept_arrays_resume_to_the_same_bits_across_adoption_and_era() -> None:
    watches = assert_resumes(ERA.nights(75, 1), CB560, FIRST)
    assert watches[-1].state.carried.value > 0.0


def test_kept_arrays_stay_of_one_size_and_resume_in_a_long_history(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(choices, "WINDOW", 60)
    monkeypatch.setattr(choices, "WINDOW_SLACK", 10)
    nights = small_nights(95, 1, lambda night: 1.0 + 0.1 * (night >= 78))
    watches = assert_resumes(nights, SMALL, 8)
    sizes = [sum(array.nbytes for array in watch.arrays().values()) for watch in watches]
    assert max(sizes[70:]) < 1.1 * max(sizes[:70])
    # Summed up or not, the same change is detected.
    change = watches[-1].verdict().change
    assert change.since == nights[78].day
    assert change.size.value == pytest.approx(0.1, abs=0.02)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(
    ("plant", "cause", "flow", "within"),
    [
        (GAPS_10, "all_gaps", 0.10 * SHARES[:3].sum(), 4),
        (GAPS_20, "all_gaps", 0.20 * SHARES[:3].sum(), 2),
        (FALL, "all_gaps", -0.15 * SHARES[:3].sum(), 3),
        (SLEEVE, "sleeve", 0.30 * SHARES[2], 3),
        (METER, "all_flows", 0.10, 5),
        (OIL, "oil_grade", 0.43, 5),
        (SENSOR, "temperature_sensor", 0.137, 5),
    ],
    ids=["gaps", "large", "fall", "sleeve", "meter", "oil", "sensor"],
)
def test_a_step_is_told_with_its_cause_its_size_and_its_begin(
    plant: Plant, cause: str, flow: float, within: int, seed: int
) -> None:
    told, first, last = told_of(plant, 50, seed)
    assert BEGIN <= told.day < BEGIN + within
    assert (last.shape, first.is_rise, last.is_rise) == ("step", flow > 0.0, flow > 0.0)
    assert last.since == BEGIN
    assert abs(first.size.value - flow) < 3.0 * first.size.sd
    assert last.size.value == pytest.approx(flow, rel=0.1)
    # Where it cannot be identified, the right one is the likeliest: never another.
    is_of_all_flows = plant in (METER, OIL, SENSOR)
    assert last.cause == cause or (is_of_all_flows and last.cause == "not_identified")
    assert next(iter(last.candidates)) == cause
    assert last.grade == (46 if cause == "oil_grade" else None)
    if cause == "sleeve":
        assert last.probability > 0.9
        assert last.path_growth.value == pytest.approx(0.30, abs=0.03)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_ring_that_wears_goes_on_and_keeps_its_begin(seed: int) -> None:
    told, first, last = told_of(RING, 80, seed)
    assert told.day < BEGIN + 10
    assert (first.shape, first.continues) == ("ramp", False)
    assert next(iter(first.candidates)) == "ring"
    assert (last.cause, last.continues, last.is_rise) == ("ring", True, True)
    assert last.detected_on > told.day
    assert last.since == pytest.approx(BEGIN, abs=2)
    assert last.size.value == pytest.approx(0.03 * 50 * SHARES[0], abs=0.012)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_repair_is_told_and_at_rest_afterwards(seed: int) -> None:
    watches = story(REPAIRED, 75, seed)
    changes = [change for watch in watches if (change := watch.verdict().change)]
    assert changes[0].cause == "sleeve"
    back = next(one for one in changes if one.cause == "back_as_before")
    assert not back.is_rise
    assert back.since == 50
    last = watches[-1].verdict()
    assert last.change is None
    assert last.present.value == pytest.approx(0.0, abs=0.01)


def test_odd_nights_again_and_again() -> None:
    """Told by the third of them; by chance one of the seeds may take them for a step."""
    told = [first_told(story(THIRD, 36, seed)) for seed in range(1, 6)]
    changes = [c for one in told if one and (c := one.verdict().change) and c.cause == "odd_nights"]
    assert len(changes) >= 4
    assert {(c.shape, c.since, c.detected_on) for c in changes} == {("now and then", 27, 33)}
    assert [c.size.value for c in changes] == pytest.approx([0.10] * len(changes), abs=0.02)


@pytest.mark.parametrize("seed", SEEDS)
def test_what_is_no_change_is_silent(seed: int) -> None:
    """One odd night, half of the load, and nothing at all."""
    for plant in (ONCE, LIGHTER, HEALTHY):
        assert first_told(story(plant, 50, seed)) is None
    # At usual operating conditions a level has no error of the model's.
    usual = story(HEALTHY, 50, seed)[-1].state
    beyond = usual.level_along(usual.baseline.all_flows).beyond
    assert np.median(beyond) == 0.0
    assert beyond == pytest.approx(np.clip(usual.window.distance - 1.5, 0.0, 4.0))
    # Of one night no more than its rarity can be left: −ln 0.003 = 5.8.
    assert max(watch.verdict().evidence for watch in story(ONCE, 50, seed)) < 7.0


@pytest.mark.parametrize("seed", SEEDS)
def test_what_grows_on_behind_its_detection_is_one_change(seed: int) -> None:
    """It is detected within the eight nights, and its size follows it to the end."""
    told, first, _ = told_of(QUICK, 60, seed)
    assert told.day < BEGIN + 6
    settled = story(QUICK, 60, seed)[told.day + 9 - FIRST + 1].verdict().change
    assert settled.detected_on == first.detected_on
    assert settled.size.value == pytest.approx(0.5, abs=0.12)
    assert story(QUICK, 60, seed)[-1].verdict().present.value == pytest.approx(0.5, abs=0.04)


@pytest.mark.parametrize("seed", SEEDS)
def test_what_grows_ever_faster_does_not_begin_later_and_later(seed: int) -> None:
    told, first, _ = told_of(FASTER, 52, seed)
    changes = [one.verdict().change for one in story(FASTER, 52, seed)[told.day - FIRST + 1 :]]
    settling = [
        change
        for change in changes
        if change is not None and change.detected_on == first.detected_on
    ]
    assert len(settling) >= 10
    assert max(one.since for one in settling) == first.since


@pytest.mark.parametrize("seed", SEEDS)
def test_a_season_on_parts_that_warm_unalike_is_no_wear(seed: int) -> None:
    assert first_told(story(UNALIKE, 100, seed)) is None


@pytest.mark.parametrize("seed", SEEDS)
def test_a_second_change_keeps_its_own_size(seed: int) -> None:
    """Now against before its own begin; what is present is against the first baseline."""
    watches = story(TWO, 90, seed)
    for watch in watches:
        change = watch.verdict().change
        if change is not None and change.since >= 58:
            assert change.cause in ("piston", "not_identified")
            assert change.size.value == pytest.approx(
                0.3 * SHARES[1] / (1.0 + 0.3 * SHARES[2]), abs=0.015
            )
            if change.path_growth is not None:
                assert change.path_growth.value == pytest.approx(0.3, abs=0.09)
    last = watches[-1].verdict()
    assert last.change.since == 60
    assert last.present.value == pytest.approx(0.3 * SHARES[1:3].sum(), abs=0.012)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_large_change_begins_an_baseline_period_that_carries_what_was_before(seed: int) -> None:
    watches = story(ERA, 75, seed)
    before, after = (watches[night - FIRST + 1] for night in (55, 74))
    assert before.state.carried.value == pytest.approx(0.40, abs=0.02)
    assert before.state.n_baseline < FIRST
    undone = before.state.causes.every[-1]
    assert undone.name == "back_as_before"
    assert (undone.mean, undone.spread) == (1.0, choices.BACK_SPREAD)
    assert undone.direction @ before.state.baseline.own_row == pytest.approx(-0.4 / 1.4, abs=0.02)
    assert before.verdict().present.value == pytest.approx(0.40, abs=0.02)
    assert after.verdict().present.value == pytest.approx(1.4 * 1.1 - 1.0, abs=0.025)
    assert after.verdict().newest_night.value == pytest.approx(1.4 * 1.1 - 1.0, abs=0.04)
    # What is in force is sized along the flows of the new period.
    begun = next(watch for watch in watches if watch.state.n_baseline < FIRST)
    assert begun.state.in_force.along == pytest.approx(begun.state.baseline.all_flows)


@pytest.mark.parametrize("seed", SEEDS)
def test_two_causes_at_once_are_several_and_named_as_none(seed: int) -> None:
    both = np.array([1.43, 1.1, 1.1, 1.1])
    plant = Plant(growth=lambda night: both if night >= BEGIN else 1.0)
    change = watched(plant.nights(40, seed), first=FIRST)[-1].verdict().change
    assert change.cause == "not_identified"
    assert next(iter(change.candidates)) == "several"
    assert change.size.value == pytest.approx(0.10 + 0.33 * SHARES[0], abs=0.012)


@pytest.mark.parametrize("seed", SEEDS)
def test_at_one_pressure_no_gap_is_named(seed: int) -> None:
    plant = Plant(operating_point="one pressure", growth=grown("sleeve", 0.30, BEGIN))
    watches = watched(plant.nights(45, seed), first=FIRST)
    changes = [change for watch in watches if (change := watch.verdict().change)]
    assert {change.cause for change in changes} == {"not_identified"}
    # One gap or all of them: together likely, each alone not.
    assert min(change.probability for change in changes) > 0.8
    at = drives(np.array([50.0, 180.0, 30.0])) * COEFFICIENTS
    wanted = 0.30 * at[2] / at.sum()
    assert watches[-1].verdict().present.value == pytest.approx(wanted, abs=0.012)


@pytest.mark.parametrize("seed", SEEDS)
def test_size_on_a_machine_that_is_not_the_fitted_one(seed: int) -> None:
    """Told, with its size, and no part blamed."""
    plant = Plant(film="turbulent", growth=grown("all_gaps", 0.20, BEGIN))
    watches = watched(plant.nights(50, seed), first=FIRST)
    told, last = first_told(watches), watches[-1].verdict()
    assert told.day < BEGIN + 4
    assert last.present.value == pytest.approx(
        of_flow(np.array([0.2, 0.2, 0.2, 0.0]), "turbulent"), abs=0.02
    )
    assert {c.cause for watch in watches if (c := watch.verdict().change)} <= {
        "not_identified",
        "all_gaps",
    }


@pytest.mark.parametrize("seed", SEEDS)
def test_a_name_is_careful_where_the_model_is_wrong(seed: int) -> None:
    """Sharp where it is right: 1.00; the shape of a change may err by the lack of fit."""
    growth = grown("piston", 0.4, BEGIN)
    right, wrong = (
        watched(Plant(film=film, growth=growth).nights(40, seed), first=FIRST)[-1].verdict().change
        for film in ("barus", "turbulent")
    )
    assert (right.cause, round(right.probability, 2)) == ("piston", 1.0)
    assert wrong.cause == "not_identified"


def test_the_evidence_of_the_smallest_change_is_the_limit() -> None:
    """Student's t of a step ten nights ago, with its share of the prior among causes and shapes."""
    healthy = story(HEALTHY, 50, 1)
    # Before there is a night behind the baseline, no night may hold a change.
    assert healthy[0].verdict().smallest is None
    watch = healthy[40 - FIRST]
    state, evidence = watch.state, watch.state.evidence_now()
    told = evidence.of_starts(np.array([len(state.window) - 10]))
    names = [one.name for one in evidence.causes.every]
    sd = (float(told.second[0, 0, names.index("all_flows")]) + 0.3**-2) ** -0.5
    freedom = state.wander.degrees_of_freedom(state.n_nights, np.array([10.0])).item()
    smallest = watch.verdict().smallest
    gain = (smallest / sd) ** 2
    ratio = 0.5 * (freedom + 1) * np.log1p(gain / freedom) + np.log(2 * sd / 0.3)
    assert ratio - np.log(2 * len(names)) == pytest.approx(state.settings.limit)


def test_the_wander_is_estimated_anew_as_the_nights_grow_by_three_tenths() -> None:
    """Not where something may be about to be detected: from evidence of 6 on."""
    watches = story(HEALTHY, 50, 1)
    assert sorted({watch.state.due for watch in watches}) == [20, 26, 34, 45, 59]
    state = watches[-1].state
    so_far = state.n_nights - 1
    for due, evidence, is_anew in (
        (so_far, 5.99, True),
        (so_far, 6.0, False),
        (so_far + 1, 0.0, False),
        (0, 0.0, False),
    ):
        asked = replace(state, due=due, evidence=evidence)
        assert (with_new_wander(asked) is not asked) == is_anew


def test_leakage_at_conditions_follows_the_worn_path() -> None:
    watch = story(SLEEVE, 50, 1)[-1]
    for conditions in ([50.0, 200.0, 30.0], [46.0, 80.0, 60.0]):
        at = np.array(conditions)
        truth = float(drives(at) @ (COEFFICIENTS * [1.0, 1.0, 1.3, 1.0]))
        told = watch.leakage_at(drives(at), at)
        assert told.value == pytest.approx(truth, rel=0.02)
        assert abs(told.value - truth) < 4.0 * told.sd
        # What the model misses of the baseline, it may miss there: 0.3 of it, beside the rest.
        baseline = replace(watch.state.baseline, lack_of_fit=0.1)
        poor = Watch(replace(watch.state, baseline=baseline)).leakage_at(drives(at), at)
        assert poor.sd == pytest.approx(np.hypot(told.sd, 0.03 * poor.value), rel=0.01)


def test_change_since_is_what_others_on_the_tank_are_asked() -> None:
    watch = story(METER, 45, 2)[35 - FIRST]
    told = watch.change_since(BEGIN)
    assert told.lower < 0.10 < told.upper
    assert watch.change_since(0) is None
    assert watch.change_since(36) is None
    # Adopted ten nights after it was detected, it is what has changed for others that are told
    # later.
    adopted = story(METER, 45, 2)[-1]
    assert adopted.state.in_force.attribution is None
    later = adopted.change_since(BEGIN)
    assert later.lower < 0.10 < later.upper
    before = adopted.change_since(40)
    assert before.lower < 0.0 < before.upper


# Evidence by an independent implementation of the same description (dense matrices, other
# optimisers, one effect of temperature without a bend), of nights that do not remember one another,
# without a line beside their wander, and of starts behind the baseline alone.
INDEPENDENT = {
    "sleeve": {20: 1.553, 40: 1.004, 60: 3.885, 80: 1.887, 119: 1.547, 120: 2.448, 122: 3.496},
    "all_flows": {100: 1.164, 110: 1.687, 120: 1.046, 121: 4.443, 122: 6.572},
}


@pytest.mark.parametrize(("path", "by"), [("sleeve", 0.03), ("all_flows", -0.015)])
def test_evidence_agrees_with_an_independent_implementation(
    path: str, by: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ring and sleeve beside a constant and the known roller: the balance piston is missed."""
    monkeypatch.setattr(wander, "PHI", np.full(len(wander.PHI), 1e-6))
    monkeypatch.setattr(choices, "LINE_PRIOR", 1e-9)
    monkeypatch.setattr(choices, "PATH_TEMPERATURE_PRIOR", 1e-6)
    paths = ("ring", "sleeve", "flushing", "known")
    nights = [
        replace(night, drives=night.drives[:, [0, 2, 0, 3]] * [1, 1, 0, 1] + [0, 0, 1, 0])
        for night in Plant(growth=grown(path, by, 120)).nights(123, 7)
    ]
    watches = watched(nights, Machine(paths, paths[:2], VG_68), first=FIRST)
    baseline = watches[0].state.baseline
    assert baseline.lack_of_fit == pytest.approx(0.0507, rel=0.05)
    in_theirs = baseline.columns.theta / [7.148e-14, 6.756e-14, 0.0354, 0.9942]
    assert in_theirs[[1, 3]] == pytest.approx([1.0, 1.0], abs=0.01)
    for night, wanted in INDEPENDENT[path].items():
        state = watches[night - FIRST + 1].state
        behind = with_evidence(state, state.evidence_now(), state.place(state.first_step))
        assert behind.evidence == pytest.approx(wanted, abs=0.06)
