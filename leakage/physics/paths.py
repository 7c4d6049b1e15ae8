r"""The laws of the leakage paths, a family with the same surface: parameters, base, and three laws.

Each law splits its flow into a lumped *coefficient*, which holds geometry and what is estimated,
and a *regressor*, which holds the operating conditions:

.. math:: Q = K(\theta)\,\varphi(|\Delta P|, T, |\omega|)

so that a motor is linear in the coefficients of its paths, whichever laws these follow. Every
coefficient grows with each of its parameters.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, NamedTuple, TypeAlias

import numpy as np

from leakage.arrays import Array
from leakage.errors import ParameterError

LITRES_PER_MINUTE = 60_000.0  # in 1 m³/s

CoefficientUnit = Literal["m3", "1", "l_per_min"]
Values: TypeAlias = Sequence[float] | Array


@dataclass(frozen=True, slots=True)
class Parameter:
    """A physical quantity that is estimated within bounds, or held fixed.

    `name`: Name in tables, such as ``"h_o"``.
    `unit`: Unit of the values as the optimiser sees them: ``"um"``, ``"1"``, ``"m3"``,
    ``"l_per_min"``.
    `value`: Initial value, or the value held where `fixed`, [unit].
    `minimum, maximum`: Bounds, [unit].
    `fixed`: Whether the value is held.

    Raises ParameterError if a figure is not finite or the value lies outside its bounds.
    """

    name: str
    unit: str
    value: float
    minimum: float
    maximum: float
    fixed: bool = False

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (self.value, self.minimum, self.maximum))):
            raise ParameterError(
                "parameter_not_finite",
                f"parameter {self.name!r}: value {self.value:g}, minimum {self.minimum:g} and"
                f" maximum {self.maximum:g} must all be finite",
            )
        if not self.minimum <= self.value <= self.maximum:
            raise ParameterError(
                "parameter_bounds",
                f"parameter {self.name!r}: {self.value:g} {self.unit} lies outside its bounds"
                f" {self.minimum:g} to {self.maximum:g}",
            )

    @property
    def lowest(self) -> float:
        """Smallest value the parameter can take: the value itself where it is fixed, [unit]."""
        return self.value if self.fixed else self.minimum

    @property
    def highest(self) -> float:
        """Largest value the parameter can take: the value itself where it is fixed, [unit]."""
        return self.value if self.fixed else self.maximum

    @property
    def is_free(self) -> bool:
        """Free to be estimated; bounds that are equal fix a parameter, too."""
        return self.lowest < self.highest


@dataclass(frozen=True, slots=True)
class PathTolerance:
    """A path as it would be with a constant off by the stated tolerance."""

    constant: str  # name of the constant, in words
    share: float  # stated tolerance, relative
    path: Law  # the path with the constant that much larger


@dataclass(frozen=True, slots=True)
class DerivedFigure:
    """A figure that a path's coefficient implies, such as a gap height."""

    # name, unit: as in tables.
    name: str
    unit: str
    # lowest, highest: values that coefficient and bounds leave possible [unit]; equal where
    # there is one.
    lowest: float
    highest: float
    # Interval that follows from the coefficient's [unit]; None where none does.
    limits: tuple[float, float] | None = None
    # Combination of parameters that alone shows in the data; empty: the coefficient's verdict
    # is the figure's.
    combination: str = ""


class Side(NamedTuple):
    """What drives n samples' leakage to the case from a side, shape (n,) each.

    Pressure difference and speed count by their size.
    """

    drive_per_s: Array  # ΔP/η [1/s]
    pressure_difference_pa: Array
    speed_rpm: Array


