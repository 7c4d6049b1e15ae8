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
from typing import NamedTuple, TypeAlias

import numpy as np

from leakage.arrays import Array
from leakage.estimation.blocks import factors
from leakage.estimation.proven_minimum import certify
from leakage.physics.conditions import OperatingConditions
from leakage.physics.motor import Motor, regressors

PASCALS_PER_BAR = 1e5
# Beginnings of the names of sources that are sensors.
SENSORS = ("pressure_difference", "oil_temperature", "speed", "leakage_flow", "charge")
# Channels of which the sign is a direction.
MAGNITUDES = ("pressure_difference_pa", "speed_rpm")


@dataclass(frozen=True, slots=True)
class ChannelTolerance:
    """Stated accuracy of a sensor."""

    offset: float = 0.0  # Constant error [unit of the channel]; 0: none stated.
    gain: float = 0.0  # Error in proportion to the reading, relative to it; 0: none stated.


@dataclass(frozen=True, slots=True)
class Tolerances:
    """Stated tolerances of channels and of what paths share; 0: none stated.

    A path carries its own.
    """

    # pressure_bar, temperature_c, speed_rpm, flow_l_per_min: Of the channels.
    pressure_bar: ChannelTolerance = ChannelTolerance()
    temperature_c: ChannelTolerance = ChannelTolerance()
    speed_rpm: ChannelTolerance = ChannelTolerance()
    flow_l_per_min: ChannelTolerance = ChannelTolerance()
    # pressure_viscosity, density: Of the oil's α and density, relative.
    pressure_viscosity: float = 0.0
    density: float = 0.0
    # Of charge above case pressure, where leakage is two-sided [bar].
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


def sources(motor: Motor, tolerances: Tolerances) -> Iterator[Source]:
    """Yield all sources of a motor of which a tolerance is stated."""
    yield from _channel_sources(tolerances)
    for path in motor.paths:
        for stated in path.tolerances():
            name = f"{path.name} {stated.constant}"
            changed = (stated.path if other.name == path.name else other for other in motor.paths)
            yield Source(name, stated.share, "1", _with(replace(motor, paths=tuple(changed))))
    for name, constant, share in (
        ("pressure-viscosity coefficient", "pressure_viscosity_per_pa", "pressure_viscosity"),
        ("density", "density_15_c_kg_per_m3", "density"),
    ):
        if relative := getattr(tolerances, share):
            oil = replace(motor.oil, **{constant: getattr(motor.oil, constant) * (1 + relative)})
            yield Source(name, relative, "1", _with(replace(motor, oil=oil)))
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
    """Return disturbance by which a channel, or the flow where it has no name, reads too high."""

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


def _with(changed: Motor) -> Disturbance:
    """Return the disturbance that makes the motor another."""
    return lambda window: window._replace(motor=changed)


@dataclass(frozen=True, slots=True)
class Effect:
    """Effect of a source on every figure, signed, for its tolerance taken as positive."""

    source: Source
    coefficients: Array
    leakages_l_per_min: Array


