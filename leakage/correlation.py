"""How long prediction errors remember: their autocorrelation across gaps that it never bridges."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

Array = NDArray[np.float64]


def autocorrelation(values: Array, index: NDArray[np.int64], longest_lag: int) -> Array:
    """Autocorrelation of a series with gaps, each lag over the pairs that exist.

    Parameters
    ----------
    values
        Series in time order, shape (n,); its mean is removed.
    index
        Place of each value on an even time base, increasing, shape (n,).
    longest_lag
        Largest lag [samples].

    Returns
    -------
    ndarray
        ρ(0) = 1 to ρ(longest_lag), shape (longest_lag + 1,); nan where no pair has that lag, or
        the series has no spread.

    Examples
    --------
    >>> autocorrelation(np.array([1.0, -1, 1, -1]), np.arange(4), 2).round(6)
    array([ 1., -1.,  1.])
    """
    place = index - index[0]
    length = int(place[-1]) + 1
    present, series = np.zeros(length), np.zeros(length)
    present[place] = 1.0
    series[place] = values - values.mean()
    size = next_fast_len(length + longest_lag + 1, real=True)
    pairs = np.round(irfft(np.abs(rfft(present, size)) ** 2, size)[: longest_lag + 1])
    products = irfft(np.abs(rfft(series, size)) ** 2, size)[: longest_lag + 1]
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(pairs > 0, products / pairs, np.nan)
        result: Array = mean / mean[0] if mean[0] > 0 else np.full(longest_lag + 1, np.nan)
    return result


def correlation_time(values: Array, index: NDArray[np.int64], longest_lag: int) -> float:
    """Lag over which the autocorrelation falls to 1/e of what it is at lag one [samples].

    Counted from lag one, so that white noise on top of a slow error does not hide the slow one.

    Parameters
    ----------
    values, index
        As for :func:`autocorrelation`.
    longest_lag
        Largest lag looked at [samples].

    Returns
    -------
    float
        0 for errors without memory; `longest_lag` where it is longer than that.

    Notes
    -----
    For a first-order autoregression of coefficient φ, with or without white noise on top, this is
    −1/ln φ, corrected for the bias that the removed mean causes in a short series [1]_.

    References
    ----------
    .. [1] M. G. Kendall, "Note on bias in the estimation of autocorrelation", *Biometrika*,
       41(3/4), 1954.
    """
    rho = autocorrelation(values, index, longest_lag)
    n = len(values)
    # Below the band of white noise there is no memory to measure.
    if not rho[1] > 2.576 / math.sqrt(n):
        return 0.0
    below = np.flatnonzero(~(rho[1:] > rho[1] / math.e))
    if not len(below):
        return float(longest_lag)
    lag = int(below[0]) + 1
    if not np.isfinite(rho[lag]):
        return float(longest_lag)
    # Linear in the logarithm between the last lag above and the first below.
    above, under = rho[lag - 1], max(float(rho[lag]), 1e-12)
    share = math.log(above * math.e / rho[1]) / math.log(above / under)
    found = lag - 2 + share
    # Removing the mean of n samples lowers an autoregression's coefficient by 4/n of a lag.
    rate = 1.0 / max(found, 1e-12) - 4.0 / n
    return min(1.0 / rate, float(longest_lag)) if rate > 0 else float(longest_lag)