class Law(ABC):
    """Surface of every law; laws differ in equation, parameters, tolerances and figures."""

    __slots__ = ()
    name: str
    coefficient_unit: ClassVar[CoefficientUnit]

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """The law's parameters, in the order in which values are passed."""

    @property
    def visible_below_pa(self) -> float:
        """Pressure difference above which the path hardly shows in the leakage [Pa]."""
        return math.inf

    @property
    def coefficient_name(self) -> str:
        """Name of the coefficient in tables."""
        return f"K_{self.name}"

    def coefficient(self, values: Values) -> Array:
        """Return lumped coefficient of all interfaces of the path, shape (…), [coefficient_unit].

        `values` are those of `parameters` in their order and units, along the last axis; of a
        single parameter the coefficient is its value.
        """
        value: Array = np.asarray(values, dtype=np.float64)[..., 0]
        return value

    @abstractmethod
    def regressor(self, side: Side) -> Array:
        """Return flow φ per unit of the coefficient, (n,), [l/min per its unit]; a new array."""

    def tolerances(self) -> tuple[PathTolerance, ...]:
        """Return the path with each constant off whose tolerance is stated; none by default."""
        return ()

    def derived_figures(
        self,
        coefficient: float,  # noqa: ARG002
        limits: tuple[float, float] | None,  # noqa: ARG002
        roughness_m: tuple[float, float],  # noqa: ARG002
    ) -> tuple[DerivedFigure, ...]:
        """Return figures that a coefficient and its interval, if any, imply; none by default.

        `roughness_m` is R_a of the two surfaces, [m].
        """
        return ()

    @property
    def is_free(self) -> bool:
        """A parameter is estimated."""
        return not all(parameter.fixed for parameter in self.parameters)

    @property
    def configured_coefficient(self) -> float:
        """Coefficient at the configured values, [coefficient_unit]."""
        return float(self.coefficient([parameter.value for parameter in self.parameters]))

    def coefficient_bounds(self) -> tuple[float, float]:
        """Return smallest and largest coefficient over the parameters' box, [coefficient_unit].

        A fixed parameter shrinks the box. The corners suffice, for a coefficient grows with each
        parameter.
        """
        return (
            float(self.coefficient([parameter.lowest for parameter in self.parameters])),
            float(self.coefficient([parameter.highest for parameter in self.parameters])),
        )


def require_positive(path: str, **constants: float) -> None:
    """Refuse a path's constants that are not finite and above 0."""
    for name, value in constants.items():
        if not 0.0 < value < math.inf:
            raise ParameterError(
                "path_constant",
                f"path {path!r}: {name} is {value:g}; it must be finite and above 0",
            )


def require_parameter(
    path: str, parameter: Parameter, unit: str, maximum: float = math.inf
) -> None:
    """Refuse a parameter in another unit, or a parameter that can leave 0 to `maximum`."""
    if parameter.unit != unit:
        raise ParameterError(
            "path_unit",
            f"path {path!r}: parameter {parameter.name!r} is in {parameter.unit!r}, the law"
            f" expects {unit!r}",
        )
    if parameter.lowest < 0.0 or parameter.highest > maximum:
        raise ParameterError(
            "parameter_bounds",
            f"path {path!r}: parameter {parameter.name!r} may range from {parameter.lowest:g} to"
            f" {parameter.highest:g} {unit}; it must stay within 0 to {maximum:g}",
        )


# The motor's flushing is a path beside those of its type: its name, and that of its flow.
FLUSHING_PATH, FLUSHING_PARAMETER = "flushing", "C_f"


@dataclass(frozen=True, slots=True)
class Laminar(Law):
    r"""Laminar leakage of an unknown geometry (Darcy's law); the thesis's distributor.

    .. math:: Q = n\,C_d\,\frac{|\Delta P|}{\eta}

    `name`: Name of the path.
    `count`: Number n of interfaces at high pressure, [-].
    `loss_factor`: C_d of an interface, [m3].

    Raises ParameterError if the count is not positive, or the loss factor negative or of another
    unit.

    Notes
    -----
    Its regressor is that of an annular gap without deformation: no data tell the two apart, so
    at most one of them should be free.

    Examples
    --------
    >>> Laminar("d", 2, Parameter("C_d", "m3", 1e-15, 0.0, 1e-13)).configured_coefficient
    2e-15

    Source: the thesis, equations (3) and (8).
    """

    coefficient_unit: ClassVar[CoefficientUnit] = "m3"

    name: str
    count: int
    loss_factor: Parameter

    def __post_init__(self) -> None:
        require_positive(self.name, count=self.count)
        require_parameter(self.name, self.loss_factor, "m3")

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The loss factor of an interface."""
        return (self.loss_factor,)

    def coefficient(self, values: Values) -> Array:
        """Return lumped loss factor n·C_d, [m³]."""
        return self.count * super(Laminar, self).coefficient(values)

    def regressor(self, side: Side) -> Array:
        """Return flow per unit of the lumped loss factor, 60 000·ΔP/η, (n,), [l/min per m³]."""
        return LITRES_PER_MINUTE * side.drive_per_s


@dataclass(frozen=True, slots=True)
class Constant(Law):
    r"""A flow that does not depend on the operating conditions: flushing.

    .. math:: Q_f = C_f

    `name`: Name of the path.
    `flow`: C_f, [l_per_min].

    Raises ParameterError if the flow can be negative or has another unit.

    Notes
    -----
    Flushing passes the drain-line sensor but is no leakage: the reference leakage is without it.

    Source: the thesis, equations (5) and (13).
    """

    coefficient_unit: ClassVar[CoefficientUnit] = "l_per_min"

    name: str
    flow: Parameter

    def __post_init__(self) -> None:
        require_parameter(self.name, self.flow, "l_per_min")

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The flow."""
        return (self.flow,)

    @property
    def coefficient_name(self) -> str:
        """Name of the flow in tables."""
        return self.flow.name

    def regressor(self, side: Side) -> Array:
        """Return ones, shape (n,), [-]."""
        return np.ones_like(side.drive_per_s)


