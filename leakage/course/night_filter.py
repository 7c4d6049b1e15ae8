r"""Loss factors of every night, however short: a random walk that each night informs.

A night of ten minutes tells no loss factor alone, and yet something. So the coefficients θ are
followed from night to night. Between nights they may move,

.. math:: P \leftarrow P + \Delta t \, \mathrm{diag}\big((0.02\, \theta_0)^2\big) ,

and a night observes them with the information of its blocks,

.. math::
    J = J_0 - \frac{\tau^2 J_0 d d' J_0}{1 + \tau^2 d' J_0 d} ,\quad
    J_0 = S M^{+} S ,\quad M_{ij} = S_{ij} \sqrt{\lambda_i \lambda_j} ,\quad S = \sum_b X_b'X_b ,

with λ the variance of the errors as the blocks see it, memory included, for each coefficient by
itself, since errors at low pressures are not those at high ones: with :math:`s_b = X_b'e_b` the
score of a block,

.. math:: \lambda_j = \frac{\sum_b s_{bj}^2 / S_{jj}}
                           {1 - \sum_b (X_b'X_b S^{+} X_b'X_b)_{jj} / S_{jj}} ,

whose numerators and denominators add up over nights, so that nights of few blocks leave it without
bias. The second term of J is a gain error τ that all flows of a night share: a sensor's scale, or a
temperature that is off, which no number of samples averages out. It moves θ along
:math:`d = S^{+} X'\hat y`, known paths included, as both act on the whole flow.

A night that the walk cannot explain (χ² of its innovation) opens the coefficients again: 40 % of
:math:`\theta_0` each, so that a step is followed within nights. Which path has stepped is then for
the nights to tell, and until they do the intervals of paths that trade against each other are wide.

References
----------
.. [1] A. C. Harvey, *Forecasting, Structural Time Series Models and the Kalman Filter*, 1989.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, stdtrit

from leakage.errors import ShapeError

Array = NDArray[np.float64]

# Relative to θ₀: how far a coefficient may move in a night, how well it is known at first, and how
# far a step may take it.
WALK_A_NIGHT: Final = 0.02
AT_FIRST: Final = 10.0
STEP: Final = 0.4
# Error of all flows of a night together.
GAIN_ERROR: Final = 0.015
# A night is told from the walk at this p.
UNLIKELY: Final = 1e-3
# Below it a night's blocks do not tell their errors.
LEAST_FREEDOM: Final = 0.1
# Of the column-scaled Gram; directions below it are not seen.
RANK_TOLERANCE: Final = 1e-10


@dataclass(frozen=True, slots=True, eq=False)
class NightInformation:
    """All that the filter needs of a night; k coefficients.

    Attributes
    ----------
    gram
        X'X, shape (k, k).
    explained, known
        X'(y − known − what is fixed) and X'known, shape (k,).
    noise, freedom
        Σ s_b² over S_jj of each coefficient, and its expectation where λ = 1, shape (k,).
    """

    gram: Array
    explained: Array
    known: Array
    noise: Array
    freedom: Array


@dataclass(frozen=True, slots=True, eq=False)
class FilterState:
    """Knowledge of the coefficients after a night; k of them.

    Attributes
    ----------
    mean, covariance
        Shapes (k,) and (k, k), in the coefficients' units.
    noise, freedom
        Sums over the nights so far, shape (k,); λ is their ratio.
    informed
        Whether any night has told something.
    opened
        Whether this night was one that the walk cannot explain.
    """

    mean: Array
    covariance: Array
    noise: Array
    freedom: Array
    informed: bool = False
    opened: bool = False

    def half_width(self, contrast: Array, level: float = 0.95) -> float:
        """Half-width of the interval of a linear combination, by Student's t."""
        quantile = float(stdtrit(max(float(self.freedom.sum()), 1.0), 0.5 + level / 2))
        return quantile * math.sqrt(max(float(contrast @ self.covariance @ contrast), 0.0))


