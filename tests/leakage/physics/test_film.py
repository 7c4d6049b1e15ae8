"""Film thickness ratio."""

from __future__ import annotations

import math

import pytest

from leakage.errors import ParameterError
from leakage.physics.annular_gap import film_thickness_ratio


def test_ratio_by_hand() -> None:
    # h(1 - e) = 12 µm · 0.75 = 9 µm; √(0.3² + 0.4²) = 0.5 µm.
    assert float(film_thickness_ratio(12e-6, 0.25, 0.3e-6, 0.4e-6)) == pytest.approx(18.0)
    # One perfectly smooth surface, no gap, and parts that touch are at the edge of what there is.
    for gap_m, e in ((0.0, 0.0), (1e-6, 1.0)):
        assert float(film_thickness_ratio(gap_m, e, 2e-7, 0.0)) == 0.0


@pytest.mark.parametrize(
    ("gap_m", "e", "rough", "other"),
    [
        (-1e-6, 0.0, 2e-7, 0.0),
        (1e-6, 1.1, 2e-7, 0.0),
        (1e-6, -0.1, 2e-7, 0.0),
        (1e-6, 0.0, 0.0, 0.0),
        (1e-6, 0.0, math.nan, 0.0),
        (1e-6, 0.0, 2e-7, -2e-7),
    ],
)
def test_nonsense_is_refused(gap_m: float, e: float, rough: float, other: float) -> None:
    with pytest.raises(ParameterError):
        film_thickness_ratio(gap_m, e, rough, other)
