"""A path of each law, with values of the model."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import strategies as st
from numpy.typing import NDArray

from leakage.physics.paths import Constant, Laminar, LeakagePath, Parameter
from tests.leakage.placeholders import balance_piston, balance_sleeve, cam_roller, piston_ring

COEFFICIENTS_M3 = st.floats(1e-18, 1e-10)
DISTRIBUTOR = Laminar("d", 2, Parameter("C_d", "m3", 1e-15, 0.0, 1e-13))
FLUSHING = Constant("f", Parameter("C_f", "l_per_min", 4.0, 0.0, 20.0))
FAMILY: tuple[LeakagePath, ...] = (
    piston_ring(),
    balance_piston(),
    balance_sleeve(),
    cam_roller(free=True),
    DISTRIBUTOR,
    FLUSHING,
)
EACH_LAW = pytest.mark.parametrize("path", FAMILY, ids=[path.name for path in FAMILY])


def vector(*values: float) -> NDArray[np.float64]:
    return np.array(values, dtype=np.float64)
