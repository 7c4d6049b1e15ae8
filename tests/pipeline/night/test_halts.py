"""Zeros of the sensors at depressurised, settled halts, in made-up signals of known zeros."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline.arrays import SECOND_US
from pipeline.config import SensorHealth
from pipeline.night.cleaning import CleanChannel
from pipeline.night.halts import Halts, settled_halts
from tests.pipeline.night.channels import cleaned

Array = NDArray[np.float64]

N = 6000
GRID = np.arange(N, dtype=np.int64) * SECOND_US
# Left out after the motor has stopped, and needed after that [s]: the defaults.
SETTLE, NEEDED = 45, 20
ZERO_BAR, ZERO_FLOW = 0.7, 0.03


def channel(values: Array, at_maximum: object = False) -> CleanChannel:
    """A cleaned channel of one sample a second."""
    period = {"period_us": SECOND_US, "longest_gap_us": 5.0 * SECOND_US}
    return cleaned(GRID, values, at_maximum=at_maximum, **period)


def night(*halts: tuple[int, int]) -> tuple[NDArray[np.bool_], Array, Array]:
    """Standstill, pressure and flow of a motor that runs but in these halts."""
    still = np.zeros(N, dtype=np.bool_)
    for first, end in halts:
        still[first:end] = True
    generator = np.random.default_rng(1)
    bar = np.where(still, ZERO_BAR, 180.0) + 0.05 * generator.standard_normal(N)
    flow = np.where(still, ZERO_FLOW, 1.4) + 0.002 * generator.standard_normal(N)
    return still, bar, flow


def found(still: NDArray[np.bool_], bar: Array, flow: Array, **more: CleanChannel) -> Halts:
    channels = {"pressure_difference": channel(bar), "leakage_flow": channel(flow)} | more
    return settled_halts(still, GRID, channels, SensorHealth())


THREE = ((500, 700), (2000, 2300), (4000, 4200))


def test_the_zeros_are_those_that_were_put_in() -> None:
    seen = found(*night(*THREE))
    assert seen.n == 3
    for zero, truth, sd in (
        (seen.pressure_bar, ZERO_BAR, 0.05),
        (seen.flow_l_per_min, ZERO_FLOW, 0.002),
    ):
        assert zero is not None
        assert zero.value == pytest.approx(truth, abs=sd)
        # From the scatter of three medians of 155 samples and more each.
        assert zero.standard_error is not None
        assert 0 < zero.standard_error < sd / 4


@pytest.mark.parametrize(
    ("disturbed", "is_at_maximum", "n"),
    [
        pytest.param([*range(500, 540), *range(2000, 2040)], False, 3, id="the oil still drains"),
        # Back-flow drives the sensor to it; ten seconds are left of the halt: less than it takes.
        pytest.param([*range(2000, 2290)], True, 2, id="a sensor at its maximum"),
    ],
)
def test_readings_that_are_no_zero_are_left_out(
    disturbed: list[int], is_at_maximum: bool, n: int
) -> None:
    still, bar, flow = night(*THREE)
    flow[disturbed] = 20.0
    stuck = is_at_maximum & np.isin(np.arange(N), disturbed)
    seen = found(still, bar, flow, leakage_flow=channel(flow, stuck))
    assert seen.n == n
    assert seen.flow_l_per_min is not None
    assert seen.flow_l_per_min.value == pytest.approx(ZERO_FLOW, abs=0.001)


def test_a_halt_that_is_too_short_tells_nothing() -> None:
    just_too_short = SETTLE + NEEDED
    assert found(*night((500, 500 + just_too_short))).n == 0
    assert found(*night((500, 500 + just_too_short + 1))).n == 1


def test_two_ports_at_charge_pressure_have_a_difference_of_zero() -> None:
    still, _, flow = night(*THREE)
    high, low = np.where(still, 15.4, 200.0), np.full(N, 15.0)
    channels = {
        "high_port_pressure": channel(high),
        "low_port_pressure": channel(low),
        "leakage_flow": channel(flow),
    }
    seen = settled_halts(still, GRID, channels, SensorHealth())
    assert seen.n == 3
    assert seen.pressure_bar is not None
    assert seen.pressure_bar.value == pytest.approx(0.4)
