r"""Intervals that hold although the prediction errors are correlated: blocks as clusters.

Errors of neighbouring samples are strongly correlated, so intervals that count samples are far too
narrow. The block of two minutes is the unit instead: the cluster-robust sandwich in its
bias-reduced form CR2, with the degrees of freedom of Bell and McCaffrey [1]_ [2]_, needs of each
block nothing but its triangular factor. With :math:`G_b = X_b^T X_b`,
:math:`B = (\sum G_b)^{-1}`, :math:`\tilde G_b = B^{1/2} G_b B^{1/2}` and
:math:`\tilde s_b = B^{1/2} X_b^T e_b`,

.. math::
    u_b = (I - \tilde G_b)^{-1/2}\,\tilde s_b ,\qquad
    \operatorname{Cov}(\hat\theta) = B^{1/2} \Big(\sum_b u_b u_b^T\Big) B^{1/2} ,

and for a contrast :math:`\tilde c = B^{1/2} c`:

.. math::
    a_b = \tilde c^T \tilde G_b (I - \tilde G_b)^{-1} \tilde c ,\quad
    w_b = (I - \tilde G_b)^{-1/2}\,\tilde G_b\,\tilde c ,\quad
    \Omega = \operatorname{diag}(a) - w w^T ,\quad
    \nu = \frac{(\operatorname{tr} \Omega)^2}{\operatorname{tr}(\Omega^2)} .

Sensor offsets are invisible here: they need stated tolerances.

References
----------
.. [1] R. M. Bell and D. F. McCaffrey, "Bias reduction in standard errors for linear regression
   with multi-stage samples", *Survey Methodology*, 28(2), 2002.
.. [2] J. E. Pustejovsky and E. Tipton, "Small-sample methods for cluster-robust variance
   estimation and hypothesis testing in fixed effects models", *Journal of Business & Economic
   Statistics*, 36(4), 2018.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from leakage.arrays import Array, Mask
from leakage.estimation.blocks import merge

# Eigenvalues of I − G̃_b below this belong to a block without which a coefficient is unknown.
LEVERAGE_FLOOR = 1e-8
# Relative size below which a singular value is rounding.
RANK_TOLERANCE = 1e-11
# Share of a contrast's square that may lie outside of what the samples span.
ROW_SPACE_TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True)
class Interval:
    """A symmetric interval about an estimate."""

    half_width: float  # half of its width, in the estimate's unit
    standard_error: float  # cluster-robust standard error, in the estimate's unit
    degrees_of_freedom: float  # of Student's t, at least 1
    # Share of what the samples say of it that rests on a single block, at least 1/b.
    largest_block_share: float


@dataclass(frozen=True, slots=True)
class ClusterRobust:
    """Cluster-robust distribution of the estimates of a fit.

    It is kept in the basis in which the whole of the active columns is orthonormal; where columns
    depend on each other that basis is smaller, and only combinations that lie in it have an
    interval.
    """

    # Coefficients off their bounds and not fixed; the others have no interval; shape (p +
    # 1,).
    active: Mask
    n_blocks: int  # blocks with samples
    _scale: Array
    _basis: Array
    _to_basis: Array
    _leverage: Array
    _inverse_root: Array
    _scores: Array

    def interval(self, contrast: Array, level: float = 0.95) -> Interval | None:
        """Return interval of a sum of coefficients; None if the samples do not span it."""
        weights = self._weights(contrast)
        if weights is None:
            return None
        if not weights.any():
            return Interval(0.0, 0.0, float(max(self.n_blocks - 1, 1)), 0.0)
        standard_error = float(np.sqrt(np.sum((self._scores @ weights) ** 2)))
        seen = self._leverage @ weights
        freedom = self._degrees_of_freedom(weights, seen)
        quantile = float(stdtrit(freedom, 0.5 + level / 2))
        shares = seen @ weights
        share = float(shares.max() / shares.sum())
        return Interval(quantile * standard_error, standard_error, freedom, share)

    def covariance(self) -> Array:
        """Return covariance of the active coefficients, shape (k, k), in their units."""
        spread = self._to_basis.T @ (self._scores.T @ self._scores) @ self._to_basis
        covariance: Array = spread / np.outer(self._scale, self._scale)
        return covariance

    def variance_inflation(self) -> Array:
        """Return VIF of the active coefficients, shape (k,): how far collinearity widens each.

        Infinite for a coefficient that no combination in the basis tells apart.
        """
        inflation = np.sum(self._to_basis**2, axis=0)
        apart = np.sum(self._basis**2, axis=0) > 1.0 - ROW_SPACE_TOLERANCE
        result: Array = np.where(apart, inflation, np.inf)
        return result

    def correlation(self) -> Array:
        """Return correlation of the active estimates that collinearity alone causes, (k, k)."""
        inverse = self._to_basis.T @ self._to_basis
        deviation = np.sqrt(np.diag(inverse))
        result: Array = inverse / np.outer(deviation, deviation)
        return result

    def _weights(self, contrast: Array) -> Array | None:
        """Return B^(1/2) c in the basis."""
        scaled = contrast[self.active] / self._scale
        inside = self._basis @ scaled
        lost = float(scaled @ scaled - inside @ inside)
        if lost > ROW_SPACE_TOLERANCE * float(scaled @ scaled):
            return None
        weights: Array = self._to_basis @ scaled
        return weights

    def _degrees_of_freedom(self, weights: Array, seen: Array) -> float:
        """Return Bell and McCaffrey's, under independent errors of equal variance; at least 1."""
        reach = self._inverse_root @ weights
        adjusted = np.einsum("bij,bj->bi", self._inverse_root, seen)
        omega = np.diag(np.einsum("bi,bi->b", adjusted, reach)) - adjusted @ adjusted.T
        spread = float(np.sum(omega * omega))
        trace = float(np.trace(omega))
        return max(trace * trace / spread, 1.0) if spread > 0 else 1.0


