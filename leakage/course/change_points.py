r"""Retrospective model of a whole series: a trend, steps, or both.

Change points come from the optimal partition of `ruptures` [1]_ with a linear kernel and the
penalty :math:`3 \sigma^2 \ln n\, (1+\varphi)/(1-\varphi)`. Partitions know steps only, so wear that
grows reads as a staircase. Four models therefore compete: nothing, a trend (all along, or from
some night on), steps, and a trend with steps. Each is fitted with first-order autoregressive errors
and judged by

.. math:: BIC = -2 \ln L + p \ln n ,

where the night of an onset counts as a parameter, as its size does. Change points are
annotations and proposals to start a new baseline; no alarm comes from them.

References
----------
.. [1] C. Truong, L. Oudre and N. Vayatis, "Selective review of offline change point detection
   methods", *Signal Processing*, 167, 2020.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from leakage.course.autoregression import (
    Array,
    Nights,
    correlation_to_previous,
    estimated_phi,
    long_run_factor,
    whitened,
)
from leakage.course.slope import LEAST_NIGHTS, check_series
from leakage.estimation.robust import MAD_TO_SD

ChangeModel: TypeAlias = Literal["too_few_nights", "none", "trend", "step", "trend_and_step"]

# Nights between two change points: less than a week is an episode.
LEAST_SEGMENT = 7
# Odd nights are brought to this many standard deviations about the median of a week.
WINSORISED_AT = 4.0
# The partition takes time with the square of the nights: longer histories are looked at from here.
MOST_NIGHTS = 1500
# Places tried for the beginning of a trend.
MOST_BEGINNINGS = 120
# The likelihood of φ is flat: so many places are enough.
PHI_GRID = np.linspace(0.0, 0.9, 10)


@dataclass(frozen=True, slots=True)
class Step:
    """A step of the level.

    Attributes
    ----------
    night
        Number of the first night after it.
    size
        Level after less level before [unit].
    """

    night: int
    size: float


@dataclass(frozen=True, slots=True)
class Changes:
    """The model that describes a series best.

    Attributes
    ----------
    model
        The winner; ``too_few_nights`` below 20.
    steps
        In order of time; of ``step`` and ``trend_and_step``.
    trend_from_night
        Night on which the trend begins, the first one where it goes all along; None without one.
    bic
        Of each model that could be fitted, by name; differences of 10 are very strong evidence.
    """

    model: ChangeModel
    steps: tuple[Step, ...] = ()
    trend_from_night: int | None = None
    bic: Mapping[ChangeModel, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class _Fitted:
    """A model with its columns: one, trend if any, steps."""

    name: ChangeModel
    bic: float
    trend_from: int | None
    places: tuple[int, ...]
    coefficients: Array


def find_changes(nights: Nights, values: Array) -> Changes:
    """Describe a series by a trend, steps, or both.

    Parameters
    ----------
    nights
        Numbers of the nights, increasing, shape (n,).
    values
        Indicator, shape (n,); nights that are not finite do not count.

    Returns
    -------
    Changes
        Of the last 1500 good nights, where there are more.

    Raises
    ------
    ShapeError
        ``shape`` or ``night_order``.

    Examples
    --------
    >>> generator = np.random.default_rng(1)
    >>> nights = np.arange(200)
    >>> found = find_changes(nights, generator.standard_normal(200) + 5.0 * (nights >= 120))
    >>> found.model, [step.night for step in found.steps], round(found.steps[0].size)
    ('step', [120], 5)
    """
    check_series(nights, values)
    kept = np.flatnonzero(np.isfinite(values))[-MOST_NIGHTS:]
    if len(kept) < LEAST_NIGHTS:
        return Changes("too_few_nights")
    nights, values = nights[kept], values[kept]
    sd = _noise(values)
    if sd <= 1e-12 * float(np.max(np.abs(values))):
        return _without_noise(nights, values)
    steady = _without_odd_nights(values, sd)
    best = _best_models(nights, steady)
    winner = min(best.values(), key=lambda model: model.bic)
    sizes = winner.coefficients[1 if winner.trend_from is None else 2 :]
    return Changes(
        model=winner.name,
        steps=tuple(
            Step(int(nights[place]), float(size))
            for place, size in zip(winner.places, sizes, strict=True)
        ),
        trend_from_night=None if winner.trend_from is None else int(nights[winner.trend_from]),
        bic={name: model.bic for name, model in best.items()},
    )


def _best_models(nights: Nights, values: Array) -> dict[ChangeModel, _Fitted]:
    """The best of each kind."""
    models = [_fitted("none", nights, values, None, ())]
    beginnings = [0, *_beginning(nights, values)]
    models += [_fitted("trend", nights, values, begin, ()) for begin in beginnings]
    trend = min(models[1:], key=lambda model: model.bic)
    places = _partition(nights, values)
    if places:
        models.append(_fitted("step", nights, values, None, places))
    # Steps stand out once the trend is away, and the trend once the steps are.
    rest = values - _trend_column(nights, trend.trend_from or 0) * trend.coefficients[1]
    for candidates in {places, _partition(nights, rest)} - {()}:
        models.append(_fitted("trend_and_step", nights, values, 0, candidates))
        models.append(_fitted("trend_and_step", nights, values, trend.trend_from, candidates))
    best: dict[ChangeModel, _Fitted] = {}
    for model in models:
        if model.name not in best or model.bic < best[model.name].bic:
            best[model.name] = model
    return best


def _fitted(
    name: ChangeModel,
    nights: Nights,
    values: Array,
    trend_from: int | None,
    places: tuple[int, ...],
) -> _Fitted:
    """Maximum likelihood over the grid of φ; steps that the criterion does not want are dropped."""
    n = len(values)
    columns = [np.ones(n)]
    columns += [] if trend_from is None else [_trend_column(nights, trend_from)]
    first = len(columns)
    columns += [(np.arange(n) >= place).astype(np.float64) for place in places]
    rho = np.stack([correlation_to_previous(float(phi), nights) for phi in PHI_GRID])
    table = np.column_stack([*columns, values])
    # Of the whitened columns and values at each φ.
    triangles = _triangular(np.stack([whitened(table, one) for one in rho]))
    logs = np.log1p(-(rho**2)).sum(axis=1)
    fitted = _likeliest(name, triangles, logs, n, trend_from, places)
    while len(fitted.places) > 1:
        # The triangles hold all that a model with fewer columns needs.
        several = len(fitted.places)
        fewer = [
            _likeliest(
                name,
                _triangular(np.delete(triangles, first + at, axis=2)),
                logs,
                n,
                trend_from,
                fitted.places[:at] + fitted.places[at + 1 :],
            )
            for at in range(several)
        ]
        dropped = min(range(several), key=lambda at: fewer[at].bic)
        if fewer[dropped].bic >= fitted.bic:
            break
        fitted = fewer[dropped]
        triangles = _triangular(np.delete(triangles, first + dropped, axis=2))
    return fitted


def _likeliest(
    name: ChangeModel,
    triangles: Array,
    logs: Array,
    n: int,
    trend_from: int | None,
    places: tuple[int, ...],
) -> _Fitted:
    """Maximum likelihood over the grid of φ, from the triangular factor at each."""
    squared = np.maximum(triangles[:, -1, -1] ** 2, 1e-300)
    twice = n * (np.log(2 * math.pi * squared / n) + 1) + logs
    best = int(np.argmin(twice))
    triangle = triangles[best]
    k = len(triangle) - 1
    # σ, φ and every column; the night on which a step or a later trend begins is found, too.
    p = 2 + k + len(places) + (1 if trend_from else 0)
    return _Fitted(
        name=name,
        bic=float(twice[best]) + p * math.log(n),
        trend_from=trend_from,
        places=places,
        coefficients=np.linalg.solve(triangle[:k, :k], triangle[:k, k]),
    )


def _triangular(stacked: Array) -> Array:
    result: Array = np.asarray(np.linalg.qr(stacked, mode="r"))
    return result


def _partition(nights: Nights, values: Array) -> tuple[int, ...]:
    """Places at which a new level begins."""
    n = len(values)
    if n < 2 * LEAST_SEGMENT:
        return ()
    # Imported where it is needed: it takes longer to load than all of this package.
    from ruptures import KernelCPD

    sd, phi = _noise(values), 0.0
    algorithm = KernelCPD(kernel="linear", min_size=LEAST_SEGMENT).fit(values[:, None])
    # The first partition takes slow memory for steps; what is left of it tells how slow it is.
    for _ in range(2):
        penalty = 3.0 * sd**2 * math.log(n) * long_run_factor(phi)
        places = tuple(algorithm.predict(pen=penalty)[:-1])
        levels = np.zeros(n)
        for first, last in zip((0, *places), (*places, n), strict=True):
            levels[first:last] = values[first:last].mean()
        sd, phi = max(sd, float(np.std(values - levels))), estimated_phi(values - levels, nights)
    return places


def _beginning(nights: Nights, values: Array) -> list[int]:
    """Place from which on a trend explains most, the nights before it being level."""
    n = len(values)
    step = max((n - 2 * LEAST_SEGMENT) // MOST_BEGINNINGS, 1)
    places = np.arange(LEAST_SEGMENT, n - LEAST_SEGMENT, step)
    if not len(places):
        return []
    columns = np.maximum(nights[:, None] - nights[places], 0).astype(np.float64)
    columns -= columns.mean(axis=0)
    explained = (values @ columns) ** 2 / np.sum(columns**2, axis=0)
    return [int(places[np.argmax(explained)])]


def _trend_column(nights: Nights, place: int) -> Array:
    result: Array = np.maximum(nights - nights[place], 0).astype(np.float64)
    return result


def _noise(values: Array) -> float:
    """Robust standard deviation about the median of a week."""
    rest = values - _running_median(values)
    # Half of a week's median is the night itself: it takes a part of the scatter away.
    return MAD_TO_SD * float(np.median(np.abs(rest[rest != 0.0]))) if np.any(rest) else 0.0


def _without_odd_nights(values: Array, sd: float) -> Array:
    centre = _running_median(values)
    result: Array = np.clip(values, centre - WINSORISED_AT * sd, centre + WINSORISED_AT * sd)
    return result


def _running_median(values: Array) -> Array:
    """Median of a week around each night; beyond its ends a series stays as it is there."""
    padded = np.pad(values, LEAST_SEGMENT // 2, mode="edge")
    centre: Array = np.median(sliding_window_view(padded, LEAST_SEGMENT), axis=1)
    return centre


def _without_noise(nights: Nights, values: Array) -> Changes:
    """A series that does not scatter: every night on which it moves is a step."""
    places = np.flatnonzero(np.diff(values)) + 1
    steps = tuple(
        Step(int(nights[place]), float(values[place] - values[place - 1]))
        for place in places.tolist()
    )
    return Changes("step" if steps else "none", steps)
