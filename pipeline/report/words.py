"""Words of the pages for codes, names and units of the tables; `schema` has those of reasons."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from pipeline.schema import QUALITY_REASONS

ABSENT: Final = "–"
STATUSES: Final[Mapping[str, str]] = {
    "ok": "fitted",
    "stood_still": "stood still",
    "no_new_data": "no log",
    "insufficient_data": "too little data",
    "failed": "failed",
}
VERDICTS: Final[Mapping[str, str]] = {
    "identified": "determined by the data",
    "only_in_combination": "known only together with others",
    "not_excited": "not seen: the motor did not run where it would show",
    "at_bound": "at its bound",
    "fixed": "held fixed",
    "too_little_data": "too little data to say",
    "not_identified": "not determined by the data",
    "outside_fitted_range": "outside what the night's data cover",
    "uncertain": "known, but not well",
    "extrapolated": "extrapolated from close by",
    "supported": "the data support the model",
    "doubtful": "the data cast doubt on the model",
    "disproved": "the data disprove the model",
}
UNITS: Final[Mapping[str, str]] = {
    "m3": "m³",
    "um": "µm",
    "l_per_min": "l/min",
    "1": "",
    "percent": "%",
}
CHANNELS: Final[Mapping[str, str]] = {
    "time_base": "all channels together",
    "leakage_flow": "drain flow",
}
FLUSHING: Final[Mapping[str, str]] = {
    "none": "no flushing",
    "fixed": "fixed flushing",
    "estimated": "estimated flushing",
}
TESTS: Final[Mapping[str, str]] = {
    "whiteness": "with itself",
    "independence": "with an input",
    "passed": "passed",
    "failed": "failed",
    "not_tested": "not tested",
    "none": "",
}
SENSORS: Final[Mapping[str, str]] = {"ok": "unchanged", "drifted": "moved"}
# A state has the name that the tables have; the pages say its meaning beside.
STATES: Final[Mapping[str, str]] = {
    "alarm": "the leakage is above the alarm level, or above the motor type's own limit",
    "warning": "a change is told and in force",
    "common_cause": "the other motors of the tank have changed alike",
    "stale": "no night with samples for long; nothing is known of now",
    "insufficient": "too few nights for a baseline",
    "ok": "no change is told; each motor says how small a change would have been",
}
TIMES_TO_LIMIT: Final[Mapping[str, str]] = {
    "no_trend": "no trend towards it",
    "already_crossed": "already crossed",
    "insufficient": "too few nights",
}
DECISIONS: Final[Mapping[str, str]] = {
    "acknowledged": "acknowledged",
    "finding": "inspected",
    "baseline_reset": "baseline reset",
    "confirmed": "wear was found",
    "not_confirmed": "no wear was found",
}
EVENTS: Final[Mapping[str, str]] = {
    "overhaul": "overhaul",
    "oil_change": "oil change",
    "flushing_change": "change of flushing",
    "motor_exchanged": "motor exchanged",
    "note": "note",
}


def plain(name: str) -> str:
    """A name of the tables with blanks for underscores."""
    return name.replace("_", " ")


def candidates(text: str | None) -> list[tuple[str, float]]:
    """Causes with their probabilities, as a row of `watch` lists them.

    Examples
    --------
    >>> candidates("balance_sleeve 0.93; all_gaps 0.05")
    [('balance sleeve', 0.93), ('all gaps', 0.05)]
    """
    parts = (one.rsplit(" ", 1) for one in (text or "").split("; ") if one)
    return [(plain(cause), float(probability)) for cause, probability in parts]


def sentence(words: str) -> str:
    """Words of a state as a sentence."""
    return f"{words[:1].upper()}{words[1:]}{'' if words.endswith('.') else '.'}"


def for_scripts() -> dict[str, Mapping[str, str]]:
    """All words that the scripts of a page need, as they are handed to it."""
    return {
        "statuses": STATUSES,
        "verdicts": VERDICTS,
        "units": UNITS,
        "channels": CHANNELS,
        "rules": {name: reason.words for name, reason in QUALITY_REASONS.items()},
        "flushing": FLUSHING,
        "tests": TESTS,
        "timesToLimit": TIMES_TO_LIMIT,
        "events": EVENTS,
    }


def figure(value: float | None, digits: int = 3) -> str:
    """A figure with a number of significant digits, never in powers of ten above that.

    Examples
    --------
    >>> figure(1.2345), figure(0.05), figure(-123456.0), figure(None)
    ('1.23', '0.0500', '−123456', '–')
    """
    if value is None:
        return ABSENT
    text = f"{value:.0f}" if abs(value) >= 10**digits else f"{value:#.{digits}g}"
    return text.removesuffix(".").replace("-", "−")


def signed(value: float | None, decimals: int = 1) -> str:
    """A change with its sign.

    Examples
    --------
    >>> signed(-3.21), signed(None)
    ('−3.2', '–')
    """
    if value is None:
        return ABSENT
    rounded = round(value, decimals) + 0.0  # no minus before a zero
    return f"{rounded:+.{decimals}f}".replace("-", "−")
