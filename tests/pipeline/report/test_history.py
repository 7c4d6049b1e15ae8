"""A motor's course: leakages by their conditions, and the nights that count."""

from __future__ import annotations

from typing import Any

import numpy as np

from tests.pipeline.report.nights import fit, history, trend, unfitted

OWN = {"own_conditions_leakage_l_per_min": 4.2}


def own_reference(*nights: int) -> dict[str, Any]:
    rows = [trend(n, "own_reference_leakage", 4.0 + n) for n in nights]
    return {"trends": rows}


def test_nights_without_a_figure_and_nights_that_do_not_count_have_no_value() -> None:
    rows = [trend(n, "K_piston_ring", 1e-14) for n in (0, 2)]
    rows.append(trend(1, "K_piston_ring", 9e-14, gated_reason="too little of it is known"))
    nights = [fit(0), fit(1, None), unfitted(2, "failed", "x"), fit(3)]
    course = history(nights, rows).course("K_piston_ring")
    assert np.isnan(course.value).tolist() == [False, True, False, True]


def test_a_night_of_which_there_is_no_fit_is_none_of_the_motor_s_nights() -> None:
    motor = history([fit(n, None, **OWN) for n in range(3)], **own_reference(1, 7))
    value = motor.leakages["frozen"].value
    assert value[1] == 5.0
    assert np.isnan(value[[0, 2]]).all()


def test_the_most_comparable_leakage_that_is_known_stands_for_the_motor() -> None:
    assert history([fit(0, 1.4, **OWN)], **own_reference(0)).leakage_kind == "reference"
    assert history([fit(0, None, **OWN)], **own_reference(0)).leakage_kind == "frozen"
    comparable = [trend(0, "comparable_drain_flow", 4.4)]
    assert history([fit(0, None, **OWN)], comparable).leakage_kind == "comparable"
    assert history([fit(0, None, **OWN)]).leakage_kind == "own"
    assert history([fit(0, None, mean_flow_l_per_min=5.0)]).leakage_kind == "flow"
    assert history([]).leakage_kind == "reference"


def test_the_leakage_of_the_trends_goes_before_that_of_the_night_s_fit() -> None:
    motor = history([fit(0, 1.4)], [trend(0, "reference_leakage", 1.5)])
    assert motor.leakages["reference"].value.tolist() == [1.5]


def test_the_drain_flow_of_the_fit_stands_in_for_nights_without_trends() -> None:
    nights = [fit(n, mean_flow_l_per_min=5.0) for n in range(2)]
    assert history(nights, [trend(0, "drain_flow", 6.0)]).flow.value.tolist() == [6.0, 5.0]


def test_the_newest_baseline_holds() -> None:
    rows = [trend(n, "K_piston_ring", 1.0, baseline_mean=mean) for n, mean in enumerate((1.0, 2.0))]
    motor = history([fit(n) for n in range(3)], [*rows, trend(2, "K_piston_ring", None)])
    assert motor.baseline("K_piston_ring") == 2.0
    assert motor.baseline("K_balance_sleeve") is None


def test_a_motor_without_nights_has_an_empty_history() -> None:
    motor = history([])
    assert motor.nights == ()
    assert len(motor.course("K_piston_ring").value) == 0
