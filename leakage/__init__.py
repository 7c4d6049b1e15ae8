"""Grey-box model of the leakage of radial piston hydraulic motors, on NumPy arrays.

The names on top are those for everyday use; the rest is in the modules.
"""

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


def __getattr__(name: str) -> Any:
    if name not in _LATE:
        raise AttributeError(f"module 'leakage' has no attribute {name!r}")
    return getattr(import_module(f"leakage.{_LATE[name]}"), name)
