"""Guesses at the channel that a name in a log means, and at its unit.

Names of columns, topics and files are taken apart into words. A whole word decides before a single
letter does, and a unit only where no word does.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import pairwise
from typing import TypeVar

from pipeline.setup.vocabulary import (
    ALL_WORDS,
    BESIDE_A_PORT,
    DIFFERENCE,
    ENDINGS,
    LETTERS,
    LONGEST_WITH_A_LETTER,
    NO_MEASUREMENT,
    PORT_PRESSURES,
    PORTS,
    PREFERRED,
    PRESSURES,
    STRANGERS,
    WORDS,
)
from pipeline.units import CHANNELS, QUANTITIES, UNITS, to_canonical

_T = TypeVar("_T")

_NEEDED = ("oil_temperature", "speed", "leakage_flow")
BRACKETED = re.compile(r"[\[(<{]([^\])>}]*)[\])>}]")
_UNIT_NAMES = {
    **dict.fromkeys(("°c", "c", "oc", "℃", "celsius", "deg c", "grad c"), "degC"),
    **dict.fromkeys(("°f", "f", "fahrenheit", "deg f"), "degF"),
    **dict.fromkeys(("kelvin",), "K"),
    **dict.fromkeys(
        ("1/min", "min-1", "min^-1", "min⁻¹", "r/min", "u/min", "rev/min", "tr/min"), "rpm"
    ),
    **dict.fromkeys(("varv/min",), "rpm"),
    **dict.fromkeys(("rps", "rev/s", "s-1", "s^-1", "s⁻¹", "hz"), "1/s"),
    **dict.fromkeys(("°/s",), "deg/s"),
    **dict.fromkeys(("bar(g)", "barg", "bar(a)", "bara"), "bar"),
    **dict.fromkeys(("psig", "psia", "lbf/in2"), "psi"),
    **dict.fromkeys(("lpm", "litre/min"), "l/min"),
    **dict.fromkeys(("lph",), "l/h"),
    **dict.fromkeys(("m³/h", "cbm/h"), "m3/h"),
    **dict.fromkeys(("m³/s",), "m3/s"),
    **dict.fromkeys(("cc/min", "cm³/min"), "cm3/min"),
    **dict.fromkeys(("cc/s", "cm³/s"), "cm3/s"),
    **dict.fromkeys(("gpm", "gal/min", "usgpm"), "us_gal/min"),
}
# Upper quartile of the magnitude that a motor at work shows, in the units of the tables.
USUAL: Mapping[str, tuple[float, float]] = {
    "pressure": (5.0, 450.0),
    "temperature": (5.0, 95.0),
    "speed": (0.5, 400.0),
    "flow": (0.05, 100.0),
}
_USUAL_LOW_SIDE = (0.2, 60.0)
# Pressures that say nothing of the load.
LOW_SIDE = ("low_port_pressure", "charge_pressure", "case_pressure")
# Units in the order in which they are met; the others after them.
_COMMON = ("bar", "kPa", "MPa", "psi", "l/min", "ml/min", "m3/h", "us_gal/min", "l/h")


def words_of(name: str) -> tuple[str, ...]:
    """Words of a name, in small letters; what stands in brackets is left out.

    Examples
    --------
    >>> words_of("drainFlow_lpm"), words_of("P_A [bar]"), words_of("ΔP")
    (('drain', 'flow', 'lpm'), ('p', 'a'), ('dp',))
    """
    # A unit of its own beside the quantity's letter is no word: "p_Pa".
    plain = re.sub(r"(?<=[^\W_][\W_])Pa\b", " ", BRACKETED.sub(" ", name))
    plain = plain.replace("Δ", "d").replace("∆", "d")
    parted = re.sub(r"(?<=[a-zäöå])(?=[A-Z])", " ", plain)
    found = re.findall(r"[^\W\d_]+|\d+", parted.lower())
    singular = [word[:-1] if word[:-1] in ALL_WORDS else word for word in found]
    return tuple(re.sub(r"\bd p\b", "dp", " ".join(singular)).split())


def channel_of(name: str, unit: str = "") -> str | None:
    """Channel that a name seems to mean, with what stands beside it as a unit; None: none.

    Examples
    --------
    >>> channel_of("drain_flow [l/min]"), channel_of("T_oil"), channel_of("AI_3", "°C")
    ('leakage_flow', 'oil_temperature', 'oil_temperature')
    >>> channel_of("p_low"), channel_of("case drain temp."), channel_of("operator")
    ('low_port_pressure', 'oil_temperature', None)
    """
    words = words_of(name)
    quantity = _quantity_of(words, name, unit)
    if quantity is None or _is_strange(quantity, words):
        return None
    if quantity != "pressure":
        return _channel_of_quantity(quantity)
    # A letter or number is that of a port only behind a word for port or pressure.
    ports = {second for first, second in pairwise(words) if first in BESIDE_A_PORT} & PORTS
    if not BESIDE_A_PORT & set(words):
        ports |= {word[1] for word in words if word in ("pa", "pb")}
    marks = (set(words) - PORTS) | ports
    found = (channel for channel, known in PRESSURES if known & marks)
    return next(found, "pressure_difference")


def is_bare_pressure(name: str) -> bool:
    """True if a name that means a pressure does not say which.

    Examples
    --------
    >>> is_bare_pressure("PT101"), is_bare_pressure("delta p")
    (True, False)
    """
    return channel_of(name) == "pressure_difference" and not DIFFERENCE & set(words_of(name))


def _is_strange(quantity: str, words: Sequence[str]) -> bool:
    """True if words name another machine or place, also at the begin of a word put together."""
    known = STRANGERS[quantity] | NO_MEASUREMENT
    ended = [word for word in words if _ending(word)]
    return bool(known & set(words)) or any(
        word.startswith(other) for word in ended for other in known if len(other) > 3
    )


def _ending(word: str) -> str | None:
    return next((q for end, q in ENDINGS.items() if word.endswith(end)), None)


def _channel_of_quantity(quantity: str) -> str:
    return next(channel for channel in CHANNELS if QUANTITIES[channel] == quantity)


def _quantity_of(words: Sequence[str], name: str, unit: str) -> str | None:
    for quantity, known in WORDS.items():
        if known & set(words) or quantity in map(_ending, words):
            return quantity
    if {"pa", "pb"} & set(words):
        return "pressure"
    letters = [LETTERS[word] for word in words if word in LETTERS]
    if letters and len(words) <= LONGEST_WITH_A_LETTER:
        return letters[0]
    texts = [unit, *BRACKETED.findall(name)]
    for quantity in WORDS:
        channel = _channel_of_quantity(quantity)
        if any(_unit_named(channel, text) for text in texts):
            return quantity
    return None


def preference(channel: str, name: str) -> int:
    """Degree to which a name fits a channel that it seems to mean."""
    return len(PREFERRED.get(channel, set()) & set(words_of(name)))


def best_by_channel(
    candidates: Iterable[tuple[str | None, tuple[int, ...], _T]],
) -> dict[str, _T]:
    """The candidate of most merit for each channel, the first of equals."""
    best: dict[str, tuple[tuple[int, ...], _T]] = {}
    for channel, merit, candidate in candidates:
        if channel is not None and (channel not in best or merit > best[channel][0]):
            best[channel] = merit, candidate
    # A motor's file has the difference or both ports.
    without = PORT_PRESSURES if "pressure_difference" in best else ()
    return {
        channel: best[channel][1]
        for channel in CHANNELS
        if channel in best and channel not in without
    }


def missing_channels(found: Collection[str]) -> list[str]:
    """Channels that a motor has to have, besides those that were found.

    Examples
    --------
    >>> missing_channels(["speed", "leakage_flow", "low_port_pressure"])
    ['oil_temperature', 'high_port_pressure']
    """
    missing = [name for name in _NEEDED if name not in found]
    other_ports = [name for name in PORT_PRESSURES if name not in found]
    if "pressure_difference" in found:
        return missing
    if len(other_ports) == len(PORT_PRESSURES):
        return ["pressure_difference", *missing]
    return [*missing, *other_ports]


def unit_of(channel: str, name: str) -> str | None:
    """Unit of a channel that a name or the cell of a line of units tells; None: none.

    Examples
    --------
    >>> unit_of("pressure_difference", "dp [kPa]"), unit_of("oil_temperature", "°C")
    ('kPa', 'degC')
    >>> unit_of("leakage_flow", "drain_flow_m3_h"), unit_of("high_port_pressure", "pA")
    ('m3/h', None)
    """
    behind = re.findall(r"(?:\bin |, ?| / )(\S+)$", name)
    words = re.split(r"[\s_]+", name)
    # Letters that are a port's in a name, and a unit's in brackets or behind the name.
    whole = [] if name.lower() == "pa" and name != "Pa" else [name]
    # "flow_m3_h" and "flow_l_per_min", as names without a stroke have it.
    lengths = [n for n in (2, 3) if len(words) >= n]
    rates = ["/".join(part for part in words[-n:] if part != "per") for n in lengths]
    parts = [*BRACKETED.findall(name), *behind, *whole, *rates, *reversed(words[1:])]
    return next((unit for part in parts if (unit := _unit_named(channel, part))), None)


def _unit_named(channel: str, text: str) -> str | None:
    known = {unit.lower(): unit for unit in UNITS[QUANTITIES[channel]]}
    named = {name: unit for name, unit in _UNIT_NAMES.items() if unit.lower() in known}
    low = text.strip().strip("[]").replace("·", "").lower()
    return known.get(low) or named.get(low)


def likely_units(channel: str, values: Iterable[float]) -> tuple[str, ...]:
    """Units in which readings are such as a motor at work shows, the commonest first.

    Examples
    --------
    >>> likely_units("oil_temperature", [320.0, 321.5])
    ('K',)
    >>> likely_units("speed", [0.0, 30.0, 31.0])
    ('rpm', 'rad/s', 'deg/s')
    """
    found = sorted(map(abs, values))
    if not found:
        return ()
    quantity = QUANTITIES[channel]
    low, high = _USUAL_LOW_SIDE if channel in LOW_SIDE else USUAL[quantity]
    typical = found[(3 * len(found)) // 4]
    units = [unit for unit in _COMMON if unit in UNITS[quantity]]
    return tuple(
        unit
        for unit in dict.fromkeys((*units, *UNITS[quantity]))
        if low <= float(to_canonical(channel, typical, unit)) <= high
    )
