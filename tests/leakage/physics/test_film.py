"""Film thickness ratio, and regimes against the thesis's table."""

from __future__ import annotations

import math

import pytest
from hypothesis import strategies as st

from leakage.errors import ParameterError
from leakage.physics.annular_gap import REGIMES, film_thickness_ratio

LENGTHS_M = st.floats(1e-8, 1e-4)


def test_ratio_by_hand() -> None:
    # h(1 - e) = 12 µm · 0.75 = 9 µm; √(0.3² + 0.4²) = 0.5 µm.
    assert float(film_thickness_ratio(12e-6, 0.25, 0.3e-6, 0.4e-6)) == pytest.approx(18.0)


def test_regimes_leave_no_ratio_out() -> None:
    """Section 2.2.4, after reference [12]."""
    lowest, highest = zip(*REGIMES.values(), strict=True)
    assert lowest == (0.0, 1.0, 3.0, 5.0)
    assert highest == (1.0, 5.0, 10.0, math.inf)
    assert all(low <= end for low, end in zip(lowest[1:], highest, strict=False))


def test_nonsense_is_refused() -> None:
    for gap_m, e, roughness_m in (
        (-1e-6, 0.0, 2e-7),
        (1e-6, 1.1, 2e-7),
        (1e-6, -0.1, 2e-7),
        (1e-6, 0.0, 0.0),
        (1e-6, 0.0, math.nan),
    ):
        with pytest.raises(ParameterError):
            film_thickness_ratio(gap_m, e, roughness_m, 0.0)
    with pytest.raises(ParameterError):
        film_thickness_ratio(1e-6, 0.0, 2e-7, -2e-7)
