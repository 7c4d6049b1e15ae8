r"""The laws of the leakage paths, one family with one surface.

Each law splits its flow into a lumped *coefficient*, which holds geometry and what is estimated,
and a *regressor*, which holds the operating conditions:

.. math:: Q = K(\theta)\,\varphi(|\Delta P|, T, |\omega|)

so that a motor is linear in the coefficients of its paths, whichever laws these follow. Every
coefficient grows with each of its parameters.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

from leakage.physics.annular_gap import AnnularGap
from leakage.physics.law import (
    LITRES_PER_MINUTE,
    CoefficientUnit,
    Law,
    Parameter,
    Values,
    only_value,
    require_parameter,
    require_positive,
)
from leakage.physics.speed_curve import SpeedCurve

__all__ = [
    "LITRES_PER_MINUTE",
    "AnnularGap",
    "CoefficientUnit",
    "Constant",
    "Laminar",
    "Law",
    "LeakagePath",
    "Parameter",
    "SpeedCurve",
    "Values",
]


# The motor's flushing is a path beside those of its type: its name, and that of its flow.
FLUSHING_PATH, FLUSHING_PARAMETER = "flushing", "C_f"


@dataclass(frozen=True, slots=True)
class Laminar(Law):
    r"""Laminar leakage of an unknown geometry (Darcy's law); the thesis's distributor.

    .. math:: Q = n\,C_d\,\frac{|\Delta P|}{\eta}

    Parameters
    ----------
    name
        Name of the path.
    count
        Number n of interfaces at high pressure, [-].
    loss_factor
        C_d of one interface, [m3].

    Raises
    ------
    ParameterError
        If the count is not positive, or the loss factor negative or of another unit.

    Notes
    -----
    Its regressor is that of an annular gap without deformation: no data tell the two apart, so
    at most one of them should be free.

    Examples
    --------
    >>> Laminar("d", 2, Parameter("C_d", "m3", 1e-15, 0.0, 1e-13)).configured_coefficient
    2e-15

    References
    ----------
    .. [1] N. Ydebäck, *Grey Box Model of Leakage in Radial Piston Hydraulic Motors*, 2021,
       equations (3) and (8).
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

    @property
    def coefficient_name(self) -> str:
        """Name of the lumped loss factor in tables."""
        return f"K_{self.name}"

    def coefficient(self, values: Values) -> NDArray[np.float64]:
        """Lumped loss factor n·C_d, [m³]."""
        return self.count * only_value(values)

    def regressor(
        self,
        drive_per_s: NDArray[np.float64],
        pressure_difference_pa: NDArray[np.float64],  # noqa: ARG002
        speed_rpm: NDArray[np.float64],  # noqa: ARG002
    ) -> NDArray[np.float64]:
        """Flow per unit of the lumped loss factor, 60 000·ΔP/η, shape (n,), [l/min per m³]."""
        return LITRES_PER_MINUTE * drive_per_s


@dataclass(frozen=True, slots=True)
class Constant(Law):
    r"""A flow that does not depend on the operating conditions: flushing.

    .. math:: Q_f = C_f

    Parameters
    ----------
    name
        Name of the path.
    flow
        C_f, [l_per_min].

    Raises
    ------
    ParameterError
        If the flow can be negative or has another unit.

    Notes
    -----
    Flushing passes the drain-line sensor but is no leakage: the reference leakage is without it.

    References
    ----------
    .. [1] N. Ydebäck, *Grey Box Model of Leakage in Radial Piston Hydraulic Motors*, 2021,
       equations (5) and (13).
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

    def coefficient(self, values: Values) -> NDArray[np.float64]:
        """The flow C_f, [l/min]."""
        return only_value(values)

    def regressor(
        self,
        drive_per_s: NDArray[np.float64],
        pressure_difference_pa: NDArray[np.float64],  # noqa: ARG002
        speed_rpm: NDArray[np.float64],  # noqa: ARG002
    ) -> NDArray[np.float64]:
        """Ones, shape (n,), [-]."""
        return np.ones_like(drive_per_s)


LeakagePath: TypeAlias = Law
