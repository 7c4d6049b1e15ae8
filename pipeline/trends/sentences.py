"""What is reported of a motor, in plain words: its sentence, what to do, names and dates."""

from __future__ import annotations

import datetime as dt
import math
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from pipeline.messages import as_sentence, plain

if TYPE_CHECKING:
    from leakage.watch import Change, Estimate
    from pipeline.trends.night_state import NightState

# What has happened, by cause; of any other cause the leakage of its path has changed.
WHAT = {
    "all_gaps": "leakage of all gaps has {risen} together",
    "all_flows": "all flows have {risen} together",
    "oil_grade": "flows have {risen} as with a {thinner} oil",
    "temperature_sensor": "flows have {risen} as with an oil temperature that reads wrong",
    "flushing": "the flushing has {risen}",
    "known": "the flow that the motor type states has {risen}",
    "zero": "flow has {risen} as with a zero of the flow sensor that has moved",
    "back_as_before": "flow is back where it was",
    "odd_nights": "single nights deviate, again and again",
    "channels": "case drain flow follows pressure, oil temperature and speed no more",
    "tank": "all flows have {risen} as those of the oil circuit's other motors",
    "a_part": "leakage of a part of the motor has {risen}",
    "not_identified": "leakage has {risen}, cause not identified",
}
CAUSES = {
    "all_gaps": "all gaps",
    "all_flows": "all flows (all gaps worn, another oil, the flow meter)",
    "oil_grade": "another oil",
    "temperature_sensor": "the oil temperature sensor",
    "temperature_effect": "the effect of temperature",
    "known": "the flow that the motor type states",
    "zero": "the zero of the flow sensor",
    "back_as_before": "back as before",
    "odd_nights": "single odd nights",
    "channels": "channels that do not belong together",
    "tank": "the oil circuit",
    "several": "more than one change at once",
    "a_part": "a part of the motor",
    "flushing": "the flushing",
}
WAIT = "Wait for more nights."
ELSEWHERE = (
    "Check that pressure, oil temperature and speed read right. If the motor runs so now, begin a "
    "baseline of these nights with `baseline reset`."
)
FALL = "Check oil, sensors and flushing, or enter the overhaul that was made: a fall is no wear."
CHECK_LOGS = "Check whether the motor's logs arrive, and the reason of its last nights."
SEE_TO_REFUSED = "See to the reason of the last nights: nothing is known of the motor since."
CHECK_CHANNELS = (
    "Compare each channel with its instrument: whose tag it is, its clock, and whether it is held, "
    "damped or late. Where all are right, inspect the motor."
)
ADVICE = {
    "all_flows": "Take an oil sample, and check the flow meter's zero at a halt.",
    "oil_grade": "Take an oil sample, or enter the oil_change that was made.",
    "temperature_sensor": "Compare the oil temperature with a second thermometer.",
    "flushing": "Check the flushing, or enter the flushing_change that was made.",
    "known": "Check the constants of the motor type, and the speed sensor.",
    "zero": "Check the zero of the flow sensor at a halt without pressure.",
    "back_as_before": "Nothing to do.",
    "odd_nights": "Compare duty, charge pressure and oil of these nights with the others.",
    "channels": CHECK_CHANNELS,
    "tank": "Check oil, temperature and charge pressure of the oil circuit.",
}
BY_SPEED = "speed_curve"
CHECK_ZERO = "Check the sensor whose zero has moved."
# Causes that are no part of the motor.
OF_OIL_AND_SENSORS = {"all_flows", "oil_grade", "temperature_sensor", "temperature_effect", "zero"}
# Causes of the case drain flow that are no leakage; between causes that cannot be distinguished.
NO_LEAKAGE, ONE_OF = ("flushing", "zero"), " or "
# Candidates that are reported, and from which probability on beside a named cause.
MOST_CANDIDATES, LEAST_REPORTED = 3, 0.05
# Statuses of a time to a limit that have dates.
DATED = ("finite", "not_before", "beyond_horizon")
# Days ahead up to which a date is given to the day, not to the month.
TO_THE_DAY = 60


