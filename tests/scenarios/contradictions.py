"""What a motor's rows of `nights` say that does not go together: state, interval, words, causes."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence

from tests.scenarios.fleets import Row

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
