"""Motor types and oils: a type is a list of leakage paths, an oil its data sheet and analyses.

Other motor families, and paths that the thesis leaves out, are files, not code.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from leakage import AnnularGap, Laminar, Oil, Parameter, SpeedCurve
from leakage.physics.motor import FIXED_COLUMNS
from leakage.physics.oil import walther_coefficients, walther_through
from leakage.physics.paths import FLUSHING_PARAMETER, FLUSHING_PATH, Law
from leakage.physics.simulated_curves import fit_deformation_pressure, fit_speed_curve
from pipeline.config.section import Id, Misfit, NonNegative, Positive, Section, Stage, left_out

BAR = 1e5
Walther = tuple[float, float]
# A viscosity further from the data sheet, by this factor, is a slip or another oil.
FURTHEST = 3.0
# A curve from a simulation that is off by more is that of another part.
MOST_SCALE = 10.0

Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,31}$")]
Source = Annotated[str, Field(min_length=1)]


class Unknown(Section):
    """An unknown of the model: starting value, bounds, and whether it is held fixed."""

    shapes = Stage.SCALE

    value: float
    """Value where fixed, else the first starting point."""
    minimum: float
    """Lower bound."""
    maximum: float
    """Upper bound."""
    fixed: bool = False
    """Held at `value`."""

    def misfits(self) -> Iterator[Misfit]:
        if not self.minimum <= self.value <= self.maximum:
            yield (), "expected minimum <= value <= maximum", None

    def parameter(self, name: str, unit: str) -> Parameter:
        """Return the unknown as the estimation knows it."""
        return Parameter(name, unit, self.value, self.minimum, self.maximum, self.fixed)


class GapHeight(Unknown):
    """Gap height in µm."""

    value: float = 8.0
    minimum: Positive = 1.0
    maximum: Positive = 60.0


class Eccentricity(Unknown):
    """Eccentricity between 0 (concentric) and 1 (touching)."""

    value: float = 0.5
    minimum: NonNegative = 0.0
    maximum: float = Field(1.0, le=1)


class PathSection(Section):
    """A `[[path]]` table: base of the models, a model for each law."""

    shapes = Stage.BLOCKS

    name: Name
    """Name of the path in the tables."""
    law: str
    """The path's law."""
    source: Annotated[Source, Stage.FIGURES]
    """Document behind the values, or `placeholder` for a guess."""
    count: Annotated[int, Stage.SCALE] = Field(ge=1)
    """Interfaces at high pressure at any time."""

    def path(self) -> Law:
        """Return path as the physics knows it; raises ValueError for numbers that it refuses."""
        raise NotImplementedError

    @model_validator(mode="after")
    def _is_physical(self) -> Self:
        self.path()
        return self


class AnnularGapPath(PathSection):
    """`annular_gap`: laminar flow through an annular gap, with deformation and eccentricity."""

    law: Literal["annular_gap"]
    radius_mm: Annotated[Positive, Stage.SCALE]
    """Radius of the gap."""
    length_mm: Annotated[Positive, Stage.SCALE]
    """Length of the gap along the flow."""
    height_factor: Annotated[Positive, Stage.SCALE] = 1.0
    """Factor on the gap height (1.1 for sleeves)."""
    deformation_pressure_bar: Positive | None = None
    """Deformation constant X; none: no deformation."""
    deformation_points: tuple[tuple[float, float, float], ...] | None = None
    """Points [bar, µm, l/min] to which X is fitted."""
    deformation_tolerance_percent: Annotated[NonNegative, Stage.FIGURES] = 0.0
    """Tolerance of the deformation constant."""
    gap_um: GapHeight = left_out()
    """Gap height."""
    eccentricity: Annotated[Eccentricity | None, Stage.SCALE] = None
    """Eccentricity, if the path has any."""

    def misfits(self) -> Iterator[Misfit]:
        if self.deformation_pressure_bar is not None and self.deformation_points is not None:
            yield (), "expected deformation_pressure_bar or deformation_points, not both", None

    def path(self) -> AnnularGap:
        deformation_pa = None
        if self.deformation_points is not None:
            deformation_pa = fit_deformation_pressure(
                [(bar * BAR, um * 1e-6, flow) for bar, um, flow in self.deformation_points]
            )
        elif self.deformation_pressure_bar is not None:
            deformation_pa = self.deformation_pressure_bar * BAR
        own = self.eccentricity
        return AnnularGap(
            name=self.name,
            count=self.count,
            radius_m=self.radius_mm * 1e-3,
            length_m=self.length_mm * 1e-3,
            gap=self.gap_um.parameter(f"h_{self.name}", "um"),
            eccentricity=None if own is None else own.parameter(f"e_{self.name}", "1"),
            deformation_pressure_pa=deformation_pa,
            height_factor=self.height_factor,
            deformation_tolerance=self.deformation_tolerance_percent / 100,
        )


