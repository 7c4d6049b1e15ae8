r"""What a fit leaves to columns that a right model does not need, and what that does to figures.

A right model leaves noise, a wrong model something that goes with temperature, load or speed.
To the columns :math:`X` of the fit come columns :math:`A` that a right model does not need: the
known flow, a constant, and the fitted leakage times the block's mean temperature, pressure, speed,
and pressure times speed, each about the night's mean. With :math:`\hat\gamma` their coefficients,
:math:`V` its cluster-robust covariance under the slow errors of the fit, and :math:`S` the Gram of
:math:`A` less what :math:`X` says of it,

.. math::
    \tau^2 = \frac{1}{N}\left(\hat\gamma^T S \hat\gamma - \operatorname{tr}(S V)\right)

is the mean square of the flow that these columns explain, less what noise alone would seem to [1]_.
It moves the figures of the fit by no more than

.. math:: R(c) = \tau \sqrt{c^T (X^T X / N)^{-1} c} ,

which is reached where the misfit lies along the contrast. It widens the intervals of a night; the
verdict on a motor's model is that of its watch, over many nights.

References
----------
.. [1] C. L. Mallows, "Some comments on C_p", *Technometrics*, 15(4), 1973.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leakage.arrays import Array, Mask
from leakage.estimation.blocks import ROUNDING, merge
from leakage.estimation.slow_errors import slow_errors, whiten
from leakage.estimation.uncertainty import cluster_robust

# Columns in front: the known flow, then products of the leakage; the constant is the ones.
IN_FRONT = 5
# Sizes of temperature [K], pressure [bar] and speed [rpm] that make columns alike.
UNITS = (10.0, 100.0, 50.0)
# Share of a column below which others say all of it.
RANK_TOLERANCE = 1e-8
# Half-widths that a misfit adds, over what it can do, of a leakage and of a coefficient: so large
# that intervals held under wrong films, oils and rollers.
LEAKAGE_FACTOR = 2.0
COEFFICIENT_FACTOR = 2.5
# A misfit is clear where it is this much larger than what noise explains.
CLEAR = 2.0
# Blocks for each coefficient that a covariance takes.
BLOCKS_A_COEFFICIENT = 2.0


@dataclass(frozen=True, slots=True)
class Misfit:
    """Structured misfit of a fit."""

    l_per_min: float  # τ [l/min]
    share: float  # τ over the mean leakage
    noise_share: float  # what noise alone explains, over the mean leakage

    @property
    def is_clear(self) -> bool:
        """True where noise alone would not seem as large."""
        return self.share > CLEAR * self.noise_share


def misfit(
    factors: Array,
    number: NDArray[np.int64],
    coefficients: Array,
    fixed: Mask,
    means: Array,
    scales: bool | None = None,
) -> Misfit | None:
    """Return structured misfit of a fit; None where blocks are too few for a covariance, or without
    leakage.

    `factors, number`: Factors of its stored blocks in time order, not whitened, shape (b, c, c),
    and their places on the clock, in blocks, shape (b,).
    `coefficients, fixed`: θ of the fit, and which of it are not estimated, shape (c − 2,).
    `means`: Mean temperature [°C], pressure [bar] and speed [rpm] of each block, shape (b, 3).
    `scales`: Whether slow errors scale the leakage, as of the fit; None: not known.
    """
    n = np.einsum("bi,bi->b", factors[:, :, -3], factors[:, :, -3])
    theta = np.concatenate([coefficients[:-1], (0.0, 1.0)])
    flow = float(np.einsum("bi,bij,j->", factors[:, :, -3], factors[:, :, :-1], theta))
    if len(factors) < BLOCKS_A_COEFFICIENT * (IN_FRONT + len(fixed)) or flow <= 0.0:
        return None
    mean_flow = flow / float(n.sum())
    about = (means - np.average(means, axis=0, weights=n)) / UNITS
    plain = _extend(factors, theta, np.column_stack([about, about[:, 1] * about[:, 2]]))
    needed = np.append(np.zeros(IN_FRONT, dtype=bool), ~fixed)
    # The column of ones is needed where flushing is estimated, and not needed otherwise.
    added = np.append(np.ones(IN_FRONT, dtype=bool), np.zeros(len(fixed), dtype=bool))
    added[-1] = fixed[-1]
    added[:-1] &= np.abs(plain).max(axis=(0, 1))[: len(added) - 1] > 0.0
    held = np.append(np.zeros(IN_FRONT), np.where(fixed, coefficients, 0.0))
    # Memory of the errors beside the misfit: to the fit alone, a misfit looks like a slow error.
    unweighted = merge(plain)
    slow = slow_errors(plain, number, ~(needed | added), held, unweighted, scales)
    white = whiten(plain, number, slow)
    whole = merge(white) if slow.are_slow else unweighted
    values = _least_squares(whole, needed | added, held)
    error = whole @ np.concatenate([-values, (-1.0, 1.0)])
    distribution = cluster_robust(white, values, needed | added, slow.widening, whole)
    if distribution is None or not error @ error > (ROUNDING * mean_flow) ** 2 * n.sum():
        return None
    columns = np.flatnonzero(added)
    beside = _beside(unweighted, columns, needed)
    gram = beside.T @ beside / float(n.sum())
    among = np.flatnonzero(added[distribution.active])
    covariance = distribution.covariance()[np.ix_(among, among)]
    noise = float(np.trace(gram @ covariance))
    size = math.sqrt(max(float(values[columns] @ gram @ values[columns]) - noise, 0.0))
    return Misfit(size, size / mean_flow, math.sqrt(noise) / mean_flow)


def _extend(rows: Array, theta: Array, about: Array) -> Array:
    """Return rows of blocks with the columns a right model does not need in front, (b, r, c+5).

    The constant among them is the statistics' own column of ones.
    """
    leakage = rows[:, :, :-1] @ theta
    products = leakage[:, :, None] * about[:, None]
    return np.concatenate([rows[:, :, -2:-1], products, rows], axis=2)


def _least_squares(whole: Array, free: Mask, held: Array) -> Array:
    """Return coefficients of the free columns by least squares; the others as held."""
    target = whole @ np.concatenate([-held, (-1.0, 1.0)])
    columns = whole[:, :-2][:, free]
    scale = np.linalg.norm(columns, axis=0)
    scale[scale == 0.0] = 1.0
    values = held.copy()
    values[free] = np.linalg.lstsq(columns / scale, target, RANK_TOLERANCE)[0] / scale
    return values


def _beside(whole: Array, places: NDArray[np.int64], needed: Mask) -> Array:
    """Return columns less what the needed ones say of them."""
    columns, others = whole[:, places], whole[:, :-2][:, needed]
    scale = np.linalg.norm(others, axis=0)
    others = others[:, scale > 0.0] / scale[scale > 0.0]
    basis, size, _ = np.linalg.svd(others, full_matrices=False)
    basis = basis[:, size > RANK_TOLERANCE * size.max(initial=0.0)]
    left: Array = columns - basis @ (basis.T @ columns)
    independent = np.linalg.norm(left, axis=0) > RANK_TOLERANCE * np.linalg.norm(columns, axis=0)
    left[:, ~independent] = 0.0
    return left


def model_errors(whole: Array, fixed: Mask, contrasts: Array, misfit_l_per_min: float) -> Array:
    """Return R(c): what a misfit τ [l/min] can do to contrasts of coefficients, shape (m,).

    Contrasts have shape (m, c − 2); `whole` is the merged factor of the fit's blocks, not whitened.
    """
    free = np.flatnonzero(~fixed & (np.abs(whole).max(axis=0)[:-2] > 0.0))
    scale = np.linalg.norm(whole[:, free], axis=0)
    _, size, rotation = np.linalg.svd(whole[:, free] / scale, full_matrices=False)
    seen = size > RANK_TOLERANCE * size[0]
    weights = (contrasts[:, free] / scale) @ rotation[seen].T / size[seen]
    n = float(np.sum(whole[:, -3] ** 2))
    errors: Array = misfit_l_per_min * np.sqrt(n * np.sum(weights**2, axis=1))
    return errors
