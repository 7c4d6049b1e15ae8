"""The annular gap: piston ring, balance piston and balance sleeve in a law."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from leakage.arrays import Array
from leakage.physics.paths import (
    LITRES_PER_MINUTE,
    CoefficientUnit,
    DerivedFigure,
    Law,
    Parameter,
    PathTolerance,
    Side,
    Values,
    require_parameter,
    require_positive,
)

MICROMETRE = 1e-6
MICROMETRES_PER_METRE = 1e6
# A gap shows below about 0.83 X: at 100 bar for the piston ring's 120 bar.
VISIBLE_BELOW = 0.83


@dataclass(frozen=True, slots=True)
class AnnularGap(Law):
    r"""Laminar flow through an annular gap that pressure may close and eccentricity widens.

    .. math:: Q = n \frac{\pi r\,(c\,h\,e^{-|\Delta P|/X})^3}{6 l}\,(1 + 1.5 e^2)\,
        \frac{|\Delta P|}{\eta} = K\, e^{-3|\Delta P|/X}\,\frac{|\Delta P|}{\eta}

    The piston ring, the balance piston and the balance sleeve follow this law: the ring with
    a deformation constant, the piston with an eccentricity, the sleeve with both and c = 1.1.

    `name`: Name of the path.
    `count`: Number n of interfaces at high pressure, [-].
    `radius_m, length_m`: Radius r of the interface and length l of the gap in the direction of
    flow, [m].
    `gap`: Gap height h, [um].
    `eccentricity`: Eccentricity e, 0 to 1, [1]; None: none.
    `deformation_pressure_pa`: Deformation constant X, [Pa]; None: no deformation.
    `height_factor`: Factor c on the gap height, [-].
    `deformation_tolerance`: Stated tolerance of X, relative; 0: none stated.

    Raises ParameterError if a constant is not positive, a bound outside the physical range or a
    unit another.

    Notes
    -----
    Laminar, thin gap (h much smaller than r), the part at rest: the velocity term of (9) is
    dropped. h and e enter through K alone: no data of pressure, temperature, speed and flow tell
    them apart.

    Examples
    --------
    >>> ring = AnnularGap("o", 32, 0.035, 0.004, Parameter("h_o", "um", 8.0, 1.0, 60.0), None,
    ...                   deformation_pressure_pa=120e5)
    >>> f"{ring.coefficient([8.0]):.6e}"
    '7.506312e-14'

    Source: the thesis, equations (6), (7), (10), (11) and (28) to (31).
    """

    coefficient_unit: ClassVar[CoefficientUnit] = "m3"

    name: str
    count: int
    radius_m: float
    length_m: float
    gap: Parameter
    eccentricity: Parameter | None
    deformation_pressure_pa: float | None = None
    height_factor: float = 1.0
    deformation_tolerance: float = 0.0

    def __post_init__(self) -> None:
        require_positive(
            self.name,
            count=self.count,
            radius_m=self.radius_m,
            length_m=self.length_m,
            height_factor=self.height_factor,
        )
        if self.deformation_pressure_pa is not None:
            require_positive(self.name, deformation_pressure_pa=self.deformation_pressure_pa)
        require_parameter(self.name, self.gap, "um")
        if self.eccentricity is not None:
            require_parameter(self.name, self.eccentricity, "1", maximum=1.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Gap height and, where the path has it, eccentricity."""
        return (self.gap,) if self.eccentricity is None else (self.gap, self.eccentricity)

    @property
    def visible_below_pa(self) -> float:
        """Pressure difference above which the deformed gap hardly shows in the leakage [Pa]."""
        deformation = self.deformation_pressure_pa
        return math.inf if deformation is None else VISIBLE_BELOW * deformation

    def coefficient(self, values: Values) -> Array:
        r"""Return lumped loss factor of all interfaces of the path.

        .. math:: K = n \frac{\pi r (c h)^3}{6 l} (1 + 1.5 e^2)

        h in [µm], e where the path has it, [-], along the last axis; K in [m³].
        """
        given = np.asarray(values, dtype=np.float64)
        gap_um = given[..., 0]
        volume: Array = gap_um * gap_um * gap_um * self._widening(given)
        return self._concentric_m3_per_um3 * volume

    def regressor(self, side: Side) -> Array:
        r"""Return flow per unit of K.

        .. math:: \varphi = 60\,000\, e^{-3|\Delta P|/X}\,\frac{|\Delta P|}{\eta}

        In [l/min per m³]; at constant viscosity the flow has its maximum at ΔP = X/3.
        """
        flow: Array = LITRES_PER_MINUTE * side.drive_per_s
        if self.deformation_pressure_pa is None:
            return flow
        closing = np.abs(side.pressure_difference_pa)
        closing *= -3.0 / self.deformation_pressure_pa
        flow *= np.exp(closing, out=closing)
        return flow

    def gap_um_from_coefficient(
        self, coefficient_m3: ArrayLike, eccentricity: float = 0.0
    ) -> Array:
        r"""Return gap height [µm] of a loss factor and eccentricity: the inverse of `coefficient`.

        .. math:: h = \frac{1}{c} \left(\frac{6 l K}{n \pi r (1 + 1.5 e^2)}\right)^{1/3}
        """
        widening = 1.0 + 1.5 * eccentricity * eccentricity
        gap_um: Array = np.cbrt(
            np.asarray(coefficient_m3) / (self._concentric_m3_per_um3 * widening)
        )
        return gap_um

    def tolerances(self) -> tuple[PathTolerance, ...]:
        """Return the path with a larger deformation constant, where a tolerance is stated."""
        share, pressure = self.deformation_tolerance, self.deformation_pressure_pa
        if not share or pressure is None:
            return ()
        stiffer = replace(self, deformation_pressure_pa=pressure * (1 + share))
        return (PathTolerance("deformation constant", share, stiffer),)

    def derived_figures(
        self,
        coefficient: float,
        limits: tuple[float, float] | None,
        roughness_m: tuple[float, float],
    ) -> tuple[DerivedFigure, ...]:
        """Return gap height, eccentricity where the path has it, and film thickness ratio."""
        gaps_um, eccentricities = self._feasible(coefficient)
        # Λ = h (1 − e) / √(R_a1² + R_a2²) at the narrowest place, section 2.2.4 of the thesis.
        roughness, (least, most) = math.hypot(*roughness_m), eccentricities
        low, high = (MICROMETRE * gap for gap in gaps_um)
        ratios = low * (1.0 - most) / roughness, high * (1.0 - least) / roughness
        e = self.eccentricity
        shared = e is not None and e.is_free and self.gap.is_free
        gap_limits = None
        if limits is not None and self.gap.is_free and eccentricities[0] == eccentricities[1]:
            # Alone in its loss factor, a gap is known as well as that: h goes with its cube root.
            low, high = self.gap_um_from_coefficient(np.maximum(limits, 0.0), eccentricities[0])
            gap_limits = float(low), float(high)

        def figure(
            name: str, unit: str, ends: tuple[float, float], own: tuple[float, float] | None = None
        ) -> DerivedFigure:
            combination = f"{self.coefficient_name} ∝ h³(1 + 1.5e²)" if shared else ""
            return DerivedFigure(f"{name}_{self.name}", unit, *ends, own, combination)

        figures = [figure("h", "um", gaps_um, gap_limits)]
        if e is not None:
            figures.append(figure("e", "1", eccentricities))
        return (*figures, figure("film_thickness_ratio", "1", ratios))

    def _feasible(self, coefficient_m3: float) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return gap heights [µm] and eccentricities that a loss factor and bounds leave possible.

        Heights at the largest and the smallest eccentricity are a factor 2.5^(1/3) = 1.357 apart
        where e is free between 0 and 1.
        """
        e = self.eccentricity
        ends = (0.0, 0.0) if e is None else (e.highest, e.lowest)
        smallest, largest = (
            float(self.gap_um_from_coefficient(coefficient_m3, end)) for end in ends
        )
        if e is None:
            return (smallest, largest), ends
        low = min(max(smallest, self.gap.lowest), self.gap.highest)
        high = max(min(largest, self.gap.highest), low)

        def eccentricity(h: float) -> float:
            # The ends of the range as they are: the root below makes 1e-8 of a rounding error.
            if h in (smallest, largest):
                return e.highest if h == smallest else e.lowest
            widening = coefficient_m3 / float(self.coefficient([h, 0.0])) - 1.0
            return float(np.clip(np.sqrt(max(widening, 0.0) / 1.5), e.lowest, e.highest))

        if not e.is_free:
            return (low, high), (e.value, e.value)
        return (low, high), (eccentricity(high), eccentricity(low))

    @property
    def _concentric_m3_per_um3(self) -> float:
        """K of concentric parts per cube of the gap height in micrometres."""
        height_m_per_um = self.height_factor / MICROMETRES_PER_METRE
        return self.count * math.pi * self.radius_m * height_m_per_um**3 / (6.0 * self.length_m)

    def _widening(self, values: Array) -> Array | float:
        """Return 1 + 1.5 e², or 1 where the path has no eccentricity."""
        if self.eccentricity is None:
            return 1.0
        eccentricity: Array = values[..., 1]
        return 1.0 + 1.5 * eccentricity * eccentricity
