"""Which path a change of a motor's leakage comes from, from the coefficients' nights.

The change of an indicator is the sum of what its paths do. Paths whose coefficient the nights do
not tell stand in as one: what the others leave unexplained.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from leakage.attribution import DEGENERATE, Attribution, attribute
from leakage.autoregression import long_run_factor
from leakage.baseline import LEAST_NIGHTS, Baseline
from pipeline.trends.baseline_flow import column_sums, expected_flow
from pipeline.trends.indicators import OWN_REFERENCE, REFERENCE
from pipeline.trends.night_records import FLUSHING, whole_matrix
from pipeline.trends.own_conditions import OwnConditions, regressor_row
from pipeline.trends.standing import CHANGED, RAISED, Standing

Array = NDArray[np.float64]
Places = NDArray[np.intp]

# Good nights that say what the coefficients are now.
NIGHTS_OF_NOW = 10
# What is not told by the coefficients, among the paths.
REST = "the rest"


@dataclass(frozen=True, slots=True)
class _Change:
    """Change of a coefficient: its nights, those of now and of the baseline.

    Where the filter says what it is now, its state in the last night has all nights' information.
    """

    series: Array
    baseline: Baseline
    before: Places
    now: Places
    state: Array | None
    number: int

    @property
    def size(self) -> float:
        """Mean of now less that of the baseline."""
        return float(np.mean(self.series[self.now])) - self.baseline.mean


def path_behind(standing: Standing, name: str, place: int) -> Attribution | None:
    """Which path explains the change that an indicator tells in a night.

    None where it tells none, a fall, or a flow that no path leaks. A coefficient speaks for its own
    path, unless another falls by what it rises and their split rests on noise.
    """
    if name == FLUSHING or not _tells_a_rise(standing, name, place):
        return None
    indicator = standing.watched[name].indicator
    flows = path_flows(standing, name, place)
    changes = _changes(standing, place, flows)
    if indicator.path:
        return _of_coefficient(indicator.path, flows, changes)
    names = tuple(changes)
    sizes = np.array([changes[one].size for one in names])
    weights = np.array([flows[one] for one in names])
    covariance = _covariance(list(changes.values()))
    if len(names) < len(flows):
        rest = _rest(standing, name, place, float(weights @ sizes), weights, covariance)
        if rest is None:
            return None
        size, variance, shared = rest
        names, sizes, weights = (*names, REST), np.append(sizes, size), np.append(weights, 1.0)
        whole = np.zeros((len(names), len(names)))
        whole[:-1, :-1] = covariance
        whole[-1, :-1] = whole[:-1, -1] = shared
        whole[-1, -1] = variance
        covariance = whole
    if not names:
        return None
    found = attribute(names, weights, sizes, covariance)
    if found.status == "no_change" and _has_risen(standing, name, place):
        return replace(
            found,
            status="cannot_be_told_apart",
            reason="the coefficients scatter too widely: they have not certainly risen",
        )
    if REST not in found.paths:
        return found
    unknown = ", ".join(one.replace("_", " ") for one in flows if one not in changes)
    return replace(
        found,
        status="cannot_be_told_apart",
        probability=None,
        reason=f"the nights do not tell the coefficients of: {unknown}",
    )


def _tells_a_rise(standing: Standing, name: str, place: int) -> bool:
    """Whether an indicator's state speaks of growth, which has a path."""
    return standing.states[name][place] in CHANGED and not standing.has_fallen(name, place)


def _has_risen(standing: Standing, name: str, place: int) -> bool:
    """Whether a rise of the motor's own is told of an indicator."""
    segment, found, _ = standing.watched[name].at(place)
    told = bool(found.own.severity[place - segment.first])
    return told and standing.states[name][place] in RAISED


