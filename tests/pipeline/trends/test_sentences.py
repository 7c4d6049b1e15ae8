"""What is told of a motor: what, how much, since when, what else, and what to do."""

from __future__ import annotations

import pytest

from leakage.watch import Estimate
from pipeline.trends.nights.history import BaselinePeriod
from pipeline.trends.sentences import WHAT, advice, sentence
from pipeline.trends.states.judged import JudgedNight
from tests.pipeline.trends.judged_nights import change, judge, waiting, watched
from tests.pipeline.trends.nights import motor, night_of

SIZE = "case drain flow +20 % [18, 22] on 1 February 2026"
SINCE = "since 22 January 2026 (21 January 2026 to 23 January 2026)"
MOVED = "the zero of the flow sensor has moved"
SLEEVE = "balance_sleeve"


def told(night: JudgedNight, *drifts: str) -> tuple[str, str]:
    return sentence(night, night_of(0), drifts), advice(night, drifts)


@pytest.mark.parametrize(
    ("night", "words", "what"),
    [
        (
            judge(watched(change(SLEEVE, path_growth=Estimate(0.331, 0.02)))),
            f"leakage of the balance sleeve has risen: {SIZE}, {SINCE}; its gap +10 % [9, 11]; "
            "97 % probable",
            "Plan a look at the balance sleeve.",
        ),
        (
            judge(watched()),
            "no change of more than 3 % since 2 January 2026; "
            "case drain flow +0.0 % [-2.0, 2.0] on 1 February 2026",
            "Nothing to do.",
        ),
        (
            judge(watched(silent=3, n_blocks=0)),
            "no change of more than 3 % since 2 January 2026; "
            "case drain flow +0.0 % [-2.0, 2.0] on 29 January 2026",
            "Nothing to do.",
        ),
        (
            judge(watched(change("balance_piston and balance_sleeve"))),
            f"leakage of the balance piston and the balance sleeve has risen: {SIZE}, {SINCE}; "
            "97 % probable",
            "Plan a look at the balance piston and the balance sleeve.",
        ),
        (
            judge(watched(change(SLEEVE, probability=0.999, candidates={"all_gaps": 0.06}))),
            f"leakage of the balance sleeve has risen: {SIZE}, {SINCE}; "
            "over 99 % probable, else all gaps 6 %",
            "Plan a look at the balance sleeve.",
        ),
        (
            judge(watched(change("piston_ring", goes_on=True))),
            f"leakage of the piston ring has risen: {SIZE}, {SINCE}; it goes on; 97 % probable",
            "Plan a look at the piston ring.",
        ),
        (
            judge(watched(change("oil_grade", grade=46))),
            f"flows have risen as with a thinner oil (ISO VG 46): {SIZE}, {SINCE}; 97 % probable",
            "Take an oil sample, or enter the oil_change that was made.",
        ),
        (
            judge(
                watched(
                    change(
                        "cannot_be_told",
                        candidates={"zero": 0.05, SLEEVE: 0.55, "oil_grade": 0.4},
                    )
                )
            ),
            f"the cause of a change cannot be told: {SIZE}, {SINCE}; it could be balance sleeve "
            "55 %, another oil 40 %, the zero of the flow sensor 5 %",
            "An oil sample, the meter's zero at a halt, a second thermometer and nights at other "
            "pressures and speeds would tell.",
        ),
        (
            judge(watched(change(SLEEVE), lack_of_fit=0.09)),
            f"the cause of a change cannot be told: {SIZE}, {SINCE}; it could be a part of the "
            "motor over 99 %; the model misses 9 % of the flow, so no part is named",
            "Plan a look at the motor.",
        ),
        (
            judge(
                watched(
                    change("cannot_be_told", candidates={"all_flows": 0.6, SLEEVE: 0.4}),
                    lack_of_fit=0.03,
                )
            ),
            f"the cause of a change cannot be told: {SIZE}, {SINCE}; it could be all flows (all "
            "gaps worn, another oil, the flow meter) 60 %, balance sleeve 40 %; the model misses "
            "3 % of the flow, so no part is named",
            "An oil sample, the meter's zero at a halt and a second thermometer would tell.",
        ),
        (
            judge(watched(change("cannot_be_told", candidates={"several": 0.9, SLEEVE: 0.1}))),
            f"the cause of a change cannot be told: {SIZE}, {SINCE}; it could be more than one "
            "change at once 90 %, balance sleeve 10 %",
            "Take an oil sample first, and check the flow meter; then plan a look at the motor.",
        ),
        (
            judge(waiting(5, period=BaselinePeriod(10, 40, "oil change on 2026-01-12"))),
            "5 of 8 nights of a baseline since oil change on 2026-01-12",
            "Wait for more nights.",
        ),
        (
            judge(waiting(5, n_blocks=0), why="stood still"),
            "5 of 8 nights of a baseline; 1 February 2026 is none: stood still",
            "Wait for more nights.",
        ),
        (
            judge(watched(change(SLEEVE), silent=10, n_blocks=0), why="no log covers this night"),
            "nothing is known since 22 January 2026: no log covers this night; leakage of the "
            "balance sleeve has risen: case drain flow +20 % [18, 22] on 22 January 2026, "
            f"{SINCE}; 97 % probable",
            "Check whether the motor's logs arrive, and the reason of its last nights.",
        ),
        (
            judge(
                watched(reference=Estimate(1.5, 0.02)),
                motor(limits="[limits]\nalarm_l_per_min = 1.4\n"),
            ),
            "leakage at the reference conditions 1.5 l/min [1.46, 1.54], beyond the motor type's "
            "limit of 1.4 l/min; no change of more than 3 % since 2 January 2026; "
            "case drain flow +0.0 % [-2.0, 2.0] on 1 February 2026",
            "Look at the motor at the next stop.",
        ),
    ],
)  # fmt: skip
def test_a_night_in_words(night: JudgedNight, words: str, what: str) -> None:
    assert told(night) == (words, what)


