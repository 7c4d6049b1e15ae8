"""A motor's course: the watch's figures, those of the nights' own fits, and nights that count."""

from __future__ import annotations

import numpy as np

from tests.pipeline.report.nights import fit, history, trend, unfitted, watch


def test_nights_without_a_figure_and_nights_that_do_not_count_have_no_value() -> None:
    rows = [trend(n, "K_piston_ring", 1e-14) for n in (0, 2)]
    rows.append(trend(1, "K_piston_ring", 9e-14, gated_reason="too little of it is known"))
    nights = [fit(0), fit(1), unfitted(2, "failed", "x"), fit(3)]
    course = history(nights, trends=rows).course("K_piston_ring")
    assert np.isnan(course.value).tolist() == [False, True, False, True]


def test_a_night_of_which_there_is_no_fit_is_none_of_the_motor_s_nights() -> None:
    motor = history([fit(n) for n in range(3)], [watch(1, 5.0), watch(7, 9.0)])
    assert motor.leakage.value[1] == 5.0
    assert np.isnan(motor.leakage.value[[0, 2]]).all()


def test_the_drain_flow_is_that_which_was_measured() -> None:
    motor = history([fit(0), unfitted(1, "failed", "x")])
    assert motor.flow.value[0] == 5.0
    assert np.isnan(motor.flow.value[1])


def test_a_motor_without_nights_has_an_empty_history() -> None:
    motor = history([])
    assert motor.nights == ()
    assert len(motor.course("K_piston_ring").value) == len(motor.watched("evidence")) == 0