class SpeedCurvePath(PathSection):
    """`speed_curve`: a curve over the speed from a simulation, scaled by pressure and viscosity."""

    law: Literal["speed_curve"]
    coefficients: tuple[float, ...] | None = Field(None, min_length=1)
    """Coefficients, highest power first, l/min over rpm."""
    speed_range_rpm: tuple[float, float] | None = None
    """Range of the coefficients."""
    points: tuple[tuple[float, float], ...] | None = None
    """Points [rpm, l/min] to which a quintic is fitted."""
    reference_pressure_bar: Positive
    """Pressure difference of the simulation."""
    reference_viscosity_mpa_s: Positive
    """Viscosity of the simulation."""
    curve_tolerance_percent: Annotated[NonNegative, Stage.FIGURES] = 0.0
    """Tolerance of the curve's level."""

    def misfits(self) -> Iterator[Misfit]:
        given = self.coefficients is not None and self.speed_range_rpm is not None
        if given == (self.points is not None):
            yield (), "expected coefficients with speed_range_rpm, or points", None

    def path(self) -> SpeedCurve:
        coefficients, speed_range = self.coefficients or (), self.speed_range_rpm or (0.0, 0.0)
        if self.points is not None:
            coefficients = fit_speed_curve(self.points)
            speed_range = (min(self.points)[0], max(self.points)[0])
        return SpeedCurve(
            name=self.name,
            count=self.count,
            coefficients=coefficients,
            speed_minimum_rpm=speed_range[0],
            speed_maximum_rpm=speed_range[1],
            reference_pressure_pa=self.reference_pressure_bar * BAR,
            reference_viscosity_pa_s=self.reference_viscosity_mpa_s * 1e-3,
            # The motor's own nights decide whether it is free.
            scale=Parameter(f"scale_{self.name}", "1", 1.0, 0.0, MOST_SCALE, fixed=True),
            curve_tolerance=self.curve_tolerance_percent / 100,
        )


class LaminarPath(PathSection):
    """`laminar`: flow in proportion to pressure difference over viscosity."""

    law: Literal["laminar"]
    coefficient_m3: Unknown
    """Loss factor of an interface, m³."""

    def path(self) -> Laminar:
        return Laminar(self.name, self.count, self.coefficient_m3.parameter(f"C_{self.name}", "m3"))


# The laws that a `[[path]]` can name.
DeclaredPath = Annotated[AnnularGapPath | SpeedCurvePath | LaminarPath, Field(discriminator="law")]


class LeakageLimits(Section):
    """Absolute limits of the reference leakage; none by default."""

    shapes = Stage.TRENDS

    warning_l_per_min: Positive | None = None
    """Reference leakage that is a warning."""
    alarm_l_per_min: Positive | None = None
    """Reference leakage that is an alarm."""


class MotorTypeFile(Section):
    """`motor_types/<motor_type>.toml`."""

    shapes = Stage.FIGURES

    motor_type: Id
    """The type."""
    path: tuple[DeclaredPath, ...] = Field(min_length=1)
    """Leakage paths of the type."""
    surface_roughness_um: tuple[Positive, Positive] = (0.2, 0.2)
    """R_a of the two surfaces of a gap."""
    limits: LeakageLimits = left_out()
    """Absolute limits, where there are any."""

    def misfits(self) -> Iterator[Misfit]:
        names, parameters = {*FIXED_COLUMNS, FLUSHING_PATH}, {FLUSHING_PARAMETER}
        for index, declared in enumerate(self.path):
            own = {parameter.name for parameter in declared.path().parameters}
            if declared.name in names or own & parameters:
                yield ("path", index, "name"), "expected a name that is not taken", declared.name
            names.add(declared.name)
            parameters |= own

    def paths(self) -> tuple[Law, ...]:
        """Return the declared paths, in order."""
        return tuple(path.path() for path in self.path)


