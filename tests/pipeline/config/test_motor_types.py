"""Other motor families are files, not code: constants of a path may be points of a simulation."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from leakage import OperatingConditions
from leakage.physics.motor import path_flows_l_per_min
from tests.pipeline.simulated import NIGHT, load_motor, motor_toml

DEFORMATION_BAR, GAP_UM = 150.0, 20.0
# [bar, µm, l/min] at constant viscosity.
POINTS = ", ".join(
    f"[{bar}, {GAP_UM}, {GAP_UM**3 * bar * np.exp(-3.0 * bar / DEFORMATION_BAR):.15g}]"
    for bar in (10.0, 40.0, 90.0, 160.0, 250.0, 320.0)
)
QUINTIC = (3.125e-14, 0.0, 0.0, -5e-7, 1.5e-4, 0.004)
SPEEDS = (0.0, 20.0, 50.0, 90.0, 130.0, 170.0, 200.0)
CURVE = ", ".join(f"[{rpm}, {np.polyval(QUINTIC, rpm):.15g}]" for rpm in SPEEDS)


def axial(deformation: str, curve: str) -> str:
    """A type without rings or sleeves, with a distributor whose coefficient is searched."""
    return f"""
motor_type = "AX-9"

[[path]]
name = "piston_clearance"
law = "annular_gap"
source = "invented"
count = 5
radius_mm = 12.0
length_mm = 40.0
{deformation}
gap_um = {{ value = {GAP_UM}, minimum = 2.0, maximum = 90.0 }}
eccentricity = {{ value = 0.8, minimum = 0.0, maximum = 1.0 }}

[[path]]
name = "distributor"
law = "laminar"
source = "invented"
count = 2
coefficient_m3 = {{ value = 5e-15, minimum = 0.0, maximum = 1e-12 }}

[[path]]
name = "slipper"
law = "speed_curve"
source = "invented"
count = 5
{curve}
reference_pressure_bar = 250.0
reference_viscosity_mpa_s = 30.0
"""


def test_points_of_a_simulation_stand_for_constants(tmp_path: Path) -> None:
    constants = axial(
        f"deformation_pressure_bar = {DEFORMATION_BAR}",
        f"coefficients = {list(QUINTIC)}\nspeed_range_rpm = [0.0, 200.0]",
    )
    points = axial(f"deformation_points = [{POINTS}]", f"points = [{CURVE}]")
    conditions = OperatingConditions.from_bar(
        np.array([20.0, 200.0, 310.0]), np.array([30.0, 50.0, 70.0]), np.array([10.0, 90.0, 190.0])
    )
    by_points, by_constants = (
        path_flows_l_per_min(
            load_motor(tmp_path / name, motor_toml("AX", "AX-9"), {"AX-9": text}).motor(
                NIGHT, "none"
            ),
            conditions,
        )
        for name, text in (("points", points), ("constants", constants))
    )
    assert list(by_points) == ["piston_clearance", "distributor", "slipper", "flushing"]
    for path, flow in by_points.items():
        np.testing.assert_allclose(flow, by_constants[path], rtol=1e-6)