def day(date: object) -> str:
    """Return a date for people, such as 3 October 2026."""
    label = dt.date.fromisoformat(str(date)[:10])
    return f"{label.day} {label:%B %Y}"


def limit_dates(row: Mapping[str, Any]) -> str:
    """Return dates between which a row reaches its limit; empty without an earliest.

    Examples
    --------
    >>> row = {"night": dt.date(2026, 10, 3), "days_to_limit_status": "not_before"}
    >>> limit_dates(row | {"days_to_limit_lower": 320.0, "days_to_limit_upper": None})
    'not before August 2027'
    >>> limit_dates(row | {"days_to_limit_lower": 0.4, "days_to_limit_upper": None})
    ''
    >>> row = row | {"days_to_limit_status": "finite", "days_to_limit_upper": 200.0}
    >>> limit_dates(row | {"days_to_limit_lower": 20.0})
    'between 23 October 2026 and April 2027'
    """
    if row["days_to_limit_status"] not in DATED:
        return ""
    earliest = _date_ahead(row["night"], row["days_to_limit_lower"])
    if row["days_to_limit_upper"] is None:
        # Not before tonight says nothing.
        return f"not before {earliest}" if row["days_to_limit_lower"] >= 1.0 else ""
    return f"between {earliest} and {_date_ahead(row['night'], row['days_to_limit_upper'])}"


def _date_ahead(night: dt.date, days: float) -> str:
    """Return a day in the next two months, a month later on."""
    date = day(night + dt.timedelta(days=int(days)))
    return date if days < TO_THE_DAY else date.split(" ", 1)[1]


def sentence(night: NightState, quiet_since: dt.date | None, drifts: Sequence[str]) -> str:
    """Return a motor's sentence of a night: what, how much, since when, what else it could be."""
    parts = [_limit_words(night)] if night.way == "limit" else []
    if night.state == "stale":
        last = night.night - dt.timedelta(days=night.silent)
        why = night.why_no_blocks.removeprefix("no new data: ")
        what = "figure" if night.is_refused else "data"
        parts.append(f"no {what} since {day(last)}{': ' * bool(why)}{why}")
    elif night.verdict is None:
        parts.append(_insufficient(night))
    if night.change is not None and night.change.cause != "temperature_effect":
        parts.append(_change_in_words(night, night.change))
    elif quiet_since is not None and night.verdict and night.state != "stale":
        parts.append(_quiet(night, quiet_since))
    if night.is_refused and night.verdict is not None and night.state != "stale":
        parts.append(f"no figure of {day(night.night)}: {night.why_no_blocks}")
    if _no_part_is_named(night) and night.verdict is not None:
        lack = night.verdict.lack_of_fit
        parts.append(f"the model misses {100 * lack:.0f} % of the flow, so no part is named")
    return "; ".join([*parts, *drifts])


def _no_part_is_named(night: NightState) -> bool:
    """Return True where the model is the reason, be it for a change in force or for any."""
    unnamed = night.change is not None and night.change.cause == "not_identified"
    return night.model_verdict == "disproved" or (unnamed and night.model_verdict == "doubtful")


def advice(night: NightState, drifts: Sequence[str]) -> str:
    """Return what to do in a night: its order, or what would identify the cause."""
    if night.way == "limit" and night.change is None:
        return _inspect("the motor", night.state)
    if night.known is not None:
        # Silence ends no order.
        is_urgent = night.known.state not in ("insufficient", "ok")
        order = f" {advice(night.known, drifts)}" if is_urgent else ""
        return f"{SEE_TO_REFUSED if night.is_refused else CHECK_LOGS}{order}"
    if night.change is not None and night.state not in ("insufficient", "ok"):
        return _advice_on(night, night.change)
    if drifts:
        return CHECK_ZERO
    if night.is_refused and night.silent > 1:
        return SEE_TO_REFUSED
    if night.state == "insufficient":
        verdict = night.verdict
        is_elsewhere = verdict is not None and verdict.is_elsewhere and verdict.smallest is not None
        return ELSEWHERE if is_elsewhere else WAIT
    return "Nothing to do."


