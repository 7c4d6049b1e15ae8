"""What is told of a motor: what, how much, since when, what else, and what to do."""

from __future__ import annotations

import pytest

from leakage.watch import Estimate
from pipeline.trends.nights.eras import Era
from pipeline.trends.sentences import WHAT, advice, sentence
from pipeline.trends.states.judged import JudgedNight
from tests.pipeline.trends.judged_nights import change, judge, waiting, watched
from tests.pipeline.trends.nights import motor, night_of


def told(night: JudgedNight, *drifts: str) -> tuple[str, str]:
    return sentence(night, night_of(0), drifts), advice(night, drifts)


def test_a_part_is_told_with_its_size_interval_date_and_gap() -> None:
    found = change("balance_sleeve", path_growth=Estimate(0.331, 0.02))
    words, what = told(judge(watched(found)))
    assert words == (
        "leakage of the balance sleeve has risen: case drain flow +20 % [18, 22] tonight, "
        "since 22 January 2026 (21 January 2026 to 23 January 2026); its gap +10 % [9, 11]; "
        "97 % probable"
    )
    assert what == "Plan a look at the balance sleeve."
    alarm = judge(watched(change("balance_sleeve", size=Estimate(0.5, 0.01))))
    assert told(alarm)[1] == "Look at the balance sleeve at the next stop."


def test_ok_says_what_it_would_have_told() -> None:
    words, what = told(judge(watched()))
    assert words == (
        "no change of more than 3 % since 2 January 2026; "
        "case drain flow +0.0 % [-2.0, 2.0] tonight"
    )
    assert what == "Nothing to do."


@pytest.mark.parametrize("cause", [None, "temperature_effect"])
def test_absence_of_an_alarm_is_no_absence_of_change(cause: str | None) -> None:
    words, _ = told(judge(watched(None if cause is None else change(cause))))
    assert "healthy" not in words
    assert "no change " not in words.replace("no change of more than", "")


def test_before_it_can_tell_a_change_it_says_so() -> None:
    words, _ = told(judge(watched(smallest=2.13)))
    assert words.startswith("too few nights since 2 January 2026 to tell a change")


def test_a_cause_that_cannot_be_told_has_its_candidates_and_what_would_tell() -> None:
    found = change(
        "cannot_be_told", candidates={"balance_sleeve": 0.55, "all_flows": 0.4, "oil_grade": 0.05}
    )
    words, what = told(judge(watched(found)))
    assert "cannot be told" in words
    assert "it could be balance sleeve 55 %, all flows (" in words
    assert words.index("balance sleeve 55 %") < words.index("40 %") < words.index("another oil 5 %")
    assert "nights at other pressures and speeds would tell" in what
    assert "oil sample" in what


def test_a_named_cause_has_beside_it_what_else_it_could_be() -> None:
    found = change("balance_sleeve", candidates={"balance_sleeve": 0.93, "all_gaps": 0.06})
    assert told(judge(watched(found)))[0].endswith("97 % probable, else all gaps 6 %")
    sure = change("balance_sleeve", probability=0.999, candidates={"balance_sleeve": 0.999})
    assert told(judge(watched(sure)))[0].endswith("over 99 % probable")


@pytest.mark.parametrize("cause", ["balance_sleeve", "all_gaps", "all_flows", "cannot_be_told"])
def test_a_fall_is_told_as_a_fall(cause: str) -> None:
    found = change(cause, is_rise=False, size=Estimate(-0.2, 0.01))
    words, what = told(judge(watched(found)))
    assert "-20 % [-22, -18]" in words
    assert "risen" not in words
    assert "Look at" not in what
    assert "look at" not in what


@pytest.mark.parametrize("cause", [*WHAT, "balance_sleeve"])
def test_every_cause_has_words_and_advice(cause: str) -> None:
    words, what = told(judge(watched(change(cause))))
    assert "+20 % [18, 22]" in words
    assert "{" not in words + what
    assert what.endswith(".")


def test_all_flows_leaves_wear_oil_and_meter_open() -> None:
    words, what = told(judge(watched(change("all_flows"))))
    assert "all flows have risen together" in words
    assert what == "An oil sample and the flow meter's zero at a halt would tell."


def test_another_grade_is_a_proposal() -> None:
    words, what = told(judge(watched(change("oil_grade", grade=46))))
    assert "as with a thinner oil (ISO VG 46)" in words
    assert "enter the oil_change" in what


def test_a_baseline_that_is_not_whole_says_how_many_nights_it_has_and_why() -> None:
    era = Era(10, 40, "oil change on 2026-01-12")
    words, what = told(judge(waiting(5, era=era)))
    assert words == "5 of 8 nights of a baseline since oil change on 2026-01-12"
    assert what == "Wait for more nights."
    words, _ = told(judge(waiting(5, n_blocks=0), why="stood still"))
    assert words == "5 of 8 nights of a baseline; tonight none: stood still"


def test_a_silent_motor_says_since_when_and_what_stood() -> None:
    night = watched(change("balance_sleeve"), silent=10, n_blocks=0)
    words, what = told(judge(night, why="no new data: no log covers this night"))
    assert words.startswith(
        "nothing is known since 22 January 2026: no new data: no log covers this night; "
        "leakage of the balance sleeve has risen: case drain flow +20 % [18, 22] in its last night"
    )
    assert "logs arrive" in what


def test_a_limit_is_told_first() -> None:
    spec = motor(limits="[limits]\nalarm_l_per_min = 1.4\n")
    words, what = told(judge(watched(reference=Estimate(1.5, 0.02)), spec))
    assert words.startswith(
        "leakage at the reference conditions 1.5 l/min [1.46, 1.54], beyond the motor type's "
        "limit of 1.4 l/min; no change of more than 3 %"
    )
    assert what == "Look at the motor at the next stop."


def test_a_model_that_is_disproved_says_so() -> None:
    words, what = told(judge(watched(change("balance_sleeve"), lack_of_fit=0.09)))
    assert words.endswith("the model misses 9 % of the flow, so no part is named")
    assert "leakage of the balance sleeve" not in words
    assert "look" not in what.lower()


def test_a_sensor_that_drifts_is_named_and_what_to_do_is_one_order() -> None:
    moved = "the zero of the flow sensor has moved"
    words, what = told(judge(watched(change("balance_sleeve"))), moved)
    assert words.endswith(f"; {moved}")
    assert what == "Plan a look at the balance sleeve."
    assert told(judge(watched()), moved)[1] == "Check the sensor whose zero has moved."


def test_what_goes_on_says_so() -> None:
    words, _ = told(judge(watched(change("piston_ring", goes_on=True))))
    assert "23 January 2026); it goes on; 97 % probable" in words


def test_two_parts_are_both_named() -> None:
    words, what = told(judge(watched(change("balance_piston and balance_sleeve"))))
    assert words.startswith("leakage of the balance piston and the balance sleeve has risen")
    assert what == "Plan a look at the balance piston and the balance sleeve."
