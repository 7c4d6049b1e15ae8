r"""Slow change, found early: Page's one-sided cumulative sum on whitened nights.

With μ₀, σ and φ of the frozen baseline (its floored ones), and Δt nights to the good night before,

.. math::
    z_t = \frac{x_t - \mu_0}{\sigma}, \qquad \rho_t = \varphi^{\Delta t}, \qquad
    w_t = \left[\frac{z_t - \rho_t z_{t-1}}{\sqrt{1 - \rho_t^2}}\right]_{-4}^{4}, \qquad
    S_t = \max(0, S_{t-1} + w_t - k_t)

and a change is told when S exceeds its limit h [1]_. A baseline's mean is off by some standard
errors, for good: through the whitening, an error δ of the mean adds
:math:`g_t \delta / \sigma, g_t = \sqrt{(1 - \rho_t)/(1 + \rho_t)}` to every night. So

.. math:: k_t = 0.25 + 3\, g_t\, \frac{s(\mu_0)}{\sigma} ,

which on even nights is close to :math:`0.25 + 3/\sqrt{n}` for n nights of baseline, whatever φ.
Textbook limits hold for known μ₀, σ and φ; these are calibrated by simulation for estimated ones.

References
----------
.. [1] E. S. Page, "Continuous inspection schemes", *Biometrika*, 41(1/2), 1954.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from leakage.course.autoregression import Array, Nights, correlation_to_previous, whitened
from leakage.course.baseline import Baseline
from leakage.course.cusum_limits import FLOOR_LIMITS, LENGTHS, LIMITS, PHI, RATES
from leakage.course.slope import check_series
from leakage.errors import ParameterError

# The limits are calibrated for these three; `python -m benchmarks cusum_limits` does it anew.
REFERENCE_VALUE: Final = 0.25
BASELINE_ERRORS: Final = 3.0
WINSORISED_AT: Final = 4.0
# Upper bound of the nights' standard deviation over the floored one, up to which the floor alone
# decides, and from which on the nights do: simulated rates stay below what is asked for between.
FLOOR_DECIDES: Final = 0.5
NIGHTS_DECIDE: Final = 1.0

_LOG_RATES = np.log(RATES)
# Rising with the length; a limit is close to linear in the error of the baseline.
_ROOT_LENGTHS = -1.0 / np.sqrt(LENGTHS)
_PHI = np.array(PHI)
_LOG_LIMITS = np.log(LIMITS)
_LOG_FLOOR_LIMITS = np.log(FLOOR_LIMITS)
_DECIDES = np.array([FLOOR_DECIDES, NIGHTS_DECIDE])


@dataclass(frozen=True, slots=True)
class Cusum:
    """Cumulative sum of a series.

    Attributes
    ----------
    statistic
        S of each night, shape (n,); nan in the baseline and on nights without a value.
    is_on
        Whether a change stands told, shape (n,); a night without a value keeps what was.
    onset
        Place in the series of the first night after S was last 0, where a change stands told, shape
        (n,); −1 elsewhere. It estimates when the change began.
    """

    statistic: Array
    is_on: NDArray[np.bool_]
    onset: NDArray[np.int64]


def cusum(nights: Nights, values: Array, baseline: Baseline, limit: float) -> Cusum:
    """Cumulative sum of the nights after a baseline, with its way back.

    Parameters
    ----------
    nights
        Numbers of the nights, increasing, shape (n,).
    values
        Indicator, shape (n,); nights that are not finite do not count.
    baseline
        Of this series; nights up to its last one are passed over.
    limit
        h, from :func:`cusum_limit`.

    Returns
    -------
    Cusum
        Never on without a baseline. Once above h, S counts on from 2h, its ceiling, and the change
        is taken back when it has fallen to h; S then starts anew from 0. So a lasting change stays
        told however long it lasts, and one that is undone is taken back as soon as one that
        appears is told.

    Raises
    ------
    ShapeError
        ``shape`` or ``night_order``.

    Examples
    --------
    >>> from leakage.course.baseline import fit_baseline
    >>> generator = np.random.default_rng(1)
    >>> nights = np.arange(120)
    >>> values = 1.0 + 0.005 * generator.standard_normal(120) + 0.05 * (nights >= 90)
    >>> found = cusum(nights, values, fit_baseline(nights, values), limit=12.0)
    >>> int(nights[found.is_on][0]), int(found.onset[-1])
    (93, 90)
    """
    check_series(nights, values)
    statistic = np.full(len(nights), np.nan)
    is_on = np.zeros(len(nights), dtype=np.bool_)
    onset = np.full(len(nights), -1, dtype=np.int64)
    watched = np.flatnonzero(np.isfinite(values) & (nights >= baseline.last_night))
    # The last night of the baseline whitens the first after it, and has no sum of its own.
    if baseline.status == "insufficient" or len(watched) < 2:
        return Cusum(statistic, is_on, onset)
    steps = _steps(nights[watched], values[watched], baseline)[1:]
    watched = watched[1:]
    sums, on, began = _with_way_back(steps, limit)
    statistic[watched] = sums
    held = np.searchsorted(watched, np.arange(len(nights)), side="right") - 1
    seen = held >= 0
    is_on[seen] = on[held[seen]]
    onset[seen] = np.where(on, watched[began], -1)[held[seen]]
    return Cusum(statistic, is_on, onset)


@lru_cache(maxsize=64)
def cusum_limit(false_alarms_per_year: float, baseline: Baseline) -> float:
    """Limit h at which a healthy indicator is told changed no more often than asked for.

    Parameters
    ----------
    false_alarms_per_year
        Rate that one indicator may have, 0.002 to 0.1 a year of nights.
    baseline
        Of at least 30 good nights; beyond 120 the limit of 120 is used, which is then on the safe
        side.

    Returns
    -------
    float
        h. Where the nights may scatter as much as their floor, it covers the errors of their
        standard deviation and φ, and holds whatever the true φ up to 0.6; where the floor is well
        above them, only the error of the mean is left, and h is lower.
        `benchmarks/results/cusum_limits.md` has the rates, and what becomes of them beyond 0.6.

    Raises
    ------
    ParameterError
        ``alarm_rate``.

    Examples
    --------
    >>> from leakage.course.baseline import BaselineSettings, fit_baseline
    >>> values = 1.0 + 0.02 * np.random.default_rng(1).standard_normal(60)
    >>> with_floor = fit_baseline(np.arange(60), values, BaselineSettings(relative_floor=0.05))
    >>> without = fit_baseline(np.arange(60), values, BaselineSettings(relative_floor=0.0))
    >>> cusum_limit(0.02, with_floor) < cusum_limit(0.02, without) < cusum_limit(0.01, without)
    True
    """
    if not RATES[0] <= false_alarms_per_year <= RATES[-1] or baseline.n < LENGTHS[0]:
        raise ParameterError(
            "alarm_rate",
            f"{false_alarms_per_year:g} false alarms a year with a baseline of {baseline.n} "
            f"nights; limits are calibrated for {RATES[0]:g} to {RATES[-1]:g} a year and "
            f"{LENGTHS[0]} nights or more",
        )
    of_nights = _along(_LOG_LIMITS, _PHI, baseline.floored_phi)
    both = np.stack([_LOG_FLOOR_LIMITS, of_nights], axis=-1)
    scatter = baseline.highest_sd() / baseline.floored_sd if baseline.floored_sd > 0.0 else 0.0
    by_scatter = _along(both, _DECIDES, scatter)
    by_length = _along(by_scatter, _ROOT_LENGTHS, -1.0 / math.sqrt(baseline.n))
    return float(np.exp(_along(by_length, _LOG_RATES, math.log(false_alarms_per_year))))


def _along(table: Array, places: Array, at: float) -> Array:
    """Interpolated along the last axis of a table; its ends hold beyond."""
    last = len(places) - 1
    upper = min(max(int(np.searchsorted(places, at)), 1), last)
    span = float(places[upper] - places[upper - 1])
    share = min(max((at - float(places[upper - 1])) / span, 0.0), 1.0)
    result: Array = (1.0 - share) * table[..., upper - 1] + share * table[..., upper]
    return result


def _steps(nights: Nights, values: Array, baseline: Baseline) -> Array:
    """w − k of each night; the first has no night before it."""
    sd = baseline.floored_sd
    if sd <= 0.0:
        # Neither scatter nor floor: any rise is a change, any fall none.
        return np.sign(values - baseline.mean) * WINSORISED_AT - REFERENCE_VALUE
    rho = correlation_to_previous(baseline.floored_phi, nights)
    white = whitened((values - baseline.mean) / sd, rho)
    gain = np.sqrt((1.0 - rho) / (1.0 + rho))
    reference = REFERENCE_VALUE + BASELINE_ERRORS * gain * baseline.floored_mean_error / sd
    result: Array = np.clip(white, -WINSORISED_AT, WINSORISED_AT) - reference
    return result


def _with_way_back(
    steps: Array, limit: float
) -> tuple[Array, NDArray[np.bool_], NDArray[np.int64]]:
    """Sums, whether a change stands told, and where it began."""
    n = len(steps)
    sums, on = np.zeros(n), np.zeros(n, dtype=np.bool_)
    began = np.zeros(n, dtype=np.int64)
    start, told = 0, False
    while start < n:
        walk = np.cumsum(steps[start:])
        if told:
            # S below its ceiling is how far the walk has fallen from its highest place.
            part = 2 * limit - (np.maximum(np.maximum.accumulate(walk), 0.0) - walk)
            end = _first(part <= limit)
        else:
            part = walk - np.minimum(np.minimum.accumulate(walk), 0.0)
            end = _first(part > limit)
        stop = start + end
        sums[start:stop], on[start:stop] = part[:end], told
        began[start:stop] = began[start - 1] if told else 0
        if stop >= n:
            break
        if told:
            sums[stop], on[stop] = 0.0, False
        else:
            sums[stop], on[stop] = 2 * limit, True
            at_zero = np.flatnonzero(part[:end] <= 0.0)
            began[stop] = start + (int(at_zero[-1]) + 1 if len(at_zero) else 0)
        start, told = stop + 1, not told
    return sums, on, began


def _first(condition: NDArray[np.bool_]) -> int:
    """Place of the first true value; the length where there is none."""
    place = int(condition.argmax()) if len(condition) else 0
    return place if len(condition) and condition[place] else len(condition)
