"""The speed curve: leakage between cam roller and piston, from a simulation."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from leakage.errors import ParameterError
from leakage.physics.law import (
    CoefficientUnit,
    Law,
    Parameter,
    PathTolerance,
    Values,
    only_value,
    require_parameter,
    require_positive,
)


@dataclass(frozen=True, slots=True)
class SpeedCurve(Law):
    r"""Leakage that follows a simulated curve over speed, scaled to pressure and viscosity.

    .. math:: Q = s\,n\,f(|\omega|)\,\frac{|\Delta P|}{\Delta P_0}\,\frac{\eta_0}{\eta}, \qquad
        f(\omega) = a \omega^5 + b \omega^4 + c \omega^3 + d \omega^2 + e \omega + f

    Parameters
    ----------
    name
        Name of the path.
    count
        Number n of interfaces at high pressure, [-].
    coefficients
        Coefficients of f, highest power first, [l/min over rpm to that power]; a quintic in the
        thesis, any degree here.
    speed_minimum_rpm, speed_maximum_rpm
        Range of the points behind the curve, [rpm]; outside it the value at its end is held.
    reference_pressure_pa, reference_viscosity_pa_s
        ΔP₀, [Pa], and η₀, [Pa·s], of the simulation.
    scale
        Factor s on the whole curve, [1]; 1 and fixed in the thesis.
    curve_tolerance
        Stated tolerance of the curve's level, relative; 0: none stated.

    Raises
    ------
    ParameterError
        If a constant is not positive, the range empty or a coefficient not finite.

    Notes
    -----
    f holds over the range of its points only: outside, a quintic runs away. `is_beyond` counts
    the samples there.

    Examples
    --------
    >>> roller = SpeedCurve("r", 32, (2.0e-11, -7.0e-9, 9.0e-7, -5.0e-5, 1.6e-3, 4.0e-3),
    ...                     0.0, 125.0, 200e5, 0.035, Parameter("scale_r", "1", 1, 0, 5, True))
    >>> roller.curve_l_per_min(np.array([125.0, -200.0])).round(7).tolist()
    [0.0819297, 0.0819297]

    References
    ----------
    .. [1] N. Ydebäck, *Grey Box Model of Leakage in Radial Piston Hydraulic Motors*, 2021,
       equations (12) and (32) to (34).
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

    def coefficient(self, values: Values) -> NDArray[np.float64]:
        """Scale s of the curve, [-]."""
        return only_value(values)

    def curve_l_per_min(self, speed_rpm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Leakage f(|ω|) of one interface at ΔP₀ and η₀, shape (n,), [l/min].

        Beyond the range of the points the value at its end.
        """
        speed = np.clip(np.abs(speed_rpm), self.speed_minimum_rpm, self.speed_maximum_rpm)
        flow: NDArray[np.float64] = np.full_like(speed, self.coefficients[0])
        for coefficient in self.coefficients[1:]:
            flow *= speed
            flow += coefficient
        return flow

    def tolerances(self) -> tuple[PathTolerance, ...]:
        """The path with a higher curve, where a tolerance is stated."""
        share = self.curve_tolerance
        if not share:
            return ()
        raised = tuple(coefficient * (1 + share) for coefficient in self.coefficients)
        return (PathTolerance("curve", share, replace(self, coefficients=raised)),)

    def is_beyond(self, speed_rpm: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Mask of |ω| outside the range of the curve's points, shape (n,)."""
        speed = np.abs(speed_rpm)
        beyond: NDArray[np.bool_] = speed > self.speed_maximum_rpm
        beyond |= speed < self.speed_minimum_rpm
        return beyond

    def regressor(
        self,
        drive_per_s: NDArray[np.float64],
        pressure_difference_pa: NDArray[np.float64],  # noqa: ARG002
        speed_rpm: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        r"""Flow per unit of the scale, [l/min]; the pressure is in the drive.

        .. math:: \varphi = n f(|\omega|)\,\frac{\eta_0}{\Delta P_0}\,\frac{|\Delta P|}{\eta}
        """
        flow = self.curve_l_per_min(speed_rpm)
        flow *= drive_per_s
        flow *= self.count * self.reference_viscosity_pa_s / self.reference_pressure_pa
        return flow