def _advice_on(night: NightState, change: Change) -> str:
    """Return what to do about a change in force."""
    if change.cause == "channels":
        return CHECK_CHANNELS
    parts = f"the {_parts(change)}" if is_of_parts(change.cause) else ""
    if night.state == "alarm":
        # An alarm carries an order, whatever its cause is called.
        return _inspect(parts or "the motor", "alarm")
    if change.cause in ADVICE:
        return ADVICE[change.cause]
    if not change.is_rise:
        return FALL
    if change.cause == "all_gaps":
        return "Take an oil sample: all gaps at once are rare."
    if change.cause in {path.name for path in night.spec.motor_type.path if path.law == BY_SPEED}:
        # A speed of another scale looks like it.
        return f"Compare the speed with a second reading; then plan an inspection of {parts}."
    return _inspect(parts, night.state) if parts else _to_identify(night, change)


def _inspect(what: str, state: str) -> str:
    if state == "alarm":
        return f"Inspect {what} at the next stop."
    return f"Plan an inspection of {what}."


def _to_identify(night: NightState, change: Change) -> str:
    """Return what would distinguish the causes that are left."""
    if change.is_several:
        return (
            "Take an oil sample first, and check the flow meter; "
            "then plan an inspection of the motor."
        )
    left = {name for label in change.candidates for name in label.split(ONE_OF)}
    elsewhere = "nights at other pressures and speeds"
    steps = []
    if left & OF_OIL_AND_SENSORS:
        steps += ["an oil sample", "the meter's zero at a halt", "a second thermometer"]
    if not left <= OF_OIL_AND_SENSORS and night.model_verdict == "supported":
        steps.append(elsewhere)
    if not steps:
        # Where the model itself misses, other nights do not show which part it is.
        return _inspect("the motor", night.state)
    if steps == [elsewhere]:
        order = _inspect("the motor", "alarm")
        return f"{order} Running at other pressures and speeds would identify the part beforehand."
    *first, last = steps
    both = f"{', '.join(first)} and {last}" if first else last
    return as_sentence(f"{both} would identify the cause")


def _limit_words(night: NightState) -> str:
    limits, leakage = night.spec.motor_type.limits, night.reference
    limit = limits.alarm_l_per_min if night.state == "alarm" else limits.warning_l_per_min
    assert leakage is not None
    return (
        f"leakage at the reference conditions {leakage.value:.3g} l/min "
        f"[{leakage.lower:.3g}, {leakage.upper:.3g}], beyond the motor type's limit of "
        f"{limit:g} l/min"
    )


def _insufficient(night: NightState) -> str:
    begin = "" if night.period.reason == "first nights" else f" since {night.period.reason}"
    none = f"; {day(night.night)} is none: {night.why_no_blocks}" if night.why_no_blocks else ""
    needed = night.spec.settings.trend.baseline_nights
    return f"{night.n_waiting} of {needed} nights of a baseline{begin}{none}"


def _quiet(night: NightState, since: dt.date) -> str:
    verdict = night.verdict
    assert verdict is not None
    words = f"too few nights since {day(since)} to show a change"
    if verdict.is_elsewhere and verdict.smallest is not None:
        words = "pressure, speed or oil are other than in the baseline: no change would show"
    if night.state != "insufficient" and verdict.smallest is not None:
        percent = max(math.ceil(100.0 * verdict.smallest), 1)
        words = (
            f"no change detected since {day(since)} (a step of {percent} % would have been within "
            "ten nights, a slow change may be larger)"
        )
    words = f"{words}; {_newest_night(night)}"
    if verdict.is_beyond:
        words = f"{words}, beyond such a step: a second night like it is a warning"
    change = night.change
    if change is not None:
        return f"{words}; the flow follows temperature otherwise than before {_since(change)}"
    if verdict.present.holds_zero:
        return words
    mean = relative_change(verdict.present)
    return f"{words}; leakage {mean} on average over the last nights, too little to be sure of"


