"""Grey-box model of the leakage of radial piston hydraulic motors, on NumPy arrays."""

from leakage.annular_gap import AnnularGap
from leakage.block_statistics import (
    BlockStatistics,
    column_means,
    criterion,
    factor,
    factors,
    flow_summary,
    gradient,
    merge,
    merge_blocks,
    normal_matrix,
    sample_count,
)
from leakage.certificate import Certificate, certify
from leakage.conditions import OperatingConditions
from leakage.correlation import autocorrelation, correlation_time
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
from leakage.identifiability import (
    Excitation,
    Identification,
    Judgement,
    LeakageJudgement,
    identify,
    judge_leakage,
)
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
from leakage.pressure_maximum import pressure_of_largest_leakage_pa
from leakage.residual_analysis import LagTest, ResidualAnalysis, analyse_residuals
from leakage.robust import huber_weights
from leakage.sensitivities import ChannelTolerance, ErrorBudget, Tolerances, error_budget
from leakage.simulated_curves import fit_deformation_pressure, fit_speed_curve
from leakage.speed_curve import SpeedCurve
from leakage.uncertainty import ClusterRobust, Interval, block_bootstrap, cluster_robust
from leakage.validation import Agreement, Criteria, agreement, criteria, effective_sample_count
from leakage.walther import kinematic_viscosity_mm2_per_s, walther_coefficients

__all__ = [
    "Agreement",
    "AnnularGap",
    "BlockStatistics",
    "Certificate",
    "ChannelTolerance",
    "ClusterRobust",
    "Constant",
    "Criteria",
    "CurveError",
    "ErrorBudget",
    "EstimationError",
    "Excitation",
    "FilmPressure",
    "Fit",
    "Identification",
    "Interval",
    "Judgement",
    "LagTest",
    "Laminar",
    "LeakageError",
    "LeakageJudgement",
    "LeakagePath",
    "Motor",
    "Oil",
    "OperatingConditions",
    "Parameter",
    "ParameterError",
    "Parametrisation",
    "ResidualAnalysis",
    "SearchSettings",
    "ShapeError",
    "SpeedCurve",
    "Start",
    "StatisticsError",
    "Tolerances",
    "ValidityError",
    "agreement",
    "analyse_residuals",
    "autocorrelation",
    "block_bootstrap",
    "certify",
    "cluster_robust",
    "column_means",
    "correlation_time",
    "criteria",
    "criterion",
    "density_kg_per_m3",
    "dynamic_viscosity_pa_s",
    "effective_sample_count",
    "error_budget",
    "factor",
    "factors",
    "film_thickness_ratio",
    "fit",
    "fit_deformation_pressure",
    "fit_speed_curve",
    "flow_summary",
    "gap_plausibility",
    "gradient",
    "huber_weights",
    "identify",
    "judge_leakage",
    "kinematic_viscosity_mm2_per_s",
    "leakage_l_per_min",
    "lubrication_regimes",
    "merge",
    "merge_blocks",
    "normal_matrix",
    "path_flows_l_per_min",
    "pressure_of_largest_leakage_pa",
    "regressors",
    "sample_count",
    "speed_beyond_curve",
    "total_flow_l_per_min",
    "walther_coefficients",
]
