"""Columns that change places, or their unit, from a night on: reported as that, not as wear.

A reading of another unit is a factor between units off for a whole night, which a load, a speed or
a temperature may be, too. It is another unit, of the night or of the others, where two of three
signs say so:

| Sign | Holds where |
|---|---|
| exact | the reading in the other unit is the usual one, nearly |
| relation | the motor's model has the flow of the night as usual with it, and not without it |
| alone | all other readings are the usual ones |

Where the other nights may be those of another unit, a speed or a flow that has risen has to be
exact to a few percent.
"""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from functools import cache, partial
from itertools import combinations, product
from operator import itemgetter
from statistics import median
from typing import Any, NamedTuple

from leakage import LeakageError, OperatingConditions, total_flow_l_per_min
from pipeline.config import MotorSpec
from pipeline.config.channels import PORT_PRESSURES
from pipeline.messages import plain
from pipeline.units import QUANTITIES, UNITS, canonical_unit, from_canonical, to_canonical

# Means that are compared, by channel, as the table `nights` has them; and their units.
COLUMNS = {
    "pressure_difference": "mean_pressure_bar",
    "oil_temperature": "mean_temperature_c",
    "speed": "mean_speed_rpm",
    "leakage_flow": "mean_drain_flow_l_per_min",
}
LOWEST, HIGHEST = " lowest", " highest"  # behind a channel: the mean of such a night
FLOW = "leakage_flow"
DIFFERENCE = "pressure_difference"
PLACES = (DIFFERENCE, "oil_temperature", "speed")
# Gauges of two are compared where each is known by itself.
OF_ONE_UNIT = (DIFFERENCE, *PORT_PRESSURES, "oil_temperature", "speed", FLOW)
# Factors within which a reading is as usual, or nearly (standstill and load shift means), and
# beyond which it is not, or is no wear of a night; a difference of two gauges of which one is in
# another unit is further off than any load with the same flow.
USUAL, NEAR, FAR, WORN, GAUGE_FAR = 1.3, 1.5, 2.0, 3.0, 10.0
# A motor may run ten times as fast from a night on, or leak four times as much.
MAY_RISE, EXACT = ("speed", FLOW), 1.04
# By how much a unit that few plants have is less likely, and the power of a factor off the model
# (of 2 640 simulated changes 7 % blame the wrong nights; by nearness alone 19 %).
RARE, MODEL_SHARE = 1.2, 0.25
COMMON_UNITS = {
    *("bar", "MPa", "kPa", "psi", "degC", "degF", "rpm", "rad/s", "1/s"),
    *("l/min", "l/h", "m3/h", "ml/min", "us_gal/min"),
}
USUAL_C = 8.0
SIGNS = 2
# A low port without charge pressure may be at any multiple of it [bar].
CHARGED_BAR = 5.0
# Nights before that say what is usual, and how many of them are needed.
USUAL_NIGHTS, FEWEST_USUAL = 7, 3

ModelFlow = Callable[[float, float, float], float | None]


class Change(NamedTuple):
    """A change of columns or of a unit, in words."""

    words: str
    is_of_others: bool = False  # the other nights have another unit than configured


def readings_of(row: Mapping[str, Any]) -> dict[str, float]:
    """Return means of the channels in a row of `nights`; empty where one is not known."""
    means = {name: row[column] for name, column in COLUMNS.items() if row.get(column) is not None}
    return means if means.keys() == COLUMNS.keys() else {}


def usual_readings(rows: Iterable[Mapping[str, Any]]) -> dict[str, float]:
    """Return medians, and lowest and highest means, of the channels; empty where rows are few."""
    nights = list(filter(None, map(readings_of, rows)))
    if len(nights) < FEWEST_USUAL:
        return {}
    return {
        name + end: of(night[name] for night in nights)
        for name in COLUMNS
        for end, of in (("", median), (LOWEST, min), (HIGHEST, max))
    }


