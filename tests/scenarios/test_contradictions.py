"""No night contradicts itself: its state, interval, evidence, causes and sentence go together."""

from __future__ import annotations

import datetime as dt
import math
import re
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import pytest

from tests.scenarios.fleets import Row, ScenarioFleet

CHANGED = ("warning", "alarm", "common_cause")
# Causes that are no change of the leakage which stays: a notice, or nights of no common size.
NOTICES, ODD = ("back_as_before", "temperature_effect", "channels"), "odd_nights"
PART, SENSOR = "a_part", "temperature_sensor"
NAMED, WHOLE = 0.9, 1.01
PERCENT = r"([+-]?[\d.]+) % \[(-?[\d.]+), (-?[\d.]+)\]"


def contradictions(rows: Sequence[Row]) -> list[str]:
    """Return what contradicts itself in the nights of a motor, in order; empty where nothing."""
    return [
        f"{row['motor_id']} {row['night']} {rule.__name__}: {row['sentence']}"
        for place, row in enumerate(rows)
        if row["evidence_limit"] is not None
        for rule in RULES
        if not rule(row, rows[: place + 1])
    ]


def _is_of_change(row: Row) -> bool:
    """True if the state rests on a change of the leakage that the watch has detected."""
    is_raised = row["state"] in CHANGED and row["onset"] is not None
    return is_raised and row["cause"] not in (*NOTICES, ODD) and "limit of" not in row["sentence"]


def _is_beyond_limit(row: Row, name: str = "mean_change") -> bool:
    """True if a change lies wholly beyond what would be detected."""
    limit, lower = row["detection_limit_percent"], row[f"{name}_lower"]
    if limit is None or lower is None:
        return False
    return bool(lower > limit or row[f"{name}_upper"] < -limit)


def ok_has_no_evidence(row: Row, _: Sequence[Row]) -> bool:
    """Nothing is reported: no evidence beyond its limit but a notice, no mean beyond detection."""
    if row["state"] != "ok":
        return True
    is_quiet = (row["evidence"] or 0.0) <= row["evidence_limit"] or row["cause"] in NOTICES
    return is_quiet and not _is_beyond_limit(row)


def warning_excludes_zero(row: Row, _: Sequence[Row]) -> bool:
    """The mean of a change that stands has an interval without 0."""
    is_no_leakage = row["cause"] in ("flushing", "zero")
    if not _is_of_change(row) or is_no_leakage or row["state"] == "common_cause":
        return True
    return not row["mean_change_lower"] <= 0.0 <= row["mean_change_upper"]


def detected_by_evidence(row: Row, rows: Sequence[Row]) -> bool:
    """In its night a change has its evidence, or is a second night beyond the limit, unnamed."""
    if not _is_of_change(row) or row["detected_on"] != row["night"]:
        return True
    is_second = not row["candidates"] and len(rows) > 1
    return is_second or (row["evidence"] or 0.0) >= row["evidence_limit"]


def dates_in_order(row: Row, _: Sequence[Row]) -> bool:
    """A change begins before it is detected, and stands since then."""
    if row["onset"] is None:
        return True
    begin = row["onset_earliest"] <= row["onset"] <= row["onset_latest"]
    is_since = row["state_since"] is None or row["state_since"] <= row["night"]
    return begin and row["onset_earliest"] <= row["detected_on"] <= row["night"] and is_since


def alarm_is_beyond(row: Row, _: Sequence[Row]) -> bool:
    """An alarm lies beyond its level, with 97.5 %."""
    if row["state"] != "alarm" or not _is_of_change(row):
        return True
    return bool(row["mean_change_lower"] >= row["alarm_level_percent"] - 1e-6)


def probabilities_sum(row: Row, _: Sequence[Row]) -> bool:
    """Probabilities of causes are at most 1 together, in the columns and in the words."""
    candidates = {one["cause"]: one["probability"] for one in row["candidates"] or ()}
    said = re.search(r"probability (?:above )?([\d.]+) %(?:, else (.*?))?(?:;|$)", row["sentence"])
    words = 0.0
    if said is not None:
        others = re.findall(r"([\d.]+) %", said.group(2) or "")
        words = (float(said.group(1)) + sum(map(float, others))) / 100.0
    is_own = row["cause"] not in candidates or math.isclose(
        candidates[row["cause"]], row["cause_probability"] or 0.0, abs_tol=0.01
    )
    return sum(candidates.values()) <= WHOLE and words <= WHOLE + 0.01 and is_own


