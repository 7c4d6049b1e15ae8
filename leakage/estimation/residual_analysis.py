r"""Residual analysis: what is left in the errors of a fitted model, and does it follow an input?

With ε the prediction error y − ŷ and u an input, both without their means,

.. math::
    \hat R_\varepsilon(k) = \frac{1}{N_k} \sum \varepsilon(t)\,\varepsilon(t - k) ,\quad
    \hat R_{u\varepsilon}(k) = \frac{1}{N_k} \sum \varepsilon(t)\,u(t - k) ,

(27) and (26), over the N_k pairs of samples that are k apart with no gap between them. Whiteness
asks whether errors tell of later errors, independence whether inputs tell of errors; at a positive
lag the input is the past one. Each is judged by one figure, with a probability to be as large by
chance. The bands, which hold 99 % at each single lag, are for the eye.

**Whiteness.** The statistic of Ljung and Box [2]_, of which the correlations over existing pairs
are the form for series with gaps [3]_,

.. math:: Q = \frac{N + 2}{N} \sum_{k=1}^{25} N_k\, \hat\rho_k^2 \sim \chi^2 .

**Independence.** If ε and u are independent, the variance of a cross-correlation is
:math:`P = \sum_\tau R_\varepsilon(\tau) R_u(\tau)` over N [1]_ [4]_, and the covariance of two is
:math:`\Pi(j - k) = \sum_\tau w(\tau) R_\varepsilon(\tau) R_u(\tau + j - k)` over N. Let r be the
correlations at lags −25 to 25 over the N samples that are 25 or more from the ends of their
segment, so that each lag has the same ones, and w(τ) the share of those samples that another one
follows after τ. Then

.. math:: T = N \sum_{i=1}^{m} \frac{(v_i^T r)^2}{\kappa_i \lambda_i} \sim \chi^2_m ,

λ and v the eigenvalues, above 10⁻³ of the largest, and eigenvectors of Π. Errors that are larger
when the input moves make correlations scatter more; with :math:`f_i` the weighted input of which
:math:`v_i^T r` is the mean product with ε, the factor
:math:`\kappa_i = \overline{e^2 f_i^2} / (\overline{\varepsilon^2}\,\overline{f_i^2})`, at least 1,
makes up for it [6]_; e is ε without its regression on all :math:`f_i`. For two white series of even
variance T is N Σ r² [5]_. An input that changes little within 25 samples has 51 correlations that
are nearly one and the same, and what a delay leaves is in how they *differ*: the bands do not see
it, T does.

References
----------
.. [1] L. Ljung, *System Identification: Theory for the User*, 2nd ed., 1999, section 16.6.
.. [2] G. M. Ljung and G. E. P. Box, "On a measure of lack of fit in time series models",
   *Biometrika*, 65(2), 1978.
.. [3] D. S. Stoffer and C. M. C. Toloi, "A note on the Ljung–Box–Pierce portmanteau statistic with
   missing data", *Statistics & Probability Letters*, 13(5), 1992.
.. [4] M. S. Bartlett, "Some aspects of the time-correlation problem in regard to tests of
   significance", *Journal of the Royal Statistical Society*, 98(3), 1935.
.. [5] L. D. Haugh, "Checking the independence of two covariance-stationary time series: a
   univariate residual cross-correlation approach", *JASA*, 71(354), 1976.
.. [6] H. White, "A heteroskedasticity-consistent covariance matrix estimator and a direct test for
   heteroskedasticity", *Econometrica*, 48(4), 1980.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from leakage.arrays import Array, Mask, Places
from leakage.errors import ShapeError, StatisticsError
from leakage.estimation.choices import (
    BAND,
    FEWEST_SAMPLES,
    LEAST_EIGENVALUE,
    LEAST_INNER_SHARE,
    LEAST_VARIANCE,
    LEVEL,
    LONGEST_LAG,
)
from leakage.estimation.lagged_products import Segments
from leakage.estimation.residual_moments import ResidualMoments
from leakage.estimation.validation import (
    ROUNDING,
    lag_one_autocorrelation,
    summed_effective_sample_count,
)

TOO_MANY_GAPS = "too few samples follow one another without a gap"
PASSED, FAILED, NOT_TESTED = "passed", "failed", "not_tested"


@dataclass(frozen=True, slots=True, eq=False)
class LagTest:
    """Correlations over lags with their band, and one figure that judges them together."""

    # Shape (k,), in samples; at a positive one the input is the past one. Empty where nothing
    # could be computed.
    lags: Places
    # Correlations, shape (k,); nan at a lag with fewer pairs than a fifth of the samples.
    values: Array
    # 99 % of correlations of independent errors lie within ± this, each by itself; nan where
    # there is no value, and at lag 0 of the autocorrelation, which is 1.
    bounds: Array
    # statistic, degrees_of_freedom, p_value: Q or T, of its chi-square distribution the
    # degrees of freedom, and the probability that independent errors give a larger one; None
    # where not tested.
    statistic: float | None = None
    degrees_of_freedom: int | None = None
    p_value: float | None = None
    reason: str | None = None  # why it was not tested; None where it was

    @property
    def verdict(self) -> str:
        """passed, failed (at the level of 1 %) or not_tested."""
        if self.p_value is None:
            return NOT_TESTED
        return FAILED if self.p_value < LEVEL else PASSED

    @property
    def outside(self) -> Mask:
        """Mask of the correlations outside the band, shape (k,)."""
        result: Mask = np.abs(self.values) > self.bounds
        return result

    @property
    def n_judged(self) -> int:
        """Number of lags with a band; of independent errors 1 % of them lie outside."""
        return int(np.isfinite(self.bounds).sum())

    @property
    def largest(self) -> tuple[int, float] | None:
        """Lag and value of the largest correlation in size, among lags with a band."""
        if not self.n_judged:
            return None
        judged = np.where(np.isfinite(self.bounds), np.abs(self.values), -1.0)
        place = int(judged.argmax())
        return int(self.lags[place]), float(self.values[place])


@dataclass(frozen=True, slots=True, eq=False)
class ResidualAnalysis:
    """Results of the residual tests of a model on some samples."""

    n: int  # number of samples
    mean_l_per_min: float  # mean error, which the tests leave out [l/min]; nan without samples
    whiteness: LagTest  # autocorrelation of the errors
    independence: Mapping[str, LagTest]  # cross-correlation with each input, by its name
    # Equivalent number of independent samples, by the sum of the errors' correlations; None
    # if the correlation time is too long to be estimated.
    n_effective: float | None
    # Correlation of each error with the one before it; None where there is no pair, or no
    # spread.
    lag_one_autocorrelation: float | None


def analyse_residuals(
    error: Array,
    inputs: Mapping[str, Array],
    index: Places,
    correlation_time: float = 0.0,
    rounding: float = 0.0,
) -> ResidualAnalysis:
    """Test the errors of a model for whiteness and for independence of its inputs.

    `benchmarks/results/residual_tests.md` says how often errors that are independent are judged
    not to be. Residuals of samples that a model was fitted to are orthogonal to its regressors, so
    on training samples failures by chance are rarer.

    `error, inputs`: Prediction errors y − ŷ in time order [l/min], and inputs by name, shape (n,)
    each.
    `index`: Place of each sample on an even time base, increasing, shape (n,); where it jumps is a
    gap.
    `correlation_time`: How long the errors remember [samples], may be infinite; variances are
    summed over ten times as many lags.
    `rounding`: Errors of this size are rounding, and not tested [l/min].

    Raises ShapeError, StatisticsError: ``shape``: the arrays differ in length; ``not_finite``.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> speed = rng.normal(size=5000)
    >>> error = 0.1 * np.roll(speed, 3) + rng.normal(size=5000)
    >>> found = analyse_residuals(error, {"speed": speed}, np.arange(5000))
    >>> found.whiteness.verdict, found.independence["speed"].verdict
    ('passed', 'failed')
    """
    shapes = {np.shape(one) for one in (error, index, *inputs.values())}
    if len(shapes) > 1 or np.ndim(error) != 1:
        raise ShapeError("shape", f"error, index and inputs must be of one length, got {shapes}")
    n, segments = len(error), Segments.of(index)
    # A mean is finite if all values are.
    means = [float(one.mean()) if n else math.nan for one in (error, *inputs.values())]
    if n and not np.isfinite(means).all():
        raise StatisticsError("not_finite", "errors or inputs hold a value that is not finite")
    lag_one = lag_one_autocorrelation(error, segments.begins)
    reason = _untestable(error, means[0], rounding)
    if reason is not None:
        nothing = _untested(reason)
        return ResidualAnalysis(n, means[0], nothing, dict.fromkeys(inputs, nothing), None, lag_one)
    moments = ResidualMoments.of([error, *inputs.values()], means, segments, correlation_time)
    constant = _untested("the input does not vary")
    return ResidualAnalysis(
        n,
        means[0],
        _whiteness(moments),
        {
            name: _independence(moments, place) if varies else constant
            for place, (name, varies) in enumerate(zip(inputs, moments.varies, strict=True))
        },
        summed_effective_sample_count(n, moments.error[moments.told]),
        lag_one,
    )


def _untestable(error: Array, mean: float, rounding: float) -> str | None:
    if len(error) < FEWEST_SAMPLES:
        return f"{len(error)} samples, {FEWEST_SAMPLES} are needed"
    lowest, highest = float(error.min()), float(error.max())
    if max(highest - mean, mean - lowest) <= max(rounding, ROUNDING * max(highest, -lowest)):
        return "the errors are rounding"
    return None


def _untested(reason: str) -> LagTest:
    empty = np.empty(0)
    return LagTest(np.empty(0, dtype=np.int64), empty, empty, reason=reason)


def _whiteness(moments: ResidualMoments) -> LagTest:
    lags = np.arange(LONGEST_LAG + 1)
    n, pairs = moments.pairs[0], moments.pairs[lags]
    judged = moments.told[lags] & (lags > 0)
    values = np.where(moments.told[lags], moments.error[lags], np.nan)
    bounds = np.where(judged, BAND / np.sqrt(np.maximum(pairs, 1.0)), np.nan)
    freedom = int(judged.sum())
    if not freedom:
        return LagTest(lags, values, bounds, reason=TOO_MANY_GAPS)
    statistic = float((n + 2.0) / n * (pairs[judged] @ values[judged] ** 2))
    return LagTest(lags, values, bounds, statistic, freedom, float(chdtrc(freedom, statistic)))


def _independence(moments: ResidualMoments, place: int) -> LagTest:
    lags = np.arange(-LONGEST_LAG, LONGEST_LAG + 1)
    n, pairs = moments.pairs[0], np.maximum(moments.pairs[np.abs(lags)], 1.0)
    told = moments.told[np.abs(lags)]
    values = np.where(told, moments.crossed[place] / pairs, np.nan)
    bounds = np.where(told, BAND * np.sqrt(_variance(moments, place) / pairs), np.nan)
    inner = moments.inner[0]
    if inner < LEAST_INNER_SHARE * n:
        return LagTest(lags, values, bounds, reason=TOO_MANY_GAPS)
    size, axes = np.linalg.eigh(_covariances(moments, place)[np.abs(lags[:, None] - lags)])
    known = size > LEAST_EIGENVALUE * size[-1]
    components = axes[:, known].T @ moments.crossed_inside[place]
    scatter = size[known] * _uneven_variance(moments, place, axes[:, known])
    statistic = float(np.sum(components**2 / scatter) / inner)
    freedom = int(known.sum())
    return LagTest(lags, values, bounds, statistic, freedom, float(chdtrc(freedom, statistic)))


def _uneven_variance(moments: ResidualMoments, place: int, axes: Array) -> Array:
    """κ of each component: its scatter where errors are larger as it is, shape (m,)."""
    # Lag −25 is the input 25 samples later, which stands last.
    weighted = moments.thinned_inputs[place] @ np.ascontiguousarray(axes[::-1])
    error, squares = moments.thinned_error, weighted**2
    # What follows the input is what is tested for, not scatter.
    rest = error - weighted @ np.linalg.lstsq(weighted, error, rcond=None)[0]
    apart = (error @ error) * squares.mean(axis=0)
    together = np.divide(rest**2 @ squares, apart, out=np.ones(len(apart)), where=apart > 0)
    found: Array = np.maximum(together, 1.0)
    return found


def _variance(moments: ResidualMoments, place: int) -> float:
    """P, of errors and input scaled to variances of 1."""
    within = slice(1, moments.longest_sum + 1)
    later = float(moments.error[within] @ moments.inputs[place, within])
    return max(1.0 + 2.0 * later, LEAST_VARIANCE)


def _covariances(moments: ResidualMoments, place: int) -> Array:
    """Π(0) to Π(50), of errors and input scaled to variances of 1."""
    longest = 2 * LONGEST_LAG
    lags = np.arange(-moments.longest_sum, moments.longest_sum + 1)
    # Around a gap no sample is an inner one for 51 places: farther off, the share is as good as
    # even.
    followed = moments.inner[np.minimum(np.abs(lags), longest)] / moments.inner[0]
    reach = np.arange(lags[0] - longest, lags[-1] + longest + 1)
    both_ways = np.correlate(
        moments.inputs[place, np.abs(reach)], followed * moments.error[np.abs(lags)], "valid"
    )
    covariances: Array = both_ways[longest:]
    covariances[0] = max(covariances[0], LEAST_VARIANCE)
    return covariances