@dataclass(frozen=True, slots=True)
class ErrorBudget:
    """Effects of all sources, and their sum by squares."""

    effects: tuple[Effect, ...]

    def of_sensors(self) -> ErrorBudget:
        """Return the effects of sensors alone."""
        return ErrorBudget(
            tuple(effect for effect in self.effects if effect.source.name.startswith(SENSORS))
        )

    def coefficients(self) -> Array | None:
        """Return systematic ± of θ, shape (p + 1,); None where nothing is stated."""
        return _by_squares([effect.coefficients for effect in self.effects])

    def leakages_l_per_min(self) -> Array | None:
        """Return systematic ± of the leakages, shape (m,); None where nothing is stated."""
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
    """Carry each stated tolerance through a fit of a thinned sample; empty where none is stated.

    `motor, conditions, flow_l_per_min`: The motor as fitted, and n thinned training samples; a few
    thousand are enough.
    `tolerances`: What is stated.
    `at, as_read`: Conditions at which the leakage is asked for, a sample each: stated, and
    as the same sensors have read them, so that a sensor that is off moves them, too.

    Raises EstimationError, ValidityError if there are fewer samples than free coefficients; if a
    disturbed temperature leaves the range of Walther's equation.
    """
    known, samples = [*sources(motor, tolerances)], slice(len(at), len(at) + len(flow_l_per_min))
    read = Window(motor, OperatingConditions.join([conditions, *as_read]), flow_l_per_min)
    windows = [read, *(source.disturbed(read) for source in known)]
    # No sensor moves what is stated.
    columns = np.stack(
        [
            regressors(window.motor, OperatingConditions.join([*at, window.conditions]))
            for window in windows
        ]
    )
    flows = np.stack([window.flow_l_per_min for window in windows])
    thetas = _coefficients(motor, np.concatenate([columns[:, samples], flows[:, :, None]], axis=2))
    asked = np.delete(columns, samples, axis=1)
    leakages = np.einsum("smp,sp->sm", asked[:, :, :-2], thetas[:, :-1]) + asked[:, :, -1]
    return ErrorBudget(
        tuple(
            Effect(source, theta - thetas[0], leakage - leakages[0])
            for source, theta, leakage in zip(known, thetas[1:], leakages[1:], strict=True)
        )
    )


def _coefficients(motor: Motor, samples: Array) -> Array:
    """Return θ of samples as read and as disturbed by each source, shape (1 + s, p + 1).

    Disturbed ones are fitted without bounds, what the first fit has on a bound held there: cut at a
    bound, the effect on a coefficient would be moved to the others.
    """
    count, n, columns = samples.shape
    whole = factors(samples.reshape(-1, columns), n * np.arange(count + 1))
    proven_minimum = certify(whole[0], *motor.coefficient_bounds())
    off = proven_minimum.off_bounds
    thetas = np.tile(proven_minimum.coefficients, (count, 1))
    matrix, held = whole[:, :, :-2], np.where(off, 0.0, proven_minimum.coefficients)
    targets = whole[:, :, -1] - whole[:, :, -2] - matrix @ held
    scales = np.linalg.norm(matrix[:, :, off], axis=1)
    for place in range(1, count):
        scaled = matrix[place][:, off] / scales[place]
        thetas[place, off] = np.linalg.lstsq(scaled, targets[place])[0] / scales[place]
    return thetas


def effects_elsewhere(
    motor: Motor,
    tolerances: Tolerances,
    coefficients: Array,
    effects: Mapping[str, tuple[Array, float]],
    before: OperatingConditions,
    after: OperatingConditions,
) -> dict[str, float]:
    """Return effects on the leakage at a stated condition from those at another, without samples.

    A constant acts on what the thinned sample's own fit says; that is taken as the nearest to θ,
    shape (p + 1,), which explains the known effects: by source, on θ and on the leakage at `before`
    [l/min]. By source, the effect on the leakage at `after` [l/min] is returned.
    """
    known = [source for source in sources(motor, tolerances) if source.name in effects]
    nothing, theta = np.zeros(1), coefficients[:-1]
    disturbed = [source.disturbed(Window(motor, before, nothing)).motor for source in known]

    def changes(at: OperatingConditions) -> tuple[Array, Array]:
        """Return by source the change of regressors, and of the leakage that does not hang on θ."""
        was = regressors(motor, at)[0]
        now = np.array([regressors(of, at)[0] for of in disturbed]).reshape(-1, len(was))
        moved = [
            row[:-2] @ effects[source.name][0][:-1] + row[-1] - was[-1]
            for source, row in zip(known, now, strict=True)
        ]
        return now[:, :-2] - was[:-2], np.array(moved)

    slopes, moved = changes(before)
    unexplained = [effects[source.name][1] for source in known] - moved - slopes @ theta
    theta = theta * (1.0 + np.linalg.lstsq(slopes * theta, unexplained)[0])
    slopes, moved = changes(after)
    effects_after = slopes @ theta + moved
    return dict(zip((source.name for source in known), effects_after.tolist(), strict=True))
