"""What the first nights fix, and a block in numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from leakage.watch import NightBlocks
from leakage.watch.baseline import Baseline, Columns, baseline_of, knots_at
from tests.leakage.watch.made_machine import CB560, COEFFICIENTS, Film, Plant

Array = NDArray[np.float64]


def mean_residual(baseline: Baseline, nights: Sequence[NightBlocks]) -> float:
    every = [baseline.columns.of_night(night) for night in nights]
    return float(
        np.concatenate([rest - design @ baseline.unknowns for design, rest in every]).mean()
    )


def test_coefficients_of_the_fitted_machine_are_found_again() -> None:
    baseline = baseline_of(CB560, Plant().nights(60, 1))
    assert baseline.columns.theta == pytest.approx(COEFFICIENTS, rel=0.05)
    assert baseline.lack_of_fit < 0.009
    assert (baseline.all_paths[:4] * baseline.share).sum() == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize(
    "plant",
    [
        Plant(),
        Plant(film="slot"),
        Plant(film="turbulent"),
        Plant(operating_point="one pressure"),
        Plant(blocks=5),
        Plant(wander=0.03),
    ],
    ids=["fitted", "slot", "turbulent", "one pressure", "ten minutes", "wild"],
)
@pytest.mark.parametrize("n", [8, 40])
def test_mean_residual_of_the_baseline_is_within_one_per_cent(plant: Plant, n: int) -> None:
    nights = plant.nights(n, 2)
    baseline = baseline_of(CB560, nights)
    assert abs(mean_residual(baseline, nights)) < 0.01
    assert np.all(baseline.columns.theta >= 0.0)


def test_lack_of_fit_tells_the_fitted_machine_from_another() -> None:
    for seed in range(5):
        assert baseline_of(CB560, Plant().nights(15, seed)).lack_of_fit < 0.009
        assert baseline_of(CB560, Plant(film="turbulent").nights(15, seed)).lack_of_fit > 0.03


def test_a_path_that_does_not_leak_has_a_coefficient_of_zero_and_costs_nothing() -> None:
    """A path that would be fitted below 0: clipped afterwards, it would put ŷ off."""
    nights = Plant(growth=lambda _: np.array([1.0, 0.0, 1.0, 1.0])).nights(15, 3)
    pulling = [
        replace(one, flow=one.flow - 0.1 * COEFFICIENTS[1] * one.drives[:, 1]) for one in nights
    ]
    baseline = baseline_of(CB560, pulling)
    assert baseline.columns.theta[1] == 0.0
    assert np.all(baseline.columns.unit > 0.0)
    assert abs(mean_residual(baseline, pulling)) < 0.01


def test_low_flow_has_a_floor_in_the_scale_only() -> None:
    """Half of the blocks nearly still: their expectation stays theirs."""
    nights = []
    for one in Plant().nights(15, 6):
        still = np.where(np.arange(30) % 2, 1.0, 0.02)
        nights.append(replace(one, drives=one.drives * still[:, None], flow=one.flow * still))
    baseline = baseline_of(CB560, nights)
    flow = np.concatenate([one.flow for one in nights])
    expected = np.concatenate([baseline.columns.expected(one.drives) for one in nights])
    assert baseline.columns.least_scale == pytest.approx(0.2 * flow.mean())
    assert expected == pytest.approx(flow, rel=0.08)


def test_one_pressure_tells_no_gap_from_another() -> None:
    still, varied = (
        baseline_of(CB560, Plant(operating_point=operating_point).nights(15, 7))
        for operating_point in ("one pressure", "varied")
    )
    assert (still.identifies_gaps, still.identifies_speed) == (False, False)
    assert (varied.identifies_gaps, varied.identifies_speed) == (True, True)


def test_information_of_a_night_is_about_what_is_left_of_the_baseline() -> None:
    """Solved for all, fifteen nights of the baseline say that the flow has not changed."""
    nights = Plant().nights(15, 10)
    baseline = baseline_of(CB560, nights)
    told = [baseline.information(night) for night in nights]
    certain = sum(one for one, _ in told) + baseline.columns.prior()
    found = np.linalg.solve(certain, sum(score for _, score in told))
    assert abs(found @ baseline.own_row) < 0.003


@pytest.mark.parametrize(("film", "tells"), [("barus", True), ("slot", True), ("turbulent", False)])
def test_gaps_are_not_distinguished_where_the_model_misses_the_shape(
    film: Film, *, tells: bool
) -> None:
    assert baseline_of(CB560, Plant(film=film).nights(15, 1)).identifies_gaps == tells


COLUMNS = Columns(
    sign=np.array([1.0, -1.0]),
    theta=np.array([2.0, 0.0]),
    unit=np.array([2.0, 0.5]),
    least_scale=1.0,
    temperature_c=50.0,
    pressure_knots=np.array([100.0, 200.0]),
    speed_knots=np.array([10.0]),
    has_zero=True,
)
# Warm and busy; at a tenth of the flow, half way between the knots; and beyond them, cold.
NIGHT = NightBlocks(
    7,
    np.array([60.0, 180.0, 300.0]),
    np.array([[2.0, -1.0], [0.2, -1.0], [1.0, 0.0]]),
    np.array([4.4, 0.5, 2.0]),
    np.array([[60.0, 100.0, 10.0], [50.0, 150.0, 10.0], [40.0, 250.0, 10.0]]),
)


def test_residuals_are_shares_of_the_expected_flow_but_for_a_floor_in_the_scale() -> None:
    """By hand: ŷ = 4, 0.4 and 2; at 0.4 it is (0.5 − 0.4)/1, not (0.5 − 1)/1."""
    _, residuals = COLUMNS.of_night(NIGHT)
    assert residuals == pytest.approx([0.1, 0.1, 0.0])


def test_design_is_by_hand() -> None:
    """By columns: paths in their units; warmth in 10 K and its square, of ŷ, and of each path;
    surface, of ŷ; zero of 5 l/min.
    """
    design, _ = COLUMNS.of_night(NIGHT)
    assert COLUMNS.n == 9
    assert design == pytest.approx(
        np.array(
            [
                [1.0, 0.5 / 4.0, 1.0, 1.0, 1.0, 0.5 / 4.0, 1.0, 0.0, 1.25],
                [0.4, 0.5, 0.0, 0.0, 0.0, 0.0, 0.2, 0.2, 5.0],
                [1.0, 0.0, -1.0, 1.0, -1.0, 0.0, 0.0, 1.0, 2.5],
            ]
        )
    )


def test_knots_that_are_near_are_merged() -> None:
    values = np.concatenate([np.full(500, 100.0), np.linspace(101.0, 300.0, 500)])
    knots = knots_at(values, (0.02, 0.35, 0.65, 0.98), 0.10)
    assert len(knots) == 3
    assert np.all(np.diff(knots) > 0.1 * 300.0)
