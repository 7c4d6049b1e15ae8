"""States and words of a night: what each asks of the watch (issue 36, model.md 7b)."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from leakage.watch import Change, Estimate, Verdict
from pipeline.config import MotorSpec
from pipeline.config.settings import Conditions
from pipeline.trends.nights.history import BaselinePeriod
from pipeline.trends.sentences import WHAT, advice, sentence
from pipeline.trends.states.course import Baseline
from pipeline.trends.states.night_state import NightState, model_verdict, with_state
from tests.pipeline.trends.nights import motor, night_of

LIMIT = math.log(365.0 / 0.04)
PATHS = ("piston_ring", "balance_piston", "balance_sleeve")
AT = 30


def change(cause: str, **more: Any) -> Change:
    """A rise by 20 % since night 20, told on night 21."""
    fields: dict[str, Any] = {
        "cause": cause,
        "probability": 0.97,
        "candidates": {cause: 0.97, "all_gaps": 0.03},
        "alike": (),
        "is_rise": True,
        "shape": "step",
        "since": night_of(20).toordinal(),
        "since_lower": night_of(19).toordinal(),
        "since_upper": night_of(21).toordinal(),
        "detected_on": night_of(21).toordinal(),
        "size": Estimate(0.2, 0.01),
    }
    return Change(**(fields | more))


def watched(found: Change | None = None, **more: Any) -> NightState:
    """Night 30 with a baseline of eight nights; `more` are fields of it or of its verdict."""
    size = Estimate(0.0, 0.01) if found is None else found.size
    verdict = Verdict(night_of(AT).toordinal(), 1.0, LIMIT, 0.005, found, size, size, 0.023)
    own = Baseline(night_of(0), night_of(7), 8, Conditions(150.0, 50.0, 40.0), (1e-14,) * 3)
    machine = SimpleNamespace(paths=(*PATHS, "known"), gaps=PATHS)
    watch: Any = SimpleNamespace(state=SimpleNamespace(machine=machine, in_force=None))
    night = replace(
        waiting(0),
        baseline=own,
        watch=watch,
        verdict=verdict,
        own_leakage=Estimate(1.2, 0.01),
        reference_leakage=Estimate(1.5, 0.02),
    )
    names = {"lack_of_fit", "present", "newest_night", "smallest", "evidence", "is_beyond"}
    in_verdict = {name: more.pop(name) for name in names & more.keys()}
    return replace(night, verdict=replace(verdict, **in_verdict), **more)


def waiting(n: int, **more: Any) -> NightState:
    """A night of a baseline period that has so many nights of its baseline period."""
    period = more.pop("period", BaselinePeriod(0, 40, "first nights"))
    n_blocks, silent = more.pop("n_blocks", 20), more.pop("silent", 0)
    return NightState(motor(), AT, night_of(AT), period, n_blocks, n, silent)


def judge(
    night: NightState, spec: MotorSpec | None = None, why: str = "", fitted: Any = None
) -> NightState:
    """The night's state for a motor, by default a CB560 with the default settings."""
    return with_state(replace(night, spec=spec or motor(), why_no_blocks=why, fitted=fitted))


LIMITS = "[limits]\nwarning_l_per_min = 1.6\nalarm_l_per_min = 1.8\n"
SLEEVE = "balance_sleeve"
FAR = change(SLEEVE, size=Estimate(0.32, 0.01))


@pytest.mark.parametrize(
    ("found", "more", "expected"),
    [
        (None, {}, "ok"),
        *((change(cause), {}, "warning") for cause in (SLEEVE, "all_flows", "not_identified")),
        # 30 % by default: 1.96 standard deviations below 32 % it is, 1.9 below it is not yet.
        (FAR, {}, "alarm"),
        (FAR, {"present": Estimate(0.3 + 1.9 * 0.01, 0.01)}, "warning"),
        (change("all_flows", is_rise=False, size=Estimate(-0.4, 0.01)), {}, "warning"),
        (change("tank", size=Estimate(0.5, 0.01)), {}, "common_cause"),
        (change("temperature_effect"), {}, "ok"),
        (change("back_as_before"), {}, "ok"),
        (None, {"silent": 7, "n_blocks": 0}, "ok"),
        (None, {"silent": 8, "n_blocks": 0}, "stale"),
        (FAR, {"silent": 8, "n_blocks": 0}, "stale"),
    ],
)
def test_a_state_by_what_the_watch_says(
    found: Change | None, more: dict[str, object], expected: str
) -> None:
    assert judge(watched(found, **more)).state == expected