def no_sensor_beside_a_part(row: Row, _: Sequence[Row]) -> bool:
    """What is named a part is not the sensor in its candidates."""
    if row["cause"] != PART:
        return True
    candidates = {one["cause"]: one["probability"] for one in row["candidates"] or ()}
    return all(p < 1.0 - NAMED for name, p in candidates.items() if SENSOR in name.split(" or "))


def odd_nights_are_odd(row: Row, rows: Sequence[Row]) -> bool:
    """Between odd nights lie ordinary ones, as many at least."""
    if row["cause"] != ODD:
        return True
    nights = [one for one in rows if one["night"] >= row["onset"]]
    known = [one for one in nights if one["leakage_change_percent"] is not None]
    middle = sorted(one["leakage_change_percent"] for one in known)[len(known) // 2]
    odd = sum(
        not one["leakage_change_lower"] <= middle <= one["leakage_change_upper"] for one in known
    )
    return 2 * odd <= len(known)


def words_are_the_columns(row: Row, rows: Sequence[Row]) -> bool:
    """Figures in the sentence are those of the columns; a rise has risen, and goes on rising."""
    sentence, newest = row["sentence"], None
    for one in rows:
        newest = one if one["leakage_change_percent"] is not None else newest
    pairs = [(rf"(?:leakage|flow) {PERCENT} on \d", newest, "leakage_change")]
    pairs += [(rf"(?:leakage|flow) {PERCENT} on average", row, "mean_change")]
    for pattern, source, name in pairs:
        found = re.search(pattern, sentence)
        if found and (source is None or not _alike(found.groups(), source, name)):
            return False
    return not ("still rising" in sentence and (newest or row)["leakage_change_upper"] < 0.0)


def limit_is_the_column(row: Row, _: Sequence[Row]) -> bool:
    """The limit in words is that of the column; a night wholly beyond it says so."""
    said = re.search(r"\(a step of (\d+) % would have been", row["sentence"])
    if said is None:
        return True
    limit = row["detection_limit_percent"]
    is_said = int(said.group(1)) == max(math.ceil(limit), 1)
    is_beyond = _is_beyond_limit(row, "leakage_change")
    return is_said and (not is_beyond or "beyond such a step" in row["sentence"])


def advice_fits(row: Row, _: Sequence[Row]) -> bool:
    """What is ok asks for nothing but a sensor; what is raised asks for something."""
    if row["state"] == "ok":
        is_quiet = row["advice"] in ("Nothing to do.", "Check the sensor whose zero has moved.")
        return is_quiet or (
            row["advice"].startswith("See to") and "no figure of" in row["sentence"]
        )
    return row["state"] not in CHANGED or row["advice"] not in ("", "Nothing to do.")


def _alike(words: Sequence[str], row: Row, name: str) -> bool:
    digits = [len(word.partition(".")[2]) for word in words]
    values = [row[f"{name}_{part}"] for part in ("percent", "lower", "upper")]
    return all(
        abs(float(word) - value) <= 0.5001 * 10**-n
        for word, value, n in zip(words, values, digits, strict=True)
    )


def of_fleet(rows: Sequence[Row]) -> Iterator[str]:
    """Contradictions of all motors of a table."""
    for motor in sorted({row["motor_id"] for row in rows}):
        yield from contradictions([row for row in rows if row["motor_id"] == motor])


RULES: tuple[Callable[[Row, Sequence[Row]], bool], ...] = (
    ok_has_no_evidence,
    warning_excludes_zero,
    detected_by_evidence,
    dates_in_order,
    alarm_is_beyond,
    probabilities_sum,
    no_sensor_beside_a_part,
    odd_nights_are_odd,
    words_are_the_columns,
    limit_is_the_column,
    advice_fits,
)


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
OF_A_PART = RISEN | {"cause": "a_part", "cause_probability": 0.6, "candidates": causes(a_part=0.6)}
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
    (
        "no_sensor_beside_a_part",
        OF_A_PART,
        {"candidates": causes(a_part=0.6, temperature_sensor=0.4)},
    ),
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
