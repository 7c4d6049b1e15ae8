"""Grey-box model of the leakage of radial piston hydraulic motors, on NumPy arrays.

The names on top are those for everyday use; the rest is in the modules.
"""

from leakage.annular_gap import AnnularGap
from leakage.conditions import OperatingConditions
from leakage.errors import EstimationError, LeakageError
from leakage.frame_fit import FrameFit, fit_frame
from leakage.law import Parameter
from leakage.motor import Motor, leakage_l_per_min, regressors, total_flow_l_per_min
from leakage.oil import FilmPressure, Oil
from leakage.paths import Constant, Laminar
from leakage.sensitivities import ChannelTolerance, Tolerances
from leakage.speed_curve import SpeedCurve

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
