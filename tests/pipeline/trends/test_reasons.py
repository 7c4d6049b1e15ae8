"""Reasons for a state, in words with figures."""

from __future__ import annotations

import re

import numpy as np
import pytest

from pipeline.trends.figures.indicators import DEVIATION, REFERENCE
from pipeline.trends.rows.alarm_rows import alarm_rows
from pipeline.trends.rows.trend_rows import trend_rows
from pipeline.trends.states.standing import RAISED, Standing
from pipeline.trends.why.reasons import path_behind, path_named, way_of, why_no_baseline, why_state
from tests.pipeline.trends.nights import (
    OIL,
    Nights,
    event,
    motor,
    named,
    night_of,
    ramp,
    reset,
    standing,
    step,
)

N, AT = 110, 80
SLEEVE = {"balance_sleeve": step(N, AT, 0.4)}


def words(found: Standing, name: str, place: int = N - 1) -> str:
    return why_state(found, name, place, path_behind(found, name, place))


def row(found: Standing, name: str, place: int) -> dict[str, object]:
    return next(one for one in trend_rows(found, [place]) if one["indicator"] == name)


def test_damage_is_told_with_size_interval_date_and_the_reference_leakage() -> None:
    found = standing(Nights(motor(), N, SLEEVE))
    said = re.fullmatch(
        r"balance sleeve gap \+(\d+) % \[(\d+), (\d+)\] since 23 March 2026; "
        r"reference leakage \+(\d+) %",
        words(found, "K_balance_sleeve"),
    )
    assert said
    size, lower, upper, reference = map(float, said.groups())
    # K is 40 % larger, and K ∝ h³; all figures are told in whole percent.
    truth = 100 * (1.4 ** (1 / 3) - 1)
    assert lower - 0.5 <= truth <= upper + 0.5
    assert size == pytest.approx(truth, abs=1.5)
    leakage = found.watched[REFERENCE].series
    expected = 100 * (np.mean(leakage[AT:]) / np.mean(leakage[:AT]) - 1)
    assert reference == pytest.approx(expected, abs=1.0)
    assert words(found, REFERENCE).endswith("; mostly by the balance sleeve (over 99 % probable)")
    assert row(found, "K_balance_sleeve", N - 1)["path"] == "balance_sleeve"


def test_every_part_in_alarm_is_named_with_its_size_the_own_first() -> None:
    wear = {"balance_piston": step(N, AT, 0.7), "balance_sleeve": step(N, AT, 0.5)}
    found = standing(Nights(motor(), N, wear))
    piston, sleeve = (
        rf"balance {part} gap \+{size} % \[\d+, \d+\] since 23 March 2026"
        # 1.7^⅓ = 1.193 and 1.5^⅓ = 1.145
        for part, size in (("piston", "(19|20)"), ("sleeve", "(14|15)"))
    )
    assert re.match(f"{piston}; {sleeve}; reference leakage ", words(found, "K_balance_piston"))
    assert re.match(f"{sleeve}; {piston}; reference leakage ", words(found, "K_balance_sleeve"))
    assert found.states[REFERENCE][-1] == "alarm"
    whole = words(found, REFERENCE)
    assert re.match(rf"reference leakage \+.*?; {piston}; {sleeve}; by the balance", whole)
    (told,) = [
        one["reason"]
        for one in alarm_rows(found, range(N))
        if (one["indicator"], one["to_state"]) == ("K_balance_sleeve", "alarm")
    ]
    assert "balance piston gap +" in told


def test_a_part_in_another_state_is_not_in_the_headline() -> None:
    wear = {"balance_piston": step(N, AT, 0.2), "balance_sleeve": step(N, AT, 0.6)}
    found = standing(Nights(motor(), N, wear))
    assert found.states["K_balance_piston"][-1] == "warning"
    assert "piston" not in words(found, "K_balance_sleeve")


def test_a_rise_that_is_undone_is_told_as_a_fall_and_blames_no_path() -> None:
    """The sum and the levels hold for some nights, in which the motor lies below its baseline."""
    wear = np.where(np.arange(N) < AT, 1.0, 1.12)
    wear[AT + 20 :] = 0.9
    found = standing(Nights(motor(), N, {"balance_sleeve": wear}))
    name, fallen = "K_balance_sleeve", []
    for place in range(AT, N):
        if found.states[name][place] not in RAISED:
            continue
        said = words(found, name, place)
        lower, upper = map(float, re.search(r"\[(\S+), (\S+)\]", said).groups())  # type: ignore[union-attr]
        if lower + upper > 0:
            assert re.match(r"balance sleeve gap \+\S+ % .* since 2\d March 2026", said)
            continue
        fallen.append(place)
        assert re.match(
            r"balance sleeve gap is down to -\S+ % \[.*\] after a rise since 2\d March 2026; a "
            "fall is no wear but another oil, a sensor, the flushing, a filled gap or a new part; ",
            said,
        )
        behind = path_behind(found, name, place)
        assert behind is None
        assert path_named(found, name, place, behind) is None
        assert row(found, name, place)["path"] is None
    assert fallen
    # Nowhere, in no indicator's words, is a fall since a date.
    rows = trend_rows(found, range(N))
    assert not [
        one for one in rows if re.search(r"-\S+ % \[.*?\] since", one.get("state_reason") or "")
    ]


