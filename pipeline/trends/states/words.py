"""Meanings of states, in plain words."""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from leakage.course.monitoring import ChangeSize
    from leakage.course.temperature_correction import TemperatureCorrection

NAMES = {
    "reference_leakage": "reference leakage",
    "own_reference_leakage": "leakage at the motor's own conditions",
    "baseline_deviation": "drain flow against the baseline's model",
    "peer_deviation": "drain flow against the other motors of the circuit",
    "drain_flow": "drain flow",
    "temperature_effect": "effect of temperature on the loss factors",
    "comparable_drain_flow": "drain flow at the reference conditions",
    "baseline_progress": "progress towards a baseline",
    "oil_viscosity": "viscosity as measured against the data sheet",
    "model_misfit": "misfit of the model",
    "C_f": "flushing",
    "pressure_zero": "zero of the pressure sensor",
    "flow_zero": "zero of the flow sensor",
}
FALL = "a fall is no wear but another oil, a sensor, the flushing, a filled gap or a new part"
# Statuses of a time to a limit that have dates.
DATED = ("finite", "not_before", "beyond_horizon")
# Days ahead up to which a date is told to the day, not to the month.
TO_THE_DAY = 60
MONTHS = (
    *("January", "February", "March", "April", "May", "June"),
    *("July", "August", "September", "October", "November", "December"),
)


def name_of(indicator: str) -> str:
    """An indicator's name for people: a loss factor K stands for its gap, K ∝ h³.

    Examples
    --------
    >>> name_of("K_balance_sleeve"), name_of("reference_leakage")
    ('balance sleeve gap', 'reference leakage')
    """
    for prefix, what in (("K_", "gap"), ("leakage_", "leakage"), ("gap_change_", "gap")):
        if indicator.startswith(prefix):
            return f"{indicator.removeprefix(prefix).replace('_', ' ')} {what}"
    return NAMES.get(indicator, indicator.replace("_", " "))


def day(date: object) -> str:
    """A date for people.

    Examples
    --------
    >>> import datetime as dt
    >>> day(dt.date(2026, 10, 3))
    '3 October 2026'
    """
    year, month, day_of_month = str(date)[:10].split("-")
    return f"{int(day_of_month)} {MONTHS[int(month) - 1]} {year}"


def limit_dates(row: Mapping[str, Any]) -> str:
    """Dates between which a row of `trends` has its limit reached; empty without an earliest one.

    Examples
    --------
    >>> import datetime as dt
    >>> row = {"night": dt.date(2026, 10, 3), "days_to_limit_status": "not_before"}
    >>> limit_dates(row | {"days_to_limit_lower": 320.0, "days_to_limit_upper": None})
    'not before August 2027'
    >>> row = row | {"days_to_limit_status": "finite", "days_to_limit_upper": 200.0}
    >>> limit_dates(row | {"days_to_limit_lower": 20.0})
    'between 23 October 2026 and April 2027'
    """
    if row["days_to_limit_status"] not in DATED:
        return ""
    earliest = _date_ahead(row["night"], row["days_to_limit_lower"])
    if row["days_to_limit_upper"] is None:
        return f"not before {earliest}"
    return f"between {earliest} and {_date_ahead(row['night'], row['days_to_limit_upper'])}"


def _date_ahead(night: dt.date, days: float) -> str:
    """A day in the next two months, a month later on."""
    date = day(night + dt.timedelta(days=int(days)))
    return date if days < TO_THE_DAY else date.split(" ", 1)[1]


def falls_words(per_kelvin: float) -> str:
    """Change of all loss factors with temperature.

    Examples
    --------
    >>> falls_words(-0.0097)
    'K falls by 0.97 % a kelvin'
    """
    way = "falls" if per_kelvin < 0.0 else "rises"
    return f"K {way} by {100.0 * abs(per_kelvin):.2f} % a kelvin"


def temperature_words(frozen: TemperatureCorrection) -> str:
    """Effect of temperature on the loss factors, of the baseline; empty where none is certain.

    Examples
    --------
    >>> from leakage.course.temperature_correction import TemperatureCorrection
    >>> temperature_words(TemperatureCorrection(-0.0097, 0.002, 50.0))
    "K falls by 0.97 % a kelvin: the sensor is not where the gap is, or the oil's curve is off"
    """
    if not frozen.is_certain:
        return ""
    effect = falls_words(frozen.per_kelvin)
    return f"{effect}: the sensor is not where the gap is, or the oil's curve is off"


def size_words(indicator: str, size: ChangeSize, since: object) -> str:
    """Rise of an indicator and its date, in words; or that the rise is undone.

    Of a loss factor K the change of the gap height is told, (1 + change of K)^⅓ − 1.

    Examples
    --------
    >>> from leakage.course.monitoring import ChangeSize
    >>> size_words("K_balance_sleeve", ChangeSize(9, 0.38, 0.29, 0.47, 10), "2026-10-03")
    'balance sleeve gap +11 % [9, 14] since 3 October 2026'
    >>> size_words("reference_leakage", ChangeSize(9, -0.057, -0.1, -0.014, 10), "2026-10-03")
    'reference leakage is down to -5.7 % [-10.0, -1.4] after a rise since 3 October 2026'
    """
    change, lower, upper = (
        relative_change(indicator, one) for one in (size.relative, size.lower, size.upper)
    )
    digits = 0 if abs(change) >= 0.1 else 1
    figures = f"{100 * change:+.{digits}f} % [{100 * lower:.{digits}f}, {100 * upper:.{digits}f}]"
    if change <= 0.0:
        return f"{name_of(indicator)} is down to {figures} after a rise since {day(since)}"
    return f"{name_of(indicator)} {figures} since {day(since)}"


def relative_change(indicator: str, change: float) -> float:
    """Relative change as it is told: of K that of its gap height, of others as it is.

    Examples
    --------
    >>> round(relative_change("K_piston_ring", 1.197), 3), relative_change("drain_flow", 0.2)
    (0.3, 0.2)
    """
    return math.cbrt(max(1.0 + change, 0.0)) - 1.0 if indicator.startswith("K_") else change
