"""Sources of systematic error: stated tolerances, and a window as it would be with each error."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from leakage.physics.motor import Motor, OperatingConditions
from leakage.physics.paths import LeakagePath

Array = NDArray[np.float64]

PASCALS_PER_BAR = 1e5
# Beginnings of the names of sources that are sensors.
SENSORS = ("pressure_difference", "oil_temperature", "speed", "leakage_flow", "charge")
# Channels of which the sign is a direction.
MAGNITUDES = ("pressure_difference_pa", "speed_rpm")


@dataclass(frozen=True, slots=True)
class ChannelTolerance:
    """Stated accuracy of a sensor.

    Attributes
    ----------
    offset
        Constant error [unit of the channel]; 0: none stated.
    gain
        Error in proportion to the reading, relative to it; 0: none stated.
    """

    offset: float = 0.0
    gain: float = 0.0


@dataclass(frozen=True, slots=True)
class Tolerances:
    """Stated tolerances of channels and of what paths share; 0: none stated.

    A path carries its own.

    Attributes
    ----------
    pressure_bar, temperature_c, speed_rpm, flow_l_per_min
        Of the channels.
    pressure_viscosity, density
        Of the oil's α and density, relative.
    film_pressure_share
        Of the share of the pressure difference in the film, absolute.
    charge_pressure_bar
        Of charge above case pressure, where leakage is two-sided [bar].
    """

    pressure_bar: ChannelTolerance = ChannelTolerance()
    temperature_c: ChannelTolerance = ChannelTolerance()
    speed_rpm: ChannelTolerance = ChannelTolerance()
    flow_l_per_min: ChannelTolerance = ChannelTolerance()
    pressure_viscosity: float = 0.0
    density: float = 0.0
    film_pressure_share: float = 0.0
    charge_pressure_bar: float = 0.0


class Window(NamedTuple):
    """A motor with a thinned sample of its window."""

    motor: Motor
    conditions: OperatingConditions
    flow_l_per_min: Array


Disturbance: TypeAlias = Callable[[Window], Window]


@dataclass(frozen=True, slots=True)
class Source:
    """A source of systematic error."""

    name: str  # such as ``oil_temperature offset``
    # tolerance, unit: its stated size.
    tolerance: float
    unit: str
    disturbed: Disturbance  # the window as it would be with that error
    sign: float = 1.0  # −1 where the error can only be put on downwards


def sources(motor: Motor, tolerances: Tolerances) -> Iterator[Source]:
    """All sources of a motor of which a tolerance is stated."""
    yield from _channel_sources(tolerances)
    for path in motor.paths:
        for stated in path.tolerances():
            name = f"{path.name} {stated.constant}"
            yield Source(name, stated.share, "1", _with_path(stated.path))
    for name, constant, share in (
        ("pressure-viscosity coefficient", "pressure_viscosity_per_pa", "pressure_viscosity"),
        ("density", "density_15_c_kg_per_m3", "density"),
    ):
        if relative := getattr(tolerances, share):
            yield Source(name, relative, "1", _with_oil(constant, relative))
    if tolerances.film_pressure_share and motor.film_pressure.model == "thesis":
        step = tolerances.film_pressure_share
        # A share lies within 0 and 1: at the upper end the step goes down.
        sign = 1.0 if motor.film_pressure.share + step <= 1.0 else -1.0
        yield Source("film pressure share", step, "1", _with_film_pressure(sign * step), sign)
    if bar := tolerances.charge_pressure_bar:
        off = _with_reading("charge_over_case_pa", bar * PASCALS_PER_BAR, 0.0)
        yield Source("charge pressure", bar, "bar", off)


def _channel_sources(tolerances: Tolerances) -> Iterator[Source]:
    pa = PASCALS_PER_BAR
    for name, unit, tolerance, field, in_si in (
        ("pressure_difference", "bar", tolerances.pressure_bar, "pressure_difference_pa", pa),
        ("oil_temperature", "°C", tolerances.temperature_c, "oil_temperature_c", 1.0),
        ("speed", "rpm", tolerances.speed_rpm, "speed_rpm", 1.0),
        ("leakage_flow", "l_per_min", tolerances.flow_l_per_min, "", 1.0),
    ):
        if offset := tolerance.offset:
            yield Source(f"{name} offset", offset, unit, _with_reading(field, offset * in_si, 0.0))
        if gain := tolerance.gain:
            yield Source(f"{name} gain", gain, "1", _with_reading(field, 0.0, gain))


def _with_reading(field: str, offset: float, gain: float) -> Disturbance:
    """A channel of the conditions, or without a name the flow, read too high."""

    def disturbed(window: Window) -> Window:
        if not field:
            return window._replace(flow_l_per_min=window.flow_l_per_min * (1 + gain) + offset)
        true = getattr(window.conditions, field)
        if true is None:
            return window
        if field in MAGNITUDES:
            read = np.maximum(np.abs(true) * (1 + gain) + offset, 0.0)
        else:
            read = true * (1 + gain) + offset
        return window._replace(conditions=replace(window.conditions, **{field: read}))

    return disturbed


def _with_path(changed: LeakagePath) -> Disturbance:
    def disturbed(window: Window) -> Window:
        motor = window.motor
        paths = tuple(changed if path.name == changed.name else path for path in motor.paths)
        return window._replace(motor=replace(motor, paths=paths))

    return disturbed


def _with_oil(constant: str, share: float) -> Disturbance:
    def disturbed(window: Window) -> Window:
        oil = window.motor.oil
        changed = replace(oil, **{constant: getattr(oil, constant) * (1 + share)})
        return window._replace(motor=replace(window.motor, oil=changed))

    return disturbed


def _with_film_pressure(step: float) -> Disturbance:
    def disturbed(window: Window) -> Window:
        film = window.motor.film_pressure
        changed = replace(film, share=max(film.share + step, 0.0))
        return window._replace(motor=replace(window.motor, film_pressure=changed))

    return disturbed
