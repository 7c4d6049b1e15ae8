r"""Robust, frozen baseline of an indicator: its mean and scatter in the motor's known condition.

The first good nights give a mean and a standard deviation. Nights are winsorised at four robust
standard deviations about their median, as the cumulative sum later winsorises them, so that odd
nights weigh in both alike. φ comes from the nights without their straight line: without it, wear
within the baseline would be whitened away.

The standard deviation has a floor: changes smaller than those of sensors and oil by themselves are
not wear, however little the nights scatter. The variance that the floor adds is taken as
uncorrelated scatter, which leaves

.. math:: r = \frac{\sigma^2}{\sigma_f^2} \frac{\varphi}{1 - \varphi}, \qquad
   \varphi_f = \frac{r}{1 + r}

as the correlation of nights with standard deviation :math:`\sigma_f` whose sums over many nights
have the same spread as those of both parts together.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from scipy.special import chdtri

from leakage.course.autoregression import Array, Nights, estimated_phi, variance_of_mean
from leakage.course.slope import check_series, fit_slope
from leakage.errors import ParameterError
from leakage.estimation.robust import MAD_TO_SD

BaselineStatus: TypeAlias = Literal["frozen", "provisional", "insufficient"]

# With fewer, no limit is calibrated.
LEAST_NIGHTS = 15
# Memory of nights up to which limits are calibrated.
HIGHEST_TRUE_PHI = 0.6
# Floors of model.md, section 7, relative to the baseline's mean.
COEFFICIENT_FLOOR = 0.05
LEAKAGE_FLOOR = 0.01
# A slope within a baseline is told at this p, and only if it moves the indicator by more than one
# floored standard deviation over the baseline: less than that is no wear.
SLOPED_P = 0.01


@dataclass(frozen=True, slots=True)
class BaselineSettings:
    """Settings of a baseline.

    Parameters
    ----------
    nights
        Number of good nights after which a baseline is frozen.
    provisional_nights
        Number of good nights from which a provisional baseline is used.
    relative_floor
        Least standard deviation, relative to the mean: 5 % of K, 1 % of a leakage.
    absolute_floor
        Least standard deviation in the unit of the indicator.
    winsorised_at
        Robust standard deviations from the median at which nights are winsorised.

    Raises
    ------
    ParameterError
        ``baseline_settings``.
    """

    nights: int = 60
    provisional_nights: int = LEAST_NIGHTS
    relative_floor: float = LEAKAGE_FLOOR
    absolute_floor: float = 0.0
    winsorised_at: float = 4.0

    def __post_init__(self) -> None:
        if not LEAST_NIGHTS <= self.provisional_nights <= self.nights:
            raise ParameterError(
                "baseline_settings",
                f"baseline of {self.nights} nights, provisional from {self.provisional_nights}; "
                f"expected {LEAST_NIGHTS} or more for the provisional one, no fewer for the whole",
            )
        if min(self.relative_floor, self.absolute_floor) < 0 or self.winsorised_at <= 0:
            raise ParameterError(
                "baseline_settings",
                "a floor of the baseline is negative or its winsorising not positive",
            )

    @property
    def lengths(self) -> tuple[int, ...]:
        """Good nights of the baselines that serve one after the other.

        Examples
        --------
        >>> BaselineSettings().lengths
        (15, 30, 60)
        """
        found = [self.provisional_nights]
        while found[-1] < self.nights:
            found.append(min(2 * found[-1], self.nights))
        return tuple(found)


@dataclass(frozen=True, slots=True)
class Baseline:
    """An indicator's baseline.

    Attributes
    ----------
    status
        ``frozen``; ``provisional``: from fewer nights than asked for; ``insufficient``: too few,
        everything below is then nan or 0.
    first_night, last_night
        Numbers of its first and last good night; 0 without one.
    n
        Good nights.
    mean
        Winsorised mean [unit].
    sd
        Winsorised standard deviation of the nights [unit].
    phi
        Correlation of neighbouring nights.
    floored_sd
        `sd`, or its floor where that is larger [unit].
    floored_phi
        Correlation of neighbouring nights that belongs to `floored_sd`.
    mean_error
        Standard error of the mean [unit].
    floored_mean_error
        The same of nights that scatter with `floored_sd` and `floored_phi` [unit].
    sloped
        Whether the baseline itself has a slope: the motor was not steady while it was taken.
    reason
        In words, where the status is not ``frozen`` or the baseline is sloped.
    """

    status: BaselineStatus
    first_night: int
    last_night: int
    n: int
    mean: float = math.nan
    sd: float = math.nan
    phi: float = math.nan
    floored_sd: float = math.nan
    floored_phi: float = math.nan
    mean_error: float = math.nan
    floored_mean_error: float = math.nan
    sloped: bool = False
    reason: str = ""

    def highest_sd(self, coverage: float = 0.95) -> float:
        r"""Upper bound of the standard deviation of the nights [unit].

        From χ² with :math:`n (1 - \varphi^2) / (1 + \varphi^2) - 1` degrees of freedom, as nights
        that remember tell less of their scatter; φ at most 0.6, the highest that is allowed for,
        since short baselines tell it poorly.
        """
        squared = min(self.phi, HIGHEST_TRUE_PHI) ** 2
        freedom = max(self.n * (1.0 - squared) / (1.0 + squared) - 1.0, 1.0)
        return self.sd * math.sqrt(freedom / float(chdtri(freedom, coverage)))

    def deviation(self, values: Array) -> Array:
        """Relative deviation from the mean, shape of `values`, [-]."""
        result: Array = values / self.mean - 1.0
        return result


def fit_baseline(
    nights: Nights, values: Array, settings: BaselineSettings | None = None
) -> Baseline:
    """Baseline of the first good nights of a series.

    Parameters
    ----------
    nights
        Numbers of the nights since the last event that starts a baseline, increasing, shape (n,).
    values
        Indicator, shape (n,); nights that are not finite are no good nights.
    settings
        How it is made; the defaults where left out.

    Returns
    -------
    Baseline
        From at most `settings.nights` good nights. Where the whole of them has a slope and the
        first `provisional_nights` have none, still the whole: which to keep is decided by
        :func:`leakage.course.monitoring.monitor`, which knows what the nights after the first
        showed.

    Raises
    ------
    ShapeError
        ``shape`` or ``night_order``.

    Examples
    --------
    >>> generator = np.random.default_rng(1)
    >>> found = fit_baseline(np.arange(90), 1.37 + 0.002 * generator.standard_normal(90))
    >>> found.status, found.n, round(found.mean, 2), round(found.floored_sd, 4)
    ('frozen', 60, 1.37, 0.0137)
    >>> fit_baseline(np.arange(5), np.ones(5)).reason
    '5 good nights; a provisional baseline needs 15'
    """
    chosen = settings or BaselineSettings()
    check_series(nights, values)
    good = np.flatnonzero(np.isfinite(values))[: chosen.nights]
    if len(good) < chosen.provisional_nights:
        reason = (
            f"{len(good)} good nights; a provisional baseline needs {chosen.provisional_nights}"
        )
        first, last = (int(one) for one in nights[good[[0, -1]]]) if len(good) else (0, 0)
        return Baseline("insufficient", first, last, len(good), reason=reason)
    nights, values = nights[good], values[good]
    median = float(np.median(values))
    # About the median, so that a constant series has no scatter of rounding.
    steady = _winsorised(values - median, _floor(median, chosen), chosen.winsorised_at)
    mean, sd = median + float(np.mean(steady)), float(np.std(steady, ddof=1))
    slope, residuals = _line(nights, steady)
    phi = estimated_phi(residuals, nights)
    floored_sd = max(sd, _floor(mean, chosen))
    phi_of_floored = floored_phi(sd, floored_sd, phi)
    # A line that moves hardly more than half a standard deviation needs no test.
    moves = abs(slope) * float(nights[-1] - nights[0])
    sloped = moves > floored_sd / 2 and _is_sloped(nights, steady, floored_sd)
    whole = len(good) == chosen.nights
    reasons = [] if whole else [f"provisional: {len(good)} of {chosen.nights} good nights"]
    reasons += ["the baseline itself has a slope"] if sloped else []
    return Baseline(
        status="frozen" if whole else "provisional",
        first_night=int(nights[0]),
        last_night=int(nights[-1]),
        n=len(good),
        mean=mean,
        sd=sd,
        phi=phi,
        floored_sd=floored_sd,
        floored_phi=phi_of_floored,
        mean_error=sd * float(np.sqrt(variance_of_mean(phi, nights))),
        floored_mean_error=floored_sd * float(np.sqrt(variance_of_mean(phi_of_floored, nights))),
        sloped=sloped,
        reason="; ".join(reasons),
    )


def floored_phi(sd: float, floored_sd: float, phi: float) -> float:
    """Correlation of neighbouring nights whose scatter was raised to a floor without memory.

    Examples
    --------
    >>> floored_phi(1.0, 1.0, 0.6), round(floored_phi(0.5, 1.0, 0.6), 4)
    (0.6, 0.2727)
    """
    if floored_sd <= 0.0:
        return 0.0
    ratio = (sd / floored_sd) ** 2 * phi / (1.0 - phi)
    return round(ratio / (1.0 + ratio), 12)


def _floor(mean: float, settings: BaselineSettings) -> float:
    return max(settings.relative_floor * abs(mean), settings.absolute_floor)


def _winsorised(values: Array, floor: float, at: float) -> Array:
    """Values about a median of 0, brought within reach of it."""
    # Where more than half of the nights are alike, the floor is the only scale there is.
    spread = MAD_TO_SD * float(np.median(np.abs(values))) or floor
    reach = at * spread if spread > 0.0 else np.inf
    steady: Array = np.clip(values, -reach, reach)
    return steady


def _line(nights: Nights, values: Array) -> tuple[float, Array]:
    """Slope of the straight line of least squares, and the residuals."""
    centred = nights - np.mean(nights)
    slope = float(centred @ values) / float(centred @ centred)
    return slope, values - np.mean(values) - slope * centred


def _is_sloped(nights: Nights, values: Array, floored_sd: float) -> bool:
    """True if a slope is certain and exceeds the scatter of the nights."""
    line = fit_slope(nights, values)
    if line.slope is None:
        return False
    certain = line.p_value is None or line.p_value < SLOPED_P
    return certain and abs(line.slope) * float(nights[-1] - nights[0]) > floored_sd
