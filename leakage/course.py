r"""A motor over its nights, for show: slopes, times until a limit, and zeros of its sensors.

**Slope.** Generalised least squares with autoregressive errors of the first order, in the transform
of Prais and Winsten: φ from the residuals of ordinary least squares, corrected for its bias, φ^Δt
across missing nights, and n − 3 degrees of freedom.

**Time to a limit.** A straight line holds for wear that is straight in the indicator, and for no
other. So the course is a mixture of shapes over the position u, 0 at the first night and 1 in the
newest night:

.. math::
    y = a + b f(u) + \varepsilon, \qquad
    f = \frac{e^{\kappa u} - 1}{e^\kappa - 1},\ \kappa = -4 \dots 6, \quad \text{and} \quad
    f = u^p,\ p = 0.3 \dots 4 .

Each shape is fitted by generalised least squares with a first-order autoregression of the
errors, and weighs prior · RSS^(−0.25 (n − 3)/2) / √det; concave, nearly straight and convex shapes
have a third of the prior each. With (a, b) distributed by Student's t of n − 3 degrees of freedom,
a rising course has crossed the limit L by u with the probability

.. math:: P(\tau \le u) = \sum_s w_s\, T_{n-3}\!\left(
          \frac{\hat a_s + \hat b_s f_s(u) - L}{\operatorname{se}_s(u)} \right) ,

which needs no draws. The set from 5 to 95 % is united with that of a gamma process on the cube root
of the indicator (a gap, where it is a loss factor) [1]_, whose drift and variance come from twelve
means of the nights.

References
----------
.. [1] J. M. van Noortwijk, "A survey of the application of gamma processes in maintenance",
   *Reliability Engineering & System Safety*, 94(1), 2009.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaincc, stdtr, stdtrit

from leakage.arrays import Array, Mask, Places

# Above this, a series of nights hardly differs from a trend.
HIGHEST_PHI = 0.95
# Pairs of residuals that an estimate of φ needs.
LEAST_PAIRS = 10
LEAST_NIGHTS = 20
SURE_NIGHTS = 60
# Parameters that cost a degree of freedom: level, slope and φ.
PARAMETERS = 3
# Scatter below this share of the values is rounding.
RELATIVE_ROUNDING = 1e-12


def whiten(columns: Array, phi: float, nights: Places) -> Array:
    r"""Return columns, shape (n, k), whose errors no longer remember: Prais and Winsten [1]_.

    .. math:: x^*_1 = x_1, \qquad x^*_t = \frac{x_t - \rho_t x_{t-1}}{\sqrt{1 - \rho_t^2}}

    with ρ = φ^Δt. The errors keep their variance, which on uneven nights the usual form without the
    root would not do.

    References
    ----------
    .. [1] S. J. Prais and C. B. Winsten, "Trend estimators and serial correlation", Cowles
       Commission Discussion Paper 383, 1954.
    """
    rho = phi ** np.diff(nights)[:, None]
    result = columns.copy()
    result[1:] = (columns[1:] - rho * columns[:-1]) / np.sqrt(1 - rho**2)
    return result


def estimated_phi(residuals: Array, nights: Places) -> float:
    r"""Return correlation of neighbouring nights, from the residuals of a straight line.

    The correlation of nights that follow each other at the commonest distance d is corrected for
    what a fitted line takes away of it [1]_, and brought to a single night:

    .. math:: \hat\varphi = \Big(r_d + \frac{2 + 4 r_d}{n}\Big)^{1/d}, \qquad
       0 \le \hat\varphi \le 0.95 .

    0 where fewer than ten pairs lie at the commonest distance, or nothing scatters.

    References
    ----------
    .. [1] P. Shaman and R. A. Stine, "The bias of autoregressive coefficient estimators",
       *Journal of the American Statistical Association*, 83(403), 1988.
    """
    n = len(residuals)
    spread = float(residuals @ residuals) / n if n else 0.0
    distances = np.diff(nights)
    if n <= LEAST_PAIRS or spread <= 0.0:
        return 0.0
    distance = int(np.argmax(np.bincount(distances)))
    at = distances == distance
    if int(at.sum()) < LEAST_PAIRS:
        return 0.0
    correlation = float(np.mean(residuals[1:][at] * residuals[:-1][at])) / spread
    corrected = min(max(correlation + (2 + 4 * correlation) / n, 0.0), HIGHEST_PHI)
    return float(min(corrected ** (1.0 / distance), HIGHEST_PHI))


@dataclass(frozen=True, slots=True)
class Slope:
    """A straight line through the nights of an indicator.

    There is none below 20 nights or where all lie at the same position, and no interval where they
    lie on the line to within rounding.
    """

    n: int  # Nights that count.
    # slope, lower, upper: Generalised least squares, and its 95 % interval [unit a unit of
    # position].
    slope: float | None = None
    lower: float | None = None
    upper: float | None = None

    @property
    def is_provisional(self) -> bool:
        """True if the interval rests on fewer than 60 nights."""
        return self.lower is not None and self.n < SURE_NIGHTS


def fit_slope(nights: Places, values: Array, position: Array) -> Slope:
    """Return slope of an indicator over time or running hours, with an interval that holds.

    Simulated coverage of 95 % intervals: 92 to 96 % for 60 nights or more and φ up to 0.6; 86 % for
    20 nights and φ = 0.6, which is why those are provisional.

    `nights, values`: Numbers of the nights, increasing, which say how far errors remember, and the
    indicator, shape (n,); nights that are not finite do not count.
    `position`: What the slope is per unit of, such as running hours, shape (n,).
    """
    known = np.isfinite(values)
    n = int(known.sum())
    nights, values, x = nights[known], values[known], position[known]
    if n < LEAST_NIGHTS or not np.ptp(x) > 0.0:
        return Slope(n)
    columns = np.column_stack([np.ones(n), values, x - float(np.mean(x))])
    line = CourseFits.of(columns)
    residuals = line.residuals(0)
    if float(np.std(residuals)) <= RELATIVE_ROUNDING * float(np.max(np.abs(values))):
        return Slope(n, float(line.slopes[0]))
    line = CourseFits.of(whiten(columns, estimated_phi(residuals, nights), nights))
    slope, errors, freedom = float(line.slopes[0]), line.residuals(0), n - PARAMETERS
    error = math.sqrt(float(errors @ errors) / freedom / float(line.spans[0]))
    half = float(stdtrit(freedom, 0.975)) * error
    return Slope(n, slope, slope - half, slope + half)


@dataclass(frozen=True, slots=True)
class CourseFits:
    """Least squares of a level and of each of some courses in turn.

    `length` is the squared length of the column of the level, `level` and `middles` the means of
    the values and of each course, weighted by it; `slopes` and `spans` each course's coefficient
    and squared length about its middle; `centred`, shape (n, 1 + s), values and courses less the
    part of the level.
    """

    length: float
    level: float
    middles: Array
    slopes: Array
    spans: Array
    centred: Array

    @classmethod
    def of(cls, columns: Array) -> CourseFits:
        """Return regressions on columns of the level, the values and the courses, (n, 2 + s)."""
        ones = columns[:, 0]
        length = float(ones @ ones)
        means = ones @ columns[:, 1:] / length
        centred = columns[:, 1:] - np.outer(ones, means)
        spans = np.einsum("ij,ij->j", centred[:, 1:], centred[:, 1:])
        slopes = centred[:, 0] @ centred[:, 1:] / spans
        return cls(length, float(means[0]), means[1:], slopes, spans, centred)

    def residuals(self, course: int) -> Array:
        """Return residuals of a course, shape (n,)."""
        left: Array = self.centred[:, 0] - self.slopes[course] * self.centred[:, 1 + course]
        return left


LOWEST, HIGHEST = 0.05, 0.95
# Calibrated by simulation: few jumps tell badly how often they come.
LOWEST_OF_JUMPS = 0.02
# Nearly 0 is the straight line.
KAPPAS: Array = np.array([-4.0, -3, -2, -1, -0.25, 1e-9, 0.25, 1, 2, 3, 4, 5, 6])
POWERS: Array = np.array([0.3, 0.5, 0.7, 1.4, 2.0, 3.0, 4.0])
NEARLY_STRAIGHT = 0.3
# Calibrated by simulation: shapes are never as sure as the errors of each would have it.
TEMPERING = 0.25
MEANS = 12
# Upper 95 % bound of a variance of eleven increments, over its estimate: few jumps tell it badly.
VARIANCE_BOUND = 2.4
# Beyond this variance of the increments over that of noise, the wear comes in jumps.
MOST_OF_NOISE = 2.0
# Standard deviation over median absolute deviation, of a normal distribution.
MAD_TO_SD = 1.482602218505602
# Scatter below this share of the limit is rounding.
ROUNDING = 1e-9
# Positions ahead, in units of what was seen: even as far as a range may go, and wider beyond.
NEAR, FIRST_FAR, FAR_STEPS = np.linspace(0.0, 1.0, 41), 1.1, 20
LARGEST_EXPONENT = 300.0


@dataclass(frozen=True, slots=True)
class TimeToLimit:
    """Time until an indicator reaches a limit from below, in units of the position."""

    # ``finite``; ``not_before``: nothing is known but an earliest time; ``beyond_horizon``: the
    # earliest time is the horizon; ``already_crossed``: more likely at the limit than below;
    # ``no_trend``: more likely falling than rising; ``insufficient``: fewer than 20 nights, or all
    # at the same position.
    status: str
    time: float | None = None  # As likely later as earlier; only of ``finite``.
    # lower, upper: Ends of the 90 % set; None where there is none.
    lower: float | None = None
    upper: float | None = None


def time_to_limit(
    nights: Places, position: Array, values: Array, limit: float, horizon: float
) -> TimeToLimit:
    """Return time until an indicator reaches a limit, if it goes on in a way that fits what it did.

    ``finite`` only where the set ends within the horizon and as far ahead as the nights reach
    back, and the wear does not come in jumps. ``benchmarks/results/dates.md`` says how often the
    sets hold.

    `nights, position, values`: Numbers of the nights up to the newest night, which say how far
    errors remember, what wear goes by, such as running hours, both increasing, and the indicator,
    shape (n,); nights that are not finite do not count. `limit`: In the unit of the indicator,
    positive. `horizon`: Time ahead beyond which nothing is said [unit of position].
    """
    known = np.isfinite(values)
    if int(known.sum()) < LEAST_NIGHTS or not np.ptp(position[known]) > 0.0:
        return TimeToLimit("insufficient")
    reach = float(position[-1] - position[known][0])
    u, y = (position[known] - position[known][0]) / reach, values[known] / limit
    farthest = max(horizon / reach, 2.0 * FIRST_FAR)
    ahead = np.append(NEAR, np.geomspace(FIRST_FAR, farthest, FAR_STEPS))
    by_shape, rising = _crossed_by_shape(nights[known], u, y, 1.0 + ahead)
    if by_shape[0] >= 0.5:
        return TimeToLimit("already_crossed", lower=0.0, upper=0.0)
    if rising <= 0.5:
        return TimeToLimit("no_trend")
    by_jumps, of_noise = _crossed_by_jumps(u, y, ahead)
    jumps = of_noise > MOST_OF_NOISE
    least = LOWEST_OF_JUMPS if jumps else LOWEST
    lower = reach * min(_quantile(ahead, by_shape, LOWEST), _quantile(ahead, by_jumps, least))
    upper = reach * max(_quantile(ahead, weights, HIGHEST) for weights in (by_shape, by_jumps))
    if lower >= horizon:
        return TimeToLimit("beyond_horizon", lower=horizon)
    if jumps or upper > min(reach, horizon):
        return TimeToLimit("not_before", lower=lower)
    return TimeToLimit("finite", reach * _quantile(ahead, by_shape, 0.5), lower, upper)


def _quantile(ahead: Array, crossed: Array, share: float) -> float:
    """Return time ahead at which having crossed has a probability; infinite where never."""
    crossed = np.maximum.accumulate(crossed)
    if crossed[-1] < share:
        return np.inf
    return float(np.interp(share, crossed, ahead))


def _shapes(u: Array) -> Array:
    """Return each shape at each position, shape (s, m): 0 at 0, and 1 at 1."""
    kappas = KAPPAS[:, None]
    exponential = np.expm1(np.minimum(kappas * u, LARGEST_EXPONENT)) / np.expm1(kappas)
    return np.concatenate([exponential, u ** POWERS[:, None]])


def _prior() -> Array:
    """Return prior of each shape: a third each for all concave, nearly straight and convex ones."""
    kind = np.concatenate([np.trunc(KAPPAS / NEARLY_STRAIGHT), POWERS - 1.0])
    _, kinds, counts = np.unique(np.sign(kind), return_inverse=True, return_counts=True)
    return np.asarray(1.0 / (3.0 * counts[kinds]), dtype=np.float64)


_PRIOR = _prior()


def _squares(fits: CourseFits) -> Array:
    """Return sum of the squared residuals of each shape."""
    values = fits.centred[:, 0]
    left: Array = float(values @ values) - fits.slopes**2 * fits.spans
    return np.maximum(left, len(values) * ROUNDING**2)


def _crossed_by_shape(nights: Places, u: Array, y: Array, at: Array) -> tuple[Array, float]:
    """Return probability that a course has reached 1 at some positions, and that it rises."""
    freedom = len(u) - PARAMETERS
    columns = np.column_stack([np.ones(len(u)), y, _shapes(u).T])
    plain = CourseFits.of(columns)
    best = plain.residuals(int(np.argmin(_squares(plain))))
    fits = CourseFits.of(whiten(columns, estimated_phi(best, nights), nights))
    squares = _squares(fits)
    log_weights = np.log(_PRIOR / np.sqrt(fits.spans))
    log_weights -= TEMPERING * freedom / 2.0 * np.log(squares)
    weights = np.exp(log_weights - np.max(log_weights))
    weights /= weights.sum()
    variance = squares / freedom
    beyond = _shapes(at) - fits.middles[:, None]
    above = fits.level - 1.0 + fits.slopes[:, None] * beyond
    error = variance[:, None] * (1.0 / fits.length + beyond**2 / fits.spans[:, None])
    crossed: Array = weights @ stdtr(freedom, above / np.sqrt(error))
    rising = stdtr(freedom, fits.slopes * np.sqrt(fits.spans / variance))
    return crossed, float(weights @ rising)


def _crossed_by_jumps(u: Array, y: Array, ahead: Array) -> tuple[Array, float]:
    """Return probability that a gamma process on y^⅓ has reached 1 and how far it is from smooth.

    The latter is the variance of the increments of twelve means over that of noise alone. A means'
    increment of a process with the variance σ² a unit has the variance ⅔ σ² Δ. Noise comes from
    the nights next to each other, by medians, which jumps do not reach.
    """
    gaps = np.cbrt(y)
    ends = np.linspace(0, len(u), MEANS + 1).astype(np.intp)
    means, at = (np.add.reduceat(values, ends[:-1]) / np.diff(ends) for values in (gaps, u))
    span = float(at[-1] - at[0])
    apart = span / (MEANS - 1)
    drift = float(means[-1] - means[0]) / span
    noise = _variance_of_noise(gaps, round(len(u) / MEANS))
    increments = np.diff(means) - drift * np.diff(at)
    seen = float(increments @ increments) / (MEANS - 2)
    process = VARIANCE_BOUND * max(seen - 2.0 * noise, 0.0) * 1.5 / apart
    of_noise = seen / (2.0 * noise)
    left = 1.0 - float(means[-1]) - drift * float(1.0 - at[-1])
    if drift <= 0.0 or left <= 0.0:
        return np.full(len(ahead), float(left <= 0.0)), of_noise
    of_drift = (process * (span - apart / 3.0) + 2.0 * noise) / span**2
    # At once nothing has grown; a gamma distribution cannot say so.
    mean = drift * np.maximum(ahead, ROUNDING)
    variance = noise + process * (apart / 3.0 + ahead) + of_drift * ahead**2
    crossed: Array = gammaincc(mean**2 / variance, left * mean / variance)
    return crossed, of_noise


def _variance_of_noise(gaps: Array, several: int) -> float:
    """Return variance of a mean of several nights by noise alone, an autoregression."""
    first, second = (
        float(np.median((step - np.median(step)) ** 2)) * MAD_TO_SD**2
        for step in (np.diff(gaps), gaps[2:] - gaps[:-2])
    )
    first = max(first, ROUNDING**2)
    phi = min(max(second / first - 1.0, 0.0), HIGHEST_PHI)
    apart = np.abs(np.subtract.outer(np.arange(several), np.arange(several)))
    return first / (2.0 * (1.0 - phi)) * float(np.mean(phi**apart))


# Zeros of pressure and flow sensors
#
# In a halt without pressure, once it has settled, pressure difference and drain flow are zero, so
# what the sensors say is their error. A drift of 0.02 l/min moves the piston rings' K by 11 %: a
# sensor that drifts has to be named before wear is.

# Halts at the beginning, and as many at the end, that a drift is estimated from.
LEAST_HALTS = 5
MOST_HALTS = 30
COVERAGE = 0.95


@dataclass(frozen=True, slots=True)
class ZeroCourse:
    """Drift of a sensor's zero as known after each halt; shape (n,) each, nan below ten halts."""

    drifts: Mask  # True where the move is certain and beyond the tolerance.
    zero: Array  # Present zero [unit].
    # change, change_lower, change_upper: Present zero less initial zero, and its 95 % interval
    # [unit].
    change: Array
    change_lower: Array
    change_upper: Array


