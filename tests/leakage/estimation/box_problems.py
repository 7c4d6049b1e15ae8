"""Problems of least squares in a box."""

from __future__ import annotations

import numpy as np

from leakage.estimation.block_statistics import Array
from tests.leakage.placeholders import placeholder_motor

MOTOR = placeholder_motor(flushing="estimated", flushing_l_per_min=2.0)
LOWER, UPPER = MOTOR.coefficient_bounds()


def column_norms(z: Array) -> Array:
    norms = np.linalg.norm(z[:, :-2], axis=0)
    return np.where(norms > 0, norms, 1.0)
