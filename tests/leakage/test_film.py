"""Film thickness ratio, regimes and plausibility, against the thesis's tables."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from leakage.errors import ParameterError
from leakage.film import (
    REGIME_TABLES,
    RegimeTable,
    film_thickness_ratio,
    gap_plausibility,
    lubrication_regimes,
)

LENGTHS_M = st.floats(1e-8, 1e-4)


def test_ratio_by_hand() -> None:
    # h(1 - e) = 12 µm · 0.75 = 9 µm; √(0.3² + 0.4²) = 0.5 µm.
    assert float(film_thickness_ratio(12e-6, 0.25, 0.3e-6, 0.4e-6)) == pytest.approx(18.0)


@given(gap_m=LENGTHS_M, roughness_m=LENGTHS_M, scale=st.floats(0.1, 10.0), e=st.floats(0.0, 0.99))
def test_ratio_has_no_dimension(gap_m: float, roughness_m: float, scale: float, e: float) -> None:
    ratio = film_thickness_ratio(gap_m, e, roughness_m, 0.0)
    larger = film_thickness_ratio(scale * gap_m, e, scale * roughness_m, 0.0)
    assert float(larger) == pytest.approx(float(ratio), rel=1e-12)


@given(gap_m=LENGTHS_M, e=st.floats(0.0, 0.9), step=st.floats(0.01, 0.1))
def test_ratio_falls_with_eccentricity_to_0_at_touch(gap_m: float, e: float, step: float) -> None:
    at_e, further, touching = film_thickness_ratio(gap_m, [e, e + step, 1.0], 0.2e-6, 0.2e-6)
    assert at_e > further >= touching == 0.0


@pytest.mark.parametrize(
    ("ratio", "table", "expected"),
    [
        (0.5, "[12]", ("boundary",)),
        (2.0, "[12]", ("mixed",)),
        (4.0, "[12]", ("mixed", "elastohydrodynamic")),
        (7.0, "[12]", ("elastohydrodynamic", "hydrodynamic")),
        (50.0, "[12]", ("hydrodynamic",)),
        (500.0, "[12]", ("hydrodynamic",)),
        (0.5, "[13]", ("boundary",)),
        (2.0, "[13]", ("mixed",)),
        (4.0, "[13]", ("elastohydrodynamic",)),
        (7.0, "[13]", ("elastohydrodynamic", "hydrodynamic")),
        (50.0, "[13]", ("hydrodynamic",)),
    ],
)
def test_regimes_of_the_two_tables(
    ratio: float, table: RegimeTable, expected: tuple[str, ...]
) -> None:
    assert lubrication_regimes(ratio, table) == expected


@pytest.mark.parametrize("table", sorted(REGIME_TABLES))
@given(ratio=st.floats(0.0, math.inf))
def test_every_ratio_has_a_regime(table: RegimeTable, ratio: float) -> None:
    assert 1 <= len(lubrication_regimes(ratio, table)) <= 2


@pytest.mark.parametrize(
    ("gap_um", "expected"),
    [
        (0.0, "below_usual_films"),
        (0.4, "below_usual_films"),
        (0.6, "elastohydrodynamic_film"),
        (4.9, "elastohydrodynamic_film"),
        (5.1, "hydrodynamic_film"),
        (499.0, "hydrodynamic_film"),
        (501.0, "above_usual_films"),
    ],
)
def test_plausibility_by_usual_film_heights(gap_um: float, expected: str) -> None:
    assert gap_plausibility(gap_um * 1e-6) == expected


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
    for ratio in (-1.0, math.nan):
        with pytest.raises(ParameterError):
            lubrication_regimes(ratio)
        with pytest.raises(ParameterError):
            gap_plausibility(ratio)
    with pytest.raises(ParameterError, match="unknown"):
        lubrication_regimes(1.0, "[11]")  # type: ignore[arg-type]