class OilFile(Section):
    """`oils/<oil>.toml`: an oil's data sheet."""

    shapes = Stage.BLOCKS

    name: Annotated[str, Stage.FIGURES] = Field(min_length=1)
    """The oil's name, as reports show it."""
    source: Annotated[Source, Stage.NOTHING]
    """Document behind the values, or `placeholder` for a guess."""
    reference_temperatures_c: tuple[float, float]
    """Temperatures of the reference viscosities."""
    reference_viscosities_mm2_per_s: tuple[Positive, Positive]
    """Kinematic viscosities there."""
    density_15_c_kg_per_m3: Positive
    """Density at 15 °C."""
    thermal_expansion_per_k: NonNegative = 7.0e-4
    """β of the density."""
    pressure_viscosity_per_pa: NonNegative = 2.0e-8
    """α of the Barus equation."""
    pressure_viscosity_tolerance_percent: Annotated[NonNegative, Stage.FIGURES] = 0.0
    """Tolerance of α."""
    density_tolerance_percent: Annotated[NonNegative, Stage.FIGURES] = 0.0
    """Tolerance of the density."""

    def misfits(self) -> tuple[()]:
        self.oil()  # raises for numbers that the physics refuses
        return ()

    def oil(self) -> Oil:
        """Return the oil as the physics knows it."""
        cold, warm = zip(
            self.reference_temperatures_c, self.reference_viscosities_mm2_per_s, strict=True
        )
        a, b = walther_coefficients(*cold, *warm)
        return Oil(
            name=self.name,
            walther_a=a,
            walther_b=b,
            density_15_c_kg_per_m3=self.density_15_c_kg_per_m3,
            thermal_expansion_per_k=self.thermal_expansion_per_k,
            pressure_viscosity_per_pa=self.pressure_viscosity_per_pa,
        )


# Oil in use


class OilSample(Section):
    """An analysis of the oil in use."""

    shapes = Stage.FIGURES

    date: dt.date
    """Day on which it was drawn."""
    viscosity_40_c_mm2_per_s: float = Field(ge=2, le=2000)
    """Kinematic viscosity at 40 °C."""
    viscosity_100_c_mm2_per_s: Annotated[float, Field(ge=1, le=200)] | None = None
    """The same at 100 °C; by default by the data sheet's slope."""

    def misfits(self) -> Iterator[Misfit]:
        at_100 = self.viscosity_100_c_mm2_per_s
        if at_100 is not None and at_100 >= self.viscosity_40_c_mm2_per_s:
            yield self.at("viscosity_100_c_mm2_per_s", "expected less than at 40 °C")

    def curve(self, oil: OilFile) -> Walther:
        """Return Walther constants of the sample."""
        at_40, at_100 = self.viscosity_40_c_mm2_per_s, self.viscosity_100_c_mm2_per_s
        if at_100 is not None:
            return walther_coefficients(40.0, at_40, 100.0, at_100)
        slope = oil.oil().walther_b
        return walther_through(40.0, at_40, slope), slope


class OilCircuitFile(Section):
    """`oil_circuits/<oil_circuit>.toml`: samples of the oil that motors share."""

    oil_samples: tuple[OilSample, ...] = ()
    """Analyses of the oil, by date."""

    def misfits(self) -> Iterator[Misfit]:
        return order_faults(self.oil_samples)


def order_faults(samples: Sequence[OilSample]) -> Iterator[Misfit]:
    """Yield samples that are not in order of their dates."""
    for index, (before, after) in enumerate(pairwise(samples), start=1):
        if after.date <= before.date:
            message = f"expected a date after {before.date}, that of the sample before"
            yield ("oil_samples", index, "date"), message, after.date.isoformat()


def measured_curve(
    samples: Sequence[OilSample], oil: OilFile, filled: dt.date | None, night: dt.date
) -> Walther | None:
    """Return Walther constants in a night by the samples of a filling; None: by the data sheet.

    Between two samples A and B are linear in time, and so is log log Z = A − B log T (ASTM D341).
    A filling with a date begins as the data sheet has it.
    """
    known = [(sample.date, sample.curve(oil)) for sample in samples]
    if known and filled is not None and filled < known[0][0]:
        sheet = oil.oil()
        known.insert(0, (filled, (sheet.walther_a, sheet.walther_b)))
    if not known or night < known[0][0]:
        return None
    days = [date.toordinal() for date, _ in known]
    a, b = (
        float(np.interp(night.toordinal(), days, constants))
        for constants in zip(*(curve for _, curve in known), strict=True)
    )
    return a, b
