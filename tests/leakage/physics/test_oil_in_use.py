"""Ageing between analyses, and the grade that a change suggests, by worked viscosities."""

from __future__ import annotations

import math

import numpy as np
import pytest

from leakage.errors import ShapeError
from leakage.physics.oil_in_use import curve_between, likely_grade
from leakage.physics.walther import kinematic_viscosity_mm2_per_s, walther_coefficients
from tests.leakage.placeholders import placeholder_oil

# model.md, section 2: VG 68 and VG 46 at 50 °C.
VG68_AT_50, VG46_AT_50 = 42.867, 29.973
FRESH, AGED = walther_coefficients(40.0, 68.0, 100.0, 8.7), walther_coefficients(40, 60, 100, 8.0)


@pytest.mark.parametrize("celsius", [0.0, 40.0, 100.0])
def test_log_log_of_the_viscosity_is_linear_in_time(celsius: float) -> None:
    days, curves = [100.0, 200.0], [FRESH, AGED]
    at = [
        math.log10(math.log10(float(kinematic_viscosity_mm2_per_s(celsius, *one)) + 0.7))
        for one in (FRESH, curve_between(125.0, days, curves), AGED)
    ]
    assert at[1] == pytest.approx(at[0] + 0.25 * (at[2] - at[0]), abs=1e-12)


def test_the_last_analysis_holds() -> None:
    assert curve_between(999.0, [100.0, 200.0], [FRESH, AGED]) == pytest.approx(AGED)


def test_analyses_without_dates_are_refused() -> None:
    with pytest.raises(ShapeError):
        curve_between(1.0, [1.0, 2.0], [FRESH])


@pytest.mark.parametrize(
    ("factor", "beta", "expected"),
    [
        # model.md, section 8: β of VG 46 for VG 68, of thinner oil or gain, of T 3 °C low [1/K].
        (VG68_AT_50 / VG46_AT_50, (-0.0046, 0.0003), 46),
        (VG68_AT_50 / VG46_AT_50, None, 46),
        (VG68_AT_50 / VG46_AT_50, (0.0, 0.0003), None),
        (1.25, None, None),
        (1.15, (-0.0021, 0.0003), None),
        (1.0, None, None),
        (1.05, (0.0, 0.0003), None),
    ],
)
def test_a_grade_is_told_from_thinner_oil_and_sensors(
    factor: float, beta: tuple[float, float] | None, expected: int | None
) -> None:
    vg68 = placeholder_oil("VG 68")
    assert likely_grade(vg68, 50.0, (math.log(factor), 0.012), beta) == expected


@pytest.mark.parametrize(("grade", "own"), [(32, "VG 46"), (46, "VG 32"), (68, "VG 46")])
def test_neighbouring_grades_are_told(grade: int, own: str) -> None:
    """By the two data sheets, whose slopes differ."""
    celsius = 55.0
    oils = [placeholder_oil(name) for name in (own, f"VG {grade}")]
    logs = [
        np.log(kinematic_viscosity_mm2_per_s(celsius, one.walther_a, one.walther_b)) for one in oils
    ]
    assert likely_grade(oils[0], celsius, (float(logs[0] - logs[1]), 0.02)) == grade
