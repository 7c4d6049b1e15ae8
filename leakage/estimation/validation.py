"""Quality of a fitted model: fit percent, prediction error, information criteria (2.5.5–2.5.9).

All figures come from the triangular factor of the samples, so judging last night's model on
the newest night's samples costs a product.

Source: the thesis, equations (23) and (25).

References
----------
.. [2] K. P. Burnham and D. R. Anderson, *Model Selection and Multimodel Inference*, 2nd ed., 2002.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from leakage.arrays import Array
from leakage.estimation.blocks import factor, sample_count, squared_error

# A fit below it is poor: the mean of the samples judged describes them better than the model.
POOR_FIT_PERCENT = 0.0


@dataclass(frozen=True, slots=True)
class Agreement:
    """Agreement of a model with some samples."""

    n: int  # number of samples
    # 100 (1 − ‖y − ŷ‖/‖y − ȳ‖) [%], (23); None if the flow varies no more than its
    # resolution.
    fit_percent: float | None
    rmse_l_per_min: float | None  # root mean squared prediction error [l/min]; None without samples
    # Mean of y − ŷ [l/min]: positive where more was measured than predicted; None without
    # samples.
    mean_error_l_per_min: float | None


def agreement(r: Array, coefficients: Array, resolution_l_per_min: float = 0.0) -> Agreement:
    """Return fit percent (23), root mean squared and mean error of a model on some samples.

    The fit is at most 100 and negative where the model is worse than the mean of the data (the
    thesis reads that as 0; the sign is kept, it tells how bad). It is None where ‖y − ȳ‖ is not
    above the sensor's resolution times √N.
    """
    n = sample_count(r)
    if not n:
        return Agreement(0, None, None, None)
    error, root_n = math.sqrt(squared_error(r, coefficients)), math.sqrt(n)
    mean_error = -float((r[:, -3] @ r / n) @ np.concatenate([coefficients, (1.0, -1.0)]))
    # By a QR of the columns 1 and y: R'R would lose half of the digits of the spread.
    (root, total), (_, spread) = factor(r[:, [-3, -1]]).tolist()
    floor = max(resolution_l_per_min * root_n, 1e-12 * abs(total / root) * root_n)
    fit = 100.0 * (1.0 - error / spread) if spread > floor else None
    return Agreement(n, fit, error / root_n, mean_error)


def is_poor(fit_percent: float | None) -> bool:
    """Return True if a fit is worse than that of a constant flow; False if there is no fit."""
    return fit_percent is not None and fit_percent < POOR_FIT_PERCENT


@dataclass(frozen=True, slots=True)
class Criteria:
    """Prediction error and information criteria; None where N leaves them undefined."""

    fpe: float | None
    aic: float | None
    aicc: float | None
    bic: float | None


def criteria(cost: float, d: int, n: float) -> Criteria:
    r"""Return FPE (25) [(l/min)²], AIC, AICc and BIC [2]_ of a least squares fit.

    .. math::
        FPE = V\frac{1 + d/N}{1 - d/N},\quad AIC = N\ln V + 2d + N(\ln 2\pi + 1),

        AICc = AIC + \frac{2d(d+1)}{N-d-1},\quad BIC = N\ln V + N(\ln 2\pi + 1) + d\ln N .

    `cost` is V of the training samples, `d` the rank of the regressors of the coefficients off
    their bounds: what was fitted, whether or not the samples tell the coefficients apart; `n` the
    number of training samples, or their effective number where residuals are correlated.
    """
    if not (cost > 0.0 and n > d):
        return Criteria(None, None, None, None)
    fpe = cost * (1 + d / n) / (1 - d / n)
    likelihood = n * math.log(cost) + n * (math.log(2 * math.pi) + 1)
    aic = likelihood + 2 * d
    aicc = aic + 2 * d * (d + 1) / (n - d - 1) if n > d + 1 else None
    return Criteria(fpe, aic, aicc, likelihood + d * math.log(n))


def effective_sample_count(n: int, autocorrelation: Array) -> float | None:
    """Return N / (1 + 2 Σ ρ(k)), the number of independent samples that carry as much, at most N.

    All correlations count: white noise on top of a slow error lowers that of neighbours. None where
    they do not come to an end within the lags given, from ρ(0).

    Notes
    -----
    The sum ends before the first ρ(2m) + ρ(2m + 1) that is not positive [1]_: from there on the
    estimates are noise.

    References
    ----------
    .. [1] C. J. Geyer, "Practical Markov chain Monte Carlo", *Statistical Science*, 7(4), 1992:
       initial positive sequence.
    """
    whole = len(autocorrelation) // 2 * 2
    sums = autocorrelation[:whole].reshape(-1, 2).sum(axis=1)
    ended = np.flatnonzero(sums <= 0.0)
    if not len(ended):
        return None
    inflation = 2.0 * float(sums[: ended[0]].sum()) - 1.0
    return n / max(inflation, 1.0)
