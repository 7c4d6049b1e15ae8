"""A motor's course: paths, leakages and gap changes."""

from __future__ import annotations

import datetime as dt

import numpy as np
import polars as pl
import pytest

from pipeline.schema import BASELINES, TRENDS, frame
from tests.pipeline.report.nights import (
    FIRST,
    ONE_DAY,
    fit,
    history,
    parameter,
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


def baselines(*frozen: tuple[dt.date, dt.date, float]) -> dict[str, pl.DataFrame]:
    """Baselines of the ring: first night, night in which it was frozen, mean."""
    key = {"motor_id": "M", "indicator": "K_piston_ring"}
    rows = [key | {"start": start, "night": night, "mean": mean} for start, night, mean in frozen]
    return {"baselines": frame(BASELINES, rows)}


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
    motor = history([fit(number) for number in range(12)], rows, baselines((FIRST, FIRST, k)))
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


def test_gaps_are_relative_to_the_baseline_of_their_night() -> None:
    """Two freezes of one baseline, the second of which holds, and a later baseline."""
    rows = [parameter(n, "K_piston_ring", 2e-14, 1e-16) for n in range(6)]
    later = FIRST + 3 * ONE_DAY
    frozen = [(FIRST, FIRST + ONE_DAY, 9e-14), (FIRST, later, 1e-14), (later, later, 2e-14)]
    motor = history([fit(n) for n in range(6)], rows, baselines(*frozen))
    change = motor.gap_changes()["piston_ring"].value
    assert change[:3] == pytest.approx(100 * (2 ** (1 / 3) - 1))
    assert change[3:] == pytest.approx(0.0, abs=1e-9)


def test_leakage_at_the_motor_s_own_conditions_stands_in_before_each_night_s() -> None:
    key = {"motor_id": "M", "indicator": "own_reference_leakage"}
    rows = [key | {"night": FIRST + n * ONE_DAY, "value": 4.0 + n} for n in (1, 7)]
    own = {"own_conditions_leakage_l_per_min": 4.2}
    nights = [fit(n, None, **own) for n in range(3)]
    motor = history(nights, trends={"trends": frame(TRENDS, rows)})
    assert motor.leakage_kind == "frozen"
    # A night of which there is no fit is none of the motor's nights.
    assert motor.frozen.value[1] == 5.0
    assert np.isnan(motor.frozen.value[[0, 2]]).all()


def test_leakage_at_own_conditions_stands_in_where_there_is_no_other() -> None:
    own = {"own_conditions_leakage_l_per_min": 4.2}
    assert history([fit(0, None, **own)]).leakage_kind == "own"
    assert history([fit(0, None, **own), fit(1, 1.4, **own)]).leakage_kind == "reference"
    assert history([]).leakage_kind == "reference"


def test_a_motor_without_nights_has_an_empty_history() -> None:
    motor = history([])
    assert motor.nights == ()
    assert motor.gap_changes() == {}


def test_without_a_baseline_there_is_no_gap_change() -> None:
    rows = [parameter(n, "K_piston_ring", 1e-14, 1e-15) for n in range(3)]
    assert history([fit(n) for n in range(3)], rows).gap_changes() == {}
