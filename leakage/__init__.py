"""Grey-box model of the leakage of radial piston hydraulic motors, on NumPy arrays.

The names on top are those for everyday use; the rest is in the rooms, from the bottom up:
`physics` (oil, leakage paths, the motor), `estimation` (a night's coefficients, intervals and
validation), `course` (a motor over its nights), `frame` (a data frame in a notebook).
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from leakage.errors import EstimationError, LeakageError
from leakage.physics.annular_gap import AnnularGap
from leakage.physics.conditions import OperatingConditions
from leakage.physics.motor import Motor, leakage_l_per_min, regressors, total_flow_l_per_min
from leakage.physics.oil import FilmPressure, Oil
from leakage.physics.paths import Constant, Laminar, Parameter, SpeedCurve

if TYPE_CHECKING:
    from leakage.estimation.sensitivities import ChannelTolerance, Tolerances
    from leakage.frame.fit import fit_frame
    from leakage.frame.result import FrameFit

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
    "ChannelTolerance": "estimation.sensitivities",
    "FrameFit": "frame.result",
    "Tolerances": "estimation.sensitivities",
    "fit_frame": "frame.fit",
}


def __getattr__(name: str) -> Any:
    if name not in _LATE:
        raise AttributeError(f"module 'leakage' has no attribute {name!r}")
    return getattr(import_module(f"leakage.{_LATE[name]}"), name)
