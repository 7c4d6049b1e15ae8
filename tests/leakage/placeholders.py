"""The placeholder motor types CB400, CB560 and CB1120, for tests only.

Every value is from the table of placeholders in the model's description: of a plausible size, not
the manufacturer's.
"""

from __future__ import annotations

from typing import Literal

from leakage.physics.annular_gap import AnnularGap
from leakage.physics.motor import Motor
from leakage.physics.oil import THESIS_FILM_PRESSURE, FilmPressure, Oil
from leakage.physics.paths import Constant, Law, Parameter, SpeedCurve

Flushing = Literal["none", "fixed", "estimated"]

# 8 interfaces of each kind a cam row at high pressure, assuming 3, 4 and 8 rows.
HIGH_PRESSURE_COUNTS = {"CB400": 24, "CB560": 32, "CB1120": 64}

ROLLER_QUINTIC = (2.0e-11, -7.0e-9, 9.0e-7, -5.0e-5, 1.6e-3, 4.0e-3)

# Data-sheet viscosities at 40 and 100 °C, mm²/s.
REFERENCE_VISCOSITIES = {"VG 32": (32.0, 5.4), "VG 46": (46.0, 6.8), "VG 68": (68.0, 8.7)}


def placeholder_oil(grade: str = "VG 68") -> Oil:
    """An oil of a grade, with the placeholder's density."""
    at_40_c, at_100_c = REFERENCE_VISCOSITIES[grade]
    return Oil.from_reference_viscosities(
        grade,
        temperature_1_c=40.0,
        viscosity_1_mm2_per_s=at_40_c,
        temperature_2_c=100.0,
        viscosity_2_mm2_per_s=at_100_c,
        density_15_c_kg_per_m3=882.0,
        thermal_expansion_per_k=7.0e-4,
        pressure_viscosity_per_pa=2.0e-8,
    )


def gap(name: str, value_um: float, *, fixed: bool = False) -> Parameter:
    """A gap height within the placeholder's bounds."""
    return Parameter(f"h_{name}", "um", value_um, 1.0, 60.0, fixed)


def eccentricity(name: str, value: float, *, fixed: bool = False) -> Parameter:
    """An eccentricity within its bounds."""
    return Parameter(f"e_{name}", "1", value, 0.0, 1.0, fixed)


def piston_ring(count: int = 32) -> AnnularGap:
    """Path o."""
    return AnnularGap("o", count, 0.035, 0.004, gap("o", 8.0), None, 120e5)


def balance_piston(count: int = 32) -> AnnularGap:
    """Path p."""
    return AnnularGap("p", count, 0.015, 0.020, gap("p", 10.0), eccentricity("p", 0.4))


def balance_sleeve(count: int = 32) -> AnnularGap:
    """Path s."""
    own = gap("s", 12.0), eccentricity("s", 0.3)
    return AnnularGap(
        "s", count, 0.020, 0.020, *own, deformation_pressure_pa=900e5, height_factor=1.1
    )


def cam_roller(count: int = 32, *, free: bool = False) -> SpeedCurve:
    """Path r; with a free scale if asked for."""
    scale = Parameter("scale_r", "1", 1.0, 0.0, 5.0, fixed=not free)
    return SpeedCurve("r", count, ROLLER_QUINTIC, 0.0, 125.0, 200e5, 0.035, scale)


def placeholder_motor(
    motor_type: str = "CB560",
    *,
    flushing: Flushing = "none",
    flushing_l_per_min: float = 0.0,
    roller_is_free: bool = False,
    film_pressure: FilmPressure = THESIS_FILM_PRESSURE,
) -> Motor:
    """A motor type at the gaps of the worked values.

    h_o 8 µm, h_p 10 µm, h_s 12 µm, e_p 0.4, e_s 0.3. The paths are o, p, s, r and, with flushing,
    f: the statistics' columns are o, p, s, one, known, measured.
    """
    count = HIGH_PRESSURE_COUNTS[motor_type]
    paths: list[Law] = [piston_ring(count), balance_piston(count), balance_sleeve(count)]
    paths.append(cam_roller(count, free=roller_is_free))
    if flushing != "none":
        fixed = flushing == "fixed"
        flow = Parameter("C_f", "l_per_min", flushing_l_per_min, 0.0, 20.0, fixed=fixed)
        paths.append(Constant("f", flow))
    return Motor(motor_type, tuple(paths), placeholder_oil(), film_pressure)
