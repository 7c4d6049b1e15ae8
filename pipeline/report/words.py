"""Words of the pages for codes and units of the tables; the watch's are in `trends.sentences`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from pipeline.messages import plain
from pipeline.schema import QUALITY_REASONS
from pipeline.trends.sentences import cause_words

ABSENT: Final = "–"
UNITS: Final[Mapping[str, str]] = {
    "m3": "m³",
    "um": "µm",
    "l_per_min": "l/min",
    "1": "",
    "percent": "%",
}
# A state has the name that the tables have; the pages say its meaning beside.
STATES: Final[Mapping[str, str]] = {
    "alarm": "the leakage is above the alarm level, or above the motor type's own limit",
    "warning": "a change was detected and is in force",
    "common_cause": "the other motors of the oil circuit have changed alike",
    "stale": "no night with samples for long; nothing is known of now",
    "insufficient": "too few nights for a baseline",
    "ok": "no change was detected; each motor says how small a change would have been",
}
# Terms of all pages, on a page of their own.
GLOSSARY: Final[Mapping[str, str]] = {
    "Leakage at the motor's own conditions": "Oil that the motor loses through its gaps, without "
    "flushing, at one fixed pressure, temperature and speed: the medians of its baseline. It does "
    "not move with the night's load, so it is the figure to follow.",
    "Leakage at the reference": "The same at the fleet's reference conditions, the same for all "
    "motors, to compare one with another. Where a motor never ran near them there is none.",
    "Drain flow": "What the sensor measures in the drain line, flushing included. It rises and "
    "falls with pressure, temperature and speed, so by itself it says nothing on wear.",
    "Baseline": "The first nights of a motor, or those after an event such as an overhaul. Later "
    "nights are compared with them.",
    "Change of the drain flow": "By how many percent the night's drain flow differs from what the "
    "baseline would give at the same pressure, temperature and speed.",
    "Change of a gap": "By how many percent a gap is higher. The flow goes with its cube: twice "
    "the flow is a gap 26 % higher. It never means the same as a change of the flow.",
    "Interval": "Two figures in brackets: the true value lies between them 95 times of 100.",
    "Evidence": "How strongly the nights speak for a change, as a logarithm (ln R). Above its "
    "limit a change is detected. Falsely that happens about once in the time the fleet file sets.",
    "Cause": "What fits a change best, with its probability: a part, the oil, a sensor. Where "
    "several fit, none is named, and the page says what would tell.",
    "Lack of fit": "What of the baseline's flow the model leaves to pressure, speed and "
    "temperature. Up to 2 % it is supported, up to 5 % doubtful; beyond, no part is named.",
}


def refusal(code: str) -> str:
    """Words of a rule that refuses samples."""
    reason = QUALITY_REASONS.get(code)
    return plain(code) if reason is None else reason.words


def candidates(text: str | None) -> list[tuple[str, float]]:
    """Causes with their probabilities, as a row of `watch` lists them.

    Examples
    --------
    >>> candidates("balance_sleeve 0.93; all_gaps 0.05")
    [('balance sleeve', 0.93), ('all gaps', 0.05)]
    """
    parts = (one.rsplit(" ", 1) for one in (text or "").split("; ") if one)
    return [(cause_words(cause), float(probability)) for cause, probability in parts]


def figure(value: float | None, digits: int = 3) -> str:
    """A figure with a number of significant digits, never in powers of ten above that.

    Examples
    --------
    >>> figure(1.2345), figure(0.05), figure(999.6), figure(-123456.0), figure(-0.0)
    ('1.23', '0.0500', '1000', '−123456', '0.00')
    """
    if value is None:
        return ABSENT
    rounded = float(f"{value:.{digits}g}") + 0.0  # no minus before a zero
    is_large = abs(rounded) >= 10**digits
    text = f"{value:.0f}" if is_large else f"{rounded:z#.{digits}g}"
    return text.removesuffix(".").replace("-", "−")


def conditions(
    pressure_bar: float | None, temperature_c: float | None, speed_rpm: float | None
) -> str:
    """Conditions of a leakage.

    Examples
    --------
    >>> conditions(131.3, 48.62, 24.7)
    '131 bar, 48.6 °C, 24.7 rpm'
    """
    return f"{figure(pressure_bar)} bar, {figure(temperature_c)} °C, {figure(speed_rpm)} rpm"


def percent(share: float | None, decimals: int = 1) -> str:
    """A change with its sign, in percent.

    Examples
    --------
    >>> percent(-0.0321), percent(-0.0001), percent(None)
    ('−3.2', '+0.0', '–')
    """
    if share is None:
        return ABSENT
    return f"{100.0 * share:+z.{decimals}f}".replace("-", "−")