@dataclass(frozen=True, slots=True)
class SpeedCurve(Law):
    r"""Leakage that follows a simulated curve over speed, scaled to pressure and viscosity.

    .. math:: Q = s\,n\,f(|\omega|)\,\frac{|\Delta P|}{\Delta P_0}\,\frac{\eta_0}{\eta}, \qquad
        f(\omega) = a \omega^5 + b \omega^4 + c \omega^3 + d \omega^2 + e \omega + f

    `name`: Name of the path.
    `count`: Number n of interfaces at high pressure, [-].
    `coefficients`: Coefficients of f, highest power first, [l/min over rpm to that power]; a
    quintic in the thesis, any degree here.
    `speed_minimum_rpm, speed_maximum_rpm`: Range of the points behind the curve, [rpm]; outside it
    the value at its end is held.
    `reference_pressure_pa, reference_viscosity_pa_s`: ΔP₀, [Pa], and η₀, [Pa·s], of the simulation.
    `scale`: Factor s on the whole curve, [1]; 1 and fixed in the thesis.
    `curve_tolerance`: Stated tolerance of the curve's level, relative; 0: none stated.

    Raises ParameterError if a constant is not positive, the range empty or a coefficient not
    finite.

    Notes
    -----
    f holds over the range of its points only: outside, a quintic runs away.

    Examples
    --------
    >>> roller = SpeedCurve("r", 32, (2.0e-11, -7.0e-9, 9.0e-7, -5.0e-5, 1.6e-3, 4.0e-3),
    ...                     0.0, 125.0, 200e5, 0.035, Parameter("scale_r", "1", 1, 0, 5, True))
    >>> roller.curve_l_per_min(np.array([125.0, -200.0])).round(7).tolist()
    [0.0819297, 0.0819297]

    Source: the thesis, equations (12) and (32) to (34).
    """

    coefficient_unit: ClassVar[CoefficientUnit] = "1"

    name: str
    count: int
    coefficients: tuple[float, ...]
    speed_minimum_rpm: float
    speed_maximum_rpm: float
    reference_pressure_pa: float
    reference_viscosity_pa_s: float
    scale: Parameter
    curve_tolerance: float = 0.0

    def __post_init__(self) -> None:
        require_positive(
            self.name,
            count=self.count,
            reference_pressure_pa=self.reference_pressure_pa,
            reference_viscosity_pa_s=self.reference_viscosity_pa_s,
        )
        require_parameter(self.name, self.scale, "1")
        if not self.coefficients or not all(map(math.isfinite, self.coefficients)):
            raise ParameterError(
                "path_curve",
                f"path {self.name!r}: the curve needs at least one coefficient, all finite",
            )
        if not 0.0 <= self.speed_minimum_rpm < self.speed_maximum_rpm < math.inf:
            raise ParameterError(
                "path_curve",
                f"path {self.name!r}: the curve's range {self.speed_minimum_rpm:g} to"
                f" {self.speed_maximum_rpm:g} rpm is none; give the first and last speed of its"
                " points, from 0 upwards",
            )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The scale."""
        return (self.scale,)

    @property
    def coefficient_name(self) -> str:
        """Name of the scale in tables."""
        return self.scale.name

    def curve_l_per_min(self, speed_rpm: Array) -> Array:
        """Return leakage f(|ω|) of an interface at ΔP₀ and η₀, shape (n,), [l/min].

        Beyond the range of the points the value at its end.
        """
        speed = np.clip(np.abs(speed_rpm), self.speed_minimum_rpm, self.speed_maximum_rpm)
        flow: Array = np.full_like(speed, self.coefficients[0])
        for coefficient in self.coefficients[1:]:
            flow *= speed
            flow += coefficient
        return flow

    def tolerances(self) -> tuple[PathTolerance, ...]:
        """Return the path with a higher curve, where a tolerance is stated."""
        share = self.curve_tolerance
        if not share:
            return ()
        raised = tuple(coefficient * (1 + share) for coefficient in self.coefficients)
        return (PathTolerance("curve", share, replace(self, coefficients=raised)),)

    def regressor(self, side: Side) -> Array:
        r"""Return flow per unit of the scale, [l/min]; the pressure is in the drive.

        .. math:: \varphi = n f(|\omega|)\,\frac{\eta_0}{\Delta P_0}\,\frac{|\Delta P|}{\eta}
        """
        flow = self.curve_l_per_min(side.speed_rpm)
        flow *= side.drive_per_s
        flow *= self.count * self.reference_viscosity_pa_s / self.reference_pressure_pa
        return flow