def oil_that_nobody_dated(until: int) -> Standing:
    """The ring wears from night 60; the oil of night 90 lifts all flows by 43 %.

    From night `until` on, no night gives a reference leakage, or the K of pistons and sleeves.
    """
    wear = {OIL: step(140, 90, 0.43), "piston_ring": step(140, 60, 0.4)}
    refused = {
        "reference_verdict": "outside_fitted_range",
        "reference_reason": "pressure",
        "coefficient_covariance_root": None,
    }
    silent = range(until, 140)
    others = ("K_balance_piston", "K_balance_sleeve")
    verdicts = {(place, name): "not_excited" for place in silent for name in others}
    changes = dict.fromkeys(silent, refused)
    return standing(Nights(motor(), 140, wear, changes=changes, verdicts=verdicts))


def test_what_was_known_before_the_change_alone_is_not_quoted_as_current() -> None:
    found = oil_that_nobody_dated(until=86)
    said = words(found, "K_piston_ring", 139)
    assert "; reference leakage not known since 28 March 2026; besides, all flows × 1.43" in said
    told = words(found, DEVIATION, 139)
    assert "reference leakage not known since 28 March 2026" in told


def test_a_figure_that_went_stale_since_the_change_is_not_quoted_as_current() -> None:
    found = oil_that_nobody_dated(until=100)
    assert re.search(r"; reference leakage \+\d+ %; ", words(found, "K_piston_ring", 106))
    assert "; reference leakage not known since 11 April 2026; " in words(
        found, "K_piston_ring", 107
    )


def test_the_motors_own_conditions_stand_in_where_the_fleets_are_no_longer_seen() -> None:
    refused = {"reference_verdict": "outside_fitted_range", "reference_reason": "pressure"}
    changes = dict.fromkeys(range(AT - 3, N), refused)
    found = standing(Nights(motor(), N, SLEEVE, changes=changes))
    said = words(found, "K_balance_sleeve")
    assert "not known" not in said
    assert re.search(r"; leakage at the motor's own conditions \+1\d %$", said)


def test_a_change_has_the_night_on_which_it_began() -> None:
    found = standing(Nights(motor(), N, SLEEVE))
    assert row(found, "K_balance_sleeve", N - 1)["change_start"] == night_of(AT)
    assert row(found, "K_piston_ring", N - 1).get("change_start") is None


def test_a_wear_of_the_ring_leaves_the_reference_leakage_unchanged() -> None:
    found = standing(Nights(motor(), N, {"piston_ring": ramp(N, 60, 0.5)}))
    said = words(found, "K_piston_ring")
    assert re.search(r"; reference leakage (unchanged|[+-]1 %)$", said), said
    assert found.states[REFERENCE][-1] == "ok"


def test_a_new_baseline_says_what_it_begins_with() -> None:
    spec = named(motor(), "M1", events=[event(60, "overhaul", note="sleeves")])
    found = standing(Nights(spec, 70), reset(65, note="valve"))
    assert why_no_baseline(found, REFERENCE, 10) == (
        "11 of 15 good nights for a baseline (first nights)"
    )
    assert why_no_baseline(found, REFERENCE, 64) == (
        f"5 of 15 good nights for a baseline (overhaul on {night_of(60)}: sleeves)"
    )
    assert why_no_baseline(found, DEVIATION, 69) == (
        f"5 of 15 good nights for a baseline (reset from {night_of(65)}: valve)"
    )
    changes = [one for one in alarm_rows(found, range(70)) if one["indicator"] == REFERENCE]
    assert [one["to_state"] for one in changes] == ["ok", "insufficient"]
    assert changes[1]["reason"] == f"a new baseline begins: overhaul on {night_of(60)}: sleeves"


def test_a_silent_motor_is_stale_after_a_week_and_says_since_when() -> None:
    nights = Nights(motor(), 60)
    found = standing(nights, tonight=70)
    assert found.states[REFERENCE][59:] == ("ok",) * 8 + ("stale",) * 4
    assert words(found, REFERENCE, 70) == (
        "no trusted figure for 11 nights: no new data: no log covers this night"
    )


