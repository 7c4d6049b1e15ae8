"""Correlations of prediction errors and inputs at many lags, from which residuals are judged.

Kept apart from their tests (:mod:`leakage.estimation.residual_analysis`), which say what
they are for.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from leakage.estimation.lagged_products import Array, Mask, Places, Segments, lagged_products

# Lags that are looked at: −25 to 25 of cross-correlations, 1 to 25 of the autocorrelation.
LONGEST_LAG = 25
# Variances are summed over this many lags, or this many correlation times of the errors.
SHORTEST_SUM, CORRELATION_TIMES = 300, 10.0
# Longer sums than this share of the samples are noise.
LONGEST_SUM_SHARE = 0.25
# A lag with fewer pairs than this share of the samples goes into no sum and no statistic.
LEAST_PAIR_SHARE = 0.2
# Samples that tell whether errors are larger where an input moves; evenly thinned.
THINNED_SAMPLES = 2_000


@dataclass(frozen=True, slots=True, eq=False)
class ResidualMoments:
    """Correlations of errors and inputs within segments, all scaled to variances of 1.

    Attributes
    ----------
    pairs
        N_k, shape (longest sum + 51,).
    told
        Whether enough pairs tell of a lag, shape (longest sum + 51,).
    error, inputs
        Autocorrelations at lags from 0, 0 where too few pairs tell; shapes (longest sum + 51,) and
        (inputs, longest sum + 51).
    crossed, crossed_inside
        Sums of ε(t) u(t − k), k = −25 … 25, over all pairs and over the inner samples alone; shape
        (inputs, 51).
    inner
        Number of inner samples that another inner one follows after 0 to 50, shape (51,).
    thinned_error, thinned_inputs
        Errors at some inner samples, shape (c,), and inputs from 25 samples before to 25 after each
        of them, shape (inputs, c, 51).
    longest_sum
        Largest lag of the sums over lags.
    """

    pairs: Array
    told: Mask
    error: Array
    inputs: Array
    crossed: Array
    crossed_inside: Array
    inner: Array
    thinned_error: Array
    thinned_inputs: Array
    longest_sum: int

    @classmethod
    def of(
        cls, error: Array, inputs: Sequence[Array], index: Places, correlation_time: float
    ) -> ResidualMoments:
        """Moments of errors and inputs that vary.

        Parameters
        ----------
        error, inputs
            In time order, shape (n,) each.
        index
            Place of each sample on an even time base, increasing, shape (n,).
        correlation_time
            How long the errors remember [samples], may be infinite.
        """
        n = len(error)
        longest_sum = int(
            min(max(SHORTEST_SUM, CORRELATION_TIMES * correlation_time), n * LONGEST_SUM_SHARE)
        )
        longest = longest_sum + 2 * LONGEST_LAG
        segments = Segments.of(index)
        inner = segments.without_ends(LONGEST_LAG)
        count = len(inputs) + 1
        series = np.empty((count + 1, n))
        for row, values in enumerate((error, *inputs)):
            np.subtract(values, values.mean(), out=series[row])
            series[row] /= math.sqrt(float(series[row] @ series[row]) / n)
        is_inner = inner.mask(n)
        np.multiply(series[0], is_inner, out=series[count])
        thinned = _thinned(np.flatnonzero(is_inner))
        columns = range(1, count)
        places = [(one, one) for one in range(count)]
        for whose in (0, count):
            places += [(whose, u) for u in columns] + [(u, whose) for u in columns]
        sums = lagged_products(series, segments, longest, places)
        pairs = segments.pair_counts(longest)
        told = pairs >= LEAST_PAIR_SHARE * n
        own = np.where(told, sums[:count] / np.maximum(pairs, 1.0), 0.0)
        future, past, inner_future, inner_past = sums[count:].reshape(4, len(inputs), longest + 1)[
            :, :, : LONGEST_LAG + 1
        ]
        return cls(
            pairs=pairs,
            told=told,
            error=own[0],
            inputs=own[1:],
            crossed=np.hstack([future[:, :0:-1], past]),
            crossed_inside=np.hstack([inner_future[:, :0:-1], inner_past]),
            inner=inner.pair_counts(2 * LONGEST_LAG),
            thinned_error=series[0, thinned],
            thinned_inputs=_surroundings(series[1:count], thinned),
            longest_sum=longest_sum,
        )


def _thinned(places: Places) -> Places:
    if len(places) <= THINNED_SAMPLES:
        return places
    return places[np.linspace(0, len(places) - 1, THINNED_SAMPLES).round().astype(np.int64)]


def _surroundings(inputs: Array, places: Places) -> Array:
    """Inputs from 25 samples before each place to 25 after it, shape (inputs, c, 51)."""
    width = 2 * LONGEST_LAG + 1
    found = np.empty((len(inputs), len(places), width))
    for row, values in zip(found, inputs, strict=True):
        row[:] = sliding_window_view(values, width)[places - LONGEST_LAG]
    return found
