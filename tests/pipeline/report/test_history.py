"""A motor's course: paths, gap changes and what counts as a change."""

from __future__ import annotations

import datetime as dt

import numpy as np
import pytest

from pipeline.schema import BASELINES, TRENDS, frame
from tests.pipeline.report.nights import (
    FIRST,
    ONE_DAY,
    fit,
    history,
    parameter,
    scattered,
    unfitted,
)

# model.md, section 3: the CB560 at 200 bar, 50 °C and 30 rpm; flow of one interface of 32, l/min.
FLOWS = {
    "piston_ring": 3.445024e-4,
    "balance_piston": 1.061377e-2,
    "balance_sleeve": 1.529589e-2,
    "cam_roller": 1.660281e-2,
}
# Section 4: its loss factors, m³.
FACTORS = {
    "piston_ring": 7.506312e-14,
    "balance_piston": 1.558230e-14,
    "balance_sleeve": 4.373874e-14,
}
TOTAL = 1.371423


def test_leakage_by_path_adds_up_and_has_the_interval_of_its_loss_factor() -> None:
    rows = [parameter(0, f"share_{path}", 32 * flow / TOTAL, 0.01) for path, flow in FLOWS.items()]
    rows += [parameter(0, f"K_{path}", k, 0.1 * k) for path, k in FACTORS.items()]
    rows.append(parameter(0, "scale_cam_roller", 1.0))
    motor = history([fit(0, TOTAL)], rows)
    assert sum(course.value[0] for course in motor.paths.values()) == pytest.approx(TOTAL, rel=1e-6)
    for path in FACTORS:
        course = motor.paths[path]
        assert course.value[0] == pytest.approx(32 * FLOWS[path], rel=1e-12)
        # The flow is K times what the conditions make of it, so ±10 % of K are ±10 % of the flow.
        assert course.lower[0] == pytest.approx(0.9 * 32 * FLOWS[path], rel=1e-12)
        assert course.upper[0] == pytest.approx(1.1 * 32 * FLOWS[path], rel=1e-12)
    assert np.isnan(motor.paths["cam_roller"].lower[0])


def test_a_gap_30_percent_wider_leaks_by_its_cube() -> None:
    """Q(2h)/Q(h) = 8 (model.md, section 8): a loss factor 1.3³ as large is a gap 30 % wider."""
    k = 5e-14
    rows = [parameter(number, "K_piston_ring", k, 0.05 * k) for number in range(10)]
    rows.append(parameter(10, "K_piston_ring", k * 1.3**3, 0.1 * k))
    rows.append(parameter(11, "K_piston_ring", k * 8, 9 * k))
    motor = history([fit(number) for number in range(12)], rows)
    change = motor.gap_changes()["piston_ring"]
    assert change.value[:10] == pytest.approx(0.0, abs=1e-9)
    assert change.value[10:] == pytest.approx([30.0, 100.0])
    assert change.upper[0] == pytest.approx(100 * (1.05 ** (1 / 3) - 1))
    # An interval that reaches below zero leaves room for a gap that is closed.
    assert change.lower[11] == -100.0


def test_nights_in_which_nothing_is_determined_have_no_value() -> None:
    rows = [parameter(number, "K_piston_ring", 1e-14, 1e-15) for number in (0, 2)]
    rows.append(parameter(1, "K_piston_ring", 9e-14, 1e-15, verdict="not_excited"))
    motor = history([fit(0), fit(1, None), unfitted(2, "failed", "x"), fit(3)], rows)
    assert np.isnan(motor.reference.value).tolist() == [False, True, True, False]
    assert np.isnan(motor.coefficients["K_piston_ring"].value).tolist() == [
        False,
        True,
        False,
        True,
    ]