def path_named(standing: Standing, name: str, place: int, found: Attribution | None) -> str | None:
    """The path behind a state, as `trends` and `alarms` name it; None where none can be named."""
    if not _tells_a_rise(standing, name, place):
        return None
    own = standing.watched[name].indicator.path
    if own and found is None:
        return own
    if found is None or found.status not in ("path", "several", "together"):
        return None
    return " and ".join(found.paths)


def path_flows(standing: Standing, name: str, place: int) -> dict[str, float]:
    """Flow of each free path per unit of its coefficient, where an indicator is told.

    At the fleet's or the motor's own reference conditions; else at what the nights since the last
    with statistics saw on average, as a ring shows at low pressures only.
    """
    if name == REFERENCE:
        return reference_flows(standing, place)
    own = standing.era(place).own
    if name == OWN_REFERENCE and own is not None:
        return _flows(standing, regressor_row(standing.history, place, own))
    sums = _latest_sums(standing, place)
    paths = standing.history.layout.paths
    if sums is None:
        return {}
    return dict(zip(paths, (sums[: len(paths)] / sums[-3]).tolist(), strict=True))


def reference_flows(standing: Standing, place: int) -> dict[str, float]:
    """Flow of each free path per unit of its coefficient at the fleet's reference conditions."""
    return _flows(standing, reference_row(standing, place))


def reference_row(standing: Standing, place: int) -> Array | str:
    """Columns of the statistics at the fleet's reference conditions, or why there are none."""
    reference = standing.history.spec.settings.reference
    charge = float(standing.history.records["charge"][place])
    at = OwnConditions(
        reference.pressure_bar,
        reference.temperature_c,
        reference.speed_rpm,
        None if np.isnan(charge) else charge,
    )
    return regressor_row(standing.history, place, at)


def _flows(standing: Standing, row: Array | str) -> dict[str, float]:
    if isinstance(row, str):
        return {}
    paths = standing.history.layout.paths
    return dict(zip(paths, row[: len(paths)].tolist(), strict=True))


def _latest_sums(standing: Standing, place: int) -> Array | None:
    """Sums of the statistics' columns of the last night that has some; None before there is one."""
    first = standing.era(place).segment.first
    known = np.isfinite(standing.history.records["factor"][first : place + 1]).all(axis=1)
    if not known.any():
        return None
    last = first + int(np.flatnonzero(known)[-1])
    sums: Array = column_sums(standing.history, slice(last, last + 1))[0]
    return sums


def _changes(standing: Standing, place: int, flows: Mapping[str, float]) -> dict[str, _Change]:
    """Changes of the coefficients that were known in the baseline and are known since.

    A wear that goes on is judged by its latest nights, one that has had no recent night says
    nothing of now, and what all motors of the oil circuit did is none.
    """
    begin, numbers = standing.earliest_onset(place), standing.history.numbers
    found = {}
    for name, watched in standing.watched.items():
        path = watched.indicator.path
        series, baseline = standing.own_change(name, place)
        if path not in flows or baseline is None:
            continue
        segment, _, _ = watched.at(place)
        good = np.flatnonzero(np.isfinite(series[: place + 1]))
        last = standing.history.place_of(baseline.last_night)
        before = good[(good >= segment.first) & (good <= last)]
        now = good[good >= max(begin, segment.first)][-NIGHTS_OF_NOW:]
        recent = now[numbers[place] - numbers[now] <= watched.settings.stale_nights]
        if len(before) < LEAST_NIGHTS or not len(recent):
            continue
        state = None
        if watched.indicator.n_nights[now[-1]] > 1:
            now, state = now[-1:], _state(standing, int(now[-1]))
        number = standing.history.layout.paths.index(path)
        found[path] = _Change(series, baseline, before, now, state, number)
    return {path: found[path] for path in flows if path in found}


def _state(standing: Standing, place: int) -> Array:
    """Covariance of the filtered coefficients in a night, shape (p + 1, p + 1)."""
    upper = whole_matrix(
        standing.history.records["spread"][place], len(standing.history.layout.free)
    )
    covariance: Array = upper + np.triu(upper, 1).T
    return covariance