def test_nights_that_are_not_to_be_trusted_hold_then_are_stale_with_their_reason() -> None:
    refused = {
        "reference_verdict": "outside_fitted_range",
        "reference_reason": "pressure 200 bar lies outside the night's 10 to 150 bar",
    }
    changes = dict.fromkeys(range(50, 60), refused)
    found = standing(Nights(motor(), 60, changes=changes))
    assert found.states[REFERENCE][49:] == ("ok",) * 8 + ("stale",) * 3
    assert "pressure 200 bar lies outside" in words(found, REFERENCE, 59)
    told = row(found, REFERENCE, 59)
    assert told["outside_fitted_range"]
    assert told["value"] is None
    assert "lies outside" in str(told["gated_reason"])
    # Its loss factors are as good as before.
    assert found.states["K_piston_ring"][59] == "ok"


# Absolute limits

LIMITS = "[limits]\nwarning_l_per_min = {}\nalarm_l_per_min = {}\n"


def limited(warning: float, alarm: float, wear: dict[str, np.ndarray]) -> Standing:
    return standing(Nights(motor(limits=LIMITS.format(warning, alarm)), N, wear))


def test_a_limit_of_the_motor_type_that_the_motor_has_always_passed() -> None:
    """It has not risen, so nothing is said of a rise, or of a night on which one began."""
    found = limited(1.2, 3.0, {})
    # Three nights of five tell it; a limit needs no baseline.
    assert found.states[REFERENCE][:] == ("insufficient",) * 2 + ("warning",) * (N - 2)
    without_baseline = row(found, REFERENCE, 10)
    assert str(without_baseline["state_reason"]).endswith("the motor type is 1.2 l/min")
    assert (without_baseline["warning_limit"], without_baseline["alarm_limit"]) == (1.2, 3.0)
    value = found.watched[REFERENCE].series[-1]
    assert words(found, REFERENCE) == (
        f"reference leakage {value:.3g} l/min, and the limit of the motor type is 1.2 l/min"
    )
    assert way_of(found, REFERENCE, N - 1) == "level"
    told = row(found, REFERENCE, N - 1)
    assert told["warning_limit"] == 1.2
    assert told["alarm_limit"] == pytest.approx(1.3 * float(str(told["baseline_mean"])))
    assert told["limit"] == 3.0
    assert told["days_to_limit"] is None


def test_a_rise_beyond_a_limit_has_both_told() -> None:
    found = limited(1.45, 1.52, SLEEVE)
    assert found.states[REFERENCE][-1] == "alarm"
    said = words(found, REFERENCE)
    assert "l/min, and the limit of the motor type is 1.52 l/min; reference leakage +1" in said
    assert said.endswith("; mostly by the balance sleeve (over 99 % probable)")
    assert row(found, REFERENCE, N - 1)["days_to_limit_status"] == "already_crossed"


# Levels in effect


def test_levels_of_a_widely_scattering_indicator_are_those_that_count() -> None:
    """Below 4.5 standard deviations a level means nothing; the table must not show another one."""
    found = standing(Nights(motor(), N, noise=3.0))
    watched = found.watched["K_balance_piston"]
    baseline = watched.baseline(N - 1)
    assert baseline is not None
    told = row(found, "K_balance_piston", N - 1)
    level = float(str(told["warning_limit"])) / baseline.mean - 1.0
    assert level == pytest.approx(4.5 * baseline.highest_sd() / baseline.mean)
    assert level > 0.3
    assert float(str(told["alarm_limit"])) >= float(str(told["warning_limit"]))
    steady = row(standing(Nights(motor(), N)), "K_balance_piston", N - 1)
    mean = float(str(steady["baseline_mean"]))
    assert steady["warning_limit"] == pytest.approx(1.15 * mean)
    assert steady["alarm_limit"] == pytest.approx(1.30 * mean)


def test_a_step_that_only_the_levels_tell_keeps_its_night() -> None:
    """The night on which it began does not move on while the alarm stands."""
    spec = motor(fleet="[alarms]\nfalse_alarms_per_year = 0.002\n")
    found = standing(Nights(spec, N, {"balance_sleeve": step(N, 100, 0.25)}))
    first = found.states["K_balance_sleeve"].index("warning")
    assert first <= 104
    since = {
        re.findall(r"since (.*?);", words(found, "K_balance_sleeve", place))[0]
        for place in range(first, N)
        if found.states["K_balance_sleeve"][place] in RAISED
    }
    assert since == {"12 April 2026"}
