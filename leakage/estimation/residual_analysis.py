r"""Residual analysis: what is left in the errors of a fitted model, and does it follow an input?

With ε the prediction error y − ŷ and u an input, both without their means,

.. math::
    \hat R_\varepsilon(k) = \frac{1}{N_k} \sum \varepsilon(t)\,\varepsilon(t - k) ,\quad
    \hat R_{u\varepsilon}(k) = \frac{1}{N_k} \sum \varepsilon(t)\,u(t - k) ,

equations (27) and (26) of the thesis, over the N_k pairs of samples that are k apart [3]_.
Whiteness asks whether errors tell of later errors, independence whether inputs tell of errors; at a
positive lag the input is in the past. Each is judged by a figure, with a probability to be as
large by chance. The bands, which hold 99 % at each single lag, are for the eye.

**Whiteness.** The statistic of Ljung and Box [2]_,

.. math:: Q = \frac{N + 2}{N} \sum_{k=1}^{25} N_k\, \hat\rho_k^2 \sim \chi^2 .

**Independence.** If ε and u are independent, the variance of a cross-correlation is
:math:`P = \sum_\tau R_\varepsilon(\tau) R_u(\tau)` over N [1]_, and the covariance of two is
:math:`\Pi(j - k) = \sum_\tau w(\tau) R_\varepsilon(\tau) R_u(\tau + j - k)` over N. Let r be the
correlations at lags −25 to 25 over the N inner samples, those with 25 others on either side, so
that each lag has the same samples, and w(τ) the share of them that another follows after τ. Then

.. math:: T = N \sum_{i=1}^{m} \frac{(v_i^T r)^2}{\kappa_i \lambda_i} \sim \chi^2_m ,

λ and v the eigenvalues, above 10⁻³ of the largest, and eigenvectors of Π. Errors that are larger
when the input moves make correlations scatter more; with :math:`f_i` the weighted input of which
:math:`v_i^T r` is the mean product with ε, the factor
:math:`\kappa_i = \overline{e^2 f_i^2} / (\overline{\varepsilon^2}\,\overline{f_i^2})`, at least 1,
makes up for it [4]_; e is ε without its regression on all :math:`f_i`. An input that changes little
within 25 samples has 51 correlations that are nearly the same, and what a delay leaves is
in how they *differ*: the bands do not see it, T does.

References
----------
.. [1] L. Ljung, *System Identification: Theory for the User*, 2nd ed., 1999, section 16.6.
.. [2] G. M. Ljung and G. E. P. Box, "On a measure of lack of fit in time series models",
   *Biometrika*, 65(2), 1978.
.. [3] D. S. Stoffer and C. M. C. Toloi, "A note on the Ljung–Box–Pierce portmanteau statistic with
   missing data", *Statistics & Probability Letters*, 13(5), 1992.
.. [4] H. White, "A heteroskedasticity-consistent covariance matrix estimator and a direct test for
   heteroskedasticity", *Econometrica*, 48(4), 1980.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.special import chdtrc

from leakage.arrays import Array, Mask, Places
from leakage.estimation.validation import effective_sample_count

TOO_MANY_GAPS = "too few samples follow one another without a gap"
# Lags that are looked at: −25 to 25 of cross-correlations, 1 to 25 of the autocorrelation, as the
# thesis draws them; half-width of a normal 99 % band, and the probability beyond it.
LONGEST_LAG = 25
BAND, LEVEL = 2.576, 0.01
# Variances are summed over the first of these numbers of lags within which the correlations of the
# errors come to an end, or over the last.
SUMS = (300, 1200, 4800)
# Of more samples than these, evenly spread stretches are tested: so many tell all that matters.
STRETCHES, STRETCH = 8, 8192
# A lag with fewer pairs than this share of the samples goes into no sum and no statistic.
LEAST_PAIR_SHARE = 0.2
# P is not below this share of its first term: a sum of noisy correlations may be negative.
LEAST_VARIANCE = 0.1
# The independence statistic needs this share of samples with 25 others on either side.
LEAST_INNER_SHARE = 0.5
# Eigenvalues below this share of the largest are not known well enough to divide by.
LEAST_EIGENVALUE = 1e-3
# With fewer samples the statistics are not distributed as they should be, as simulated.
FEWEST_SAMPLES = 40 * LONGEST_LAG
# Samples that tell whether errors are larger where an input moves; evenly thinned, for time.
THINNED_SAMPLES = 2_000
PASSED, FAILED, NOT_TESTED = "passed", "failed", "not_tested"
# Errors, or an input, whose deviation is below this share of their mean do not vary.
CONSTANT = 1e-12
BOTH_WAYS = np.arange(-LONGEST_LAG, LONGEST_LAG + 1)


@dataclass(frozen=True, slots=True, eq=False)
class LagTest:
    """Correlations over lags with their band, and a figure that judges them together."""

    # Shape (k,), in samples; at a positive lag the input is in the past. Empty where nothing
    # could be computed.
    lags: Places
    # Correlations, shape (k,); nan at a lag with fewer pairs than a fifth of the samples.
    values: Array
    # 99 % of correlations of independent errors lie within ± this, each by itself; nan where
    # there is no value, and at lag 0 of the autocorrelation, which is 1.
    bounds: Array
    # Probability that independent errors give a larger figure; None where not tested.
    p_value: float | None = None
    reason: str | None = None  # why it was not tested; None where it was

    @classmethod
    def untested(cls, reason: str) -> LagTest:
        """Return a test that could not be made."""
        return cls(np.empty(0, np.int64), np.empty(0), np.empty(0), reason=reason)

    @property
    def verdict(self) -> str:
        """Return passed, failed (at the level of 1 %) or not_tested."""
        if self.p_value is None:
            return NOT_TESTED
        return FAILED if self.p_value < LEVEL else PASSED

    @property
    def largest(self) -> tuple[int, float] | None:
        """Return lag and value of the largest correlation in size, among lags with a band."""
        size = np.where(np.isfinite(self.bounds), np.abs(self.values), -1.0)
        if not (size >= 0.0).any():
            return None
        place = int(size.argmax())
        return int(self.lags[place]), float(self.values[place])


@dataclass(frozen=True, slots=True, eq=False)
class ResidualAnalysis:
    """Results of the residual tests of a model on some samples."""

    n: int  # number of samples
    whiteness: LagTest  # autocorrelation of the errors
    independence: Mapping[str, LagTest]  # cross-correlation with each input, by its name
    # Equivalent number of independent samples, by the sum of the errors' correlations; None
    # where they remember for longer than can be estimated, or are not tested.
    n_effective: float | None

    @property
    def memory(self) -> float | None:
        """Return the sum of the errors' correlations from lag 1 on [samples].

        For a first-order autoregression it is about the time in which it falls to 1/e.
        """
        return None if self.n_effective is None else (self.n / self.n_effective - 1.0) / 2.0


def analyse_residuals(
    error: Array, inputs: Mapping[str, Array], index: Places, rounding: float = 0.0
) -> ResidualAnalysis:
    """Test the errors of a model for whiteness and for independence of its inputs.

    `benchmarks/results/residual_tests.md` says how often errors that are independent are judged
    not to be. Residuals of samples that a model was fitted to are orthogonal to its regressors, so
    on training samples failures by chance are rarer.

    `error, inputs`: Prediction errors y − ŷ in time order [l/min], and inputs by name, shape (n,)
    each.
    `index`: Place of each sample on an even time base, increasing, shape (n,); where it jumps is a
    gap.
    `rounding`: Errors of this size are rounding, and not tested [l/min].
    """
    n, reason = len(error), ""
    if n < FEWEST_SAMPLES:
        reason = f"{n} samples, {FEWEST_SAMPLES} are needed"
    elif np.ptp(error) <= 2.0 * max(rounding, CONSTANT * float(np.abs(error).max())):
        reason = "the errors are rounding"
    if reason:
        nothing = LagTest.untested(reason)
        return ResidualAnalysis(n, nothing, dict.fromkeys(inputs, nothing), None)
    some = _choose_tested(n)
    errors = _Errors.of(error[some], index[some])
    effective = errors.effective_share
    return ResidualAnalysis(
        n,
        _whiteness(errors),
        {name: _independence(errors, values[some]) for name, values in inputs.items()},
        None if effective is None else n * effective,
    )


def _choose_tested(n: int) -> Places | slice:
    """Return the samples that are tested: all, or evenly spread stretches of very many."""
    if n <= STRETCHES * STRETCH:
        return slice(None)
    begins = np.linspace(0, n - STRETCH, STRETCHES).round().astype(np.int64)
    return (begins[:, None] + np.arange(STRETCH)).ravel()


class _Spectra:
    """A series on the time base, 0 where no sample is, transformed piece by piece."""

    def __init__(self, series: Array, longest_lag: int) -> None:
        size = max(4096, 1 << (4 * longest_lag).bit_length())
        step = size - longest_lag
        n_rows = -(-len(series) // step)
        padded = np.zeros(n_rows * step + longest_lag)
        padded[: len(series)] = series
        self.size, self.longest_lag = size, longest_lag
        # Conjugates of pieces alone, and pieces with what follows: each pair is in a product once.
        self.pieces = np.fft.rfft(padded[: n_rows * step].reshape(n_rows, step), size)
        np.conjugate(self.pieces, out=self.pieces)
        self.with_next = np.fft.rfft(sliding_window_view(padded, size)[::step])

    def products(self, other: _Spectra) -> Array:
        """Return Σ a(t) b(t + k) for k from 0 to the longest lag."""
        product = np.einsum("rf,rf->f", self.pieces, other.with_next)
        sums: Array = np.fft.irfft(product, self.size)[: self.longest_lag + 1]
        return sums

    def products_both_ways(self, other: _Spectra) -> Array:
        """Return Σ a(t) b(t − k) for k from −25 to 25."""
        ahead, behind = self.products(other), other.products(self)
        return np.concatenate([ahead[LONGEST_LAG:0:-1], behind[: LONGEST_LAG + 1]])


@dataclass(frozen=True, slots=True, eq=False)
class _Errors:
    """Errors on their time base, what they tell of themselves, and where an input is needed."""

    place: Places  # of each sample on the time base, shape (n,)
    scaled: Array  # errors without their mean, of variance 1, shape (n,)
    spectra: _Spectra
    pairs: Array  # N_k, shape (k,)
    is_known: Mask  # lags of which enough pairs tell, shape (k,)
    correlations: Array  # 0 where too few pairs tell, shape (k,)
    effective_share: float | None  # independent samples, over all; None if not to be estimated
    # Inner samples on the time base; how many of them another follows, shape (51,); the
    # spectra of their errors; and places of some of them.
    n_inner: int
    follows: Array
    spectra_inside: _Spectra
    thinned: Places

    @classmethod
    def of(cls, error: Array, index: Places) -> _Errors:
        n = len(error)
        # A gap beyond all lags need not be as long as it was.
        steps = np.minimum(np.diff(index, prepend=index[:1]), SUMS[-1] + 2 * LONGEST_LAG + 1)
        place = LONGEST_LAG + np.cumsum(steps)
        scaled = (error - error.mean()) / error.std()
        present, series = _on_grid(np.ones(n), place), _on_grid(scaled, place)
        # Sums over many more lags than the errors remember add noise alone.
        for summed in SUMS:
            longest = min(summed, n // 4) + 2 * LONGEST_LAG
            there, spectra = _Spectra(present, longest), _Spectra(series, longest)
            pairs = np.round(there.products(there))
            is_known = pairs >= LEAST_PAIR_SHARE * n
            products = spectra.products(spectra)
            correlations = np.where(is_known, products / np.maximum(pairs, 1.0), 0.0)
            n_effective = effective_sample_count(n, correlations[is_known])
            if n_effective is not None:
                break
        around = np.convolve(present, np.ones(2 * LONGEST_LAG + 1), "same")
        inner = around > 2 * LONGEST_LAG + 0.5
        places = np.flatnonzero(inner)
        inside = _Spectra(inner.astype(np.float64), longest)
        some = np.linspace(0, len(places) - 1, min(THINNED_SAMPLES, len(places)))
        return cls(
            place=place,
            scaled=scaled,
            spectra=spectra,
            pairs=pairs,
            is_known=is_known,
            correlations=correlations,
            effective_share=None if n_effective is None else n_effective / n,
            n_inner=len(places),
            follows=inside.products(inside)[: 2 * LONGEST_LAG + 1],
            spectra_inside=_Spectra(np.where(inner, series, 0.0), longest),
            thinned=places[some.round().astype(np.int64)],
        )


def _on_grid(values: Array, place: Places) -> Array:
    series = np.zeros(int(place[-1]) + LONGEST_LAG + 1)
    series[place] = values
    return series


def _whiteness(errors: _Errors) -> LagTest:
    lags = np.arange(LONGEST_LAG + 1)
    n, pairs, is_known = errors.pairs[0], errors.pairs[lags], errors.is_known[lags]
    tested = is_known & (lags > 0)
    values = np.where(is_known, errors.correlations[lags], np.nan)
    bounds = np.where(tested, BAND / np.sqrt(np.maximum(pairs, 1.0)), np.nan)
    if not tested.any():
        return LagTest(lags, values, bounds, reason=TOO_MANY_GAPS)
    statistic = float((n + 2.0) / n * (pairs[tested] @ values[tested] ** 2))
    return LagTest(lags, values, bounds, float(chdtrc(tested.sum(), statistic)))


def _independence(errors: _Errors, values: Array) -> LagTest:
    spread = float(values.std())
    if spread <= CONSTANT * float(np.abs(values).max()):
        return LagTest.untested("the input does not vary")
    series = _on_grid((values - values.mean()) / spread, errors.place)
    spectra = _Spectra(series, errors.spectra.longest_lag)
    pairs, is_known = errors.pairs[np.abs(BOTH_WAYS)], errors.is_known[np.abs(BOTH_WAYS)]
    own = spectra.products(spectra) / np.maximum(errors.pairs, 1.0)
    own[~errors.is_known] = 0.0
    crossed = np.where(
        is_known, errors.spectra.products_both_ways(spectra) / np.maximum(pairs, 1.0), np.nan
    )
    variance = max(1.0 + 2.0 * float(errors.correlations[1:] @ own[1:]), LEAST_VARIANCE)
    bounds = np.where(is_known, BAND * np.sqrt(variance / np.maximum(pairs, 1.0)), np.nan)
    if errors.n_inner < LEAST_INNER_SHARE * errors.pairs[0]:
        return LagTest(BOTH_WAYS, crossed, bounds, reason=TOO_MANY_GAPS)
    covariances = _covariances(errors, own)
    size, axes = np.linalg.eigh(covariances[np.abs(BOTH_WAYS[:, None] - BOTH_WAYS)])
    clear = size > LEAST_EIGENVALUE * size[-1]
    size, axes = size[clear], axes[:, clear]
    components = axes.T @ errors.spectra_inside.products_both_ways(spectra)
    scatter = size * _uneven_variance(errors, series, axes)
    statistic = float(np.sum(components**2 / scatter) / errors.n_inner)
    return LagTest(BOTH_WAYS, crossed, bounds, float(chdtrc(len(size), statistic)))


def _covariances(errors: _Errors, own: Array) -> Array:
    """Return Π(0) to Π(50), of errors and input scaled to variances of 1."""
    longest, reach = 2 * LONGEST_LAG, len(own) - 1
    lags = np.arange(longest - reach, reach - longest + 1)
    # Around a gap no sample is an inner sample for 51 places: farther off, the share is as good as
    # even.
    followed = errors.follows[np.minimum(np.abs(lags), longest)] / errors.n_inner
    both_ways = np.correlate(
        own[np.abs(np.arange(-reach, reach + 1))],
        followed * errors.correlations[np.abs(lags)],
        "valid",
    )
    covariances: Array = both_ways[longest:]
    covariances[0] = max(covariances[0], LEAST_VARIANCE)
    return covariances


def _uneven_variance(errors: _Errors, series: Array, axes: Array) -> Array:
    """Return κ of each component: its scatter where errors are larger as it is, shape (m,)."""
    windows = sliding_window_view(series, 2 * LONGEST_LAG + 1)[errors.thinned - LONGEST_LAG]
    # The axes of a symmetric Toeplitz matrix are the same from either end, but for their signs.
    weighted = windows @ axes
    at = np.searchsorted(errors.place, errors.thinned)
    error, squares = errors.scaled[at], weighted**2
    # What follows the input is what is tested for, not scatter.
    rest = error - weighted @ np.linalg.lstsq(weighted, error, rcond=None)[0]
    apart = (error @ error) * squares.mean(axis=0)
    together = np.divide(rest**2 @ squares, apart, out=np.ones(len(apart)), where=apart > 0)
    uneven: Array = np.maximum(together, 1.0)
    return uneven