def zero_course(zeros: Array, errors: Array, tolerance: float) -> ZeroCourse:
    """Return drift of a sensor's zero since its first halts, halt by halt.

    From the means of the first and of the last halts, up to thirty each and without overlap, by
    Welch's t; the scatter between halts counts, and is at least that of the errors. The result
    after a halt depends only on that halt and those before it.

    `zeros, errors`: Zero and standard error of each halt since the sensor was last corrected, in
    order [unit], shape (n,); those that are not finite do not count, and keep the result before.
    `tolerance`: Stated tolerance of the sensor's zero [unit]: a smaller move is no drift, however
    certain.
    """
    counts = np.isfinite(zeros) & np.isfinite(errors)
    count = np.cumsum(counts, dtype=np.int64)
    # The last halt that counts is what each halt knows.
    last = np.maximum(count - 1, 0)
    size = np.minimum(count // 2, MOST_HALTS)
    known = size >= LEAST_HALTS
    size = np.where(known, size, LEAST_HALTS)
    if not counts.any():
        nothing = np.full(len(zeros), np.nan)
        return ZeroCourse(known, nothing, nothing, nothing, nothing)
    # The first, not their middle: what is known after a halt must not hang on later ones.
    reference = float(zeros[counts][0])
    value, square, square_error = (
        np.concatenate([[0.0], np.cumsum(part)])
        for part in (
            zeros[counts] - reference,
            (zeros[counts] - reference) ** 2,
            errors[counts] ** 2,
        )
    )

    def of_halts(first: Places, end: Places) -> tuple[Array, Array]:
        """Return mean of some halts, and its variance."""
        mean = (value[end] - value[first]) / size
        squares = square[end] - square[first] - size * mean**2
        scatter = np.maximum(squares / (size - 1), (square_error[end] - square_error[first]) / size)
        return mean, np.maximum(scatter, 0.0) / size

    end = np.minimum(last + 1, len(value) - 1)
    now, now_variance = of_halts(np.maximum(end - size, 0), end)
    before, before_variance = of_halts(np.zeros_like(size), np.minimum(size, len(value) - 1))
    change, variance = now - before, now_variance + before_variance
    # Welch and Satterthwaite, for groups of equal size.
    both = now_variance**2 + before_variance**2
    freedom = np.where(both > 0.0, (size - 1) * variance**2 / np.where(both > 0, both, 1), size - 1)
    reach = stdtrit(freedom, 0.5 + COVERAGE / 2) * np.sqrt(variance)

    def only(values: Array) -> Array:
        return np.where(known, values, np.nan)

    return ZeroCourse(
        drifts=known & (np.abs(change) > np.maximum(reach, tolerance)),
        zero=only(reference + now),
        change=only(change),
        change_lower=only(change - reach),
        change_upper=only(change + reach),
    )
