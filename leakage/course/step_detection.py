"""Steps of the leakage within hours, against the frozen model of a baseline.

Blocks of minutes, in order of time, are compared with what the model expects of them. Their errors
are slow and white; a Kalman filter predicts the slow part, and a generalised likelihood ratio looks
in its innovations for a step that began in one of the last blocks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]

# Blocks in which a step may have begun, and the smallest relative step that is looked for.
STARTS, LEAST_RISE = 60, 0.03
# Lags, in blocks, whose products tell the slow part from the white one.
LAGS = (1, 10)
# Bounds of the correlation of neighbours, and least white error relative to the flow.
MOST_CORRELATION, LEAST_WHITE = 0.999, 0.001
# Errors beyond so many robust standard deviations count as these: a fault of a sensor is no noise.
WINSORISED_AT = 5.0
# Days between two exceedances of the limit, and the least limit in standard deviations.
DAYS_BETWEEN, LEAST_LIMIT = 3650.0, 5.0
EULER = 0.5772156649015329


@dataclass(frozen=True, slots=True)
class BlockErrors:
    r"""Errors of a block's mean flow: :math:`e = \hat y s + w`, s autoregressive and w white.

    Attributes
    ----------
    correlation
        Of s in neighbouring blocks, ρ [-].
    slow_sd
        Standard deviation of s, relative to the expected flow [-].
    white_sd
        Standard deviation of w [l/min].
    """

    correlation: float
    slow_sd: float
    white_sd: float


def block_errors(number: Numbers, expected: Array, error: Array) -> BlockErrors:
    r"""Slow and white errors of a baseline's blocks, from products at lags 1 and 10.

    .. math:: c_k = \frac{\sum e_b e_{b+k}}{\sum \hat y_b \hat y_{b+k}} = \sigma_s^2 \rho^k,
        \quad \sigma_w^2 = \overline{e^2} - \sigma_s^2 \overline{\hat y^2}

    Parameters
    ----------
    number
        Place of each block on the clock, in blocks, increasing, shape (n,).
    expected
        Expected flow ŷ, above 0, shape (n,) [l/min].
    error
        Measured less expected flow, shape (n,) [l/min].

    Returns
    -------
    BlockErrors
        All white where neighbours do not move alike.

    Examples
    --------
    >>> generator = np.random.default_rng(1)
    >>> from scipy.signal import lfilter
    >>> slow = lfilter([0.03 * (1 - 0.9**2) ** 0.5], [1, -0.9], generator.normal(size=100_000))
    >>> error = 2.0 * slow + generator.normal(scale=0.02, size=100_000)
    >>> found = block_errors(np.arange(100_000), np.full(100_000, 2.0), error)
    >>> print(f"{found.correlation:.2f} {found.slow_sd:.3f} {found.white_sd:.3f}")
    0.90 0.030 0.020
    """
    relative = error / expected
    middle = float(np.median(relative))
    widest = WINSORISED_AT * 1.4826 * float(np.median(np.abs(relative - middle)))
    error = expected * np.clip(relative, middle - widest, middle + widest)
    near, far = (_product_ratio(number, expected, error, lag) for lag in LAGS)
    whole, flow = float(np.mean(error**2)), float(np.mean(expected**2))
    correlation, slow = 0.0, 0.0
    if near > 0.0:
        ratio = max(far / near, 0.0) ** (1.0 / (LAGS[1] - LAGS[0]))
        # Where only neighbours move alike, all that they share is slow.
        correlation = min(ratio or 0.5, MOST_CORRELATION)
        slow = min(near / correlation, whole / flow)
    white = max(whole - slow * flow, LEAST_WHITE**2 * flow)
    return BlockErrors(correlation, slow**0.5, white**0.5)


def _product_ratio(number: Numbers, expected: Array, error: Array, lag: int) -> float:
    """c_k of blocks at a distance; 0 where there are no such pairs."""
    first = np.flatnonzero(np.isin(number + lag, number))
    second = np.searchsorted(number, number[first] + lag)
    total = float(expected[first] @ expected[second])
    return float(error[first] @ error[second]) / total if total else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class StepWatch:
    """State of the filter after a block, of one series or of several side by side.

    Attributes
    ----------
    number
        The block's place on the clock, shape (...).
    level, variance
        Slow part s and its variance, shape (...).
    began
        Blocks in which a step may have begun, the newest last; negative: none. Shape (..., m).
    step, pulse
        Of a step, and of an error of that one block alone, that began there: the part that s has
        taken up, Σ gν/S, and Σ g²/S, with g what it adds to the innovation ν of variance S. Shape
        (3, ..., m).
    """

    number: Numbers
    level: Array
    variance: Array
    began: Numbers
    step: Array
    pulse: Array

    @classmethod
    def begin(cls, errors: BlockErrors, shape: tuple[int, ...] = ()) -> StepWatch:
        """The state before the first block."""
        return cls(
            np.full(shape, -1),
            np.zeros(shape),
            np.full(shape, errors.slow_sd**2),
            np.full((*shape, STARTS), -1),
            np.zeros((3, *shape, STARTS)),
            np.zeros((3, *shape, STARTS)),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """Evidence of a step after a block, shape (...).

    Attributes
    ----------
    statistic
        Root of twice the logarithm of the likelihood ratio; 0 without any.
    began
        Block in which the step began.
    rise, rise_sd
        Relative step, and its standard deviation.
    """

    statistic: Array
    began: Numbers
    rise: Array
    rise_sd: Array


def advance(
    watch: StepWatch, errors: BlockErrors, number: Numbers, expected: Array, error: Array
) -> tuple[StepWatch, Evidence]:
    r"""Take up a block of each series.

    With :math:`\nu = e - \hat y \rho^d s` of variance :math:`S`, d blocks after the one before, a
    relative step δ since block j adds :math:`\delta g_j` to ν, where g is ŷ put through the same
    filter, and

    .. math:: 2 \ln \Lambda_j = 2 \delta \sum g_j \nu / S - \delta^2 \sum g_j^2 / S,
        \quad \delta = \max(\hat\delta_j, 3\,\%)

    Parameters
    ----------
    watch, errors
        State before, and the errors of the baseline's blocks.
    number
        Place of the block on the clock, above those before, shape (...).
    expected, error
        Expected flow, and measured less expected, shape (...) [l/min]; nan: no such block.

    Returns
    -------
    StepWatch
        State after it.
    Evidence
        Of the most likely step. One counts from its second block on, while it is more likely than
        an error of a single block since, and while the last block lies above the baseline by half
        of it: neither a spike nor the end of a fall is a step.

    Notes
    -----
    After Willsky and Jones, A generalized likelihood ratio approach to the detection and estimation
    of jumps in linear systems, IEEE Trans. Automatic Control 21 (1976).
    """
    there = np.isfinite(error) & (expected > 0.0)
    flow, seen = np.where(there, expected, 1.0), np.where(there, error, 0.0)
    fading = errors.correlation ** np.where(watch.number < 0, 1, number - watch.number)
    level = fading * watch.level
    variance = errors.slow_sd**2 + fading**2 * (watch.variance - errors.slow_sd**2)
    spread = flow**2 * variance + errors.white_sd**2
    innovation, gain = seen - flow * level, flow * variance / spread
    began = np.concatenate([watch.began[..., 1:], np.asarray(number)[..., None]], axis=-1)
    is_new = np.arange(STARTS) == STARTS - 1

    def moved(before: Array, driven: NDArray[np.bool_]) -> Array:
        taken, score, information = np.concatenate(
            [before[..., 1:], np.zeros_like(before[..., :1])], axis=-1
        )
        taken = fading[..., None] * taken
        added = flow[..., None] * (driven - taken)
        score = score + added * (innovation / spread)[..., None]
        information = information + added**2 / spread[..., None]
        return np.stack([taken + gain[..., None] * added, score, information])

    possible = began >= 0
    step = moved(watch.step, possible) * possible
    pulse = moved(watch.pulse, is_new) * possible
    after = StepWatch(
        np.where(there, number, watch.number),
        np.where(there, level + gain * innovation, watch.level),
        np.where(there, (1.0 - gain * flow) * variance, watch.variance),
        np.where(there[..., None], began, watch.began),
        np.where(there[..., None], step, watch.step),
        np.where(there[..., None], pulse, watch.pulse),
    )
    counts = there[..., None] & possible & ~is_new
    return after, _evidence(after, counts, seen / flow)


def _evidence(watch: StepWatch, counts: NDArray[np.bool_], relative: Array) -> Evidence:
    _, score, information = watch.step
    _, score_of_pulse, information_of_pulse = watch.pulse
    some = np.where(information > 0.0, information, 1.0)
    best = score / some
    rise = np.maximum(best, LEAST_RISE)
    likelihood = 2.0 * rise * score - rise**2 * information
    of_pulse = np.maximum(score_of_pulse, 0.0) ** 2 / np.where(
        information_of_pulse > 0.0, information_of_pulse, 1.0
    )
    # The most likely one of a block since.
    rival = np.maximum.accumulate(of_pulse[..., ::-1], axis=-1)[..., ::-1]
    counts = counts & (likelihood > rival) & (relative[..., None] >= 0.5 * best)
    likelihood = np.where(counts, likelihood, 0.0)
    most = np.argmax(likelihood, axis=-1)[..., None]

    def at(values: Array) -> Array:
        return np.take_along_axis(values, most, axis=-1)[..., 0]

    return Evidence(
        np.sqrt(np.maximum(at(likelihood), 0.0)),
        np.take_along_axis(watch.began, most, axis=-1)[..., 0],
        at(best),
        at(some) ** -0.5,
    )


def limit_of_maxima(maxima: Array, days_between: float = DAYS_BETWEEN) -> float:
    r"""Limit that the largest statistic of a day exceeds once in many days.

    A Gumbel distribution is fitted to the days by moments, :math:`\beta = \sqrt 6 s / \pi`,
    :math:`\mu = \bar x - 0.5772 \beta`, :math:`x = \mu - \beta \ln(-\ln(1 - 1/d))`.

    Parameters
    ----------
    maxima
        Largest statistic of each day of the baseline, shape (n,), n at least 2.
    days_between
        Days between two exceedances, d.

    Returns
    -------
    float
        Not below 5.

    Examples
    --------
    >>> maxima = -np.log(-np.log((np.arange(1, 1001) - 0.5) / 1000))  # of a mean of 0.577
    >>> round(limit_of_maxima(maxima), 1), round(float(-np.log(-np.log1p(-1 / 3650))), 1)
    (8.2, 8.2)
    """
    beta = np.sqrt(6.0) / np.pi * float(np.std(maxima, ddof=1))
    mode = float(np.mean(maxima)) - EULER * beta
    return max(float(mode - beta * np.log(-np.log1p(-1.0 / days_between))), LEAST_LIMIT)
