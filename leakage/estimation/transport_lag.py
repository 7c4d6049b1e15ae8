r"""How long a motor's drain flow lags what drives it.

The lag that explains most of the flow's variance,

.. math:: y(t) \approx \theta_0 + \theta^T u(t - \tau) ,

is sought over the samples themselves; an error of the drivers u in shape costs explained variance
at every lag alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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
    """Lag of a flow behind what drives it, in a night."""

    seconds: float  # lag that explains most; negative where the flow is ahead
    gain: float  # share of the flow's variance that it explains beyond what lag 0 does


def transport_lag(
    flow: Array, drivers: Sequence[Array], index: Places, period_s: float, paired_s: float = 0.0
) -> TransportLag | None:
    """Estimate how long a flow lags its drivers, shape (n,) each, `index` their places in time.

    `paired_s`: Lag by which the drivers have been shifted already; it is part of the result [s].
    None where nothing varies, the largest lag is an outermost, or samples lie too far apart or have
    too few neighbours.

    Examples
    --------
    >>> load = np.repeat(np.random.default_rng(1).normal(size=100), 30)
    >>> lag = transport_lag(np.roll(load, 8), [load], np.arange(3000), 1.0)
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
    ours = _gather(drivers, chosen)
    centre, spread = ours.mean(axis=1)[:, None], ours.std(axis=1)
    scale = np.array([*np.where(spread > 0.0, spread, 1.0), 1.0, 1.0])

    def explained(lags: Places, apart: int = 1) -> Array:
        own, at = chosen[::apart], here[::apart]
        moments = np.array([_moments(flow, drivers, centre, own, place[at - lag]) for lag in lags])
        return _explained_share(moments / np.outer(scale, scale), len(own))

    apart = max(len(chosen) // ENOUGH_FOR_COARSE, 1)
    every = np.arange(zero - longest, zero + longest + 1, coarse)
    likely = every[np.argsort(explained(every, apart), kind="stable")[-LIKELY:]]
    near = likely[np.argmax(explained(likely))]
    around = np.arange(near - coarse - fine, near + coarse + fine + 1, fine)
    shares = explained(around)
    peak = 1 + int(np.argmax(shares[1:-1]))
    best = int(around[peak])
    before, middle, after = shares[peak - 1 : peak + 2].tolist()
    if min(before, middle, after) <= 0.0 or abs(best - zero) >= longest:
        return None
    bend = before - 2.0 * middle + after
    top = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    lag_s = paired_s + (best + fine * top) * period_s
    return TransportLag(lag_s, middle - float(explained(np.array([zero]))[0]))


def _gather(drivers: Sequence[Array], places: Places) -> Array:
    """Return drivers at some places, shape (k, m): at all of a day it would take long."""
    return np.stack([driver.take(places) for driver in drivers])


def _moments(
    flow: Array, drivers: Sequence[Array], centre: Array, chosen: Places, partner: Places
) -> Array:
    """Return sums of products of drivers at other places, -1: at none, of the flow, and of ones."""
    paired = partner >= 0
    if not paired.all():
        chosen, partner = chosen[paired], partner[paired]
    values = np.ones((len(drivers) + 2, len(chosen)))
    np.subtract(_gather(drivers, partner), centre, out=values[:-2])
    values[-2] = flow[chosen]
    products: Array = values @ values.T
    return products


def _explained_share(moments: Array, most: int) -> Array:
    """Return R² of the flow on the drivers by each lag's moments; 0 where samples are few."""
    n, sums = moments[:, -1, -1], moments[:, -1, :-1]
    centred = (
        moments[:, :-1, :-1] - sums[:, :, None] * sums[:, None] / np.maximum(n, 1.0)[:, None, None]
    )
    squares, products, total = centred[:, :-1, :-1], centred[:, :-1, -1], centred[:, -1, -1]
    # Of a motor at a constant load the drivers are nearly the same.
    inverse = np.linalg.pinv(squares, rcond=1e-9, hermitian=True)
    by_drivers = np.einsum("li,lij,lj->l", products, inverse, products)
    enough = (n >= max(LEAST_SHARE * most, moments.shape[1])) & (total > 0.0)
    return np.where(enough, by_drivers / np.where(enough, total, 1.0), 0.0)
