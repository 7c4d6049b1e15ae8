"""Motors for the search, with fewer or more free parameters."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import strategies as st

from leakage.physics.motor import Motor
from leakage.physics.paths import Parameter
from tests.leakage.placeholders import balance_piston, placeholder_motor

PLAIN = placeholder_motor()
FLUSHED = placeholder_motor(flushing="estimated", flushing_l_per_min=4.0)
EVERYTHING_FREE = placeholder_motor(
    flushing="estimated", flushing_l_per_min=4.0, roller_is_free=True
)
MOTORS = pytest.mark.parametrize(
    "motor", [PLAIN, FLUSHED, EVERYTHING_FREE], ids=["plain", "flushed", "everything free"]
)
SEEDS = st.integers(0, 10_000)


def with_piston(motor: Motor, height: Parameter, offset: Parameter) -> Motor:
    """The motor with other parameters of the balance piston."""
    piston = replace(balance_piston(), gap=height, eccentricity=offset)
    return replace(motor, paths=(motor.paths[0], piston, *motor.paths[2:]))
