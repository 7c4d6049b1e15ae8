"""Rows of `trends`: every indicator of a night, against its baseline and over time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from leakage.course.baseline import Baseline
from leakage.course.cusum import cusum_limit
from leakage.course.hypotheses import Posterior
from leakage.course.slope import fit_slope
from leakage.course.time_to_limit import time_to_limit
from pipeline.trends.figures.indicators import NO_BASELINE, PEER_DEVIATION, Indicator
from pipeline.trends.nights.running import NIGHTS_BEFORE, coverage
from pipeline.trends.rows.first_rows import first_rows, reference_flows
from pipeline.trends.states.peers import Peers
from pipeline.trends.states.standing import CHANGED, DAYS_A_YEAR, RAISED, Standing
from pipeline.trends.states.zeros import HALF, NO_HALT, Zero
from pipeline.trends.why.explanation_words import cannot_be_told
from pipeline.trends.why.oil import grade_of, oil_as_measured
from pipeline.trends.why.reasons import (
    path_behind,
    path_named,
    why_gated,
    why_no_baseline,
    why_not_named,
    why_state,
)

Row = dict[str, Any]
Array = NDArray[np.float64]

DIVERGED = "with one other motor: they diverge, nobody can tell which"


def trend_rows(standing: Standing, places: Sequence[int]) -> Iterator[Row]:
    """Rows of `trends` of some nights."""
    for place in places:
        shared, flows = _shared(standing, place), reference_flows(standing, place)
        for name in standing.watched:
            yield shared | _watched_row(standing, name, place)
            yield from (shared | row for row in _derived(standing, name, place, flows))
        yield from (shared | row for row in first_rows(standing, place))
        if standing.peers is not None:
            yield shared | _peer_row(standing.peers, standing.diverged[place], place)
        for zero in standing.zeros.values():
            if np.isfinite(zero.value[: place + 1]).any():
                yield shared | _zero_row(zero, place)


def _shared(standing: Standing, place: int) -> Row:
    """Columns that all rows of a night share."""
    history, era = standing.history, standing.era(place)
    # Before there is a baseline, the nights so far stand in for it.
    last = min(era.known_from, era.segment.end - 1, place)
    record = history.records[place]
    return {
        **standing.key(place),
        "running_hours": float(standing.hours.total[place]),
        "running_hours_estimated": bool(standing.hours.estimated[place]),
        "oil": history.spec.file.oil_on(standing.label(place)),
        "mean_temperature_c": _finite(record["mean_temperature_c"]),
        "share_reversed": _finite(record["share_reversed"]),
        "flushing_mode": record["mode"].decode() or None,
        "coverage": coverage(history, place, era.segment.first, last),
        "sensor_health": standing.health(place),
    }


def _watched_row(standing: Standing, name: str, place: int) -> Row:
    watched = standing.watched[name]
    found, baseline = watched.found, watched.baseline(place)
    state, indicator = standing.states[name][place], watched.indicator
    limits = watched.settings.limits
    row = _figures(indicator, place)
    if indicator.told[place]:
        row["gated_reason"] = why_gated(standing, name, place) or None
    row |= {"state": state, "state_reason": None}
    if state in CHANGED and (begin := standing.change_start(name, place)) is not None:
        row["change_start"] = standing.label(begin)
    if baseline is None:
        why = (
            why_no_baseline(standing, name, place)
            if state == "insufficient"
            else why_state(standing, name, place, None)
        )
        row |= {"warning_limit": limits.warning, "alarm_limit": limits.alarm}
        return row | {"state_reason": why} | _line(standing, name, place, None)
    limit = cusum_limit(watched.settings.false_alarms_per_year, baseline)
    warning, alarm = standing.levels(name, place)
    row |= {
        "baseline_start": standing.label(standing.history.place_of(baseline.first_night)),
        "baseline_mean": baseline.mean - indicator.shift,
        "deviation_percent": _finite(100.0 * found.deviation[place]),
        "cusum": _finite(found.evidence[place] * limit),
        "cusum_limit": limit,
        "warning_limit": _limit(baseline.mean * (1.0 + warning), limits.warning) - indicator.shift,
        "alarm_limit": _limit(baseline.mean * (1.0 + alarm), limits.alarm) - indicator.shift,
    }
    if state != "ok":
        path = path_behind(standing, name, place)
        row["state_reason"] = why_state(standing, name, place, path)
        row["path"] = path_named(standing, name, place, path)
        row |= _explained(standing, place, path, row["path"])
    return row | _line(standing, name, place, baseline)


def _explained(standing: Standing, place: int, found: Posterior | None, path: str | None) -> Row:
    """Columns of the probabilities of paths and of a common factor as causes of a change."""
    if found is None:
        return {}
    history, begin = standing.history, standing.earliest_onset(place)
    factor = found.factor
    row: Row = {"common_probability": found.common, "common_origin": found.origin}
    if path:
        row["path_probability"] = min(found.paths[name] for name in path.split(" and "))
    elif why := why_not_named(standing, place, found):
        row["path_reason"] = why
    elif found.verdict == "cannot_be_told":
        row["path_reason"] = cannot_be_told(found, oil_as_measured(history, place, begin))
    if found.is_common:
        half = HALF * factor.sd
        row |= {
            "common_factor": math.exp(factor.log),
            "common_factor_lower": math.exp(factor.log - half),
            "common_factor_upper": math.exp(factor.log + half),
            "likely_iso_vg": grade_of(history, place, begin, found),
        }
    return row


def _limit(relative: float, absolute: float | None) -> float:
    """The lower of the level over the baseline and the limit of the motor type, if it has one."""
    return relative if absolute is None else min(relative, absolute)


def _line(standing: Standing, name: str, place: int, baseline: Baseline | None) -> Row:
    """Slopes and time to limit as of a night."""
    watched, trend = standing.watched[name], standing.history.spec.settings.trend
    if not watched.indicator.told[place]:
        return {"n_slope": 0, "provisional": False, "days_to_limit_status": "insufficient"}
    first = standing.line_start(name, place)
    here = slice(first, place + 1)
    numbers, series = standing.history.numbers[here], watched.series[here]
    hours = standing.hours.total[here]
    line = fit_slope(numbers, series, numbers / DAYS_A_YEAR, coverage=trend.confidence)
    by_hours = fit_slope(numbers, series, hours / 1000.0, coverage=trend.confidence, median=False)
    row = {
        "n_slope": line.n,
        "slope_start": standing.label(first) if line.slope is not None else None,
        "provisional": line.status == "provisional",
        "p_value": line.p_value,
        "theil_sen_per_year": line.theil_sen,
        "theil_sen_outside": line.theil_sen_outside if line.slope is not None else None,
        **{
            f"slope_{per}{end}": figure
            for per, one in (("per_year", line), ("per_1000_h", by_hours))
            for end, figure in (("", one.slope), ("_lower", one.lower), ("_upper", one.upper))
        },
        "days_to_limit_status": "insufficient",
    }
    if baseline is None or line.slope is None:
        return row
    limit = watched.settings.limits.alarm
    if limit is None:
        limit = baseline.mean * (1.0 + standing.levels(name, place)[1])
    days = _days(numbers, hours, series, limit, trend.horizon_years)
    return row | {"limit": limit - watched.indicator.shift} | days


def _derived(
    standing: Standing, name: str, place: int, flows: Mapping[str, float]
) -> Iterator[Row]:
    """The same of a loss factor as people are shown it: leakage of its path, change of its gap."""
    watched = standing.watched[name]
    path, baseline = watched.indicator.path, watched.baseline(place)
    if not path:
        return
    row = _figures(watched.indicator, place) | {"state": standing.states[name][place]}

    def as_shown(change: Callable[[float], float]) -> Row:
        known = (one for one in ("value", "lower", "upper") if row[one] is not None)
        return {one: _finite(change(row[one])) for one in known}

    factor = flows.get(path)
    if factor is not None:
        mean = {} if baseline is None else {"baseline_mean": factor * baseline.mean}
        shown = as_shown(lambda figure: factor * figure)
        yield row | shown | mean | {"indicator": f"leakage_{path}", "unit": "l/min"}
    # The change of a gap, (K/K_baseline)^⅓ − 1, needs no geometry.
    if baseline is not None and name.startswith("K_"):
        shown = as_shown(lambda figure: 100.0 * (np.cbrt(figure / baseline.mean) - 1.0))
        gap = {"indicator": f"gap_change_{path}", "unit": "%", "baseline_mean": 0.0}
        yield row | shown | gap


def _peer_row(peers: Peers, state: str, place: int) -> Row:
    value = _finite(np.expm1(peers.deviation[place]))
    alone = int(peers.n_others[place]) == 1 and state in RAISED
    return {
        "indicator": PEER_DEVIATION,
        "unit": "1",
        "value": value,
        "n_nights": 1,
        "gated_reason": None if value is not None else "no figure of the circuit's motors",
        "state": state,
        "state_reason": DIVERGED if alone else None,
    }


def _zero_row(zero: Zero, place: int) -> Row:
    value, half = zero.value[place], HALF * zero.error[place]
    return {
        "indicator": zero.name,
        "unit": zero.unit,
        "value": _finite(value),
        "lower": _finite(value - half),
        "upper": _finite(value + half),
        "n_nights": 1,
        "gated_reason": None if np.isfinite(value) else NO_HALT,
        "outside_fitted_range": False,
        "baseline_mean": _finite(zero.first[place]),
        "state": zero.state[place],
        "state_reason": zero.words(place) or None,
    }


def _figures(indicator: Indicator, place: int) -> Row:
    """Figures of a night, as far as they were known in it."""
    told = bool(indicator.told[place])
    gated = indicator.gated[place]
    return {
        "indicator": indicator.name,
        "unit": indicator.unit,
        "value": _finite(indicator.value[place]) if told else None,
        "lower": _finite(indicator.lower[place]) if told else None,
        "upper": _finite(indicator.upper[place]) if told else None,
        "n_nights": int(indicator.n_nights[place]) if told else 1,
        "gated_reason": (gated if told else NO_BASELINE) or None,
        "outside_fitted_range": told and bool(indicator.outside[place]),
    }


def _days(
    nights: NDArray[np.int64], hours: Array, series: Array, limit: float, years_ahead: float
) -> Row:
    """Days to a limit: the fit goes by running hours, and the days by the hours of a night.

    Those of the last month and of all nights may differ; the earliest date takes the larger, the
    latest the smaller.
    """
    every, recent = (
        float(np.ptp(hours[part])) / max(int(np.ptp(nights[part])), 1)
        for part in (slice(None), slice(-NIGHTS_BEFORE - 1, None))
    )
    # A motor that has stood still for a month is taken to run again as it did.
    rates = every, recent or every
    found = time_to_limit(nights, hours, series, limit, years_ahead * DAYS_A_YEAR * max(rates))

    def days(ahead: float | None, rate: float) -> float | None:
        return None if ahead is None else ahead / rate

    return {
        "days_to_limit": days(found.time, every),
        "days_to_limit_lower": days(found.lower, max(rates)),
        "days_to_limit_upper": days(found.upper, min(rates)),
        "days_to_limit_status": found.status,
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
