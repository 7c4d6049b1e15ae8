"""Grey-box model of the leakage of radial piston hydraulic motors, on NumPy arrays.

The names on top are those for everyday use; the rest is in the modules. Other names that were on
top before the first release still work, with a warning that says where they are.
"""

import warnings
from importlib import import_module
from typing import TYPE_CHECKING, Any

from leakage.annular_gap import AnnularGap
from leakage.conditions import OperatingConditions
from leakage.errors import EstimationError, LeakageError
from leakage.law import Parameter
from leakage.motor import Motor, leakage_l_per_min, regressors, total_flow_l_per_min
from leakage.oil import FilmPressure, Oil
from leakage.paths import Constant, Laminar
from leakage.speed_curve import SpeedCurve

if TYPE_CHECKING:
    from leakage.frame_fit import fit_frame
    from leakage.frame_result import FrameFit
    from leakage.sensitivities import ChannelTolerance, Tolerances

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

# Modules that bring SciPy, or libraries of data frames: loaded with the first use of a name.
_LATE = {
    "ChannelTolerance": "sensitivities",
    "FrameFit": "frame_result",
    "Tolerances": "sensitivities",
    "fit_frame": "frame_fit",
}

# Names that were on top, by module. `slow_errors` and `time_to_limit` now name the modules.
_MOVED = {
    name: module
    for module, names in {
        "alarms": "Levels Limits State StateChange",
        "baseline": "Baseline BaselineSettings fit_baseline",
        "block_statistics": "column_means criterion factor factors flow_summary "
        "gradient merge sample_count with_free_known",
        "certificate": "Certificate certify",
        "change_points": "Changes Step find_changes",
        "correlation": "autocorrelation correlation_time",
        "cusum": "Cusum cusum_limit",
        "errors": "CurveError ParameterError ShapeError StatisticsError ValidityError",
        "estimation": "Fit fit",
        "film": "film_thickness_ratio",
        "identifiability": "Excitation Identification Judgement LeakageJudgement identify "
        "judge_leakage",
        "monitoring": "ChangeSize Monitoring MonitorSettings Track change_size monitor track",
        "motor": "path_flows_l_per_min speed_beyond_curve",
        "multi_start": "Parametrisation SearchSettings Start",
        "oil": "density_kg_per_m3 dynamic_viscosity_pa_s",
        "paths": "LeakagePath",
        "pressure_maximum": "pressure_of_largest_leakage_pa",
        "residual_analysis": "LagTest ResidualAnalysis analyse_residuals",
        "robust": "huber_weights",
        "sensitivities": "ErrorBudget error_budget",
        "simulated_curves": "fit_deformation_pressure fit_speed_curve",
        "slope": "Slope benjamini_hochberg fit_slope theil_sen",
        "slow_errors": "ShortBlocks SlowErrors short_blocks whitened",
        "time_to_limit": "TimeToLimit",
        "uncertainty": "ClusterRobust Interval block_bootstrap cluster_robust",
        "validation": "Agreement Criteria agreement criteria effective_sample_count",
        "walther": "kinematic_viscosity_mm2_per_s walther_coefficients",
    }.items()
    for name in names.split()
}


def __getattr__(name: str) -> Any:
    if name in _LATE:
        return getattr(import_module(f"leakage.{_LATE[name]}"), name)
    if name not in _MOVED:
        raise AttributeError(f"module 'leakage' has no attribute {name!r}")
    place = f"leakage.{_MOVED[name]}"
    warnings.warn(
        f"leakage.{name} is deprecated: import it from {place}", DeprecationWarning, stacklevel=2
    )
    return getattr(import_module(place), name)