def test_without_a_baseline_a_motor_waits_or_is_stale() -> None:
    assert judge(waiting(5)).state == "insufficient"
    assert judge(waiting(5)).model_verdict is None
    assert judge(waiting(0, silent=8, n_blocks=0)).state == "stale"


@pytest.mark.parametrize(
    ("leakage", "expected"),
    [(1.55, "ok"), (1.65, "warning"), (1.83, "warning"), (1.85, "alarm")],
)
def test_limits_of_the_motor_type_count_with_97_percent(leakage: float, expected: str) -> None:
    spec = motor(limits=LIMITS)
    found = judge(watched(reference_leakage=Estimate(leakage, 0.02)), spec)
    assert found.state == expected
    assert expected == "ok" or found.way == "limit"
    # Before there is a watch the night's own fit tells it, too.
    early = judge(waiting(3), spec, fitted=Estimate(leakage, 0.02))
    assert early.state == ("insufficient" if expected == "ok" else expected)
    # Whatever the others on the tank do.
    tank = judge(watched(change("tank"), reference_leakage=Estimate(leakage, 0.02)), spec)
    assert tank.state == ("common_cause" if expected == "ok" else expected)


@pytest.mark.parametrize(
    ("cause", "lack", "named"),
    [
        (SLEEVE, 0.05, SLEEVE),
        (SLEEVE, 0.06, "not_identified"),
        ("balance_sleeve and piston_ring", 0.06, "not_identified"),
        ("all_gaps", 0.06, "not_identified"),
        ("all_flows", 0.2, "all_flows"),
    ],
)
def test_where_the_model_is_disproved_no_part_is_named(cause: str, lack: float, named: str) -> None:
    candidates = {cause: 0.6, "piston_ring": 0.2, "oil_grade": 0.2}
    found = judge(
        watched(
            change(cause, path_growth=Estimate(0.5, 0.02), candidates=candidates), lack_of_fit=lack
        )
    )
    assert found.change.cause == named
    assert (found.gap_growth is None) == (named != SLEEVE)
    if lack > 0.05:
        assert "piston_ring" not in found.change.candidates
        assert sum(found.change.candidates.values()) == pytest.approx(1.0)


def test_the_verdict_on_the_model_is_its_lack_of_fit() -> None:
    found = [model_verdict(one) for one in (0.02, 0.0201, 0.05, 0.0501)]
    assert found == ["supported", "doubtful", "doubtful", "disproved"]


def test_a_gap_goes_with_the_cube_root_of_its_leakage() -> None:
    gap = judge(watched(change("piston_ring", path_growth=Estimate(1.197, 0.03)))).gap_growth
    assert gap.value == pytest.approx(0.3, abs=1e-4)
    # d(1 + g)^(1/3) = dg / (3 (1 + g)^(2/3)).
    assert gap.sd == pytest.approx(0.03 / (3 * 1.3**2), rel=1e-4)
    assert judge(watched(change("known", path_growth=Estimate(0.5, 0.03)))).gap_growth is None


SIZE = "leakage +20 % [18, 22] on 1 February 2026"
SINCE = "since 22 January 2026 (21 January 2026 to 23 January 2026)"
MOVED = "the zero of the flow sensor has moved"
UNTOLD = "leakage has risen, cause not identified"


def told(night: NightState, *drifts: str) -> tuple[str, str]:
    return sentence(night, night_of(0), drifts), advice(night, drifts)


QUIET = "no change of more than 3 % since 2 January 2026; leakage +0.0 % [-2.0, 2.0]"
LOOK_AT_SLEEVE = "Plan an inspection of the balance sleeve."
SEVERAL = {"zero": 0.05, SLEEVE: 0.55, "oil_grade": 0.4}
MISSED = "% of the flow, so no part is named"


