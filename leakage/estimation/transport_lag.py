r"""How long a motor's drain flow lags what drives it.

The lag that explains most of the flow's variance,

.. math:: y(t) \approx \theta_0 + \theta^T u(t - \tau) ,

is sought over the samples themselves; an error of the drivers u in shape costs explained variance
at every lag alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from leakage.arrays import Array, Places

# Lags that are tried, both ways, and their distances, from coarse to fine [s].
LONGEST_S, COARSE_S, FINE_S = 25.0, 1.0, 0.2
# So many samples, evenly chosen, are enough to place a lag within a few hundredths of a second.
MOST_SAMPLES = 8_000
# Of the lags from coarse to coarse fewer tell which are likely.
ENOUGH_FOR_COARSE, LIKELY = 2_000, 3
# Of these, the share that a lag needs: gaps leave some without a partner.
LEAST_SHARE = 0.5


@dataclass(frozen=True, slots=True)
class TransportLag:
    """Lag of a flow behind what drives it, in one night."""

    seconds: float  # lag that explains most; negative where the flow is ahead
    gain: float  # share of the flow's variance that it explains beyond what lag 0 does


def transport_lag(
    flow: Array, drivers: Array, index: Places, period_s: float, paired_s: float = 0.0
) -> TransportLag | None:
    """Estimate how long a flow lags its drivers.

    Parameters
    ----------
    flow, drivers
        Shapes (n,) and (n, k).
    index
        Place of each sample on an even time base, increasing, shape (n,).
    period_s
        Period of that time base [s].
    paired_s
        Lag by which the drivers have been shifted already; it is part of the result [s].

    Returns
    -------
    None where nothing varies, the largest lag is one of the outermost, or samples lie too far apart
    or have too few neighbours.

    Examples
    --------
    >>> load = np.repeat(np.random.default_rng(1).normal(size=100), 30)
    >>> lag = transport_lag(np.roll(load, 8), load[:, None], np.arange(3000), 1.0)
    >>> round(lag.seconds, 1), round(lag.gain, 1)
    (8.0, 0.5)
    """
    longest = int(LONGEST_S / period_s)
    if longest < 1 or len(index) < 2 * longest or not np.ptp(flow):
        return None
    chosen = np.linspace(0, len(index) - 1, min(len(index), MOST_SAMPLES)).astype(np.int64)
    zero = -round(paired_s / period_s)
    coarse, fine = (max(round(step_s / period_s), 1) for step_s in (COARSE_S, FINE_S))
    # Place of each sample of the time base, -1 where there is none, as far as any lag reaches.
    reach = longest + abs(zero) + coarse + fine
    first = int(index[0]) - reach
    place = np.full(int(index[-1]) - first + reach + 1, -1)
    place[index - first] = np.arange(len(index))
    here = index[chosen] - first
    # Of all samples of a day it would cost more than the search.
    centre, spread = drivers[chosen].mean(axis=0), drivers[chosen].std(axis=0)
    scale = centre, np.where(spread > 0.0, spread, 1.0)

    @cache
    def explained(lag: int, apart: int = 1) -> float:
        return _explained(flow, drivers, scale, chosen[::apart], place[here[::apart] - lag])

    apart = max(len(chosen) // ENOUGH_FOR_COARSE, 1)
    every = range(zero - longest, zero + longest + 1, coarse)
    likely = sorted(every, key=lambda lag: explained(lag, apart))[-LIKELY:]
    near = max(likely, key=explained)
    best = max(range(near - coarse, near + coarse + 1, fine), key=explained)
    before, middle, after = (explained(best + step) for step in (-fine, 0, fine))
    if min(before, middle, after) <= 0.0 or abs(best - zero) >= longest:
        return None
    bend = before - 2.0 * middle + after
    top = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    lag_s = paired_s + (best + fine * top) * period_s
    return TransportLag(lag_s, middle - explained(zero))


def _explained(
    flow: Array, drivers: Array, scale: tuple[Array, Array], chosen: Places, partner: Places
) -> float:
    """Return R² of the flow on the drivers at other places, -1: at none; 0 where these are few."""
    paired = partner >= 0
    n = int(np.count_nonzero(paired))
    if n < max(LEAST_SHARE * len(chosen), drivers.shape[1] + 2):
        return 0.0
    if n < len(chosen):
        chosen, partner = chosen[paired], partner[paired]
    y, u = flow[chosen], (drivers[partner] - scale[0]) / scale[1]
    means, mean = u.sum(axis=0) / n, y.mean()
    total = float(y @ y - n * mean**2)
    if total <= 0.0:
        return 0.0
    # Of a motor at one load the drivers are nearly one and the same.
    products = u.T @ y - n * mean * means
    squares = u.T @ u - n * np.outer(means, means)
    theta = np.linalg.lstsq(squares, products, rcond=1e-9)[0]
    return float(products @ theta) / total
