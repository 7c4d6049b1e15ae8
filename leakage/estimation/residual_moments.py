"""Correlations of prediction errors and inputs at many lags, from which residuals are judged.

Kept apart from their tests (:mod:`leakage.estimation.residual_analysis`), which say what
they are for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from leakage.arrays import Array, Mask
from leakage.estimation.choices import (
    CORRELATION_TIMES,
    LEAST_PAIR_SHARE,
    LONGEST_LAG,
    LONGEST_SUM_SHARE,
    SHORTEST_SUM,
    THINNED_SAMPLES,
)
from leakage.estimation.lagged_products import Segments, lagged_products, products_near_ends

# Inputs whose deviation is below this share of their mean do not vary.
CONSTANT = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class ResidualMoments:
    """Correlations of errors and inputs within segments, scaled to variances of 1."""

    pairs: Array  # N_k, shape (longest sum + 51,)
    told: Mask  # whether enough pairs tell of a lag, shape (longest sum + 51,)
    varies: Mask  # inputs that vary, shape (inputs,); correlations of the others mean nothing
    # error, inputs: autocorrelations at lags from 0, 0 where too few pairs tell; shapes
    # (longest sum + 51,) and (inputs, longest sum + 51).
    error: Array
    inputs: Array
    # crossed, crossed_inside: sums of ε(t) u(t − k), k = −25 … 25, over all pairs and over
    # the inner samples alone; shape (inputs, 51).
    crossed: Array
    crossed_inside: Array
    # Number of inner samples that another inner one follows after 0 to 50, shape (51,).
    inner: Array
    # thinned_error, thinned_inputs: errors at some inner samples, shape (c,), and inputs from
    # 25 samples before to 25 after each of them, shape (c, 51) an input; both without their
    # means, not scaled.
    thinned_error: Array
    thinned_inputs: list[Array]
    longest_sum: int  # largest lag of the sums over lags

    @classmethod
    def of(
        cls,
        series: Sequence[Array],
        means: Sequence[float],
        segments: Segments,
        correlation_time: float,
    ) -> ResidualMoments:
        """Moments of errors that vary, and of inputs."""
        n = segments.n
        longest_sum = int(
            min(max(SHORTEST_SUM, CORRELATION_TIMES * correlation_time), n * LONGEST_SUM_SHARE)
        )
        longest = longest_sum + 2 * LONGEST_LAG
        inner = segments.without_ends(LONGEST_LAG)
        own, crossed = lagged_products(series, means, segments, longest, LONGEST_LAG)
        inside = np.zeros_like(crossed)
        if inner.n:
            inside = crossed - products_near_ends(series, means, segments, LONGEST_LAG)
        size = np.sqrt(own[:, 0] / n)
        # The caller has seen that the errors vary.
        varies = size[1:] > CONSTANT * np.abs(means[1:])
        size[1:][~varies] = 1.0
        scale = size[0] * size[1:, None]
        pairs = segments.pair_counts(longest)
        told = pairs >= LEAST_PAIR_SHARE * n
        own = np.where(told, own / np.maximum(pairs, 1.0), 0.0) / size[:, None] ** 2
        thinned = inner.samples(
            np.linspace(0, inner.n - 1, min(THINNED_SAMPLES, inner.n)).round().astype(np.int64)
        )
        begins = thinned - LONGEST_LAG
        return cls(
            pairs=pairs,
            told=told,
            varies=varies,
            error=own[0],
            inputs=own[1:],
            # The lag of the sums is that of the input behind the error.
            crossed=crossed[:, ::-1] / scale,
            crossed_inside=inside[:, ::-1] / scale,
            inner=inner.pair_counts(2 * LONGEST_LAG),
            thinned_error=series[0][thinned] - means[0],
            thinned_inputs=[
                sliding_window_view(one, 2 * LONGEST_LAG + 1)[begins] - mean
                for one, mean in zip(series[1:], means[1:], strict=True)
            ],
            longest_sum=longest_sum,
        )
