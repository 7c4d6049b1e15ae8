"""No night contradicts itself: its state, interval, evidence, causes and sentence go together."""

from __future__ import annotations

import datetime as dt
from typing import Any

import pytest

from tests.scenarios.contradictions import contradictions, of_fleet
from tests.scenarios.fleets import ScenarioFleet
from tests.scenarios.published import Row


@pytest.mark.parametrize("name", ["demo", "shared_plant", "others"])
def test_no_night_contradicts_itself(name: str, request: pytest.FixtureRequest) -> None:
    fleet: ScenarioFleet = request.getfixturevalue(name)
    rows = fleet.table("nights").to_dicts()
    assert sum(row["evidence_limit"] is not None for row in rows) > len(rows) // 2
    assert list(of_fleet(rows)) == []


DAY = dt.date(2026, 2, 1)
OK: Row = {
    "motor_id": "M",
    "night": DAY,
    "state": "ok",
    "state_since": None,
    "cause": None,
    "cause_probability": None,
    "candidates": None,
    "onset": None,
    "onset_earliest": None,
    "onset_latest": None,
    "detected_on": None,
    "evidence": 2.0,
    "evidence_limit": 9.4,
    "detection_limit_percent": 4.2,
    "alarm_level_percent": 30.0,
    **{f"{name}_percent": 0.5 for name in ("leakage_change", "mean_change")},
    **{f"{name}_lower": -1.5 for name in ("leakage_change", "mean_change")},
    **{f"{name}_upper": 2.5 for name in ("leakage_change", "mean_change")},
    "sentence": "no change of more than 5 % since 1 January 2026; leakage +0.5 % [-1.5, 2.5] on "
    "1 February 2026",
    "advice": "Nothing to do.",
}
RISEN = OK | {
    "state": "warning",
    "state_since": DAY,
    "cause": "piston_ring",
    "cause_probability": 0.92,
    "candidates": [
        {"cause": "piston_ring", "probability": 0.92},
        {"cause": "temperature_sensor", "probability": 0.06},
    ],
    "onset": DAY,
    "onset_earliest": DAY,
    "onset_latest": DAY,
    "detected_on": DAY,
    "evidence": 14.0,
    **{f"{name}_percent": 8.5 for name in ("leakage_change", "mean_change")},
    **{f"{name}_lower": 6.5 for name in ("leakage_change", "mean_change")},
    **{f"{name}_upper": 10.5 for name in ("leakage_change", "mean_change")},
    "sentence": "leakage of the piston ring has risen: leakage +8.5 % [6.5, 10.5] on 1 February "
    "2026, since 1 February 2026; still rising; probability 92 %, else the oil temperature "
    "sensor 6 %",
    "advice": "Plan an inspection of the piston ring.",
}
BACK = OK | {"cause": "back_as_before", "evidence": 80.0, "onset": None}
BEYOND = {"leakage_change_percent": 8.5, "leakage_change_lower": 6.5, "leakage_change_upper": 10.5}
SENSOR = [
    {"cause": "a_part", "probability": 0.6},
    {"cause": "temperature_sensor", "probability": 0.4},
]
# By rule: a row that goes together, and what contradicts it.
PLANTED: tuple[tuple[str, Row, dict[str, Any]], ...] = (
    ("ok_has_no_evidence", OK, {"evidence": 9.6}),
    (
        "ok_has_no_evidence",
        OK,
        {"mean_change_percent": 7.8, "mean_change_lower": 5.9, "mean_change_upper": 9.7},
    ),
    ("ok_has_no_evidence", BACK, {"mean_change_lower": 5.0, "mean_change_upper": 9.0}),
    ("warning_excludes_zero", RISEN, {"mean_change_lower": -0.3}),
    ("detected_by_evidence", RISEN, {"evidence": 9.3}),
    ("dates_in_order", RISEN, {"onset": DAY - dt.timedelta(days=1)}),
    ("dates_in_order", RISEN, {"detected_on": DAY + dt.timedelta(days=1)}),
    ("alarm_is_beyond", RISEN, {"state": "alarm"}),
    ("probabilities_sum", RISEN, {"cause_probability": 0.6}),
    (
        "probabilities_sum",
        RISEN,
        {"sentence": RISEN["sentence"].replace("sensor 6 %", "sensor 60 %")},
    ),
    (
        "no_sensor_beside_a_part",
        RISEN | {"cause": "a_part", "cause_probability": 0.6, "candidates": SENSOR[:1]},
        {"candidates": SENSOR},
    ),
    ("words_are_the_columns", OK, {"leakage_change_percent": 1.5}),
    (
        "words_are_the_columns",
        RISEN,
        {
            "sentence": "leakage has risen: leakage -8.5 % [-10.5, -6.5] on 1 February 2026; "
            "still rising",
            "leakage_change_percent": -8.5,
            "leakage_change_lower": -10.5,
            "leakage_change_upper": -6.5,
        },
    ),
    ("limit_is_the_column", OK, {"detection_limit_percent": 5.5}),
    (
        "limit_is_the_column",
        OK | BEYOND | {"sentence": "no change of more than 5 % since x, beyond that"},
        {"sentence": "no change of more than 5 % since x"},
    ),
    ("advice_fits", OK, {"advice": "Plan an inspection of the motor."}),
    ("advice_fits", RISEN, {"advice": "Nothing to do."}),
)


@pytest.mark.parametrize(("rule", "row", "planted"), PLANTED)
def test_what_is_planted_is_seen(rule: str, row: Row, planted: dict[str, Any]) -> None:
    assert contradictions([row]) == []
    assert [words.split()[2] for words in contradictions([row | planted])] == [f"{rule}:"]


def test_odd_nights_need_ordinary_ones_between() -> None:
    odd = {"state": "warning", "cause": "odd_nights", "onset": DAY, "advice": "Compare them."}
    for every, expected in ((3, []), (1, ["odd_nights_are_odd:"])):
        rows = [OK | {"night": DAY + dt.timedelta(days=place)} for place in range(9)]
        rows = [
            row
            if place and place % every
            else row | {name: value + 4.0 * place for name, value in BEYOND.items()}
            for place, row in enumerate(rows)
        ]
        last = rows[-1] | odd | {"sentence": "single nights deviate", "detected_on": DAY}
        last |= {"onset_earliest": DAY, "onset_latest": DAY}
        found = contradictions([last])
        assert found == []
        found = [words.split()[2] for words in contradictions([*rows[:-1], last])]
        assert [name for name in found if name.startswith("odd")] == expected
