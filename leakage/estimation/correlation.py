"""Autocorrelation of prediction errors in series with gaps, over the pairs that exist."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from leakage.arrays import Array
from leakage.estimation.choices import BAND, LONGEST_MEMORY_S, MEMORY_CELL_S
from leakage.estimation.lagged_products import Segments, lagged_products

# Lags that are looked at first: most errors forget sooner, and more lags take longer.
FIRST_LAGS = 500


def autocorrelation(values: Array, index: NDArray[np.int64], longest_lag: int) -> Array:
    """ρ at lags from 0, over the pairs that exist; nan where none has a lag, or nothing varies."""
    place, mean = index - index[0], float(values.mean())
    pairs = pair_counts(place, longest_lag)
    products = _products(values, mean, place, longest_lag)
    with np.errstate(invalid="ignore", divide="ignore"):
        at_lag = np.where(pairs > 0, products / pairs, np.nan)
        result: Array = at_lag / at_lag[0] if at_lag[0] > 0 else np.full(longest_lag + 1, np.nan)
    return result


def pair_counts(place: NDArray[np.int64], longest_lag: int) -> Array:
    r"""Return how many pairs of samples are k apart, across gaps too, for k from 0 on.

    With d the edges of the stretches without a gap, +1 at a begin and −1 behind an end, the counts
    c have the second difference −D, :math:`D(k) = \sum d(t) d(t + k)`: exact, and of the few edges
    alone.

    Parameters
    ----------
    place
        Places of the samples on an even time base, increasing, shape (n,).
    longest_lag
        Largest k.

    Returns
    -------
    Counts, shape (longest_lag + 1,).

    Examples
    --------
    >>> pair_counts(np.array([0, 1, 2, 5]), 3)
    array([4., 2., 1., 1.])
    """
    behind = np.flatnonzero(np.diff(place) != 1)
    begins = place[np.append(0, behind + 1)]
    ends = place[np.append(behind, len(place) - 1)] + 1
    edges = np.column_stack([begins, ends]).ravel()
    products = np.zeros(longest_lag + 1, dtype=np.int64)
    # Neighbours that are an odd number of edges apart have opposite signs.
    for neighbour in range(1, len(edges)):
        apart = edges[neighbour:] - edges[:-neighbour]
        apart = apart[apart <= longest_lag]
        if not len(apart):
            break
        products += (-1) ** neighbour * np.bincount(apart, minlength=longest_lag + 1)
    # At lag 0 each edge meets itself, and half of that lies on either side.
    slopes = np.append(0, -len(edges) // 2 - np.cumsum(products)[:-1])
    counts: Array = (len(place) + np.cumsum(slopes)).astype(float)
    return counts


def _products(values: Array, mean: float, place: NDArray[np.int64], longest_lag: int) -> Array:
    """Sums of x(t) x(t + k), x = values − mean, across gaps too: 0 where a sample is missing."""
    series = np.full(int(place[-1]) + 1, mean)
    series[place] = values
    together = Segments(np.array([0]), np.array([len(series)]))
    own, _ = lagged_products([series], [mean], together, longest_lag)
    products: Array = own[0]
    return products


def correlation_time(values: Array, index: NDArray[np.int64], longest_lag: int) -> float:
    """Lag over which the autocorrelation falls to 1/e of what it is at lag one [samples].

    Counted from lag one, so that white noise on top of a slow error does not hide the slow one. 0
    for errors without memory; infinite where it is longer than `longest_lag`, or than the series
    can tell.

    Notes
    -----
    For a first-order autoregression of coefficient φ, with or without white noise on top, this is
    −1/ln φ, corrected for the bias that the removed mean causes in a short series [1]_.

    References
    ----------
    .. [1] M. G. Kendall, "Note on bias in the estimation of autocorrelation", *Biometrika*,
       41(3/4), 1954.
    """
    if longest_lag > FIRST_LAGS >= index[1] - index[0]:
        found = correlation_time(values, index, FIRST_LAGS)
        if math.isfinite(found):
            return found
    rho = autocorrelation(values, index, longest_lag)
    n = len(values)
    # Of every second sample there is no pair at lag one: the first lag there is stands in.
    lags = np.flatnonzero(np.isfinite(rho[1:])) + 1
    # Below the band of white noise there is no memory to measure.
    if not len(lags) or not rho[lags[0]] > BAND / math.sqrt(n):
        return 0.0
    start = float(rho[lags[0]])
    below = np.flatnonzero(rho[lags] <= start / math.e)
    if not len(below):
        return math.inf
    before, lag = lags[below[0] - 1], lags[below[0]]
    # Linear in the logarithm between the last lag above and the first below.
    above, under = float(rho[before]), max(float(rho[lag]), 1e-12)
    share = math.log(above * math.e / start) / math.log(above / under)
    found = before - lags[0] + share * (lag - before)
    # Removing the mean of n samples lowers an autoregression's coefficient by 4/n of a lag.
    rate = 1.0 / max(found, 1e-12) - 4.0 / n
    return 1.0 / rate if rate > 0 else math.inf


def slowest_correlation_time(
    values: Array, index: NDArray[np.int64], longest_lag: int, cell: int
) -> float:
    """The longer of the correlation times of a series and of its means over cells [samples].

    A slow error under a larger fast one falls to 1/e with the fast one; in means over cells of
    `cell` samples, long against the fast one, the slow one is left.
    """
    fast = correlation_time(values, index, longest_lag)
    if cell < 2:
        return fast
    cells = np.arange(index[0] // cell, index[-1] // cell + 1)
    first = np.searchsorted(index, cells * cell)
    sizes = np.diff(first, append=len(values))
    whole = sizes >= cell / 2
    means = np.add.reduceat(values, first)[whole] / sizes[whole]
    longest = min(longest_lag // cell, int(whole.sum()) // 4)
    if longest < 2:
        return fast
    return max(fast, cell * correlation_time(means, cells[whole], longest))


def memory_s(error: Array, index: NDArray[np.int64], period_s: float, rounding: float) -> float:
    """Time over which prediction errors forget [s].

    0 without memory, infinite where it is longer than the samples can tell. Errors of the size of
    `rounding` remember nothing.
    """
    longest = int(min(LONGEST_MEMORY_S / period_s, len(error) // 4))
    if longest <= 1 or not (error.max() > rounding or error.min() < -rounding):
        return 0.0
    return (
        slowest_correlation_time(error, index, longest, round(MEMORY_CELL_S / period_s)) * period_s
    )
