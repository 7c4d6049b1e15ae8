"""The pressure of largest leakage: the thesis's 40 bar, the stated values, a search of our own."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from leakage import FilmPressure
from leakage.errors import ParameterError
from leakage.physics.oil import flow_drive_per_s
from leakage.physics.pressure_maximum import pressure_of_largest_leakage_pa
from tests.leakage.placeholders import placeholder_oil


@pytest.mark.parametrize(
    ("film_pressure", "bar"),
    [(None, 40.0), (FilmPressure(share=1.0), 37.04), (FilmPressure(share=0.5), 38.46)],
)
def test_of_the_ring_as_stated(film_pressure: FilmPressure | None, bar: float) -> None:
    found = pressure_of_largest_leakage_pa(120e5, 2e-8, film_pressure)
    assert round(found / 1e5, 2) == bar


@given(
    x_bar=st.floats(50.0, 2000.0),
    alpha=st.floats(1e-9, 5e-8),
    film_pressure=st.one_of(
        st.builds(FilmPressure, share=st.floats(0.0, 1.0)), st.just(FilmPressure("slot"))
    ),
)
def test_is_where_a_search_finds_it(
    x_bar: float, alpha: float, film_pressure: FilmPressure
) -> None:
    oil = placeholder_oil(pressure_viscosity_per_pa=alpha)

    def negative_leakage(bar: float) -> float:
        drive = flow_drive_per_s(bar * 1e5, 50.0, oil, film_pressure)
        return -float(drive) * math.exp(-3.0 * bar / x_bar)

    search = minimize_scalar(
        negative_leakage, bounds=(0.0, x_bar), method="bounded", options={"xatol": 1e-7}
    )
    found = pressure_of_largest_leakage_pa(x_bar * 1e5, alpha, film_pressure) / 1e5
    assert found == pytest.approx(search.x, rel=1e-4)


def test_without_thickening_all_film_pressures_agree() -> None:
    for film_pressure in (None, FilmPressure(), FilmPressure("slot")):
        assert pressure_of_largest_leakage_pa(900e5, 0.0, film_pressure) == pytest.approx(300e5)


@pytest.mark.parametrize("x_pa", [0.0, -1.0, np.inf, np.nan])
def test_a_constant_that_is_none_is_refused(x_pa: float) -> None:
    with pytest.raises(ParameterError) as caught:
        pressure_of_largest_leakage_pa(x_pa)
    assert caught.value.code == "path_constant"
