"""Base of the laws of leakage paths: parameters within bounds, and one surface."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
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
    """A path as it would be with one of its constants off by the stated tolerance."""

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
    """What drives n samples' leakage to the case from one side, shape (n,) each.

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

        `values` are those of `parameters` in their order and units, along the last axis; of one
        parameter alone, the coefficient is its value.
        """
        value: Array = np.asarray(values, dtype=np.float64)[..., 0]
        return value

    @abstractmethod
    def regressor(self, side: Side) -> Array:
        """Flow φ per unit of the coefficient, shape (n,), [l/min per its unit]; a new array."""

    def tolerances(self) -> tuple[PathTolerance, ...]:
        """Return the path with each constant off whose tolerance is stated; none by default."""
        return ()

    def derived_figures(
        self,
        coefficient: float,  # noqa: ARG002
        limits: tuple[float, float] | None,  # noqa: ARG002
        roughness_m: tuple[float, float],  # noqa: ARG002
    ) -> tuple[DerivedFigure, ...]:
        """Figures that a coefficient and its interval, if there is one, imply; none by default.

        `roughness_m` is R_a of the two surfaces, [m].
        """
        return ()

    @property
    def is_free(self) -> bool:
        """At least one parameter is estimated."""
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
    """Refuse a parameter in another unit, or one that can leave 0 to `maximum`."""
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
