"""Subject of the figures of a motor type: its model, and the source of its values."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from leakage import AnnularGap, FilmPressure, Motor, OperatingConditions, SpeedCurve
from leakage.physics.oil import dynamic_viscosity_pa_s, flow_drive_per_s
from leakage.physics.paths import LeakagePath
from pipeline.arrays import Array
from pipeline.config.fleet import Fleet
from pipeline.config.motor_types import (
    BAR,
    MICROMETRE,
    AnnularGapPath,
    MotorTypeFile,
    OilFile,
    SpeedCurvePath,
)
from pipeline.config.settings import Settings
from pipeline.errors import UsageError
from pipeline.palette import path_places

PLACEHOLDER = "placeholder"

# The working pressure up to which the thesis's motors are recommended (its section 1.1).
USUAL_HIGHEST_PRESSURE_BAR = 350.0
_LONGEST_NAME = 60


@dataclass(frozen=True, slots=True)
class ModelSubject:
    """A motor type with its oil, at the values that its config files state."""

    # The declared paths with the oil; gap heights and eccentricities are the configured ones.
    motor: Motor
    oil_name: str  # name in the oil's file
    # Data-sheet points (temperature, [°C]; kinematic viscosity, [mm²/s]).
    reference_viscosities: tuple[tuple[float, float], ...]
    roughness_m: tuple[float, float]  # R_a of the two surfaces of a gap, [m]
    # pressure_bar, temperature_c, speed_rpm: reference conditions.
    pressure_bar: float
    temperature_c: float
    speed_rpm: float
    # Charge above case pressure for two-sided leakage; None: one-sided.
    charge_over_case_bar: float | None
    # Points (ΔP, [bar]; h, [µm]; Q, [l/min]) by path to which X is fitted.
    deformation_points: Mapping[str, Array]
    # Points (ω, [rpm]; Q, [l/min]) by path to which the curve is fitted.
    speed_points: Mapping[str, Array]
    placeholders: frozenset[str]  # paths with placeholder values
    oil_is_placeholder: bool

    @property
    def highest_pressure_bar(self) -> float:
        """End of every pressure axis."""
        simulated = [points[:, 0].max() for points in self.deformation_points.values()]
        return float(max(USUAL_HIGHEST_PRESSURE_BAR, self.pressure_bar, *simulated))

    @property
    def places(self) -> dict[str, int]:
        """Place of each path among the pens."""
        return path_places(path.name for path in self.motor.paths)

    def conditions(self, pressure_bar: Array) -> OperatingConditions:
        """Reference temperature and speed at each of some pressures, shape (n,)."""
        return OperatingConditions.from_bar(
            pressure_bar, self.temperature_c, self.speed_rpm, self.charge_over_case_bar
        )

    def film_drive_per_s(self, pressure_bar: Array) -> Array:
        """ΔP/η at the configured film pressure and the reference temperature, one-sided."""
        motor = self.motor
        return flow_drive_per_s(
            pressure_bar * BAR, self.temperature_c, motor.oil, motor.film_pressure
        )

    def constant_drive_per_s(self, pressure_bar: Array) -> Array:
        """ΔP/η with the viscosity that the oil has at no pressure, one-sided."""
        return pressure_bar * BAR / dynamic_viscosity_pa_s(self.temperature_c, 0.0, self.motor.oil)

    def marks(self, *paths: LeakagePath, oil: bool = False) -> str:
        """Note on placeholders for a figure of these paths; empty without one."""
        strange = [path for path in paths if path.name in self.placeholders]
        kinds = ["curve" if isinstance(path, SpeedCurve) else "geometry" for path in strange]
        if oil and self.oil_is_placeholder:
            kinds.append("oil")
        *others, last = dict.fromkeys(kinds) or [""]
        listed = f"{', '.join(others)} and {last}" if others else last
        return f"{PLACEHOLDER} {listed}" if last else ""

    def conditions_words(self) -> str:
        """Oil, temperature and side for which one interface is drawn, in words."""
        side = "" if self.charge_over_case_bar is None else ", high-pressure side alone"
        return f"{self.oil_name} at {self.temperature_c:g} °C{side}"

    def film_words(self) -> str:
        """The configured pressure of the films, in words."""
        film = self.motor.film_pressure
        if film.model == "slot":
            return "Barus viscosity along the slot"
        return "Barus viscosity at ΔP" + ("" if film.share == 1.0 else f" × {film.share:g}")


def stated(path: LeakagePath) -> str:
    """Configured values of a gap, in words."""
    if not isinstance(path, AnnularGap):
        return ""
    words = f"h = {path.gap.value:g} µm"
    if path.eccentricity is not None:
        words += f", e = {path.eccentricity.value:g}"
    return words


def subject_of(motor_type: MotorTypeFile, oil: OilFile, settings: Settings) -> ModelSubject:
    """Subject from the files of a motor type and an oil."""
    model, reference = settings.model, settings.reference
    charge = model.charge_pressure_bar - model.case_pressure_bar
    film_pressure = FilmPressure(model.film_pressure, model.film_pressure_share)
    return ModelSubject(
        motor=Motor(motor_type.motor_type, motor_type.paths(), oil.oil(), film_pressure),
        # A name may hold line breaks; a figure's line cannot.
        oil_name=textwrap.shorten(oil.name, _LONGEST_NAME),
        reference_viscosities=tuple(
            zip(oil.reference_temperatures_c, oil.reference_viscosities_mm2_per_s, strict=True)
        ),
        roughness_m=(
            motor_type.surface_roughness_um[0] * MICROMETRE,
            motor_type.surface_roughness_um[1] * MICROMETRE,
        ),
        pressure_bar=reference.pressure_bar,
        temperature_c=reference.temperature_c,
        speed_rpm=reference.speed_rpm,
        charge_over_case_bar=max(charge, 0.0) if model.is_two_sided() else None,
        deformation_points={
            path.name: np.array(path.deformation_points)
            for path in motor_type.path
            if isinstance(path, AnnularGapPath) and path.deformation_points
        },
        speed_points={
            path.name: np.array(path.points)
            for path in motor_type.path
            if isinstance(path, SpeedCurvePath) and path.points
        },
        placeholders=frozenset(path.name for path in motor_type.path if path.source == PLACEHOLDER),
        oil_is_placeholder=oil.source == PLACEHOLDER,
    )


def choose(fleet: Fleet, motor_type: str, oil: str | None = None) -> ModelSubject:
    """Find a motor type and its oil, by default that of the fleet's first motor of the type.

    Raises UsageError if there is no such type (``unknown_type``), or no such oil, or none that is
    meant (``unknown_oil``).
    """
    if motor_type not in fleet.motor_types:
        known = ", ".join(sorted(fleet.motor_types))
        raise UsageError("unknown_type", f"no motor type {motor_type!r}; there are {known}")
    named = oil or next(
        (spec.file.oil for spec in fleet.motors if spec.motor_type.motor_type == motor_type),
        None,
    )
    if named is None or named not in fleet.oils:
        known = ", ".join(sorted(fleet.oils))
        what = f"no oil {named!r}" if named else f"no motor of type {motor_type} names an oil"
        raise UsageError("unknown_oil", f"{what}; name one with --oil: {known}")
    return subject_of(fleet.motor_types[motor_type], fleet.oils[named], fleet.settings)
