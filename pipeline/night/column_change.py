"""Columns that change places, or their unit, from one night on: told as that, not as wear."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import chain, combinations
from statistics import median
from typing import Any

from pipeline.config import MotorSpec
from pipeline.config.channels import PORT_PRESSURES
from pipeline.messages import plain
from pipeline.units import QUANTITIES, UNITS, canonical_unit, from_canonical, to_canonical

# Means that are compared, by channel, as the table `operation` has them; and their units.
COLUMNS = {
    "pressure_difference": "mean_pressure_bar",
    "oil_temperature": "mean_temperature_c",
    "speed": "mean_speed_rpm",
    "leakage_flow": "mean_flow_l_per_min",
}
FLOW = "leakage_flow"
DIFFERENCE = "pressure_difference"
PLACES = (DIFFERENCE, "oil_temperature", "speed")
# Of these, and of two gauges where each is known by itself. A speed may well be ten times another
# night's, with the flow as before.
OF_ONE_UNIT = (DIFFERENCE, *PORT_PRESSURES, "oil_temperature")
# Factors within which a reading is as usual, and beyond which it is not; a difference of two gauges
# of which one is in another unit is further off than any load with the same flow.
NEAR, FAR, GAUGE_FAR = 1.5, 2.0, 10.0
# A low port without charge pressure may be at any multiple of it [bar].
CHARGED_BAR = 5.0
# Nights before that say what is usual, and how many of them are needed.
USUAL_NIGHTS, FEWEST_USUAL = 7, 3


def readings_of(row: Mapping[str, Any]) -> dict[str, float]:
    """Means of the channels in a row of `operation`; empty where one is not known."""
    found = {name: row[column] for name, column in COLUMNS.items() if row.get(column) is not None}
    return found if found.keys() == COLUMNS.keys() else {}


def usual_readings(rows: Iterable[Mapping[str, Any]]) -> dict[str, float]:
    """Medians of the channels over rows of `operation`; empty where these are few."""
    means = list(filter(None, map(readings_of, rows)))
    if len(means) < FEWEST_USUAL:
        return {}
    return {name: median(one[name] for one in means) for name in COLUMNS}


def column_change(
    spec: MotorSpec, usual: Mapping[str, float], now: Mapping[str, float]
) -> str | None:
    """Why readings look like those of other columns or units than before; None: they do not.

    The drain flow is as before, which it would not be had load or oil changed as far. Both have
    the channels of `COLUMNS`, in the units of the tables, and may have each gauge of two.
    """
    least = min(one[name] for one in (usual, now) for name in COLUMNS)
    if least <= 0.0 or _factor(now[FLOW], usual[FLOW]) > FAR:
        return None
    return next(chain(_swapped(usual, now), _other_unit(spec, usual, now)), None)


def _swapped(usual: Mapping[str, float], now: Mapping[str, float]) -> Iterator[str]:
    for one, other in combinations(PLACES, 2):
        are_far = all(_factor(now[name], usual[name]) > FAR for name in (one, other))
        pairs = (now[one], usual[other]), (now[other], usual[one])
        if are_far and all(_factor(*pair) < NEAR for pair in pairs):
            yield (
                f"columns changed? {plain(one)} and {plain(other)} look swapped: "
                f"{_said(one, now)} and {_said(other, now)}, "
                f"before {_said(one, usual)} and {_said(other, usual)}"
            )


def _other_unit(
    spec: MotorSpec, usual: Mapping[str, float], now: Mapping[str, float]
) -> Iterator[str]:
    channels = {str(name): one for name, one in spec.file.channels.items()}
    far = {
        name: _factor(now[name], usual[name]) for name in OF_ONE_UNIT if _is_known(name, usual, now)
    }
    for name in [name for name in far if far[name] > FAR]:
        configured = channels[name if name in channels else PORT_PRESSURES[0]].unit
        for unit in UNITS[QUANTITIES[name]]:
            in_log = from_canonical(name, now[name], configured)
            reading = float(to_canonical(name, in_log, unit))
            if reading > 0.0 and _factor(reading, usual[name]) < NEAR:
                yield (
                    f"unit changed? {_changed(name, usual, now)}: as before if the log is now in "
                    f"{unit} where the config has {configured}"
                )
    if far[DIFFERENCE] > GAUGE_FAR and DIFFERENCE not in channels:
        yield f"unit changed? {_changed(DIFFERENCE, usual, now)}: of one of its two gauges?"


def _is_known(name: str, usual: Mapping[str, float], now: Mapping[str, float]) -> bool:
    least = CHARGED_BAR if name in PORT_PRESSURES else 0.0
    return usual.get(name, 0.0) > least and now.get(name, 0.0) > 0.0


def _changed(name: str, usual: Mapping[str, float], now: Mapping[str, float]) -> str:
    return f"{plain(name)} {_said(name, now)}, before {_said(name, usual)}"


def _said(name: str, values: Mapping[str, float]) -> str:
    return f"{values[name]:.3g} {canonical_unit(name).replace('degC', '°C')}"


def _factor(one: float, other: float) -> float:
    return max(one / other, other / one)