def _covariance(changes: Sequence[_Change]) -> Array:
    """Covariance of the changes of several coefficients, from the baseline's nights.

    Their scatter from night to night holds both the errors of the fits, with their correlation, and
    what the motor does by itself.
    """
    if not changes:
        return np.empty((0, 0))
    common = changes[0].before
    for one in changes[1:]:
        common = np.intersect1d(common, one.before)
    sd = np.array([one.baseline.sd for one in changes])
    correlation = np.eye(len(changes))
    if len(common) >= LEAST_NIGHTS:
        table = np.array([one.series[common] for one in changes])
        spread = np.atleast_2d(np.cov(table))
        scale = np.sqrt(np.diag(spread))
        scale[scale == 0.0] = 1.0
        # The winsorised scatter for the size, all nights for the correlation.
        correlation = spread / np.outer(scale, scale)
    share = np.array([_variance_share(one) for one in changes])
    error = sd * np.sqrt(share)
    covariance: Array = correlation * np.outer(error, error)
    for row, one in enumerate(changes):
        for column, other in enumerate(changes):
            if one.state is not None and other.state is not None:
                covariance[row, column] += one.state[one.number, other.number]
    return covariance


def _variance_share(change: _Change) -> float:
    """Variance of a change over that of a night: of the mean of now, and of the baseline's."""
    baseline = change.baseline
    if baseline.sd <= 0.0:
        return 0.0
    now = 0.0 if change.state is not None else long_run_factor(baseline.phi) / len(change.now)
    return min(now, 1.0) + (baseline.mean_error / baseline.sd) ** 2


def _rest(
    standing: Standing,
    name: str,
    place: int,
    explained: float,
    weights: Array,
    covariance: Array,
) -> tuple[float, float, Array] | None:
    """What the known paths leave unexplained of an indicator's change [l/min]."""
    segment, _, _ = standing.watched[name].at(place)
    series, baseline = standing.own_change(name, place)
    recent = series[max(standing.earliest_onset(place), segment.first) : place + 1]
    recent = recent[np.isfinite(recent)][-NIGHTS_OF_NOW:]
    if baseline is None or not len(recent):
        return None
    level = _level(standing, name, place, baseline)
    whole = level * float(np.mean(baseline.deviation(recent)))
    error = level * baseline.sd / baseline.mean
    variance = error**2 * (
        1.0 / len(recent) + (baseline.mean_error / max(baseline.sd, 1e-300)) ** 2
    )
    shared = -covariance @ weights
    return whole - explained, variance + float(weights @ covariance @ weights), shared


def _level(standing: Standing, name: str, place: int, baseline: Baseline) -> float:
    """What a relative change of an indicator is relative to [l/min]."""
    model, sums = standing.era(place).model, _latest_sums(standing, place)
    if standing.watched[name].indicator.shift and model is not None and sums is not None:
        _, expected = expected_flow(sums[None], model)
        return float(expected[0] / sums[-3]) * baseline.mean
    return baseline.mean


def _of_coefficient(
    path: str, flows: Mapping[str, float], changes: Mapping[str, _Change]
) -> Attribution | None:
    """That a path's rise cannot be told from the fall of another; None where it can."""
    if path not in changes:
        return None
    for other in changes:
        if other == path:
            continue
        both = [changes[path], changes[other]]
        covariance = _covariance(both)
        scale = np.sqrt(np.diag(covariance))
        if not scale.all() or covariance[0, 1] > DEGENERATE * scale[0] * scale[1]:
            continue
        weights = np.array([flows[path], flows[other]])
        found = attribute((path, other), weights, np.array([one.size for one in both]), covariance)
        if found.status == "no_change":
            return replace(
                found,
                status="cannot_be_told_apart",
                paths=(path, other),
                reason=f"{other} falls by what {path} rises, and their split rests on noise (error "
                f"correlation {covariance[0, 1] / (scale[0] * scale[1]):.3f})",
            )
    return None
