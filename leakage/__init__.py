"""Grey-box model of the leakage of radial piston hydraulic motors, on NumPy arrays."""

from leakage.annular_gap import AnnularGap
from leakage.certificate import Certificate, certify
from leakage.conditions import OperatingConditions
from leakage.errors import (
    CurveError,
    EstimationError,
    LeakageError,
    ParameterError,
    ShapeError,
    StatisticsError,
    ValidityError,
)
from leakage.estimation import Fit, fit
from leakage.film import film_thickness_ratio, gap_plausibility, lubrication_regimes
from leakage.law import Parameter
from leakage.motor import (
    Motor,
    leakage_l_per_min,
    path_flows_l_per_min,
    regressors,
    speed_beyond_curve,
    total_flow_l_per_min,
)
from leakage.multi_start import Parametrisation, SearchSettings, Start
from leakage.oil import FilmPressure, Oil, density_kg_per_m3, dynamic_viscosity_pa_s
from leakage.paths import Constant, Laminar, LeakagePath
from leakage.simulated_curves import fit_deformation_pressure, fit_speed_curve
from leakage.speed_curve import SpeedCurve
from leakage.walther import kinematic_viscosity_mm2_per_s, walther_coefficients

__all__ = [
    "AnnularGap",
    "Certificate",
    "Constant",
    "CurveError",
    "EstimationError",
    "FilmPressure",
    "Fit",
    "Laminar",
    "LeakageError",
    "LeakagePath",
    "Motor",
    "Oil",
    "OperatingConditions",
    "Parameter",
    "ParameterError",
    "Parametrisation",
    "SearchSettings",
    "ShapeError",
    "SpeedCurve",
    "Start",
    "StatisticsError",
    "ValidityError",
    "certify",
    "density_kg_per_m3",
    "dynamic_viscosity_pa_s",
    "film_thickness_ratio",
    "fit",
    "fit_deformation_pressure",
    "fit_speed_curve",
    "gap_plausibility",
    "kinematic_viscosity_mm2_per_s",
    "leakage_l_per_min",
    "lubrication_regimes",
    "path_flows_l_per_min",
    "regressors",
    "speed_beyond_curve",
    "total_flow_l_per_min",
    "walther_coefficients",
]