def _change_in_words(night: NightState, change: Change) -> str:
    """Return a change in force in words."""
    if change.cause == "channels":
        return _channels_apart(night, change)
    what = WHAT.get(change.cause, f"leakage of the {_parts(change)} has {{risen}}")
    if ONE_OF in change.cause:
        what = f"leakage has {{risen}} through one or more of: {_one_of(change.cause)}"
    risen = "risen" if change.is_rise else "fallen"
    headline = what.format(risen=risen, thinner="thinner" if change.is_rise else "thicker")
    if change.grade:
        # Behind the oil, whatever else it may be.
        grade = rf"\g<0> (ISO VG {change.grade})"
        headline = re.sub("(thinner|thicker|another) oil", grade, headline)
    gap = "" if night.gap_growth is None else f"its gap {relative_change(night.gap_growth)}"
    size = f"{_newest_night(night)}, {_since(change)}"
    verdict = night.verdict
    assert verdict is not None
    newest = verdict.newest_night
    is_shown = newest.lower > 0.0 if change.is_rise else newest.upper < 0.0
    if not is_shown:
        # What a single night does not show by itself, those since the change do.
        mean = f"{_quantity(change)} {relative_change(verdict.present)} on average"
        size = f"{mean} {_since(change)}, {_newest_night(night)}"
    still = f"; still {'rising' if change.is_rise else 'falling'}"
    still = still if change.continues and is_shown else ""
    parts = (
        *(f"{headline}: {size}{still}", gap),
        *(_beside_circuit(night, change), _others(change)),
    )
    return "; ".join(part for part in parts if part)


def _channels_apart(night: NightState, change: Change) -> str:
    """Return in words that the flow follows the other channels no more."""
    verdict = night.verdict
    assert verdict is not None
    missed, usual = 100.0 * verdict.misfit, 100.0 * verdict.usual_misfit
    return (
        f"{WHAT[change.cause]} {_since(change)}: they leave {missed:.0f} % of it unexplained, at "
        f"most {max(usual, 0.1):.1f} % over the baseline; as measured {_newest_night(night)}"
    )


def _beside_circuit(night: NightState, change: Change) -> str:
    """Return the motor's own part and what its circuit's other motors did, over which nights."""
    circuit = night.circuit
    if circuit is None or change.cause == "odd_nights":
        return ""
    over = "in the first ten nights" if night.is_beyond_circuit_nights else "since then"
    return (
        f"on average {over} its own part {relative_change(circuit.own)}, the circuit's other "
        f"motors {relative_change(circuit.of_circuit)}"
    )


def _others(change: Change) -> str:
    """Return what it could be, with probabilities."""
    if change.cause == "odd_nights":
        return ""
    several = sorted(change.candidates.items(), key=lambda pair: -pair[1])
    if change.cause == "not_identified":
        left = [f"{cause_words(name)} {percent(p)}" for name, p in several[:MOST_CANDIDATES]]
        return f"possible: {', '.join(left)}" if left else ""
    left = [
        f"{cause_words(name)} {percent(p)}"
        for name, p in several
        if name != change.cause and p >= LEAST_REPORTED
    ]
    else_ = f", else {', '.join(left[:MOST_CANDIDATES])}" if left else ""
    return f"probability {percent(change.probability)}{else_}"


def _newest_night(night: NightState) -> str:
    verdict = night.verdict
    assert verdict is not None
    newest = night.night - dt.timedelta(days=night.silent)
    change = relative_change(verdict.newest_night)
    return f"{_quantity(night.change)} {change} on {day(newest)}"


