"""Grey-box model of the leakage of radial piston hydraulic motors, on NumPy arrays.

The names on top are those for everyday use; the rest is in the modules. Names that were on top in
version 0.1 still work, with a warning that says where they are; `slow_errors` and `time_to_limit`,
which their modules are called by, too, without one.
"""

import warnings
from importlib import import_module
from typing import Any

from leakage.annular_gap import AnnularGap
from leakage.conditions import OperatingConditions
from leakage.errors import EstimationError, LeakageError
from leakage.frame_fit import fit_frame
from leakage.frame_result import FrameFit
from leakage.law import Parameter
from leakage.motor import Motor, leakage_l_per_min, regressors, total_flow_l_per_min
from leakage.oil import FilmPressure, Oil
from leakage.paths import Constant, Laminar
from leakage.sensitivities import ChannelTolerance, Tolerances
from leakage.slow_errors import slow_errors as slow_errors
from leakage.speed_curve import SpeedCurve
from leakage.time_to_limit import time_to_limit as time_to_limit

__all__ = [
    "AnnularGap",
    "ChannelTolerance",
    "Constant",
    "EstimationError",
    "FilmPressure",
    "FrameFit",
    "Laminar",
    "LeakageError",
    "Motor",
    "Oil",
    "OperatingConditions",
    "Parameter",
    "SpeedCurve",
    "Tolerances",
    "fit_frame",
    "leakage_l_per_min",
    "regressors",
    "total_flow_l_per_min",
]

# Names that were on top, by module.
_MOVED = {
    "alarms": "Levels Limits State StateChange",
    "baseline": "Baseline BaselineSettings fit_baseline",
    "block_statistics": "BlockStatistics column_means criterion factor factors flow_summary "
    "gradient merge merge_blocks normal_matrix sample_count with_free_known",
    "certificate": "Certificate certify",
    "change_points": "Changes Step find_changes",
    "correlation": "autocorrelation correlation_time",
    "cusum": "Cusum cusum_limit",
    "errors": "CurveError ParameterError ShapeError StatisticsError ValidityError",
    "estimation": "Fit fit",
    "film": "film_thickness_ratio gap_plausibility lubrication_regimes",
    "identifiability": "Excitation Identification Judgement LeakageJudgement "
    "identify judge_leakage",
    "monitoring": "ChangeSize Monitoring MonitorSettings Track change_size monitor track",
    "motor": "path_flows_l_per_min speed_beyond_curve",
    "multi_start": "Parametrisation SearchSettings Start",
    "oil": "density_kg_per_m3 dynamic_viscosity_pa_s",
    "paths": "LeakagePath",
    "peers": "PeerDeviations peer_deviations",
    "pressure_maximum": "pressure_of_largest_leakage_pa",
    "residual_analysis": "LagTest ResidualAnalysis analyse_residuals",
    "robust": "huber_weights",
    "sensitivities": "ErrorBudget error_budget",
    "sensor_zero": "HaltZero ZeroDrift halt_zero zero_drift",
    "simulated_curves": "fit_deformation_pressure fit_speed_curve",
    "slope": "Slope benjamini_hochberg fit_slope theil_sen",
    "slow_errors": "ShortBlocks SlowErrors short_blocks whitened",
    "time_to_limit": "TimeToLimit",
    "uncertainty": "ClusterRobust Interval block_bootstrap cluster_robust",
    "validation": "Agreement Criteria agreement criteria effective_sample_count",
    "walther": "kinematic_viscosity_mm2_per_s walther_coefficients",
}


def __getattr__(name: str) -> Any:
    for module, names in _MOVED.items():
        if name in names.split():
            warnings.warn(
                f"leakage.{name} is deprecated: import it from leakage.{module}",
                DeprecationWarning,
                stacklevel=2,
            )
            return getattr(import_module(f"leakage.{module}"), name)
    raise AttributeError(f"module 'leakage' has no attribute {name!r}")