def test_before_it_can_tell_a_change_it_is_not_ok() -> None:
    assert judge(watched(smallest=0.5)).state == "ok"
    assert judge(watched(smallest=None)).state == "insufficient"
    early = judge(watched(smallest=0.51))
    assert (early.state, early.way) == ("insufficient", "baseline")
    words, what = told(early)
    assert words.startswith("too few nights since 2 January 2026 to tell a change")
    assert what == "Wait for more nights."


def test_an_alarm_asks_for_a_look_at_the_next_stop() -> None:
    alarm = judge(watched(change(SLEEVE, size=Estimate(0.5, 0.01))))
    assert told(alarm)[1] == "Look at the balance sleeve at the next stop."


@pytest.mark.parametrize("cause", [SLEEVE, "all_gaps", "all_flows", "cannot_be_told"])
def test_a_fall_is_told_as_a_fall(cause: str) -> None:
    words, what = told(judge(watched(change(cause, is_rise=False, size=Estimate(-0.2, 0.01)))))
    assert "-20 % [-22, -18]" in words
    assert "risen" not in words
    assert "look at" not in what.lower()


@pytest.mark.parametrize("cause", [*WHAT, SLEEVE])
def test_every_cause_has_words_and_advice(cause: str) -> None:
    words, what = told(judge(watched(change(cause))))
    assert "+20 % [18, 22]" in words
    assert "{" not in words + what
    assert what.endswith(".")


def test_a_sensor_that_drifts_is_named_and_what_to_do_is_one_order() -> None:
    words, what = told(judge(watched(change(SLEEVE))), MOVED)
    assert words.endswith(f"; {MOVED}")
    assert what == "Plan a look at the balance sleeve."
    assert told(judge(watched()), MOVED)[1] == "Check the sensor whose zero has moved."