def refusal(change_words: str, unlike: dt.date | None = None) -> str:
    """Return why a night is refused for a change, be it the other nights' beside one unlike it."""
    how = "mend the log or the motor's file, enter a dated event if the motor runs so now"
    which = "" if unlike is None else f"unlike night {unlike}: "
    return f"{which}{change_words}; {how}, or ack the night"


def column_change(
    spec: MotorSpec,
    usual: Mapping[str, float],
    now: Mapping[str, float],
    *,
    is_fitted: bool = True,
) -> Change | None:
    """Return why readings look like those of other columns or units than usual; None: they do not.

    A night that is not fitted says nothing of the others' units.
    """
    if min(means[name] for means in (usual, now) for name in COLUMNS) <= 0.0:
        return None
    # Of all units that a flow may be in, the model's flow is the same.
    model_flow = cache(partial(_model_flow, spec))
    units = [
        other_unit
        for is_of_others in ((False, True) if is_fitted else (False,))
        for other_unit in _other_units(spec, model_flow, usual, now, is_of_others=is_of_others)
    ]
    likeliest = min(units, key=itemgetter(0), default=(0.0, None))[1]
    return _swapped_columns(usual, now) or likeliest or _other_gauge(spec, usual, now)


def _model_flow(
    spec: MotorSpec, pressure_bar: float, temperature_c: float, speed_rpm: float
) -> float | None:
    """Return the flow of the configured model at mean conditions, or None where it has none."""
    conditions = OperatingConditions.from_bar(pressure_bar, temperature_c, speed_rpm)
    with suppress(LeakageError):
        motor = spec.motor(dt.date.max, spec.file.flushing.mode)
        return float(total_flow_l_per_min(motor, conditions)[0])
    return None


def _swapped_columns(usual: Mapping[str, float], now: Mapping[str, float]) -> Change | None:
    """Return a pair of columns that changed places, or None; the flow is as before."""
    if _factor(now[FLOW], usual[FLOW]) > FAR:
        return None
    for channel, other in combinations(PLACES, 2):
        are_far = all(_factor(now[name], usual[name]) > FAR for name in (channel, other))
        pairs = (now[channel], usual[other]), (now[other], usual[channel])
        if are_far and all(_factor(*pair) < NEAR for pair in pairs):
            return Change(
                f"columns changed? {plain(channel)} and {plain(other)} look swapped: "
                f"{_reading(channel, now)} and {_reading(other, now)}, "
                f"usually {_reading(channel, usual)} and {_reading(other, usual)}"
            )
    return None


def _other_units(
    spec: MotorSpec,
    model_flow: ModelFlow,
    usual: Mapping[str, float],
    now: Mapping[str, float],
    *,
    is_of_others: bool,
) -> Iterator[tuple[float, Change]]:
    """Yield readings that are right in another unit, the likeliest with the smallest figure.

    The right ones, of now or the usual ones, are nearer to the configured model, and the others in
    a unit that plants have.
    """
    right, wrong = (now, usual) if is_of_others else (usual, now)
    misfit = _factor(_relation(model_flow, right), 1.0) ** MODEL_SHARE
    channels = {str(name): channel for name, channel in spec.file.channels.items()}
    for name in (name for name in OF_ONE_UNIT if _is_known(name, usual, now)):
        channel = channels[name if name in channels else PORT_PRESSURES[0]]
        is_unusual = name == FLOW or _beyond(name, now[name], usual) > NEAR
        if channel.is_counted or not is_unusual:
            continue
        place = f"channels.{name}" if name in channels else "both gauges"
        may_be_right = is_of_others and name in MAY_RISE and now[name] > usual[name]
        for configured, unit in product(channel.units, UNITS[QUANTITIES[name]]):
            # As it is if the log is in another unit than configured.
            as_logged = from_canonical(name, wrong[name], configured)
            reading = float(to_canonical(name, as_logged, unit))
            if reading <= 0.0 or _factor(reading, wrong[name]) <= FAR:
                continue
            off = _off(model_flow, name, reading, right, wrong)
            if off < (EXACT if may_be_right else math.inf):
                like, when = ("now", "usually") if is_of_others else ("usual", "now")
                words = (
                    f"unit changed? {_changed(name, usual, now)}: as {like} if the log {when} has "
                    f"it in {unit} where the config has {configured} (earlier_units of "
                    f"{place} date a unit)"
                )
                rarity = 1.0 if unit in COMMON_UNITS else RARE
                yield off * rarity * misfit, Change(words, is_of_others)