@pytest.mark.parametrize(
    ("found", "lack", "what", "rest", "order"),
    [
        (
            change(SLEEVE, path_growth=Estimate(0.331, 0.02)), 0.005,
            "leakage of the balance sleeve has risen", "its gap +10 % [9, 11]; probability 97 %",
            LOOK_AT_SLEEVE,
        ),
        (
            change("balance_piston and balance_sleeve"), 0.005,
            "leakage of the balance piston and the balance sleeve has risen", "probability 97 %",
            "Plan an inspection of the balance piston and the balance sleeve.",
        ),
        (
            change(SLEEVE, probability=0.999, candidates={"all_gaps": 0.06}), 0.005,
            "leakage of the balance sleeve has risen", "probability above 99 %, else all gaps 6 %",
            LOOK_AT_SLEEVE,
        ),
        (
            change("piston_ring", continues=True), 0.005,
            "leakage of the piston ring has risen", "still rising; probability 97 %",
            "Plan an inspection of the piston ring.",
        ),
        (
            change("oil_grade", grade=46), 0.005,
            "flows have risen as with a thinner oil (ISO VG 46)", "probability 97 %",
            "Take an oil sample, or enter the oil_change that was made.",
        ),
        (
            change("not_identified", candidates=SEVERAL), 0.005,
            UNTOLD,
            "possible: balance sleeve 55 %, another oil 40 %, the zero of the flow sensor 5 %",
            "An oil sample, the meter's zero at a halt, a second thermometer and nights at other "
            "pressures and speeds would identify the cause.",
        ),
        (
            change(SLEEVE), 0.09,
            "leakage of a part of the motor has risen",
            f"probability above 99 %; the model misses 9 {MISSED}",
            "Plan an inspection of the motor.",
        ),
        (
            change("not_identified", candidates={"all_flows": 0.6, SLEEVE: 0.4}), 0.03,
            UNTOLD,
            "possible: all flows (all gaps worn, another oil, the flow meter) 60 %, balance "
            f"sleeve 40 %; the model misses 3 {MISSED}",
            "An oil sample, the meter's zero at a halt and a second thermometer would identify the "
            "cause.",
        ),
        (
            change("not_identified", candidates={}, probability=0.0), 0.005,
            UNTOLD, "", "Plan an inspection of the motor.",
        ),
        (
            change(SLEEVE, alike=("balance_piston", SLEEVE),
                   candidates={SLEEVE: 0.7, "balance_piston": 0.28, "oil_grade": 0.02}), 0.005,
            "leakage has risen through one or more of: balance piston, balance sleeve",
            "probability 98 %", "Plan an inspection of the balance piston and the balance sleeve.",
        ),
        (
            change("not_identified", alike=("oil_grade", SLEEVE),
                   candidates={SLEEVE: 0.5, "oil_grade": 0.48, "zero": 0.02}), 0.09,
            "leakage has risen through one or more of: a part of the motor, another oil",
            f"probability 98 %; the model misses 9 {MISSED}",
            "An oil sample, the meter's zero at a halt and a second thermometer would identify the "
            "cause.",
        ),
        (
            change("not_identified", candidates={"several": 0.9, SLEEVE: 0.1}), 0.005,
            UNTOLD, "possible: more than one change at once 90 %, balance sleeve 10 %",
            "Take an oil sample first, and check the flow meter; then plan an inspection of the "
            "motor.",
        ),
    ],
)  # fmt: skip
def test_a_change_in_words(found: Change, lack: float, what: str, rest: str, order: str) -> None:
    words = f"{what}: {SIZE}, {SINCE}; {rest}".removesuffix("; ")
    assert told(judge(watched(found, lack_of_fit=lack))) == (words, order)


@pytest.mark.parametrize(
    ("night", "words", "order"),
    [
        (judge(watched()), f"{QUIET} on 1 February 2026", "Nothing to do."),
        (judge(watched(silent=3, n_blocks=0)), f"{QUIET} on 29 January 2026", "Nothing to do."),
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
            "no data since 22 January 2026: no log covers this night; leakage of the "
            "balance sleeve has risen: leakage +20 % [18, 22] on 22 January 2026, "
            f"{SINCE}; probability 97 %",
            "Check whether the motor's logs arrive, and the reason of its last nights.",
        ),
        (
            judge(
                watched(reference_leakage=Estimate(1.5, 0.02)),
                motor(limits="[limits]\nalarm_l_per_min = 1.4\n"),
            ),
            "leakage at the reference conditions 1.5 l/min [1.46, 1.54], beyond the motor type's "
            f"limit of 1.4 l/min; {QUIET} on 1 February 2026",
            "Inspect the motor at the next stop.",
        ),
    ],
)
def test_a_night_in_words(night: NightState, words: str, order: str) -> None:
    assert told(night) == (words, order)