def _quantity(change: Change | None) -> str:
    """Return what a change is of: a flushing and a meter's zero are no leakage (model.md, 7c.3)."""
    return "case drain flow" if change is not None and change.cause in NO_LEAKAGE else "leakage"


def relative_change(size: Estimate) -> str:
    """Return a relative change with its interval, in per cent."""
    return in_percent(100 * size.value, 100 * size.lower, 100 * size.upper)


def change_of(row: Mapping[str, Any], name: str = "leakage_change") -> str:
    """Return a change of a row of `nights` with its interval; empty where there is none."""
    ends = [row[f"{name}_{end}"] for end in ("percent", "lower", "upper")]
    return "" if None in ends else in_percent(*ends)


def change_in_force(row: Mapping[str, Any]) -> str:
    """Return the change of the newest night, or the mean since the onset where that shows none."""
    newest = change_of(row)
    if newest and row["onset"] and _may_be_zero(row, "leakage_change"):
        mean = change_of(row, "mean_change")
        return f"{mean} on average" if mean and not _may_be_zero(row, "mean_change") else newest
    return newest


def _may_be_zero(row: Mapping[str, Any], name: str) -> bool:
    return bool(row[f"{name}_lower"] <= 0.0 <= row[f"{name}_upper"])


def headline(row: Mapping[str, Any]) -> str:
    """Return the change of a row of `nights`, since when, and the part; empty without a change."""
    if not (size := change_in_force(row)):
        return ""
    quantity = "case drain flow" if row["cause"] in NO_LEAKAGE else "leakage"
    since = f" since {day(row['onset'])}" if row["onset"] else ""
    if row["cause"] == "channels":
        return f"{WHAT['channels']}{since}; as measured {quantity} {size}"
    part = f", {part_of(row['cause'])}" if row["cause"] else ""
    return f"{quantity} {size}{since}{part}"


def part_of(cause: str) -> str:
    """Return the part that a cause names, in words."""
    return "part not identified" if cause in ("not_identified", "a_part") else cause_words(cause)


def in_percent(value: float, lower: float, upper: float) -> str:
    """Return a change in per cent with its interval; a zero has no minus.

    Examples
    --------
    >>> in_percent(-0.02, -0.31, 0.27), in_percent(25.4, -0.4, 51.2)
    ('+0.0 % [-0.3, 0.3]', '+25 % [0, 51]')
    """
    digits = 0 if abs(value) >= 10 else 1
    return f"{value:+z.{digits}f} % [{lower:z.{digits}f}, {upper:z.{digits}f}]"


def _since(change: Change) -> str:
    first, low, high = (
        dt.date.fromordinal(ordinal)
        for ordinal in (change.since, change.since_lower, change.since_upper)
    )
    between = "" if low == high else f" ({day(low)} to {day(high)})"
    return f"since {day(first)}{between}"


def cause_words(name: str) -> str:
    """Return a cause for people, or causes that cannot be distinguished.

    Examples
    --------
    >>> cause_words("oil_grade"), cause_words("balance_sleeve or oil_grade")
    ('another oil', 'one or more of: balance sleeve, another oil')
    """
    return f"one or more of: {_one_of(name)}" if ONE_OF in name else CAUSES.get(name, plain(name))


def _one_of(label: str) -> str:
    return ", ".join(cause_words(name) for name in label.split(ONE_OF))


def is_of_parts(label: str) -> bool:
    """Return True if a cause, or all that cannot be distinguished, are parts of the motor."""
    return all(name not in CAUSES and name not in WHAT for name in label.split(ONE_OF))


def _parts(change: Change) -> str:
    *first, last = plain(change.cause).replace(" and ", ONE_OF).split(ONE_OF)
    return f"{', the '.join(first)} and the {last}" if first else last


def percent(probability: float) -> str:
    """Return a probability for people."""
    return "above 99 %" if probability > 0.99 else f"{100 * probability:.0f} %"
