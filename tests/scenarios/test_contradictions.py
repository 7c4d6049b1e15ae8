"""No night contradicts itself: its state, interval, evidence, causes and sentence go together."""

from __future__ import annotations

import datetime as dt
from typing import Any

import pytest

from tests.scenarios.contradictions import contradictions, of_fleet
from tests.scenarios.fleets import Row, ScenarioFleet


@pytest.mark.parametrize("name", ["demo", "shared_plant", "others"])
def test_no_night_contradicts_itself(name: str, request: pytest.FixtureRequest) -> None:
    fleet: ScenarioFleet = request.getfixturevalue(name)
    rows = fleet.table("nights").to_dicts()
    assert sum(row["evidence_limit"] is not None for row in rows) > len(rows) // 3
    assert list(of_fleet(rows)) == []


DAY = dt.date(2026, 2, 1)
Change = tuple[float, float, float]


def changed(name: str, percent: float, lower: float, upper: float) -> Row:
    """A change of the leakage with its interval, in the columns of `nights`."""
    return {f"{name}_percent": percent, f"{name}_lower": lower, f"{name}_upper": upper}


def night(change: Change, **columns: Any) -> Row:
    """A row of `nights` whose change is that of the night and of the mean."""
    dates = ("state_since", "onset", "onset_earliest", "onset_latest", "detected_on")
    row: Row = dict.fromkeys((*dates, "cause", "cause_probability", "candidates"))
    row |= {"motor_id": "M", "night": DAY, "evidence_limit": 9.4, "alarm_level_percent": 30.0}
    row |= changed("leakage_change", *change) | changed("mean_change", *change)
    return row | {"detection_limit_percent": 4.2} | columns


def causes(**probabilities: float) -> list[dict[str, Any]]:
    return [{"cause": cause, "probability": p} for cause, p in probabilities.items()]


OK = night(
    (0.5, -1.5, 2.5),
    state="ok",
    evidence=2.0,
    sentence="no change detected since 1 January 2026 (a step of 5 % would have been within ten "
    "nights, a slow change may be larger); leakage +0.5 % [-1.5, 2.5] on 1 February 2026",
    advice="Nothing to do.",
)
RISEN = night(
    (8.5, 6.5, 10.5),
    state="warning",
    cause="piston_ring",
    cause_probability=0.92,
    candidates=causes(piston_ring=0.92, temperature_sensor=0.06),
    evidence=14.0,
    sentence="leakage of the piston ring has risen: leakage +8.5 % [6.5, 10.5] on 1 February 2026, "
    "since 1 February 2026; still rising; probability 92 %, else the oil temperature sensor 6 %",
    advice="Plan an inspection of the piston ring.",
    **dict.fromkeys(("state_since", "onset", "onset_earliest", "onset_latest"), DAY),
    detected_on=DAY,
)
BACK = OK | {"cause": "back_as_before", "evidence": 80.0}
PART = RISEN | {"cause": "a_part", "cause_probability": 0.6, "candidates": causes(a_part=0.6)}
FALLING = "leakage has risen: leakage -8.5 % [-10.5, -6.5] on 1 February 2026; still rising"
LIMIT = "no change detected since x (a step of 5 % would have been"
BEYOND = OK | changed("leakage_change", 8.5, 6.5, 10.5)
BEYOND |= {"sentence": f"{LIMIT}, beyond such a step"}
# By rule: a row that goes together, and what contradicts it.
PLANTED: tuple[tuple[str, Row, Row], ...] = (
    ("ok_has_no_evidence", OK, {"evidence": 9.6}),
    ("ok_has_no_evidence", OK, changed("mean_change", 7.8, 5.9, 9.7)),
    ("ok_has_no_evidence", BACK, changed("mean_change", 7.0, 5.0, 9.0)),
    ("warning_excludes_zero", RISEN, {"mean_change_lower": -0.3}),
    ("detected_by_evidence", RISEN, {"evidence": 9.3}),
    ("dates_in_order", RISEN, {"onset": DAY - dt.timedelta(days=1)}),
    ("dates_in_order", RISEN, {"detected_on": DAY + dt.timedelta(days=1)}),
    ("alarm_is_beyond", RISEN, {"state": "alarm"}),
    ("probabilities_sum", RISEN, {"cause_probability": 0.6}),
    ("probabilities_sum", RISEN, {"sentence": RISEN["sentence"].replace("sensor 6", "sensor 60")}),
    ("no_sensor_beside_a_part", PART, {"candidates": causes(a_part=0.6, temperature_sensor=0.4)}),
    ("words_are_the_columns", OK, {"leakage_change_percent": 1.5}),
    (
        "words_are_the_columns",
        RISEN,
        changed("leakage_change", -8.5, -10.5, -6.5) | {"sentence": FALLING},
    ),
    ("limit_is_the_column", OK, {"detection_limit_percent": 5.5}),
    ("limit_is_the_column", BEYOND, {"sentence": LIMIT}),
    ("advice_fits", OK, {"advice": "Plan an inspection of the motor."}),
    ("advice_fits", RISEN, {"advice": "Nothing to do."}),
)


@pytest.mark.parametrize(("rule", "row", "planted"), PLANTED)
def test_what_is_planted_is_seen(rule: str, row: Row, planted: Row) -> None:
    assert contradictions([row]) == []
    assert [words.split()[2] for words in contradictions([row | planted])] == [f"{rule}:"]


@pytest.mark.parametrize(("every", "is_seen"), [(3, False), (1, True)])
def test_odd_nights_need_ordinary_ones_between(every: int, is_seen: bool) -> None:
    rows = []
    for place in range(9):
        size = 0.0 if place % every else 4.0 * place
        change = changed("leakage_change", size + 0.5, size - 1.5, size + 2.5)
        rows.append(OK | {"night": DAY + dt.timedelta(days=place)} | change)
    odd = {"state": "warning", "cause": "odd_nights", "advice": "Compare them.", "detected_on": DAY}
    odd |= dict.fromkeys(("onset", "onset_earliest", "onset_latest"), DAY)
    rows[-1] |= odd | {"sentence": "single nights deviate"}
    found = [words.split()[2] for words in contradictions(rows)]
    assert ("odd_nights_are_odd:" in found) == is_seen
