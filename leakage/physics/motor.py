"""A motor as a declared list of leakage paths: its regressors and its total flow.

Source: the thesis, sections 2.3 and 3.1.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from leakage.arrays import Array
from leakage.errors import ParameterError
from leakage.physics.conditions import OperatingConditions
from leakage.physics.oil import THESIS_FILM_PRESSURE, FilmPressure, Oil, flow_drive_per_s
from leakage.physics.paths import Constant, Law, Side, SpeedCurve

FIXED_COLUMNS = ("one", "known", "measured")

# Chunks whose temporaries stay in the cache take a third off a motor-day (864 000 samples).
_CHUNK = 16_384


@dataclass(frozen=True)  # without slots: what follows from the paths is worked out once a motor
class Motor:
    """A motor type with its oil: nothing but a list of leakage paths, each with its law.

    `motor_type`: Name of the type, such as ``"CB560"``.
    `paths`: Leakage paths in declared order; names are unique, at most one is a `Constant`.
    `oil`: The oil in the motor.
    `film_pressure`: Pressure at which the viscosity of the films is taken.

    Raises ParameterError if there is no path, a name stands twice or is reserved, or two paths are
    constant.

    Notes
    -----
    In the statistics of a night each free path but the constant has a column, then come
    `FIXED_COLUMNS`: the ones that the flushing multiplies, the sum of the paths that are not
    free, and the measured flow. A fixed flushing is no part of the known flow, so that a single set
    of statistics serves every flushing mode.
    """

    motor_type: str
    paths: tuple[Law, ...]
    oil: Oil
    film_pressure: FilmPressure = THESIS_FILM_PRESSURE

    def __post_init__(self) -> None:
        if not self.paths:
            raise self._fault("declares no leakage path; declare at least one")
        names = [path.name for path in self.paths]
        parameters = [parameter.name for path in self.paths for parameter in path.parameters]
        for kind, declared in (("path", names), ("parameter", parameters)):
            twice = sorted(name for name, n in Counter(declared).items() if n > 1)
            if twice:
                raise self._fault(f"declares {kind} {twice} more than once; give each its own name")
        reserved = sorted(set(names) & set(FIXED_COLUMNS))
        if reserved:
            raise self._fault(
                f"calls a path {reserved}; {FIXED_COLUMNS} are taken by other columns"
            )
        if sum(isinstance(path, Constant) for path in self.paths) > 1:
            raise self._fault("declares more than one constant path; data see only their sum")

    @cached_property
    def constant(self) -> Constant | None:
        """The constant path, the motor's flushing."""
        return next((path for path in self.paths if isinstance(path, Constant)), None)

    @cached_property
    def column_paths(self) -> tuple[Law, ...]:
        """Free paths but the constant, in declared order: a column each."""
        return tuple(path for path in self.paths if path.is_free and not isinstance(path, Constant))

    @cached_property
    def coefficient_paths(self) -> tuple[Law | None, ...]:
        """Path of each coefficient of θ: the columns', then the constant's or None."""
        return (*self.column_paths, self.constant)

    def coefficient_bounds(self) -> tuple[Array, Array]:
        """Return bounds of θ that those of the parameters imply, each of shape (p + 1,)."""
        paths = self.coefficient_paths
        limits = [path.coefficient_bounds() if path else (0.0, 0.0) for path in paths]
        lower, upper = zip(*limits, strict=True)
        return np.array(lower), np.array(upper)

    @cached_property
    def known_paths(self) -> tuple[Law, ...]:
        """Paths of which nothing is free, but the constant: their sum is the known flow."""
        return tuple(
            path for path in self.paths if not path.is_free and not isinstance(path, Constant)
        )

    @cached_property
    def standard(self) -> SpeedCurve | None:
        """The speed curve that is the whole known flow: what its scale is, data can tell."""
        known = [path for path in self.known_paths if path.configured_coefficient]
        for path in known:
            if len(known) == 1 and isinstance(path, SpeedCurve):
                return path if path.scale.minimum < path.scale.maximum else None
        return None

    def with_free_standard(self) -> Motor:
        """Return the motor with the scale of its standard free within its bounds."""
        return replace(
            self,
            paths=tuple(
                replace(path, scale=replace(path.scale, fixed=False))
                if path is self.standard and isinstance(path, SpeedCurve)
                else path
                for path in self.paths
            ),
        )

    @cached_property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns of the statistics: free paths, 1, known, measured."""
        return (*(path.name for path in self.column_paths), *FIXED_COLUMNS)

    def _fault(self, what: str) -> ParameterError:
        return ParameterError("motor_paths", f"motor type {self.motor_type!r} {what}")


def regressors(motor: Motor, conditions: OperatingConditions, out: Array | None = None) -> Array:
    r"""Return columns in which the motor's flow is linear: y = known + Σ K φ + C_f + ε.

    .. math:: z(t) = (\varphi_1, \dots, \varphi_p, 1, \textstyle\sum_{known} K \varphi)

    `motor`: The motor.
    `conditions`: Operating conditions of n samples.
    `out`: Where the columns go, shape (n, p + 2); None: into an array of their own.

    Returns
    -------
    ndarray
        Shape (n, p + 2), a row for each sample: the free paths in the order of `Motor.columns`,
        [l/min per unit of each coefficient], ones, and the known flow, [l/min].

    Raises ValidityError if a temperature is outside the range of Walther's equation for this oil.

    Notes
    -----
    A sample that is nan in a channel is nan in the columns which depend on that channel.

    Source: the thesis, equations (4), (5) and (16).
    """
    column_paths = motor.column_paths
    known_paths = [(path, path.configured_coefficient) for path in motor.known_paths]
    shape = (len(conditions), len(column_paths) + 2)
    # Column by column in memory: each is written, and decomposed, on its own.
    columns = np.empty(shape, order="F") if out is None else out
    for rows, sides in _chunks(motor, conditions):
        for index, path in enumerate(column_paths):
            columns[rows, index] = _regressor(path, sides)
        columns[rows, -2] = 1.0
        columns[rows, -1] = sum(
            coefficient * _regressor(path, sides) for path, coefficient in known_paths
        )
    return columns


def path_flows_l_per_min(
    motor: Motor,
    conditions: OperatingConditions,
    coefficients: Mapping[str, float] | None = None,
) -> dict[str, Array]:
    """Return flow of each path, Q = K φ, by its name in declared order, shape (n,) each, [l/min].

    All interfaces of a path together; the constant among them.

    `motor, conditions`: The motor, and operating conditions of n samples.
    `coefficients`: By path name, [`coefficient_unit` of the path]; others keep their configured
    one.

    Raises ParameterError if a coefficient names no path of the motor. Raises ValidityError if a
    temperature is outside the range of Walther's equation for this oil.
    """
    given = dict(coefficients or {})
    unknown = sorted(given.keys() - {path.name for path in motor.paths})
    if unknown:
        raise ParameterError(
            "coefficient_unknown",
            f"motor type {motor.motor_type!r} has no path {unknown}; it has"
            f" {[path.name for path in motor.paths]}",
        )
    flows = {path.name: np.empty(len(conditions)) for path in motor.paths}
    for rows, sides in _chunks(motor, conditions):
        for path in motor.paths:
            coefficient = given.get(path.name, path.configured_coefficient)
            flows[path.name][rows] = coefficient * _regressor(path, sides)
    return flows


def total_flow_l_per_min(
    motor: Motor,
    conditions: OperatingConditions,
    coefficients: Mapping[str, float] | None = None,
) -> Array:
    """Return flow over the drain-line sensor, flushing included, (n,), [l/min]; (5) of the thesis.

    Arguments and errors as of :func:`path_flows_l_per_min`.
    """
    flows = path_flows_l_per_min(motor, conditions, coefficients)
    return sum(flows.values(), np.zeros(len(conditions)))


def leakage_l_per_min(
    motor: Motor,
    conditions: OperatingConditions,
    coefficients: Mapping[str, float] | None = None,
) -> Array:
    """Return leakage of the motor, flushing excluded, shape (n,), [l/min]; (4) of the thesis.

    Arguments and errors as of :func:`path_flows_l_per_min`.
    """
    flows = path_flows_l_per_min(motor, conditions, coefficients)
    if motor.constant is not None:
        del flows[motor.constant.name]
    return sum(flows.values(), np.zeros(len(conditions)))


def _chunks(motor: Motor, conditions: OperatingConditions) -> Iterator[tuple[slice, list[Side]]]:
    """Yield rows of chunks of samples in turn, with what regressors take, side by side.

    Sides are those from which paths leak to the case.
    """
    for start in range(0, len(conditions), _CHUNK):
        rows = slice(start, start + _CHUNK)
        sides = []
        for side in conditions.part(rows).sides():
            pressure, temperature = side.pressure_difference_pa, side.oil_temperature_c
            drive = flow_drive_per_s(pressure, temperature, motor.oil, motor.film_pressure)
            sides.append(Side(drive, pressure, side.speed_rpm))
        yield rows, sides


def _regressor(path: Law, sides: list[Side]) -> Array:
    """Return regressor of a path, summed over the sides; a constant flow has none of them."""
    first, *others = (path.regressor(side) for side in sides)
    if isinstance(path, Constant):
        return first
    for other in others:
        first += other
    return first
