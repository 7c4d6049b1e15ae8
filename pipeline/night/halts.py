"""Depressurised, settled halts: the only time at which a sensor's zero shows.

Without pressure nothing leaks, and the drain flow is the flushing alone. Equal pressures on both
ports leak to the case: the flow's zero shows only where they are known to be near case pressure.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import SECOND_US, Mask, Times, Values
from pipeline.config import SensorHealth
from pipeline.night.cleaning import CleanChannel
from pipeline.night.masks import stretches

# Channels of the low side, and of the case.
LOW_SIDE, CASE = ("low_port_pressure", "charge_pressure"), "case_pressure"
# Time left out after the motor has stopped, and credible samples that a halt needs after that.
SETTLE_US, MINIMUM_US = 45 * SECOND_US, 20 * SECOND_US
# |Pressure difference| of a halt that shows its zero; |low side over case| for the flow's.
DEPRESSURISED_BELOW_BAR = 5.0


@dataclass(frozen=True, slots=True)
class Zero:
    """Reading of a sensor while there is nothing to measure."""

    value: float  # median over the halts of each halt's median, in the channel's unit
    standard_error: float | None  # from the scatter between halts; None for fewer than three


def zeros_of_halts(
    standstill: Mask,
    grid_us: Times,
    channels: Mapping[str, CleanChannel],
    settings: SensorHealth,
) -> tuple[Zero | None, Zero | None]:
    """Return the zeros of the pressure difference and the drain flow; None where no halt shows it.

    Samples refused as frozen count: a sensor that has nothing to measure may well not move.
    """
    sides = {"pressure_difference": 1.0}
    if "high_port_pressure" in channels:
        sides = {"high_port_pressure": 1.0, "low_port_pressure": -1.0}
    pressures: list[float] = []
    flows: list[float] = []
    begins, ends = stretches(standstill)
    for first, last in zip(grid_us[begins].tolist(), grid_us[ends - 1].tolist(), strict=True):
        begin, end = first + SETTLE_US, last
        if end - begin < MINIMUM_US:
            continue
        flow = _readings(channels["leakage_flow"], begin, end)
        ports = [(sign, _readings(channels[name], begin, end)) for name, sign in sides.items()]
        if not len(flow) or not all(len(port) for _, port in ports):
            continue
        if any(np.ptp(port) > DEPRESSURISED_BELOW_BAR for _, port in ports):
            continue
        bar = sum(sign * float(np.median(port)) for sign, port in ports)
        if abs(bar) <= DEPRESSURISED_BELOW_BAR:
            pressures.append(bar)
            if _is_relieved(channels, (begin, end), settings):
                flows.append(float(np.median(flow)))
    return _zero(pressures), _zero(flows)


def _is_relieved(
    channels: Mapping[str, CleanChannel], halt: tuple[int, int], settings: SensorHealth
) -> bool:
    """Return True if the low side is known to be near case pressure, and the other port with it."""
    low = next((name for name in LOW_SIDE if name in channels), None)
    if settings.without_pressure_at_halts or low is None:
        return settings.without_pressure_at_halts
    port = _readings(channels[low], *halt)
    case = _readings(channels[CASE], *halt) if CASE in channels else np.zeros(1)
    if not len(port) or not len(case):
        return False
    return bool(abs(np.median(port) - np.median(case)) <= DEPRESSURISED_BELOW_BAR)


def _readings(channel: CleanChannel, begin_us: int, end_us: int) -> Values:
    """Return readings in a stretch, below the sensor's maximum; none where it is too short."""
    first, last = np.searchsorted(channel.time_us, [begin_us, end_us])
    value, saturated = channel.value[first:last], channel.at_maximum[first:last]
    readings: Values = value[np.isfinite(value) & ~saturated]
    enough = len(readings) * (end_us - begin_us) >= MINIMUM_US * len(value)
    return readings if enough else readings[:0]


def _zero(halts: Sequence[float]) -> Zero | None:
    """Return zero of some halts; None where there is none."""
    if not halts:
        return None
    error = None if len(halts) < 3 else float(np.std(halts, ddof=1) / np.sqrt(len(halts)))
    return Zero(float(np.median(halts)), error)