def test_before_it_can_tell_a_change_it_is_not_ok() -> None:
    assert judge(watched(smallest=0.5)).state == "ok"
    assert judge(watched(smallest=None)).state == "insufficient"
    early = judge(watched(smallest=0.51))
    assert (early.state, early.way) == ("insufficient", "baseline")
    words, what = told(early)
    assert words.startswith("too few nights since 2 January 2026 to show a change")
    assert what == "Wait for more nights."


def test_an_alarm_asks_for_an_inspection_at_the_next_stop() -> None:
    alarm = judge(watched(change(SLEEVE, size=Estimate(0.5, 0.01))))
    assert told(alarm)[1] == "Inspect the balance sleeve at the next stop."


@pytest.mark.parametrize("cause", [SLEEVE, "all_gaps", "all_flows", "not_identified"])
def test_a_fall_is_told_as_a_fall(cause: str) -> None:
    words, what = told(judge(watched(change(cause, is_rise=False, size=Estimate(-0.2, 0.01)))))
    assert "-20 % [-22, -18]" in words
    assert "risen" not in words
    assert "inspect" not in what.lower()


@pytest.mark.parametrize("cause", [*WHAT, SLEEVE])
def test_every_cause_has_words_and_advice(cause: str) -> None:
    words, what = told(judge(watched(change(cause))))
    assert "+20 % [18, 22]" in words
    assert "{" not in words + what
    assert what.endswith(".")


def test_a_sensor_that_drifts_is_named_and_what_to_do_is_one_order() -> None:
    words, what = told(judge(watched(change(SLEEVE))), MOVED)
    assert words.endswith(f"; {MOVED}")
    assert what == "Plan an inspection of the balance sleeve."
    assert told(judge(watched()), MOVED)[1] == "Check the sensor whose zero has moved."


def test_a_warning_of_all_gaps_asks_for_an_oil_sample() -> None:
    words = "Take an oil sample: all gaps at once are rare."
    assert told(judge(watched(change("all_gaps"))))[1] == words


def test_an_alarm_carries_an_order_whatever_the_name_and_a_flushing_is_none() -> None:
    for cause in ("not_identified", "all_flows", "oil_grade", "all_gaps"):
        alarm = judge(watched(change(cause, size=Estimate(0.5, 0.01))))
        assert (alarm.state, told(alarm)[1]) == ("alarm", "Inspect the motor at the next stop.")
    for cause in ("flushing", "zero"):
        night = judge(watched(change(cause, size=Estimate(0.5, 0.01))))
        assert night.state == "warning"
        assert "case drain flow +50 % [48, 52]" in told(night)[0]


def test_what_one_night_does_not_show_those_since_the_change_do() -> None:
    newest, mean = Estimate(0.02, 0.02), Estimate(0.03, 0.005)
    words, _ = told(judge(watched(change(SLEEVE), newest_night=newest, present=mean)))
    assert "leakage +3.0 % [2.0, 4.0] since then, leakage +2.0 % [-1.9, 5.9] on" in words


def test_a_night_alone_beyond_the_detection_limit_is_said() -> None:
    words, _ = told(judge(watched(newest_night=Estimate(0.08, 0.01), is_beyond=True)))
    assert words.endswith("beyond that: a second night like it is a warning")


@pytest.mark.parametrize(
    ("cause", "more", "may_wear"),
    [
        (SLEEVE, {}, True),
        ("all_flows", {}, True),
        ("not_identified", {"candidates": {}}, True),
        ("temperature_sensor", {}, False),
        ("flushing", {}, False),
        ("tank", {}, False),
        (SLEEVE, {"is_rise": False}, False),
    ],
)
def test_what_is_no_wear_has_no_time_to_a_limit(
    cause: str, more: dict[str, object], may_wear: bool
) -> None:
    assert judge(watched(change(cause, **more))).may_wear == may_wear
    assert judge(watched()).may_wear