def test_an_event_starts_anew() -> None:
    levels = [*[1.0] * 12, *[2.0] * 12, 2.2]
    rows = [
        parameter(number, "K_piston_ring", level * 1e-14, 1e-16)
        for number, level in enumerate(levels)
    ]
    fits = [fit(number) for number in range(len(levels))]
    motor = history(fits, rows, [FIRST + 12 * ONE_DAY])
    change = motor.gap_changes()["piston_ring"].value
    assert change[:24] == pytest.approx(0.0, abs=1e-9)
    assert change[24] == pytest.approx(100 * (1.1 ** (1 / 3) - 1))
    assert motor.change(motor.coefficients["K_piston_ring"]) is None  # 13 nights since then
    before = history(fits, rows)
    assert before.gap_changes()["piston_ring"].value[12] == pytest.approx(100 * (2 ** (1 / 3) - 1))


def test_change_is_that_of_medians_and_needs_twenty_nights() -> None:
    values = [*scattered(10, 1.0, 1), *scattered(5, 9.0, 2), *scattered(10, 1.5, 3)]
    values[4], values[20] = 30.0, 0.001  # one wild night in each group moves no median far
    motor = history([fit(number, value) for number, value in enumerate(values)])
    change = motor.change(motor.reference)
    assert change is not None
    assert change.ratio == pytest.approx(1.5, rel=0.02)
    assert change.is_clear
    assert change.percent == pytest.approx(50.0, abs=3.0)
    assert change.gap_percent == pytest.approx(100 * (1.5 ** (1 / 3) - 1), abs=1.0)
    short = history([fit(number, value) for number, value in enumerate(values[:19])])
    assert short.change(short.reference) is None


def test_scatter_alone_is_hardly_ever_a_clear_change() -> None:
    """Thrice the standard error, from ten nights each: some 2 in 100, and never 15 % of scatter."""
    clear = 0
    for seed in range(300):
        values = scattered(40, 1.4, seed, sd=0.03)
        motor = history([fit(number, value) for number, value in enumerate(values)])
        change = motor.change(motor.reference)
        assert change is not None
        assert abs(change.percent) < 15
        clear += change.is_clear
    assert clear < 0.06 * 300


def test_a_frozen_baseline_takes_the_place_of_the_first_nights() -> None:
    """Two freezes of one baseline, the second of which holds, and a later baseline."""
    rows = [parameter(n, "K_piston_ring", 2e-14, 1e-16) for n in range(6)]
    later = FIRST + 3 * ONE_DAY
    frozen = [(FIRST, FIRST + ONE_DAY, 9e-14), (FIRST, later, 1e-14), (later, later, 2e-14)]
    key = {"motor_id": "M", "indicator": "K_piston_ring"}
    baselines = frame(
        BASELINES,
        [key | {"start": start, "night": night, "mean": mean} for start, night, mean in frozen],
    )
    motor = history([fit(n) for n in range(6)], rows, trends={"baselines": baselines})
    change = motor.gap_changes()["piston_ring"].value
    assert change[:3] == pytest.approx(100 * (2 ** (1 / 3) - 1))
    assert change[3:] == pytest.approx(0.0, abs=1e-9)


def test_leakage_at_the_motor_s_own_conditions_stands_in_before_each_night_s() -> None:
    key = {"motor_id": "M", "indicator": "own_reference_leakage"}
    rows = [key | {"night": FIRST + n * ONE_DAY, "value": 4.0 + n} for n in (1, 7)]
    own = {"own_conditions_leakage_l_per_min": 4.2}
    nights = [fit(n, None, **own) for n in range(3)]
    motor = history(nights, trends={"trends": frame(TRENDS, rows)})
    name, course = motor.leakage
    assert name == "frozen"
    # A night of which there is no fit is none of the motor's nights.
    assert course.value[1] == 5.0
    assert np.isnan(course.value[[0, 2]]).all()


def test_leakage_at_own_conditions_stands_in_where_there_is_no_other() -> None:
    own = {"own_conditions_leakage_l_per_min": 4.2}
    assert history([fit(0, None, **own)]).leakage[0] == "own"
    assert history([fit(0, None, **own), fit(1, 1.4, **own)]).leakage[0] == "reference"
    assert history([]).leakage[0] == "reference"


def test_a_motor_without_nights_has_an_empty_history() -> None:
    motor = history([], events=[dt.date(2026, 1, 1)])
    assert motor.nights == ()
    assert motor.change(motor.reference) is None
    assert motor.gap_changes() == {}
