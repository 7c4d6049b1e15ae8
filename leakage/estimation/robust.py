r"""Huber's loss: samples with large errors count less, before they are compressed to statistics.

A triangular factor knows squares only, so the loss is met by weights on the samples, found by
iteratively reweighted least squares [1]_: with errors e and their robust scale s,

.. math:: w_i = \min\left(1, \frac{k s}{|e_i|}\right), \qquad z_i \to \sqrt{w_i}\, z_i .

References
----------
.. [1] P. J. Huber and E. M. Ronchetti, *Robust Statistics*, 2nd ed., Wiley, 2009, section 7.8.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from leakage.estimation.block_statistics import factor
from leakage.estimation.certificate import certify

Array = NDArray[np.float64]

# 95 % efficient under normal errors.
TUNING = 1.345
MAD_TO_SD = 1.482602218505602
MOST_ROUNDS = 50
SETTLED = 1e-8


def huber_weights(z: Array, lower: Array, upper: Array, tuning: float = TUNING) -> Array:
    """Weights of samples under Huber's loss."""
    weights = np.ones(len(z))
    before = np.inf
    for _ in range(MOST_ROUNDS):
        root = np.sqrt(weights)
        theta = certify(factor(z * root[:, None]), lower, upper).coefficients
        error = np.abs(z @ np.concatenate([theta, (1.0, -1.0)]))
        scale = MAD_TO_SD * float(np.median(error))
        if scale <= 0.0:
            return np.ones(len(z))
        weights = np.minimum(1.0, tuning * scale / np.maximum(error, 1e-300))
        loss = _loss(error / scale, tuning) * scale**2
        if abs(before - loss) <= SETTLED * loss:
            break
        before = loss
    return weights


def weight_inflation(weights: Array) -> float:
    r"""Factor, at least 1, by which standard errors that take the weights as known are too small.

    With ψ the slope of the loss, the estimate moves with :math:`(\sum \psi' x x^T)^{-1}`, and
    ψ' is 1 where a sample has its full weight and 0 elsewhere; weighted least squares uses the
    larger :math:`\sum w x x^T` in its place.
    """
    full = float(np.mean(weights >= 1.0)) if len(weights) else 1.0
    return max(float(np.mean(weights)) / full, 1.0) if full > 0 else float("inf")


def _loss(standardised: Array, tuning: float) -> float:
    """Mean Huber loss of errors in units of their scale."""
    within = np.minimum(standardised, tuning)
    return float(np.mean(within * (standardised - within / 2)))
