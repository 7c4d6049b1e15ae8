"""Transport delay between the motor and the sensors of its drain line, equation (14).

In a full line a change of flow arrives at the speed of sound and only the oil's temperature is
carried along; the thesis delays the drain flow as a whole, and so do lines that are not full, and
meters that average. So a delay of the flow is estimated from the motor's first nights, or stated.
"""

from __future__ import annotations

from math import pi

import numpy as np

from pipeline.arrays import Mask, Values
from pipeline.config import TransportDelay
from pipeline.config.settings import MAXIMUM_DELAY_S

L_PER_MIN_PER_M3_PER_S = 60_000.0
DELAYED = ("pressure_difference", "oil_temperature", "speed")
# Averaging time of the drain flow that the delay is taken from.
FLOW_AVERAGE_S = 10.0


def drain_line_delay_s(
    flow_l_per_min: Values, line_length_m: float, line_inner_diameter_mm: float
) -> Values:
    """Return time that oil takes through the drain line.

    .. math:: \\tau(t) = \\frac{L}{v(t)}, \\qquad v = \\frac{y}{\\pi d^2 / 4}

    Infinite without flow, nan where the flow is.

    References
    ----------
    .. [1] N. Ydebäck, *Grey Box Model of Leakage in Radial Piston Hydraulic Motors*, Luleå
       University of Technology, 2021, equation (14).
    """
    area_m2 = pi * (line_inner_diameter_mm / 1000.0) ** 2 / 4.0
    velocity = flow_l_per_min / L_PER_MIN_PER_M3_PER_S / area_m2
    delay = np.full(len(flow_l_per_min), np.inf)
    np.divide(line_length_m, velocity, out=delay, where=velocity > 0)
    delay[np.isnan(velocity)] = np.nan
    return delay


def delay_on_grid_s(
    flow_l_per_min: Values, present: Mask, period_s: float, settings: TransportDelay
) -> Values:
    """Return τ at each sample, shape (n,) [s], by an average: a pulse meter's readings may be 0."""
    if settings.fixed_s is not None:
        return np.full(len(flow_l_per_min), settings.fixed_s)
    if settings.line_length_m is None or settings.line_inner_diameter_mm is None:
        raise ValueError("a delay by the flow needs the line's length and diameter")
    half = round(FLOW_AVERAGE_S / period_s) // 2
    row = np.arange(len(flow_l_per_min))
    first, last = np.maximum(row - half, 0), np.minimum(row + half + 1, len(row))
    total = np.concatenate([[0.0], np.cumsum(np.where(present, flow_l_per_min, 0.0))])
    count = np.concatenate([[0], np.cumsum(present)])
    average = np.full(len(row), np.nan)
    n = count[last] - count[first]
    np.divide(total[last] - total[first], n, out=average, where=present & (n > 0))
    return drain_line_delay_s(average, settings.line_length_m, settings.line_inner_diameter_mm)


def shifted(value: Values, present: Mask, steps: Values) -> tuple[Values, Mask]:
    """Return a channel of the time base whose element i is its value at i + steps[i]."""
    known = np.isfinite(steps)
    place = np.arange(len(value)) + np.where(known, steps, 0.0)
    left = np.floor(place)
    share = place - left
    right = left + (share > 0)
    known &= (left >= 0) & (right < len(value))
    left_row = np.where(known, left, 0).astype(np.int64)
    right_row = np.where(known, right, 0).astype(np.int64)
    known &= present[left_row] & present[right_row]
    result = value[left_row] + share * (value[right_row] - value[left_row])
    return np.where(known, result, np.nan), known


def delay_inputs(
    values: dict[str, Values],
    present: dict[str, Mask],
    period_s: float,
    settings: TransportDelay,
) -> tuple[dict[str, Values], dict[str, Mask], Mask, Values]:
    """Pair the drain flow y(t) with inputs at t − τ(t)."""
    tau = delay_on_grid_s(values["leakage_flow"], present["leakage_flow"], period_s, settings)
    refused = ~(tau <= MAXIMUM_DELAY_S)
    usable = np.where(refused, np.nan, tau)
    new_values, new_present = dict(values), dict(present)
    for name in DELAYED:
        new_values[name], new_present[name] = shifted(
            values[name], present[name], -usable / period_s
        )
    return new_values, new_present, refused, tau
