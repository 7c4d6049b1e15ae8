"""Nights that have no fit, and what they say instead."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pipeline.config import MotorSpec
from pipeline.schema.fits import FAILED, INSUFFICIENT_DATA, STOOD_STILL
from tests.pipeline.night.noise_free import fit, simulate
from tests.pipeline.simulated import Array, operate, with_channel

MOVING = operate()
N = len(MOVING.time_us)
PLACE = np.arange(N)
LIMITS: dict[str, dict[str, Any]] = {
    "leakage_flow": {"sensor_maximum": 0.5},
    "oil_temperature": {"valid_range": (0.0, 1000.0)},
}


@pytest.mark.parametrize(
    ("limited", "changed", "outcome", "words"),
    [
        pytest.param(
            "", {"speed": 0.1 + 1e-3 * np.sin(MOVING.pressure_bar)},
            STOOD_STILL, ["the motor stood still all night"], id="stood still",
        ),
        pytest.param(
            "leakage_flow", {"speed": np.where(PLACE < 60, 0.0, MOVING.speed_rpm)},
            INSUFFICIENT_DATA, ["leakage_flow at_maximum"], id="a sensor at its maximum",
        ),
        pytest.param(
            "", {"oil_temperature": np.empty(0)},
            INSUFFICIENT_DATA, ["no samples of oil_temperature"], id="a sensor without a sample",
        ),
        pytest.param(
            "", {"oil_temperature": np.where(PLACE % 1000 < 500, 850.0, MOVING.temperature_c)},
            INSUFFICIENT_DATA, ["oil_temperature out_of_range", "60 % are needed"],
            id="too much refused",
        ),
        pytest.param(
            "oil_temperature", {"oil_temperature": MOVING.temperature_c + 600.0},
            FAILED, ["outside ASTM D341"], id="beyond Walther",
        ),
    ],
)  # fmt: skip
def test_a_night_without_a_fit_has_one_row_that_says_why(
    spec: MotorSpec, limited: str, changed: dict[str, Array], outcome: str, words: list[str]
) -> None:
    spec = with_channel(spec, limited, **LIMITS[limited]) if limited else spec
    found = fit(spec, MOVING, simulate(spec, MOVING) | changed)
    check_unfitted(found, outcome, words)
    assert (found.error_code is None) == (outcome != FAILED)
    assert ("quality" in found.rows) == all(len(values) for values in changed.values())


@pytest.mark.parametrize(("minutes", "is_enough"), [(5.0, False), (5.1, True)])
def test_five_minutes_of_training_are_needed(
    spec: MotorSpec, minutes: float, is_enough: bool
) -> None:
    """Blocks that begin in the first four fifths train: two of 2 minutes, or all three."""
    short = operate(minutes=minutes)
    found = fit(spec, short, simulate(spec, short))
    if is_enough:
        assert found.status == "ok"
    else:
        check_unfitted(found, INSUFFICIENT_DATA, ["4.0 minutes", "5 are needed"])


def check_unfitted(found: Any, outcome: str, words: list[str]) -> None:
    """One primary row in `fits`, with a reason and neither a window nor any figure."""
    assert (found.status, found.model) == (outcome, {})
    (row,) = found.rows["fits"]
    assert (row["is_primary"], row["status"]) == (True, outcome)
    assert row["reason"] == found.reason
    assert all(one in row["reason"] for one in words), row["reason"]
    assert row["error_code"] == found.error_code
    assert row.get("window_start") is None
    assert row.get("reference_leakage_l_per_min") is None
    assert not found.rows.keys() & {"parameters", "starts", "predictions"}
