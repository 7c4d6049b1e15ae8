"""A block in numbers."""

from __future__ import annotations

import numpy as np
import pytest

from leakage.watch import NightBlocks
from leakage.watch.baseline import Columns, knots_at

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
