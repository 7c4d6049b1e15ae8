"""The thesis's search: its starts, its ends, and that it agrees with the proven minimum."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from leakage.estimation.block_statistics import factor
from leakage.estimation.multi_start import ECCENTRICITY_NUDGE, coefficients_at, points_of, search
from leakage.physics.annular_gap import AnnularGap
from leakage.physics.law import Parameter
from leakage.physics.motor import Motor
from tests.leakage.made_samples import made_samples
from tests.leakage.placeholders import (
    balance_piston,
    eccentricity,
    gap,
    placeholder_motor,
    placeholder_oil,
)

PLAIN = placeholder_motor()


def generator() -> np.random.Generator:
    return np.random.default_rng(20)


@pytest.mark.parametrize("count", [1, 2, 60])
def test_first_is_the_configured_point_the_rest_a_latin_hypercube(count: int) -> None:
    limits = ((-5.0, 0.1), (0.0, 60.0), (1.0, 1.0))
    parameters = [
        Parameter(f"x_{index}", "um", low + 0.3 * width, low, low + width)
        for index, (low, width) in enumerate(limits)
    ]
    points = points_of(parameters, count, generator())
    assert points[0].tolist() == [parameter.value for parameter in parameters]
    for drawn, (low, width) in zip(points[1:].T, limits, strict=True):
        strata = np.floor((drawn - low) / width * (count - 1) * (1.0 - 1e-12))
        assert sorted(strata) == list(range(count - 1))


@pytest.mark.parametrize(
    "motor",
    [
        placeholder_motor(flushing="estimated", flushing_l_per_min=4.0),
        placeholder_motor(flushing="estimated", flushing_l_per_min=4.0, roller_is_free=True),
    ],
    ids=["flushed", "everything free"],
)
def test_all_starts_reach_the_certificate_and_none_goes_below(motor: Motor) -> None:
    r = factor(made_samples(motor))
    found, again = (search(r, motor, generator(), starting_points=5) for _ in range(2))
    assert found.at_minimum == found.starts
    assert len(found.starts) == 5
    assert found.gap == pytest.approx(0.0, abs=1e-7)
    for start, same in zip(found.starts, again.starts, strict=True):
        assert start.cost >= found.proven_minimum.cost * (1.0 - 1e-10)
        # Same seed, same start to the bit.
        assert (start.cost, start.final.tobytes()) == (same.cost, same.final.tobytes())


def test_a_start_is_at_the_minimum_within_a_ten_thousandth_of_the_cost() -> None:
    found = search(factor(made_samples(PLAIN)), PLAIN, generator(), starting_points=1)
    (start,) = found.starts
    near, far = (
        replace(start, cost=found.proven_minimum.cost * (1.0 + above)) for above in (0.9e-4, 1.1e-4)
    )
    told = replace(found, starts=(near, far))
    assert told.at_minimum == (near,)
    assert told.gap == pytest.approx(0.9e-4)


def test_starts_at_the_minimum_share_loss_factors_while_gap_and_eccentricity_spread() -> None:
    made = search(factor(made_samples(PLAIN)), PLAIN, generator(), starting_points=12)
    assert len(made.at_minimum) == 12
    finals = np.array([start.final for start in made.starts])
    found = coefficients_at(PLAIN, finals)[:, :3]
    assert (np.ptp(found, axis=0) / found.mean(axis=0)).max() < 1e-6
    ring_gap, piston_gap, piston_e, sleeve_gap, sleeve_e = finals.T
    assert np.ptp(ring_gap) < 1e-5
    assert min(np.ptp(piston_e), np.ptp(sleeve_e)) > 0.3
    assert min(np.ptp(piston_gap), np.ptp(sleeve_gap)) > 0.5
    piston = PLAIN.paths[1]
    assert isinstance(piston, AnnularGap)
    smallest, largest = piston.feasible_gap_um(float(found[0, 1]))
    assert ((piston_gap > smallest * (1 - 1e-6)) & (piston_gap < largest * (1 + 1e-6))).all()


def test_a_start_at_no_eccentricity_with_the_gap_at_its_maximum_moves() -> None:
    # K_p needs h 10 µm and e 0.4; h can be no more than 10 µm, and at e = 0 nothing pulls on e.
    piston = replace(
        balance_piston(),
        gap=Parameter("h_p", "um", 10.0, 1.0, 10.0),
        eccentricity=eccentricity("p", 0.0),
    )
    motor = replace(PLAIN, paths=(PLAIN.paths[0], piston, *PLAIN.paths[2:]))
    found = search(factor(made_samples(PLAIN)), motor, generator(), starting_points=1)
    (start,) = found.starts
    assert start.initial.tolist() == [8.0, 10.0, ECCENTRICITY_NUDGE, 12.0, 0.3]
    assert start.final[2] > 0.39
    assert start.cost == pytest.approx(found.proven_minimum.cost, rel=1e-9)


def test_nothing_to_search_gives_no_starts() -> None:
    only = replace(balance_piston(), gap=gap("p", 10.0, fixed=True), eccentricity=None)
    for motor, wanted in ((PLAIN, 0), (Motor("fixed", (only,), placeholder_oil()), 10)):
        found = search(factor(made_samples(motor)), motor, generator(), starting_points=wanted)
        assert (found.starts, found.gap) == ((), None)
