r"""A verdict on the model itself: how much of the flow it leaves to what it should not need.

A right model leaves noise, a wrong one leaves something that goes with temperature, load or speed.
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

which is reached where the misfit lies along the contrast.

References
----------
.. [1] C. L. Mallows, "Some comments on C_p", *Technometrics*, 15(4), 1973.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from leakage.estimation.block_statistics import merge
from leakage.estimation.slow_errors import WIDENING, ShortBlocks, slow_errors, whitened
from leakage.estimation.uncertainty import cluster_robust

Array = NDArray[np.float64]

ModelVerdict: TypeAlias = Literal["supported", "doubtful", "disproved"]
# What a model has of the low-pressure side.
LowSide: TypeAlias = Literal["modelled", "known", "unknown"]

# Columns that a right model does not need, in order; the ones come last, as in the statistics.
COLUMNS = ("known flow", "temperature", "pressure", "speed", "pressure and speed", "constant")
IN_FRONT = len(COLUMNS) - 1
UPPER = np.triu_indices(len(COLUMNS))
MISFIT_NUMBERS = 2 + len(COLUMNS) + 3 * len(UPPER[0])
# What each of them speaks for.
KINDS: dict[str, tuple[int, ...]] = {"temperature": (1,), "load": (2, 4, 5), "speed": (0, 3)}
ROLLER = (0,)
# What a kind explains from which on it is named: over what noise would, and over what the known
# flow does, in which a scale and a bend of all flows show first.
TELLING = 4.0
LEAST_BESIDE = 0.005
# Likely causes, and what to try.
CAUSES = {
    "temperature": "another oil than stated, or a temperature sensor that lags or sits elsewhere; "
    "check the grade and take a sample",
    "load": 'another film law, or a sensor\'s zero; try film_pressure "slot", check zeros',
    "speed": "the cam roller's curve or count, or all other flows on another scale (oil, film "
    "law); check them, roller_scale says by how much",
}
# The likeliest of load, by what is known of the low-pressure side.
LOW_SIDES: dict[LowSide, str] = {
    "modelled": "",
    "known": "leakage may be two-sided: try model.two_sided; or ",
    "unknown": "leakage may be two-sided: log or state the charge pressure; or ",
}
# Half-widths that a misfit adds, over what it can do: of a leakage, and of a coefficient.
LEAKAGE_FACTOR = 2.0
COEFFICIENT_FACTOR = 2.5
# Structured misfit over the mean leakage from which a model is disproved: in one night, over ten.
DISPROVED_IN_ONE = 0.015
DISPROVED_OVER_TEN = 0.010
# 95 % quantiles of a right model, from which on it is doubtful.
DOUBTFUL_IN_ONE = 0.0068
DOUBTFUL_OVER_TEN = 0.0059
NIGHTS_TOGETHER = 10
# A misfit counts where it is this much larger than what noise explains.
CLEAR = 2.0
# Over that of the baseline, where it has grown.
LARGER = 1.5
# Blocks for each coefficient that a covariance takes; errors of less than this are rounding.
BLOCKS_A_COEFFICIENT = 2.0
ROUNDING = 1e-9
# Sizes of temperature [K], pressure [bar] and speed [rpm] that make columns alike.
UNITS = (10.0, 100.0, 50.0)
# Share of a column below which others say all of it.
RANK_TOLERANCE = 1e-8


@dataclass(frozen=True, slots=True)
class Misfit:
    """Misfit statistics of one fit, for the columns its model does not need; additive over nights.

    Attributes
    ----------
    n
        Samples.
    flow_l_per_min
        Sum over them of the fitted leakage, flushing excluded [l/min].
    gram
        S, shape (6, 6).
    information, score, meat
        Of γ, whitened and over the variance of the errors: the normal equations, shapes (6, 6) and
        (6,), and the covariance of the score, shape (6, 6).
    """

    n: float
    flow_l_per_min: float
    gram: Array
    information: Array
    score: Array
    meat: Array

    def numbers(self) -> Array:
        """All of it in one row, upper triangles row by row, shape (`MISFIT_NUMBERS`,)."""
        upper = (part[UPPER] for part in (self.gram, self.information, self.meat))
        return np.concatenate([(self.n, self.flow_l_per_min), self.score, *upper])

    @classmethod
    def of(cls, numbers: Array) -> Misfit:
        """Misfit from a row made by :meth:`numbers`."""
        (n, flow), score, *upper = np.split(numbers, (2, 8, 29, 50))
        wholes = np.zeros((3, len(COLUMNS), len(COLUMNS)))
        wholes[:, *UPPER] = upper
        gram, information, meat = wholes + np.triu(wholes, 1).transpose(0, 2, 1)
        return cls(float(n), float(flow), gram, information, score, meat)


@dataclass(frozen=True, slots=True)
class StructuredMisfit:
    """Size and kinds of a structured misfit.

    Attributes
    ----------
    l_per_min
        τ [l/min].
    share
        τ over the mean leakage.
    noise_share
        What noise alone explains, over the mean leakage.
    kinds
        Those of `KINDS` that explain more than noise would, the largest first.
    n_nights
        Nights that it is of.
    """

    l_per_min: float
    share: float
    noise_share: float
    kinds: tuple[str, ...]
    n_nights: int


def misfit(
    factors: Array,
    short: ShortBlocks,
    coefficients: Array,
    fixed: NDArray[np.bool_],
    means: Array,
) -> Misfit | None:
    """Misfit statistics of a fit, from its blocks, for the columns that its model does not need.

    Parameters
    ----------
    factors
        Factors of its stored blocks in time order, not whitened, shape (b, c, c); columns: paths,
        one, known, measured.
    short
        Short blocks from which the blocks were merged.
    coefficients
        θ of the fit, shape (c − 2,).
    fixed
        Coefficients that are not estimated, shape (c − 2,).
    means
        Mean temperature [°C], pressure [bar] and speed [rpm] of each block, shape (b, 3).

    Returns
    -------
    Misfit or None
        None where there are too few blocks for a covariance, or no leakage.
    """
    n = np.einsum("bi,bi->b", factors[:, :, -3], factors[:, :, -3])
    theta = np.concatenate([coefficients[:-1], (0.0, 1.0)])
    flow = float(np.einsum("bi,bij,j->", factors[:, :, -3], factors[:, :, :-1], theta))
    if len(factors) < BLOCKS_A_COEFFICIENT * (IN_FRONT + len(fixed)) or flow <= 0.0:
        return None
    about = (means - np.average(means, axis=0, weights=n)) / UNITS
    about = np.column_stack([about, about[:, 1] * about[:, 2]])
    plain = _extended(factors, theta, about)
    short = replace(short, means=_extended(short.means[:, None], theta, about[short.stored])[:, 0])
    needed = np.append(np.zeros(IN_FRONT, dtype=bool), ~fixed)
    # The column of ones is needed where flushing is estimated, and not needed otherwise.
    added = np.append(np.ones(IN_FRONT, dtype=bool), np.zeros(len(fixed), dtype=bool))
    added[-1] = fixed[-1]
    added[:-1] &= np.abs(plain).max(axis=(0, 1))[: len(added) - 1] > 0.0
    held = np.append(np.zeros(IN_FRONT), np.where(fixed, coefficients, 0.0))
    # Memory of the errors beside the misfit: to the fit alone, a misfit looks like a slow error.
    unweighted = merge(plain)
    slow = slow_errors(plain, short, ~(needed | added), held, unweighted)
    white = whitened(plain, short, slow)
    whole = merge(white) if slow.are_slow else unweighted
    values = _least_squares(whole, needed | added, held)
    error = whole @ np.concatenate([-values, (-1.0, 1.0)])
    variance = float(error @ error) / float(n.sum())
    widening = WIDENING if slow.are_slow else 1.0
    distribution = cluster_robust(white, values, needed | added, widening, whole)
    if distribution is None or not variance > (ROUNDING * flow / float(n.sum())) ** 2:
        return None
    columns = np.append(np.arange(IN_FRONT), len(added) - 1)
    covariance = np.zeros((len(added),) * 2)
    covariance[np.ix_(distribution.active, distribution.active)] = distribution.covariance()
    beside = np.where(added[columns], _beside(whole, columns, needed), 0.0)
    gram_root = np.where(added[columns], _beside(unweighted, columns, needed), 0.0)
    information = beside.T @ beside / variance
    return Misfit(
        n=float(n.sum()),
        flow_l_per_min=flow,
        gram=gram_root.T @ gram_root,
        information=information,
        score=beside.T @ (error + whole[:, columns] @ values[columns]) / variance,
        meat=information @ covariance[np.ix_(columns, columns)] @ information,
    )


def _extended(rows: Array, theta: Array, about: Array) -> Array:
    """Rows of blocks with the columns that a right model does not need in front, shape (b, r, c+5).

    The constant among them is the statistics' own column of ones.
    """
    leakage = rows[:, :, :-1] @ theta
    products = leakage[:, :, None] * about[:, None]
    return np.concatenate([rows[:, :, -2:-1], products, rows], axis=2)


def _least_squares(whole: Array, free: NDArray[np.bool_], held: Array) -> Array:
    """Coefficients of the free columns by least squares; the others as held."""
    target = whole @ np.concatenate([-held, (-1.0, 1.0)])
    columns = whole[:, :-2][:, free]
    scale = np.linalg.norm(columns, axis=0)
    scale[scale == 0.0] = 1.0
    values = held.copy()
    values[free] = np.linalg.lstsq(columns / scale, target, RANK_TOLERANCE)[0] / scale
    return values


def _beside(whole: Array, places: NDArray[np.int64], needed: NDArray[np.bool_]) -> Array:
    """Columns less what the needed ones say of them."""
    columns, others = whole[:, places], whole[:, :-2][:, needed]
    scale = np.linalg.norm(others, axis=0)
    others = others[:, scale > 0.0] / scale[scale > 0.0]
    basis, size, _ = np.linalg.svd(others, full_matrices=False)
    basis = basis[:, size > RANK_TOLERANCE * size.max(initial=0.0)]
    left: Array = columns - basis @ (basis.T @ columns)
    told = np.linalg.norm(left, axis=0) > RANK_TOLERANCE * np.linalg.norm(columns, axis=0)
    left[:, ~told] = 0.0
    return left


def structured_misfit(nights: Sequence[Misfit]) -> StructuredMisfit:
    """Structured misfit of one or more nights together; each has loss factors of its own."""
    n = sum(night.n for night in nights)
    flow = sum(night.flow_l_per_min for night in nights) / n
    gram, information, score, meat = (
        sum(getattr(night, name) for night in nights)
        for name in ("gram", "information", "score", "meat")
    )
    inverse = _inverse(information)
    gamma = inverse @ score
    noise = float(np.trace(gram @ inverse @ meat @ inverse)) / n
    misfit = math.sqrt(max(float(gamma @ gram @ gamma) / n - noise, 0.0))
    return StructuredMisfit(
        misfit,
        misfit / flow,
        math.sqrt(noise) / flow,
        _kinds(information, score, meat),
        len(nights),
    )


def _kinds(information: Array, score: Array, meat: Array) -> tuple[str, ...]:
    """Kinds that explain more than noise would, the largest first.

    The known flow is a standard: whatever scales the estimated flows, or bends them, makes it look
    wrong, too. So the other columns count by what they explain beside it.
    """
    known, by_chance = _explained(information, score, meat, ROLLER)
    found = {}
    for kind, places in KINDS.items():
        squares, noise = _explained(information, score, meat, tuple(sorted({*places, *ROLLER})))
        if kind != "speed":
            squares, noise = squares - known, max(noise - by_chance, LEAST_BESIDE / TELLING * known)
        if squares > TELLING * noise:
            found[kind] = 0.0 if kind == "speed" else squares
    return tuple(sorted(found, key=found.__getitem__, reverse=True))


def _explained(
    information: Array, score: Array, meat: Array, places: tuple[int, ...]
) -> tuple[float, float]:
    """Squares that some columns explain without the others, and what noise would."""
    of = np.ix_(places, places)
    inverse = _inverse(information[of])
    part = score[list(places)]
    return float(part @ inverse @ part), float(np.trace(inverse @ meat[of]))


def _inverse(gram: Array) -> Array:
    """Inverse of a Gram over the directions that it spans."""
    scale = np.sqrt(np.diag(gram))
    scale = np.where(scale > 0.0, scale, 1.0)
    size = np.outer(scale, scale)
    values, vectors = np.linalg.eigh(gram / size)
    seen = np.abs(values) > RANK_TOLERANCE * np.abs(values).max(initial=0.0)
    inverse: Array = (vectors[:, seen] / values[seen]) @ vectors[:, seen].T / size
    return inverse


def model_verdict(misfit: StructuredMisfit) -> ModelVerdict | None:
    """Verdict on a model; None where noise alone would seem a misfit that disproves it."""
    many = misfit.n_nights >= NIGHTS_TOGETHER
    disproved = DISPROVED_OVER_TEN if many else DISPROVED_IN_ONE
    noise = CLEAR * misfit.noise_share
    if noise > max(misfit.share, disproved):
        return None
    if misfit.share > disproved:
        return "disproved"
    doubtful = DOUBTFUL_OVER_TEN if many else DOUBTFUL_IN_ONE
    return "doubtful" if misfit.share > doubtful else "supported"


def grown_misfit(share: Array, noise_share: Array) -> Array:
    """Size of a misfit beside the first of its course, to hold against what disproves a model.

    Parameters
    ----------
    share, noise_share
        Of a structured misfit over the last ten nights, night by night, shape (n,); nan where it
        is not known.

    Returns
    -------
    ndarray
        √(share² − first²), shape (n,); 0 where the share is not larger by a half, or noise alone
        would seem as large.

    Examples
    --------
    >>> grown_misfit(np.array([0.003, 0.004, 0.005]), np.zeros(3)).round(4)
    array([0.   , 0.   , 0.004])
    """
    first = share[0]
    more = np.sqrt(np.maximum(share**2 - first**2, 0.0))
    hidden = (share < LARGER * first) | (CLEAR * noise_share > share)
    found: Array = np.where(np.isfinite(share), np.where(hidden, 0.0, more), np.nan)
    return found


def verdict_in_words(misfit: StructuredMisfit, low_side: LowSide = "unknown") -> str:
    """Size of the misfit, what it goes with, likely causes in order, and what to try."""
    size = f"{100 * misfit.share:.1f} % of the leakage goes with what the model does not describe"
    causes = CAUSES | {"load": LOW_SIDES[low_side] + CAUSES["load"]}
    return "; ".join([size, *(f"{kind}: {causes[kind]}" for kind in misfit.kinds)])


def model_errors(
    whole: Array, fixed: NDArray[np.bool_], contrasts: Array, misfit_l_per_min: float
) -> Array:
    """R(c): what a structured misfit can do to combinations of coefficients.

    Parameters
    ----------
    whole
        Merged factor of the fit's blocks, not whitened, shape (c, c).
    fixed
        Coefficients that are not estimated, shape (c − 2,).
    contrasts
        Weights of all coefficients, shape (m, c − 2).
    misfit_l_per_min
        τ [l/min].

    Returns
    -------
    ndarray
        In the units of the combinations, shape (m,).
    """
    free = np.flatnonzero(~fixed & (np.abs(whole).max(axis=0)[:-2] > 0.0))
    scale = np.linalg.norm(whole[:, free], axis=0)
    _, size, rotation = np.linalg.svd(whole[:, free] / scale, full_matrices=False)
    seen = size > RANK_TOLERANCE * size[0]
    weights = (contrasts[:, free] / scale) @ rotation[seen].T / size[seen]
    n = float(np.sum(whole[:, -3] ** 2))
    errors: Array = misfit_l_per_min * np.sqrt(n * np.sum(weights**2, axis=1))
    return errors
