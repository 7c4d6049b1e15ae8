"""Grey-box model of the leakage of radial piston hydraulic motors, on NumPy arrays."""

from leakage.alarms import Levels, Limits, State, StateChange
from leakage.annular_gap import AnnularGap
from leakage.baseline import Baseline, BaselineSettings, fit_baseline
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
    with_free_known,
)
from leakage.certificate import Certificate, certify
from leakage.change_points import Changes, Step, find_changes
from leakage.conditions import OperatingConditions
from leakage.correlation import autocorrelation, correlation_time
from leakage.cusum import Cusum, cusum_limit
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
from leakage.frame_fit import FrameFit, fit_frame
from leakage.identifiability import (
    Excitation,
    Identification,
    Judgement,
    LeakageJudgement,
    identify,
    judge_leakage,
)
from leakage.law import Parameter
from leakage.monitoring import (
    ChangeSize,
    Monitoring,
    MonitorSettings,
    Track,
    change_size,
    monitor,
    track,
)
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
from leakage.peers import PeerDeviations, peer_deviations
from leakage.pressure_maximum import pressure_of_largest_leakage_pa
from leakage.residual_analysis import LagTest, ResidualAnalysis, analyse_residuals
from leakage.robust import huber_weights
from leakage.sensitivities import ChannelTolerance, ErrorBudget, Tolerances, error_budget
from leakage.sensor_zero import HaltZero, ZeroDrift, halt_zero, zero_drift
from leakage.simulated_curves import fit_deformation_pressure, fit_speed_curve
from leakage.slope import Slope, benjamini_hochberg, fit_slope, theil_sen
from leakage.slow_errors import ShortBlocks, SlowErrors, short_blocks, slow_errors, whitened
from leakage.speed_curve import SpeedCurve
from leakage.time_to_limit import TimeToLimit, time_to_limit
from leakage.uncertainty import ClusterRobust, Interval, block_bootstrap, cluster_robust
from leakage.validation import Agreement, Criteria, agreement, criteria, effective_sample_count
from leakage.walther import kinematic_viscosity_mm2_per_s, walther_coefficients

__all__ = [
    "Agreement",
    "AnnularGap",
    "Baseline",
    "BaselineSettings",
    "BlockStatistics",
    "Certificate",
    "ChangeSize",
    "Changes",
    "ChannelTolerance",
    "ClusterRobust",
    "Constant",
    "Criteria",
    "CurveError",
    "Cusum",
    "ErrorBudget",
    "EstimationError",
    "Excitation",
    "FilmPressure",
    "Fit",
    "FrameFit",
    "HaltZero",
    "Identification",
    "Interval",
    "Judgement",
    "LagTest",
    "Laminar",
    "LeakageError",
    "LeakageJudgement",
    "LeakagePath",
    "Levels",
    "Limits",
    "MonitorSettings",
    "Monitoring",
    "Motor",
    "Oil",
    "OperatingConditions",
    "Parameter",
    "ParameterError",
    "Parametrisation",
    "PeerDeviations",
    "ResidualAnalysis",
    "SearchSettings",
    "ShapeError",
    "ShortBlocks",
    "Slope",
    "SlowErrors",
    "SpeedCurve",
    "Start",
    "State",
    "StateChange",
    "StatisticsError",
    "Step",
    "TimeToLimit",
    "Tolerances",
    "Track",
    "ValidityError",
    "ZeroDrift",
    "agreement",
    "analyse_residuals",
    "autocorrelation",
    "benjamini_hochberg",
    "block_bootstrap",
    "certify",
    "change_size",
    "cluster_robust",
    "column_means",
    "correlation_time",
    "criteria",
    "criterion",
    "cusum_limit",
    "density_kg_per_m3",
    "dynamic_viscosity_pa_s",
    "effective_sample_count",
    "error_budget",
    "factor",
    "factors",
    "film_thickness_ratio",
    "find_changes",
    "fit",
    "fit_baseline",
    "fit_deformation_pressure",
    "fit_frame",
    "fit_slope",
    "fit_speed_curve",
    "flow_summary",
    "gap_plausibility",
    "gradient",
    "halt_zero",
    "huber_weights",
    "identify",
    "judge_leakage",
    "kinematic_viscosity_mm2_per_s",
    "leakage_l_per_min",
    "lubrication_regimes",
    "merge",
    "merge_blocks",
    "monitor",
    "normal_matrix",
    "path_flows_l_per_min",
    "peer_deviations",
    "pressure_of_largest_leakage_pa",
    "regressors",
    "sample_count",
    "short_blocks",
    "slow_errors",
    "speed_beyond_curve",
    "theil_sen",
    "time_to_limit",
    "total_flow_l_per_min",
    "track",
    "walther_coefficients",
    "whitened",
    "with_free_known",
    "zero_drift",
]
