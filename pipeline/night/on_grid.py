"""A channel on an even grid of times, and the drain flow paired with inputs before it.

In a full line a change of flow arrives at the speed of sound and only the oil's temperature is
carried along; the thesis delays the drain flow as a whole, and so do lines that are not full, and
meters that average. So a delay of the flow is estimated from the motor's first nights, or stated.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Mask, Times, Values
from pipeline.config import TransportDelay
from pipeline.config.settings import MAXIMUM_DELAY_S
from pipeline.night.cleaning import CleanChannel

# A channel with more than this many samples a cell of the grid is averaged, not interpolated.
AVERAGE_ABOVE = 1.5
# Share of a cell's samples that must be kept for its average.
CELL_SHARE = 0.5
# Samples in equal steps are filled in without a search where stretches of them are this long.
EVEN_SAMPLES = 64
# A mean stands for this share of its period on either side; half, and some for jitter.
MEAN_REACH = 0.6
DELAYED = ("pressure_difference", "oil_temperature", "speed")
# Averaging time of the drain flow that the delay is taken from.
FLOW_AVERAGE_S = 10.0


class OnGrid(NamedTuple):
    """A channel on the time base: values, where it has any, and where it is silent; (n,) each."""

    value: Values
    present: Mask
    silent: Mask


def on_grid(channel: CleanChannel, grid_us: Times, period_us: int) -> OnGrid:
    """Return a channel on an even grid."""
    n = len(grid_us)
    if not n or not len(channel.time_us):
        return OnGrid(np.full(n, np.nan), np.zeros(n, np.bool_), np.ones(n, np.bool_))
    if channel.rules.hold:
        return _held(channel, grid_us)
    if channel.rules.mean_us > 0:
        return _mean_of_its_period(channel, grid_us)
    on_change = channel.rules.on_change
    if channel.period_us and not on_change and channel.period_us * AVERAGE_ABOVE < period_us:
        return _average(channel, grid_us, period_us)
    return _interpolate(channel, grid_us, period_us)


# A refused value may be infinite.
@np.errstate(over="ignore", invalid="ignore")
def _interpolate(channel: CleanChannel, grid_us: Times, period_us: int) -> OnGrid:
    """Return samples as they are at their own times lines between them; not beside refused ones."""
    time = channel.time_us
    # A zero has no sign here, at samples as between them.
    known = channel.value + 0.0
    known[channel.refused] = np.nan
    value = np.full(len(grid_us), np.nan)
    _fill_even(value, channel, known, int(grid_us[0]), period_us)
    others = np.flatnonzero(np.isnan(value))
    rows: NDArray[np.intp] | slice = slice(None)
    if len(others) < len(value) // EVEN_SAMPLES:
        # The samples around them will do, and not all are converted; one where there are none.
        after = time.searchsorted(grid_us[others])
        rows = np.unique(np.concatenate([[0], after - 1, after]).clip(0, len(time) - 1))
    value[others] = np.interp(grid_us[others], time[rows], known[rows], left=np.nan, right=np.nan)
    # Before the first sample, within gaps between two, and after the last it is silent.
    gaps = channel.gaps
    if channel.ends is not None:
        gaps = np.union1d(gaps, np.flatnonzero(channel.ends[:-1]))
    begins = [0, *grid_us.searchsorted([*time[gaps], time[-1]], "right").tolist()]
    ends = [*grid_us.searchsorted([time[0], *time[gaps + 1]]).tolist(), len(grid_us)]
    silent = np.zeros(len(grid_us), np.bool_)
    for begin, end in zip(begins, ends, strict=True):
        value[begin:end], silent[begin:end] = np.nan, True
    return OnGrid(value, np.isfinite(value), silent)


def _fill_even(
    value: Values, channel: CleanChannel, known: Values, grid_start_us: int, period_us: int
) -> None:
    """Fill in samples in equal steps: the same values as by a search, in a fraction of the time."""
    time, step_us = channel.time_us, int(channel.period_us or 0)
    apart = step_us // period_us
    edges = channel.steps.uneven
    if not apart or step_us % period_us or len(edges) > len(time) // EVEN_SAMPLES:
        return
    for before, last in zip([-1, *edges.tolist()], [*edges.tolist(), len(time) - 1], strict=True):
        place, beside = divmod(int(time[before + 1]) - grid_start_us, period_us)
        first = before + 1 + max(-(place // apart), 0)
        place += (first - before - 1) * apart
        n = min(last - first, (len(value) - 1 - place) // apart)
        if beside or n < 0:
            continue
        sample = known[first : first + n + 1]
        if apart > 1:
            lines = value[place : place + n * apart].reshape(n, apart)
            np.multiply(np.diff(sample)[:, None] / step_us, np.arange(apart) * period_us, out=lines)
            lines += sample[:-1, None]
        value[place : place + n * apart + 1 : apart] = sample


def _held(channel: CleanChannel, grid_us: Times) -> OnGrid:
    """Return last sample, within the longest silence; none after a refused sample."""
    last = np.searchsorted(channel.time_us, grid_us, side="right") - 1
    known, last = last >= 0, np.maximum(last, 0)
    silent = ~known | (grid_us - channel.time_us[last] > channel.longest_gap_us)
    if channel.ends is not None:
        silent |= channel.ends[last] & (channel.time_us[last] < grid_us)
    present = ~silent & ~channel.refused[last]
    return OnGrid(np.where(present, channel.value[last], np.nan), present, silent)


def _mean_of_its_period(channel: CleanChannel, grid_us: Times) -> OnGrid:
    """Return mean in whose period a time lies: interpolated means would be averaged once more."""
    time = channel.time_us
    right = np.minimum(np.searchsorted(time, grid_us), len(time) - 1)
    left = np.maximum(right - 1, 0)
    nearest = np.where(grid_us - time[left] < time[right] - grid_us, left, right)
    reach = MEAN_REACH * channel.rules.mean_us
    silent = np.abs(grid_us - time[nearest]) > reach
    present = ~silent & ~channel.refused[nearest]
    return OnGrid(np.where(present, channel.value[nearest], np.nan), present, silent)


def _average(channel: CleanChannel, grid_us: Times, period_us: int) -> OnGrid:
    n = len(grid_us)
    cell = (channel.time_us - grid_us[0] + period_us // 2) // period_us
    within = (cell >= 0) & (cell < n)
    silent = np.bincount(cell[within], minlength=n) == 0
    chosen = within & ~channel.refused
    cell = cell[chosen]
    counts = np.bincount(cell, minlength=n)
    total = np.bincount(cell, weights=channel.value[chosen], minlength=n)
    assert channel.period_us is not None
    present = counts >= CELL_SHARE * period_us / channel.period_us
    result = np.full(n, np.nan)
    result[present] = total[present] / counts[present]
    return OnGrid(result, present, silent)


def drain_line_delay_s(flow_l_per_min: Values, line_volume_l: float) -> Values:
    """Return time that oil takes through the drain line.

    .. math:: \\tau(t) = \\frac{L}{v(t)} = \\frac{V}{y(t)}, \\qquad V = L \\pi d^2 / 4

    Infinite without flow, nan where the flow is.

    References
    ----------
    .. [1] N. Ydebäck, *Grey Box Model of Leakage in Radial Piston Hydraulic Motors*, Luleå
       University of Technology, 2021, equation (14).
    """
    delay = np.full(len(flow_l_per_min), np.inf)
    np.divide(60.0 * line_volume_l, flow_l_per_min, out=delay, where=flow_l_per_min > 0)
    delay[np.isnan(flow_l_per_min)] = np.nan
    return delay


def delay_on_grid_s(
    flow_l_per_min: Values, present: Mask, period_s: float, settings: TransportDelay
) -> Values:
    """Return τ at each sample, shape (n,) [s], by an average: a pulse meter's readings may be 0."""
    if settings.fixed_s is not None:
        return np.full(len(flow_l_per_min), settings.fixed_s)
    if settings.line_volume_l is None:
        raise ValueError("a delay by the flow needs the line's volume")
    half = round(FLOW_AVERAGE_S / period_s) // 2
    row = np.arange(len(flow_l_per_min))
    first, last = np.maximum(row - half, 0), np.minimum(row + half + 1, len(row))
    total = np.concatenate([[0.0], np.cumsum(np.where(present, flow_l_per_min, 0.0))])
    count = np.concatenate([[0], np.cumsum(present)])
    average = np.full(len(row), np.nan)
    n = count[last] - count[first]
    np.divide(total[last] - total[first], n, out=average, where=present & (n > 0))
    return drain_line_delay_s(average, settings.line_volume_l)


def shift(value: Values, present: Mask, steps: Values) -> tuple[Values, Mask]:
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
        new_values[name], new_present[name] = shift(values[name], present[name], -usable / period_s)
    return new_values, new_present, refused, tau
