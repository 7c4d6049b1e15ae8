"""Explanations of a change in plain words: what looks the same, and what would tell."""

from __future__ import annotations

import math

import numpy as np

from leakage.course.growth import Shift
from leakage.course.hypotheses import PROBABLE, Posterior
from leakage.physics.oil import dynamic_viscosity_pa_s
from pipeline.trends.nights.history import History
from pipeline.trends.why.oil import grade_of, mean_temperature_c, oil_as_measured, water_in_oil

# Standard error up to which a change with temperature says something [1/K].
WIDEST_BETA = 0.001
LEAST_TOLD = 0.02
# What lifts the flushing and lowers the gaps' part, or the reverse.
MAY_TAKE_BACK = (
    "a path with another pressure law (as a ring that leaks most at low pressure), the meter's "
    "zero or the flushing may; what would tell: such a path in the motor type, halts without "
    "pressure, the flushing measured and fixed"
)


def why_words(
    history: History, place: int, begin: int, found: Posterior | None, own: str = ""
) -> str:
    """Cause of the change of a motor's flows since a place, in words; empty if none can be told.

    For a loss factor whose own path has grown, only the other causes.
    """
    if found is None:
        return ""
    factor = _factor(history, place, begin, found) if found.is_common else ""
    if own and own in found.named:
        return f"besides, {factor}" if factor else ""
    if found.verdict == "path":
        percent = probable_words(min(found.paths[name] for name in found.named))
        names = " and ".join(_plain(name) for name in found.named)
        grown = ", which have all grown" if len(found.named) > 1 else ""
        by = "by" if grown else "mostly by"
        words = f"{by} {names}{grown} ({percent} probable)"
        return f"{words}; and {factor}" if factor else words
    if found.verdict == "common":
        no_path = probable_words(1.0 - found.any_path)
        return f"{factor}; no path ({no_path})"
    if found.verdict == "no_change":
        no_path = probable_words(1.0 - found.any_path)
        return f"no path ({no_path}), and no common change of all flows is certain"
    besides = cannot_be_told(found, oil_as_measured(history, place, begin))
    return f"{factor}; whether a path has grown besides {besides}" if factor else besides


def probable_words(probability: float) -> str:
    """A probability of a thing that is told.

    Examples
    --------
    >>> probable_words(0.9712), probable_words(0.9991)
    ('97 %', 'over 99 %')
    """
    return "over 99 %" if probability > 0.99 else f"{100 * probability:.0f} %"


def _plain(name: str) -> str:
    return f"the {name.replace('_', ' ')}"


def _factor(history: History, place: int, begin: int, found: Posterior) -> str:
    """The common change of all flows, in words, and the causes that look like it."""
    measured = oil_as_measured(history, place, begin)
    told = measured or water_in_oil(history, place)
    grade = grade_of(history, place, begin, found)
    parts = [_causes(history, place, found, measured), told]
    if grade is not None:
        parts.append(
            f"ISO VG {grade} would do so: if it was filled in, enter an oil_change with its date "
            "in the motor's file"
        )
    return "; ".join(part for part in parts if part)


def _causes(history: History, place: int, found: Posterior, measured: str) -> str:
    log, sd = found.factor.log, found.factor.sd
    factor = math.exp(log)
    words = f"all flows × {factor:.2f} ± {1.96 * sd * factor:.2f}"
    thinner = 100.0 * (1.0 - 1.0 / factor)
    oil = f"the oil were {abs(thinner):.0f} % {'thinner' if thinner > 0 else 'thicker'}"
    if found.is_of_tank:
        words += ", as in the other motors of the oil circuit"
        if measured:
            return f"{words}: the oil's temperature or the charge pressure, not this motor"
        return f"{words}: as if {oil}, not this motor"
    kelvin, beta = _as_temperature(history, place, log)
    sensor = (
        f"the temperature sensor read {abs(kelvin):.0f} °C {'low' if kelvin > 0 else 'high'}, or "
        f"the meter {abs(100.0 * (factor - 1.0)):.0f} % {'high' if factor > 1.0 else 'low'}"
    )
    if found.own_sensor is not None and found.own_sensor >= PROBABLE:
        words += f", unlike the other motors of the oil circuit: its own sensor, as if {sensor}"
    else:
        words += f": as if {sensor}" if measured else f": as if {oil}, or {sensor}"
    return words + _hint(found, beta)


def _as_temperature(history: History, place: int, log: float) -> tuple[float, float]:
    """Error of the temperature that looks like a factor [K], and its change with it [1/K]."""
    oil = history.spec.oil_on(history.nights[place]).oil()
    at = np.array([-1.0, 0.0, 1.0]) + mean_temperature_c(history, place)
    below, here, above = np.log(dynamic_viscosity_pa_s(at, 0.0, oil)).tolist()
    kelvin = -2.0 * log / (above - below)
    return kelvin, -kelvin * (above - 2.0 * here + below)


def _hint(found: Posterior, of_sensor: float) -> str:
    """The cause that the change of the factor with temperature suggests; empty if none."""
    if found.with_temperature is None or found.with_temperature[1] > WIDEST_BETA:
        return ""
    if found.own_sensor is None and abs(found.factor.log) < LEAST_TOLD:
        return ""
    beta, error = found.with_temperature
    is_sensor, is_gain = abs(beta - of_sensor) < 2.0 * error, abs(beta) < 2.0 * error
    if is_sensor == is_gain and is_sensor:
        return ""
    says = "the temperature sensor" if is_sensor else "another grade of oil"
    if is_gain:
        says = "thinner or thicker oil of the same grade, or the meter"
    return f" (it changes by {1000 * beta:+.1f} ± {2000 * error:.1f} % per 10 K, as by {says})"


def _taken_back(shift: Shift) -> str:
    """What the gaps and the flushing did against each other, what may do so, what would tell."""
    gaps, flushing = 1.96 * np.sqrt(np.diag(shift.covariance))
    return (
        f"the gaps' part {100.0 * shift.gaps:+.1f} ± {100.0 * gaps:.1f} % and the flushing "
        f"{shift.flow * shift.flushing:+.2f} ± {shift.flow * flushing:.2f} l/min, which no oil "
        f"does: {MAY_TAKE_BACK}"
    )


def cannot_be_told(found: Posterior, measured_oil: str = "") -> str:
    """Possible causes of a change, and the data that would decide between them."""
    if found.taken_back:
        return _taken_back(found.taken_back)
    some = [f"{_plain(name)} ({100 * found.paths[name]:.0f} %)" for name in found.candidates]
    is_path = found.any_path >= PROBABLE
    if not is_path and 1.0 - PROBABLE < found.common < PROBABLE:
        some.append(f"a common change of all flows ({100 * found.common:.0f} %)")
    missing = [_plain(name) for name in found.unjudged]
    if missing:
        some.append(f"{' or '.join(missing)}, of which the nights tell too little")
    tells = ["more nights"]
    if not found.has_standard:
        tells.append("varying speed")
    if not is_path and found.tank is None:
        tells.append("a second motor on the tank")
    if not is_path and not found.is_common and not measured_oil:
        tells.append("an oil sample")
    what = "which path cannot be told" if is_path else "cannot be told"
    may_be = f": {' or '.join(some)}" if some else ""
    return what + may_be + (f"; what would tell: {', '.join(tells)}" if tells else "")