def cluster_robust(
    factors: Array,
    coefficients: Array,
    active: Mask,
    widening: float = 1.0,
    whole: Array | None = None,
) -> ClusterRobust | None:
    """Return the distribution of the active estimates; None with fewer than two blocks.

    `widening` is a factor on all standard errors.
    """
    filled = factors[factors.any(axis=(1, 2))]
    if not active.any() or len(filled) < 2:
        return None
    columns = filled[:, :, :-2][:, :, active]
    scale = np.sqrt(np.einsum("bij,bij->j", columns, columns))
    scale[scale == 0.0] = 1.0
    scaled = columns / scale
    error = -(filled @ np.concatenate([coefficients, (1.0, -1.0)]))
    # The whole's singular values come from its merged factor: a sum of Grams loses half the digits.
    whole = merge(np.ascontiguousarray(filled)) if whole is None else whole
    _, values, rotation = np.linalg.svd(whole[:, :-2][:, active] / scale, full_matrices=False)
    clear = values > RANK_TOLERANCE * values[0]
    basis = rotation[clear]
    to_basis = basis / values[clear, None]
    orthonormal = scaled @ to_basis.T
    leverage = np.einsum("bij,bik->bjk", orthonormal, orthonormal)
    eigenvalues, vectors = np.linalg.eigh(np.eye(len(basis)) - leverage)
    clipped = np.sqrt(np.maximum(eigenvalues, LEVERAGE_FLOOR))
    inverse_root = (vectors / clipped[:, None, :]) @ vectors.transpose(0, 2, 1)
    scores = np.einsum("bij,bi->bj", orthonormal, error)
    return ClusterRobust(
        active=active,
        n_blocks=len(filled),
        _scale=scale,
        _basis=basis,
        _to_basis=to_basis,
        _leverage=leverage,
        _inverse_root=inverse_root,
        _scores=widening * np.einsum("bij,bj->bi", inverse_root, scores),
    )