def night_information(
    factors: Array, coefficients: Array, free: NDArray[np.bool_]
) -> NightInformation:
    """Information of a night from its blocks.

    Parameters
    ----------
    factors
        Triangular factors of the blocks, shape (b, c, c); columns: paths, one, known, measured.
    coefficients
        θ, shape (p + 1,), of which those that are not free count.
    free
        Coefficients that are followed, shape (p + 1,), k of them.

    Raises
    ------
    ShapeError
        ``shape``.
    """
    p = factors.shape[-1] - 2
    if factors.ndim != 3 or coefficients.shape != (p,) or free.shape != (p,):
        raise ShapeError(
            "shape",
            f"factors {factors.shape} with coefficients {coefficients.shape} and free {free.shape};"
            f" expected (b, c, c) and twice (c − 2,)",
        )
    columns = factors[:, :, :-2][:, :, free]
    flow = (
        factors[:, :, -1]
        - factors[:, :, -2]
        - factors[:, :, :-2][:, :, ~free] @ coefficients[~free]
    )
    grams = np.einsum("bij,bik->bjk", columns, columns)
    scores = np.einsum("bij,bi->bj", columns, flow)
    gram, explained = grams.sum(axis=0), scores.sum(axis=0)
    basis = _basis(gram)
    inverse = basis @ basis.T
    errors = scores - grams @ (inverse @ explained)
    size = np.diag(gram).copy()
    size[size == 0.0] = 1.0
    expected = np.diag(gram) - np.einsum("bji,jk,bki->i", grams, inverse, grams)
    return NightInformation(
        gram,
        explained,
        np.einsum("bij,bi->j", columns, factors[:, :, -2]),
        np.sum(errors**2, axis=0) / size,
        expected / size,
    )


def first_state(scale: Array) -> FilterState:
    """Knowledge before the first night, hardly any; `scale` is θ₀, positive, shape (k,)."""
    nothing = np.zeros(len(scale))
    return FilterState(scale.copy(), np.diag((AT_FIRST * scale) ** 2), nothing, nothing)


def follow(
    state: FilterState,
    night: NightInformation,
    nights_since: int,
    scale: Array,
    learns_noise: bool = True,
) -> FilterState:
    """Knowledge after one more night.

    Parameters
    ----------
    state
        After the night before.
    night
        What it tells.
    nights_since
        Nights since `state`, those without data included.
    scale
        θ₀: the baseline's coefficients, the configured ones before that; shape (k,).
    learns_noise
        Whether the night counts for λ: those of the baseline do.

    Returns
    -------
    FilterState
        Without any night that tells λ so far, only what is known of λ.
    """
    if learns_noise:
        state = replace(
            state, noise=state.noise + night.noise, freedom=state.freedom + night.freedom
        )
    walked = state.covariance + nights_since * np.diag((WALK_A_NIGHT * scale) ** 2)
    before = replace(state, covariance=walked, opened=False)
    if not np.all((state.freedom > LEAST_FREEDOM) & (state.noise > 0.0)):
        return before
    root, seen = _observation(night, np.sqrt(state.noise / state.freedom))
    if not root.shape[1]:
        return before
    innovation = seen - root.T @ state.mean
    spread = np.eye(root.shape[1]) + root.T @ walked @ root
    opened = state.informed and float(innovation @ np.linalg.solve(spread, innovation)) > float(
        chdtri(root.shape[1], UNLIKELY)
    )
    if opened:
        walked = walked + np.diag((STEP * scale) ** 2)
        spread = np.eye(root.shape[1]) + root.T @ walked @ root
    gain = np.linalg.solve(spread, root.T @ walked).T
    covariance = walked - gain @ root.T @ walked
    return replace(
        before,
        mean=state.mean + gain @ innovation,
        covariance=(covariance + covariance.T) / 2.0,
        informed=True,
        opened=opened,
    )


def _observation(night: NightInformation, sd: Array) -> tuple[Array, Array]:
    """Root L of the information, J = LL', shape (k, r), and L'θ̂ as the night has it, shape (r,)."""
    basis = _basis(night.gram)
    # J₀ = WW' = S M⁻¹ S with M = √λ S √λ: as S, it sees nothing that the night does not.
    root = night.gram / sd @ basis
    # A common gain error moves the coefficients as the whole flow does: L = W (I − c hh').
    moved = root.T @ (basis @ (basis.T @ (night.explained + night.known)))
    size = float(moved @ moved)
    if size > 0.0:
        left = 1.0 / math.sqrt(1.0 + GAIN_ERROR**2 * size)
        root = root - np.outer(root @ moved, moved) * ((1.0 - left) / size)
    return root, root.T @ (basis @ (basis.T @ night.explained))


def _basis(gram: Array) -> Array:
    """B with B'SB = I over what S sees, shape (k, r)."""
    unit = np.sqrt(np.diag(gram))
    unit[unit == 0.0] = 1.0
    values, vectors = np.linalg.eigh(gram / np.outer(unit, unit))
    seen = values > RANK_TOLERANCE
    basis: Array = vectors[:, seen] / np.sqrt(values[seen]) / unit[:, None]
    return basis
