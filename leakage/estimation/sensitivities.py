r"""Systematic errors: what stated tolerances of sensors and constants do to every figure.

An interval from the samples cannot see a sensor that reads 1 °C too high, yet such errors dominate
in practice. Each stated tolerance is therefore put on in turn, the model is fitted anew to a
thinned sample, and the change of each figure is kept: an error budget by source. Independent
sources add by their squares:

.. math:: u = \sqrt{\sum_j \left(\hat x(s_j + t_j) - \hat x(s_j)\right)^2}
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from leakage.estimation.block_statistics import factor
from leakage.estimation.certificate import certify
from leakage.estimation.multi_start import Parametrisation
from leakage.physics.motor import Motor, OperatingConditions, regressors
from leakage.physics.paths import LeakagePath

Array = NDArray[np.float64]

PASCALS_PER_BAR = 1e5
# Beginnings of the names of sources that are sensors.
SENSORS = ("pressure_difference", "oil_temperature", "speed", "leakage_flow", "charge")


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


@dataclass(frozen=True, slots=True)
class Source:
    """A source of systematic error.

    Attributes
    ----------
    name
        Such as ``oil_temperature offset``.
    tolerance, unit
        Its stated size.
    disturbed
        The window as it would be with that error.
    sign
        −1 where the error can only be put on downwards.
    """

    name: str
    tolerance: float
    unit: str
    disturbed: Callable[[Window], Window]
    sign: float = 1.0


@dataclass(frozen=True, slots=True)
class Figures:
    """The figures of a fit that a budget is made for.

    Attributes
    ----------
    coefficients
        θ, shape (p + 1,).
    leakages_l_per_min
        Leakage at each of the asked-for conditions, the stated ones first, shape (m,).
    """

    coefficients: Array
    leakages_l_per_min: Array


@dataclass(frozen=True, slots=True)
class Effect:
    """Effect of one source on every figure, signed, for its tolerance taken as positive."""

    source: Source
    coefficients: Array
    leakages_l_per_min: Array


@dataclass(frozen=True, slots=True)
class ErrorBudget:
    """Effects of all sources, and their sum by squares."""

    effects: tuple[Effect, ...]

    def of_sensors(self) -> ErrorBudget:
        """The effects of sensors alone."""
        return ErrorBudget(
            tuple(one for one in self.effects if one.source.name.startswith(SENSORS))
        )

    def coefficients(self) -> Array | None:
        """Systematic ± of θ, shape (p + 1,); None where nothing is stated."""
        return _by_squares([effect.coefficients for effect in self.effects])

    def leakages_l_per_min(self) -> Array | None:
        """Systematic ± of the leakages, shape (m,); None where nothing is stated."""
        return _by_squares([effect.leakages_l_per_min for effect in self.effects])


def _by_squares(effects: Sequence[Array]) -> Array | None:
    if not effects:
        return None
    return np.array([math.hypot(*of_one) for of_one in np.transpose(effects)])


def error_budget(
    motor: Motor,
    conditions: OperatingConditions,
    flow_l_per_min: Array,
    tolerances: Tolerances,
    at: Sequence[OperatingConditions] = (),
    as_read: Sequence[OperatingConditions] = (),
) -> ErrorBudget:
    """Carry each stated tolerance through a fit of a thinned sample.

    Parameters
    ----------
    motor
        The motor as fitted.
    conditions, flow_l_per_min
        Thinned training samples, n of them; a few thousand are enough.
    tolerances
        What is stated.
    at, as_read
        Conditions at which the leakage is asked for, one sample each: stated ones, and ones that
        the same sensors have read, so that a sensor that is off moves them, too.

    Returns
    -------
    ErrorBudget
        Empty where no tolerance is stated.

    Raises
    ------
    EstimationError
        If there are fewer samples than free coefficients.
    ValidityError
        If a disturbed temperature leaves the range of Walther's equation.
    """
    window = Window(motor, conditions, flow_l_per_min)
    undisturbed, off_bounds = _figures(window, (*at, *as_read), None)
    effects = []
    for source in _sources(motor, tolerances):
        moved = [source.disturbed(Window(motor, one, np.zeros(1))).conditions for one in as_read]
        disturbed, _ = _figures(source.disturbed(window), (*at, *moved), off_bounds)
        effects.append(
            Effect(
                source,
                source.sign * (disturbed.coefficients - undisturbed.coefficients),
                source.sign * (disturbed.leakages_l_per_min - undisturbed.leakages_l_per_min),
            )
        )
    return ErrorBudget(tuple(effects))


def effects_elsewhere(
    motor: Motor,
    tolerances: Tolerances,
    coefficients: Array,
    effects: Mapping[str, tuple[Array, float]],
    before: OperatingConditions,
    after: OperatingConditions,
) -> dict[str, float]:
    """Effects on the leakage at one stated condition from those at another, without samples.

    A constant acts on what the thinned sample's own fit says; that is taken as the nearest to θ
    which explains the known effects.

    Parameters
    ----------
    motor, tolerances
        The motor as fitted, and what is stated.
    coefficients
        θ, shape (p + 1,).
    effects
        By source, its effect on θ, shape (p + 1,), and on the leakage at `before` [l/min].
    before, after
        One condition each.

    Returns
    -------
    dict
        By source, its effect on the leakage at `after` [l/min].
    """
    sources = [source for source in _sources(motor, tolerances) if source.name in effects]
    nothing, theta = np.zeros(1), coefficients[:-1]
    disturbed = [source.disturbed(Window(motor, before, nothing)).motor for source in sources]

    def changes(at: OperatingConditions) -> tuple[Array, Array]:
        """By source, change of the regressors, and of the leakage that does not hang on θ."""
        was = regressors(motor, at)[0]
        now = np.array([regressors(of, at)[0] for of in disturbed]).reshape(-1, len(was))
        moved = [
            one[:-2] @ (source.sign * effects[source.name][0][:-1]) + one[-1] - was[-1]
            for source, one in zip(sources, now, strict=True)
        ]
        return now[:, :-2] - was[:-2], np.array(moved)

    signs = np.array([source.sign for source in sources])
    slopes, moved = changes(before)
    unexplained = signs * [effects[source.name][1] for source in sources] - moved - slopes @ theta
    theta = theta * (1.0 + np.linalg.lstsq(slopes * theta, unexplained)[0])
    slopes, moved = changes(after)
    found = signs * (slopes @ theta + moved)
    return dict(zip((source.name for source in sources), found.tolist(), strict=True))


def _figures(
    window: Window, at: Sequence[OperatingConditions], off_bounds: NDArray[np.bool_] | None
) -> tuple[Figures, NDArray[np.bool_]]:
    """Figures of a window, and which coefficients are off their bounds.

    A disturbed window is fitted without bounds, those that were on one held there: cut at a bound,
    the effect on one coefficient would be moved to the others.
    """
    motor = window.motor
    z = np.column_stack([regressors(motor, window.conditions), window.flow_l_per_min])
    r = factor(z)
    lower, upper = Parametrisation.of(motor).coefficient_bounds()
    certificate = certify(r, lower, upper)
    theta = certificate.coefficients.copy()
    if off_bounds is not None:
        held = np.where(certificate.at_upper, upper, lower)
        theta = np.where(off_bounds, 0.0, held)
        columns = r[:, :-2]
        scale = np.linalg.norm(columns[:, off_bounds], axis=0)
        target = r[:, -1] - r[:, -2] - columns @ theta
        theta[off_bounds] = np.linalg.lstsq(columns[:, off_bounds] / scale, target)[0] / scale
    rows = [regressors(motor, conditions)[0] for conditions in at]
    leakages = [float(row[:-2] @ theta[:-1] + row[-1]) for row in rows]
    return Figures(theta, np.array(leakages)), certificate.off_bounds


def _sources(motor: Motor, tolerances: Tolerances) -> Iterator[Source]:
    yield from _channel_sources(tolerances)
    for path in motor.paths:
        for stated in path.tolerances():
            name = f"{path.name} {stated.constant}"
            yield Source(name, stated.share, "1", _with_path(stated.path))
    if tolerances.pressure_viscosity:
        share = tolerances.pressure_viscosity
        yield Source("pressure-viscosity coefficient", share, "1", _pressure_viscosity(share))
    if tolerances.density:
        yield Source("density", tolerances.density, "1", _density(tolerances.density))
    if tolerances.film_pressure_share and motor.film_pressure.model == "thesis":
        step = tolerances.film_pressure_share
        # A share lies within 0 and 1: at the upper end the step goes down.
        sign = 1.0 if motor.film_pressure.share + step <= 1.0 else -1.0
        yield Source("film pressure share", step, "1", _film_pressure(sign * step), sign)
    if tolerances.charge_pressure_bar:
        bar = tolerances.charge_pressure_bar
        yield Source("charge pressure", bar, "bar", _charge(bar))


def _channel_sources(tolerances: Tolerances) -> Iterator[Source]:
    channels = (
        ("pressure_difference", "bar", tolerances.pressure_bar, _pressure),
        ("oil_temperature", "°C", tolerances.temperature_c, _temperature),
        ("speed", "rpm", tolerances.speed_rpm, _speed),
        ("leakage_flow", "l_per_min", tolerances.flow_l_per_min, _flow),
    )
    for name, unit, tolerance, disturb in channels:
        if tolerance.offset:
            yield Source(f"{name} offset", tolerance.offset, unit, disturb(tolerance.offset, 0.0))
        if tolerance.gain:
            yield Source(f"{name} gain", tolerance.gain, "1", disturb(0.0, tolerance.gain))


Disturbance = Callable[[Window], Window]


def _pressure(offset_bar: float, gain: float) -> Disturbance:
    def disturbed(window: Window) -> Window:
        magnitude = np.abs(window.conditions.pressure_difference_pa)
        shifted = np.maximum(magnitude * (1 + gain) + offset_bar * PASCALS_PER_BAR, 0.0)
        return window._replace(
            conditions=replace(window.conditions, pressure_difference_pa=shifted)
        )

    return disturbed


def _charge(offset_bar: float) -> Disturbance:
    def disturbed(window: Window) -> Window:
        charge = window.conditions.charge_over_case_pa
        if charge is None:
            return window
        shifted = charge + offset_bar * PASCALS_PER_BAR
        return window._replace(conditions=replace(window.conditions, charge_over_case_pa=shifted))

    return disturbed


def _temperature(offset_c: float, gain: float) -> Disturbance:
    def disturbed(window: Window) -> Window:
        shifted = window.conditions.oil_temperature_c * (1 + gain) + offset_c
        return window._replace(conditions=replace(window.conditions, oil_temperature_c=shifted))

    return disturbed


def _speed(offset_rpm: float, gain: float) -> Disturbance:
    def disturbed(window: Window) -> Window:
        shifted = np.maximum(np.abs(window.conditions.speed_rpm) * (1 + gain) + offset_rpm, 0.0)
        return window._replace(conditions=replace(window.conditions, speed_rpm=shifted))

    return disturbed


def _flow(offset_l_per_min: float, gain: float) -> Disturbance:
    def disturbed(window: Window) -> Window:
        return window._replace(flow_l_per_min=window.flow_l_per_min * (1 + gain) + offset_l_per_min)

    return disturbed


def _with_path(changed: LeakagePath) -> Disturbance:
    def disturbed(window: Window) -> Window:
        motor = window.motor
        paths = tuple(changed if path.name == changed.name else path for path in motor.paths)
        return window._replace(motor=replace(motor, paths=paths))

    return disturbed


def _pressure_viscosity(share: float) -> Disturbance:
    def disturbed(window: Window) -> Window:
        oil = window.motor.oil
        changed = replace(
            oil, pressure_viscosity_per_pa=oil.pressure_viscosity_per_pa * (1 + share)
        )
        return window._replace(motor=replace(window.motor, oil=changed))

    return disturbed


def _density(share: float) -> Disturbance:
    def disturbed(window: Window) -> Window:
        oil = window.motor.oil
        changed = replace(oil, density_15_c_kg_per_m3=oil.density_15_c_kg_per_m3 * (1 + share))
        return window._replace(motor=replace(window.motor, oil=changed))

    return disturbed


def _film_pressure(step: float) -> Disturbance:
    def disturbed(window: Window) -> Window:
        film = window.motor.film_pressure
        changed = replace(film, share=max(film.share + step, 0.0))
        return window._replace(motor=replace(window.motor, film_pressure=changed))

    return disturbed
