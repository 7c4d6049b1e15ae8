"""Other motor families are files, not code."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from leakage import (
    AnnularGap,
    Constant,
    Laminar,
    Motor,
    OperatingConditions,
    Parameter,
    SpeedCurve,
    total_flow_l_per_min,
)
from pipeline.config import MotorSpec
from tests.pipeline.simulated import NIGHT, load_motor, motor_toml

X_CLEARANCE_BAR, X_PLATE_BAR = 150.0, 700.0


def points_of(deformation_bar: float, gap_um: float) -> str:
    """Points as a simulation would give them: [bar, µm, l/min] at constant viscosity."""
    return ", ".join(
        f"[{bar}, {gap_um}, {gap_um**3 * bar * np.exp(-3.0 * bar / deformation_bar):.15g}]"
        for bar in (10.0, 40.0, 90.0, 160.0, 250.0, 320.0)
    )


def slipper_l_per_min(speed_rpm: float) -> float:
    """A curve of the invented simulation, itself a quintic."""
    x = speed_rpm / 200.0
    return 0.004 + 0.03 * x - 0.02 * x**2 + 0.01 * x**5


SPEEDS = (0.0, 20.0, 50.0, 90.0, 130.0, 170.0, 200.0)

# An axial piston motor: no rings, no balance sleeves, two gaps that close under pressure, a
# distributor whose coefficient is searched, and slippers after points of a curve.
AXIAL = f"""
motor_type = "AX-9"
surface_roughness_um = [0.1, 0.4]

[[path]]
name = "piston_clearance"
law = "annular_gap"
source = "invented"
count = 5
radius_mm = 12.0
length_mm = 40.0
deformation_points = [{points_of(X_CLEARANCE_BAR, 20.0)}]
gap_um = {{ value = 20.0, minimum = 2.0, maximum = 90.0 }}
eccentricity = {{ value = 0.8, minimum = 0.0, maximum = 1.0 }}

[[path]]
name = "valve_plate"
law = "annular_gap"
source = "invented"
count = 1
radius_mm = 45.0
length_mm = 10.0
deformation_points = [{points_of(X_PLATE_BAR, 9.0)}]
gap_um = {{ value = 9.0, minimum = 1.0, maximum = 60.0 }}

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
points = [{", ".join(f"[{rpm}, {slipper_l_per_min(rpm):.15g}]" for rpm in SPEEDS)}]
reference_pressure_bar = 250.0
reference_viscosity_mpa_s = 30.0
"""


def axial_by_hand(spec: MotorSpec) -> Motor:
    """The same motor without the config's help; constants as they were before the points."""
    quintic = np.zeros(6)
    for power, factor in ((0, 0.004), (1, 0.03), (2, -0.02), (5, 0.01)):
        quintic[5 - power] = factor / 200.0**power
    clearance, plate = Parameter("h", "um", 23.0, 2.0, 90.0), Parameter("p", "um", 10.0, 1.0, 60.0)
    share = Parameter("e", "1", 0.6, 0.0, 1.0)
    paths = (
        AnnularGap("piston_clearance", 5, 0.012, 0.04, clearance, share, X_CLEARANCE_BAR * 1e5),
        AnnularGap("valve_plate", 1, 0.045, 0.010, plate, None, X_PLATE_BAR * 1e5),
        Laminar("distributor", 2, Parameter("C", "m3", 8e-15, 0.0, 1e-12)),
        SpeedCurve(
            name="slipper",
            count=5,
            coefficients=tuple(quintic.tolist()),
            speed_minimum_rpm=0.0,
            speed_maximum_rpm=200.0,
            reference_pressure_pa=250e5,
            reference_viscosity_pa_s=0.030,
            scale=Parameter("s", "1", 1.0, 0.0, 10.0, fixed=True),
        ),
        Constant("flushing", Parameter("C_f", "l_per_min", 0.0, 0.0, 0.0, fixed=True)),
    )
    return Motor("AX-9", paths, spec.oil_on(NIGHT).oil())


def test_a_type_of_another_family_is_files_alone(tmp_path: Path) -> None:
    """Curves, points and bounds of a file give the same flows as the motor by hand."""
    spec = load_motor(tmp_path, motor_toml("AX", "AX-9"), {"AX-9": AXIAL})
    motor, truth = spec.motor(NIGHT, "none"), axial_by_hand(spec)
    coefficients = {path.name: path.configured_coefficient for path in truth.paths}
    conditions = OperatingConditions.from_bar(
        np.array([20.0, 200.0, 310.0]), np.array([30.0, 50.0, 70.0]), np.array([10.0, 90.0, 190.0])
    )
    np.testing.assert_allclose(
        total_flow_l_per_min(motor, conditions, coefficients),
        total_flow_l_per_min(truth, conditions),
        rtol=1e-6,
    )
    assert [parameter.name for path in motor.paths for parameter in path.parameters] == [
        *("h_piston_clearance", "e_piston_clearance", "h_valve_plate", "C_distributor"),
        *("scale_slipper", "C_f"),
    ]
    assert spec.motor_type.surface_roughness_um == (0.1, 0.4)
