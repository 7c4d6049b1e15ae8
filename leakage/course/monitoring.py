"""An indicator watched night by night: baseline, deviation, cumulative sum, levels, state.

A night's state depends on that night and those before it alone, so a run that looks back at a year
says of each night what a run on that night said.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from leakage.course.alarms import (
    OF_SEVERITY,
    Levels,
    Limits,
    Severities,
    State,
    level_severity,
    limit_severity,
    nights_since_good,
)
from leakage.course.autoregression import Array, Nights, variance_of_sum
from leakage.course.baseline import Baseline, BaselineSettings, fit_baseline
from leakage.course.cusum import cusum, cusum_limit
from leakage.course.slope import check_series

# Good nights that say how large a change is now; from so many on, by the end of their line.
NIGHTS_OF_SIZE = 10
LEAST_OF_LINE = 5


@dataclass(frozen=True, slots=True)
class MonitorSettings:
    """Settings for monitoring one indicator.

    Parameters
    ----------
    false_alarms_per_year
        Allowed rate of this one indicator on a healthy motor: the motor's rate over the number of
        its indicators.
    baseline
        Settings of the baseline.
    levels
        Levels relative to the baseline.
    limits
        Absolute limits.
    stale_nights
        Number of nights without a trusted value after which the state is ``stale``.
    """

    false_alarms_per_year: float = 0.02
    baseline: BaselineSettings = field(default_factory=BaselineSettings)
    levels: Levels = field(default_factory=Levels)
    limits: Limits = field(default_factory=Limits)
    stale_nights: int = 7


@dataclass(frozen=True, slots=True)
class Monitoring:
    """An indicator against its baseline, and its states.

    Attributes
    ----------
    states
        One a night.
    baselines
        In the order in which they served: provisional ones, then the whole, or the last of them
        again where it is kept; none where there are too few good nights, or their mean is not
        positive.
    served_from
        Place in the series from which each served.
    deviation
        Relative deviation from the baseline that served, shape (n,); nan before there was one, and
        on nights without a value.
    evidence
        Cumulative sum over its limit, shape (n,): told above 1, at most 2; nan as `deviation`.
    onset
        Place of the night on which the change that the sum tells began, shape (n,); −1 without one.
    severity
        By levels and sum together, shape (n,): 0, 1 or 2; nights without a value hold.
    limit_severity
        By the absolute limits, likewise; they need no baseline.
    has_baseline
        Shape (n,).
    since_good
        Nights since the last one with a value, shape (n,).
    """

    states: list[State]
    baselines: tuple[Baseline, ...]
    served_from: tuple[int, ...]
    deviation: Array
    evidence: Array
    onset: NDArray[np.int64]
    severity: Severities
    limit_severity: Severities
    has_baseline: NDArray[np.bool_]
    since_good: Nights

    def baseline_at(self, place: int) -> Baseline | None:
        """The baseline that served in a night; None before there was one."""
        served = bisect_right(self.served_from, place)
        return self.baselines[served - 1] if served else None


@dataclass(frozen=True, slots=True)
class ChangeSize:
    """Present size of a change.

    Attributes
    ----------
    since_night
        Number of the night on which the change began.
    relative, lower, upper
        Rise over the baseline, and its interval, [-].
    n
        Nights behind it.
    """

    since_night: int
    relative: float
    lower: float
    upper: float
    n: int


def monitor(
    nights: Nights,
    values: Array,
    settings: MonitorSettings | None = None,
    allowance: Array | float = 0.0,
    limited: Array | None = None,
) -> Monitoring:
    """Watch an indicator from an event that starts a baseline to tonight.

    The first good nights make a provisional baseline, and longer ones take its place
    (`BaselineSettings.lengths`), unless a change stands told by then, or the longer one rises, or
    has a slope that the shorter has not: wear must not become its own baseline.

    Parameters
    ----------
    nights
        Numbers of the nights, increasing, shape (n,). A night without logs may be absent; tonight
        should be there, so that it can be stale.
    values
        Indicator, positive, shape (n,); nan on nights that are missing or not to be trusted.
    settings
        How it is watched; the defaults where left out.
    allowance
        Relative ± of each night that nights alike share, such as that of an unknown effect of their
        temperature, shape (n,): only what a night deviates by beyond it counts.
    limited
        Values that the absolute limits hold against, shape (n,), where they are others.

    Returns
    -------
    Monitoring
        States: ``insufficient`` without a baseline; ``stale`` after too many nights without a
        value; otherwise what levels and sum say. An absolute limit holds with or without a
        baseline.

    Raises
    ------
    ShapeError
        ``shape`` or ``night_order``.
    ParameterError
        ``alarm_rate``.

    Examples
    --------
    >>> generator = np.random.default_rng(1)
    >>> nights = np.arange(120)
    >>> values = 1.37 * (1 + 0.004 * generator.standard_normal(120)) * (1 + 0.2 * (nights >= 90))
    >>> states = monitor(nights, values).states
    >>> states.index("ok"), states.index("warning")
    (15, 92)
    """
    check_series(nights, values)
    chosen = settings or MonitorSettings()
    limited = values if limited is None else limited
    parts = _Parts.empty(len(nights))
    served = _serve(nights, values, chosen, parts, allowance)
    has_baseline = np.arange(len(nights)) >= (served[0][0] if served else len(nights))
    beyond = limit_severity(limited, chosen.limits, chosen.levels)
    since_good = nights_since_good(nights, np.isfinite(values))
    # A limit that is passed now is no old news.
    fresh = nights_since_good(nights, np.isfinite(limited)) <= chosen.stale_nights
    states = np.array(OF_SEVERITY, dtype=object)[np.maximum(parts.severity, beyond)]
    states[(since_good > chosen.stale_nights) & ~(fresh & (beyond > 0))] = "stale"
    states[~has_baseline & (beyond == 0)] = "insufficient"
    return Monitoring(
        states=states.tolist(),
        baselines=tuple(baseline for _, baseline in served),
        served_from=tuple(start for start, _ in served),
        deviation=parts.deviation,
        evidence=parts.evidence,
        onset=parts.onset,
        severity=parts.severity,
        limit_severity=beyond,
        has_baseline=has_baseline,
        since_good=since_good,
    )


def change_size(
    nights: Nights, values: Array, baseline: Baseline, onset: int, place: int
) -> ChangeSize:
    """Size of a change that began at a place, on a later one, with its 95 % interval.

    From up to ten good nights since it began. The interval holds the scatter of the nights and the
    error of the baseline. A mean over ten nights lags behind wear that continues, so the size is
    the end of the straight line through them; with fewer than five nights it is their mean.
    """
    recent = onset + np.flatnonzero(np.isfinite(values[onset : place + 1]))[-NIGHTS_OF_SIZE:]
    weights = weights_of_now(nights[recent])
    ratio = float(weights @ values[recent]) / baseline.mean
    # Nights scatter in proportion to the indicator.
    scatter = baseline.sd**2 * variance_of_sum(weights, baseline.phi, nights[recent])
    error = ratio * math.hypot(math.sqrt(scatter), baseline.mean_error) / baseline.mean
    half = float(stdtrit(baseline.n - 1, 0.975)) * error
    rise = ratio - 1.0
    return ChangeSize(int(nights[onset]), rise, rise - half, rise + half, len(recent))


def weights_of_now(nights: Nights) -> Array:
    """Weights with which some nights tell what an indicator is in the last of them, shape (n,).

    Of the end of the straight line through them, which sum to 1; all alike for fewer than five.

    Examples
    --------
    >>> weights_of_now(np.arange(2)).tolist()
    [0.5, 0.5]
    >>> nights = np.arange(10)
    >>> round(float(weights_of_now(nights) @ (3.0 + 2.0 * nights)), 9)
    21.0
    """
    n = len(nights)
    weights: Array = np.full(n, 1.0 / max(n, 1))
    if n >= LEAST_OF_LINE:
        centred = nights - np.mean(nights)
        weights = weights + centred * centred[-1] / float(centred @ centred)
    return weights


@dataclass(slots=True)
class _Parts:
    """Columns of a track while it is being followed."""

    deviation: Array
    evidence: Array
    onset: NDArray[np.int64]
    severity: Severities

    @classmethod
    def empty(cls, n: int) -> _Parts:
        return cls(
            np.full(n, np.nan),
            np.full(n, np.nan),
            np.full(n, -1, dtype=np.int64),
            np.zeros(n, dtype=np.int64),
        )

    def follow(
        self,
        nights: Nights,
        values: Array,
        baseline: Baseline,
        settings: MonitorSettings,
        start: int,
        allowance: Array | float,
    ) -> None:
        """Fill the columns from a place on to the end of the series given, by one baseline."""
        stop = len(nights)
        limit = cusum_limit(settings.false_alarms_per_year, baseline)
        deviation = baseline.deviation(values)
        allowed = np.clip(deviation, -np.asarray(allowance), allowance)
        sums = cusum(nights, values - baseline.mean * allowed, baseline, limit)
        relative_sd = baseline.highest_sd() / baseline.mean
        by_level = level_severity((deviation - allowed)[start:], relative_sd, settings.levels)
        # A change that is certain but below the levels is a warning.
        by_sum = sums.is_on[start:].astype(np.int64)
        self.deviation[start:stop] = deviation[start:]
        self.evidence[start:stop] = sums.statistic[start:] / limit
        self.onset[start:stop] = sums.onset[start:]
        self.severity[start:stop] = np.maximum(by_level, by_sum)


def _serve(
    nights: Nights,
    values: Array,
    settings: MonitorSettings,
    parts: _Parts,
    allowance: Array | float,
) -> list[tuple[int, Baseline]]:
    """Baselines with the places from which they serve; fills the parts by them."""
    served: list[tuple[int, Baseline]] = []
    *_, whole = lengths = settings.baseline.lengths
    for length in lengths:
        chosen = replace(settings.baseline, nights=length, provisional_nights=length)
        found = fit_baseline(nights, values, chosen)
        # A relative deviation needs something to be relative to.
        if found.status == "insufficient" or found.mean <= 0.0:
            break
        begin = int(np.searchsorted(nights, found.last_night)) + 1
        kept = _why_kept(served[-1][1], found, bool(parts.severity[begin - 1])) if served else ""
        if kept and length < whole:
            continue
        if kept:
            # As a baseline of its own: what was said before it was decided stays as it was said.
            found = replace(served[-1][1], status="frozen", reason=kept)
        elif length < whole:
            words = f"provisional: {length} of {whole} good nights"
            found = replace(found, status="provisional", reason=_joined(words, found.reason))
        if not kept:
            parts.follow(nights, values, found, settings, begin, allowance)
        served.append((begin, found))
    return served


def _why_kept(first: Baseline, whole: Baseline, told: bool) -> str:
    """Reason to keep the provisional baseline; empty if the whole one replaces it."""
    if told:
        return f"kept at {first.n} good nights: a change was told before there were {whole.n}"
    if whole.sloped and (not first.sloped or whole.mean > first.mean):
        return f"kept at {first.n} good nights: {whole.n} have a slope"
    return ""


def _joined(*reasons: str) -> str:
    return "; ".join(reason for reason in reasons if reason)
