r"""The laws of the leakage paths, one family with one surface.

Each law splits its flow into a lumped *coefficient*, which holds geometry and what is estimated,
and a *regressor*, which holds the operating conditions:

.. math:: Q = K(\theta)\,\varphi(|\Delta P|, T, |\omega|)

so that a motor is linear in the coefficients of its paths, whichever laws these follow. Every
coefficient grows with each of its parameters.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, TypeAlias

import numpy as np

from leakage.arrays import Array
from leakage.errors import ParameterError
from leakage.physics.law import (
    LITRES_PER_MINUTE,
    CoefficientUnit,
    Law,
    Parameter,
    PathTolerance,
    Side,
    Values,
    require_parameter,
    require_positive,
)

# The motor's flushing is a path beside those of its type: its name, and that of its flow.
FLUSHING_PATH, FLUSHING_PARAMETER = "flushing", "C_f"


@dataclass(frozen=True, slots=True)
class Laminar(Law):
    r"""Laminar leakage of an unknown geometry (Darcy's law); the thesis's distributor.

    .. math:: Q = n\,C_d\,\frac{|\Delta P|}{\eta}

    `name`: Name of the path.
    `count`: Number n of interfaces at high pressure, [-].
    `loss_factor`: C_d of one interface, [m3].

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
        """The loss factor of one interface."""
        return (self.loss_factor,)

    def coefficient(self, values: Values) -> Array:
        """Return lumped loss factor n·C_d, [m³]."""
        return self.count * super(Laminar, self).coefficient(values)

    def regressor(self, side: Side) -> Array:
        """Flow per unit of the lumped loss factor, 60 000·ΔP/η, shape (n,), [l/min per m³]."""
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


LeakagePath: TypeAlias = Law


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
        """Return leakage f(|ω|) of one interface at ΔP₀ and η₀, shape (n,), [l/min].

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
