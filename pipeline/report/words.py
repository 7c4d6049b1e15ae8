"""Words of the pages for codes and units of the tables; the watch's are in `trends.sentences`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from pipeline.messages import plain
from pipeline.schema import QUALITY_REASONS, model_verdict
from pipeline.trends.sentences import cause_words

ABSENT: Final = "–"
INDICATORS: Final[Mapping[str, str]] = {
    "pressure_zero": "zero of the pressure sensor",
    "flow_zero": "zero of the flow sensor",
}
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
    "stale": "no night with samples for long: the present state is unknown",
    "removed": "in the config no more, and nobody has confirmed it",
    "insufficient": "too few nights for a baseline, or to show a change",
    "ok": "no change was detected; each motor says how small a step would have been",
}


def refusal(code: str) -> str:
    """Words of a rule that refuses samples."""
    reason = QUALITY_REASONS.get(code)
    return plain(code) if reason is None else reason.words


def candidates(causes: Sequence[Mapping[str, Any]] | None) -> list[tuple[str, float]]:
    """Return causes in words with their probabilities, as a row of `nights` lists them."""
    return [(cause_words(cause["cause"]), cause["probability"]) for cause in causes or ()]


def of_model(model_error_percent: float) -> str:
    """Return the verdict on a model by what it misses of the flow."""
    return model_verdict(model_error_percent / 100.0)


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
    """Return conditions of a leakage in words."""
    return f"{figure(pressure_bar)} bar, {figure(temperature_c)} °C, {figure(speed_rpm)} rpm"