def _other_gauge(
    spec: MotorSpec, usual: Mapping[str, float], now: Mapping[str, float]
) -> Change | None:
    """Return a difference of two gauges that no load makes with the same flow, or None."""
    far = _factor(now[DIFFERENCE], usual[DIFFERENCE])
    is_as_before = _factor(now[FLOW], usual[FLOW]) <= FAR
    if far > GAUGE_FAR and DIFFERENCE not in spec.file.channels and is_as_before:
        words = f"unit changed? {_changed(DIFFERENCE, usual, now)}"
        return Change(f"{words}: of one of its two gauges?")
    return None


def _off(
    model_flow: ModelFlow,
    name: str,
    reading: float,
    usual: Mapping[str, float],
    now: Mapping[str, float],
) -> float:
    """Return the factor by which another reading is off; inf without two signs for it."""
    right = _with_reading(name, reading, now)
    before, as_read, mended = (_relation(model_flow, means) for means in (usual, now, right))
    off, left = _factor(as_read, before), _factor(mended, before)
    if name != FLOW:
        left_of_range = _beyond(name, reading, usual)
        is_exact, is_related = left_of_range < USUAL, off > NEAR and left < USUAL
    else:
        # The flow itself is no sign of its unit; no wear of a night is as far off.
        left_of_range, is_exact, is_related = left, left < USUAL, off > WORN
    own = {name, DIFFERENCE} if name in PORT_PRESSURES else {name}
    others = [channel for channel in COLUMNS if channel not in own]
    is_alone = all(_is_usual(other, usual, now) for other in others)
    n_signs = sum((is_exact, is_related, is_alone))
    return left_of_range if left_of_range <= NEAR and n_signs >= SIGNS else math.inf


def _beyond(name: str, value: float, usual: Mapping[str, float]) -> float:
    """Return the factor by which a mean is beyond those of the usual nights; 1 within them."""
    lowest, highest = (usual.get(name + end, usual[name]) for end in (LOWEST, HIGHEST))
    return max(lowest / value, value / highest, 1.0)


def _with_reading(name: str, reading: float, now: Mapping[str, float]) -> dict[str, float]:
    """Return the means with another reading of a channel, of which the difference may be."""
    right = {**now, name: reading}
    if name in PORT_PRESSURES:
        high, low = (right[port] for port in PORT_PRESSURES)
        right[DIFFERENCE] = abs(high - low)
    return right


def _relation(model_flow: ModelFlow, means: Mapping[str, float]) -> float:
    """Return the flow over that of the configured model; the flow where it has none."""
    return means[FLOW] / (
        model_flow(means[DIFFERENCE], means["oil_temperature"], means["speed"]) or 1.0
    )


def _is_usual(name: str, usual: Mapping[str, float], now: Mapping[str, float]) -> bool:
    if name == "oil_temperature":
        return abs(now[name] - usual[name]) < USUAL_C
    return _beyond(name, now[name], usual) < USUAL


def _is_known(name: str, usual: Mapping[str, float], now: Mapping[str, float]) -> bool:
    least = CHARGED_BAR if name in PORT_PRESSURES else 0.0
    return usual.get(name, 0.0) > least and now.get(name, 0.0) > 0.0


def _changed(name: str, usual: Mapping[str, float], now: Mapping[str, float]) -> str:
    return f"{plain(name)} {_reading(name, now)}, usually {_reading(name, usual)}"


def _reading(name: str, values: Mapping[str, float]) -> str:
    return f"{values[name]:.3g} {canonical_unit(name).replace('degC', '°C')}"


def _factor(value: float, other: float) -> float:
    return max(value / other, other / value)
