"""Rows of `trends`, `alarms`, `baselines` and `change_points`."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from leakage import OperatingConditions, regressors
from leakage.alarms import OF_SEVERITY
from leakage.attribution import Attribution, attribute
from leakage.baseline import Baseline
from leakage.change_points import find_changes
from leakage.cusum import cusum_limit
from leakage.errors import LeakageError
from leakage.monitoring import Monitoring, change_size
from leakage.slope import Slope, fit_slope
from leakage.time_to_limit import TimeToLimit, time_to_limit
from pipeline.nights import night as night_labelled
from pipeline.trends.indicators import (
    DEVIATION,
    OWN_REFERENCE,
    PEER_DEVIATION,
    REFERENCE,
    Indicator,
    gap_change,
    scaled,
    status_gates,
)
from pipeline.trends.peers import Peers
from pipeline.trends.running import coverage, running_hours, sensor_health
from pipeline.trends.segments import Segment
from pipeline.trends.watch import RATIOS, MotorWatch, Watched
from pipeline.trends.words import moved_words, path_words, size_words

Array = NDArray[np.float64]
Row = dict[str, Any]

DAYS_A_YEAR = 365.25
UTC_EPOCH = dt.datetime(1970, 1, 1, tzinfo=dt.UTC)
RAISED = ("warning", "alarm")
# Good nights that say what the coefficients are now.
NIGHTS_OF_NOW = 10
# Indicators whose changes are described by steps and trends, once a run.
LEAST_CHANGE_NIGHTS = 20


@dataclass(frozen=True)
class MotorRows:
    """The rows of a motor's trends.

    Parameters
    ----------
    watch
        What watching its indicators has shown.
    peers
        Its deviation from the other motors of its oil circuit, of the baseline deviation; None for
        a motor on its own.
    apart
        Nights on which its paths had moved by different amounts, shape (n,).
    """

    watch: MotorWatch
    peers: Peers | None
    apart: NDArray[np.bool_]

    @cached_property
    def _hours(self) -> tuple[Array, NDArray[np.bool_]]:
        found = running_hours(self.watch.history)
        return found.total, found.estimated

    @cached_property
    def _positions(self) -> tuple[Array, Array]:
        """Years and thousands of running hours of each night."""
        return self.watch.numbers / DAYS_A_YEAR, self._hours[0] / 1000.0

    def trends(self, places: Sequence[int]) -> Iterator[Row]:
        """Rows of `trends` of some nights."""
        for place in places:
            shared = self._shared(place)
            for name, watched in self.watch.watched.items():
                yield shared | self._watched_row(name, watched, place)
                yield from (shared | row for row in self._derived(name, watched, place))
            if self.peers is not None:
                yield shared | self._peer_row(place)

    def alarms(self, places: Sequence[int]) -> Iterator[Row]:
        """Rows of `alarms`: changes of state in some nights."""
        wanted = set(places)
        for name, watched in self.watch.watched.items():
            before = "insufficient"
            for place in range(len(self.watch.numbers)):
                after = self._state(watched, place)
                if after != before and place in wanted and {before, after} != {"insufficient"}:
                    yield from self._alarm_row(name, watched, place, before, after)
                before = after

    def closing_row(self, old: Row, place: int) -> Row:
        """The row that closes a published alarm which its motor's later data took back."""
        end_us = night_labelled(self._label(place), self.watch.spec.settings.nights).end_us
        return {
            **self._key(place),
            "time": UTC_EPOCH + dt.timedelta(microseconds=end_us),
            "indicator": old["indicator"],
            "from_state": old["to_state"],
            "to_state": self._state(self.watch.watched[old["indicator"]], place)
            if old["indicator"] in self.watch.watched
            else "insufficient",
            "reason": f"recomputed: what was raised on {old['night']} is not in the figures as "
            "they are now",
            "deviation_percent": None,
            "way": "recomputed",
            "path": None,
        }

    def baselines(self, places: Sequence[int]) -> Iterator[Row]:
        """Rows of `baselines` that were frozen in some nights."""
        wanted = set(places)
        for name, watched in self.watch.watched.items():
            for segment, found in zip(watched.segments, watched.monitoring, strict=True):
                track = found.own
                for baseline, served in zip(track.baselines, track.served_from, strict=True):
                    frozen = segment.first + served - 1
                    if frozen in wanted:
                        yield self._baseline_row(name, watched, segment, baseline, frozen)

    def change_points(self, place: int) -> Iterator[Row]:
        """Rows of `change_points` as they are seen from a night."""
        for name, watched in self.watch.watched.items():
            if self._state(watched, place) not in (*RAISED, "common_cause"):
                continue
            segment, _, _ = _at(watched, place)
            here = slice(segment.first, place + 1)
            series, numbers = watched.series[here], self.watch.numbers[here]
            if int(np.isfinite(series).sum()) < LEAST_CHANGE_NIGHTS:
                continue
            found = find_changes(numbers, series)
            for step in found.steps:
                at = int(np.searchsorted(numbers, step.night))
                level = abs(float(np.nanmedian(series[:at] if at else series)))
                # Smaller steps are what sensors and oil do by themselves.
                if level and abs(step.size) >= watched.indicator.floor * level:
                    yield {
                        **self._key(place),
                        "indicator": name,
                        "change_night": self._label(segment.first + at),
                        "size_percent": 100.0 * step.size / level,
                        "model": found.model.replace("_", " "),
                    }

    def _label(self, place: int) -> dt.date:
        return self.watch.history.nights[place]

    def _key(self, place: int) -> Row:
        return {"motor_id": self.watch.spec.motor_id, "night": self._label(place)}

    def _shared(self, place: int) -> Row:
        """What all rows of a night have in common."""
        history = self.watch.history
        era = next(one for one in self.watch.eras if place < one.segment.end)
        total, estimated = self._hours
        first = era.segment.first
        # Before there is a baseline, the nights so far stand in for it.
        last = min(era.known_from, era.segment.end - 1, place)

        def operated(name: str) -> float | None:
            return _finite(history.operated(name)[place])

        return {
            **self._key(place),
            "running_hours": float(total[place]),
            "running_hours_estimated": bool(estimated[place]),
            "oil": self.watch.spec.file.oil_on(self._label(place)),
            "mean_temperature_c": operated("mean_temperature_c"),
            "share_reversed": operated("share_reversed"),
            "flushing_mode": history.fits["flushing_mode"][place],
            "coverage": coverage(history, place, first, last),
            "sensor_health": sensor_health(self.watch.spec, history, place, first).status,
        }

    def _state(self, watched: Watched, place: int) -> str:
        """State of a night; what moved one path alone is no common cause, whatever others did."""
        segment, found, _ = _at(watched, place)
        inside = place - segment.first
        state = found.states[inside]
        if state == "common_cause" and self.apart[place]:
            return OF_SEVERITY[int(found.own.severity[inside])]
        return state

    def _watched_row(self, name: str, watched: Watched, place: int) -> Row:
        segment, found, baseline = _at(watched, place)
        inside = place - segment.first
        state = self._state(watched, place)
        row = _figures(watched.indicator, place)
        row |= {"state": state, "state_reason": None}
        if baseline is None:
            if row["value"] is not None and name in (DEVIATION, OWN_REFERENCE):
                # Not known on the night itself: what it is relative to was frozen later.
                row |= dict.fromkeys(("value", "lower", "upper"))
                row["gated_reason"] = "no baseline yet"
            row["state_reason"] = self._why_no_baseline(watched, place)
            era = next(one for one in self.watch.eras if place < one.segment.end)
            if name in (DEVIATION, OWN_REFERENCE) and place < era.known_from:
                # On that night there was no series to lay a line through.
                return row | {"days_to_limit_status": "insufficient"}
            return row | self._line(watched, place, None)
        evidence = found.own.evidence[inside]
        limit = cusum_limit(watched.settings.false_alarms_per_year, baseline)
        shift = 1.0 if name in RATIOS else 0.0
        row |= {
            "baseline_start": self._label(_place_of(self.watch.numbers, baseline.first_night)),
            "baseline_mean": baseline.mean - shift,
            "deviation_percent": _percent(found.own.deviation[inside]),
            "cusum": None if np.isnan(evidence) else float(evidence) * limit,
            "cusum_limit": limit,
            "warning_limit": baseline.mean * (1.0 + watched.settings.levels.warning) - shift,
            "alarm_limit": baseline.mean * (1.0 + watched.settings.levels.alarm) - shift,
        }
        if state == "ok":
            return row | self._line(watched, place, baseline)
        attribution = self._attribution(name, place)
        row["state_reason"] = self._why(name, watched, place, attribution)
        row["path"] = _path(name, state, attribution)
        if attribution is not None:
            row |= {
                "path_probability": attribution.probability,
                "path_reason": attribution.reason or None,
            }
        return row | self._line(watched, place, baseline)

    def _line(self, watched: Watched, place: int, baseline: Baseline | None) -> Row:
        """Slopes and time to limit as of a night."""
        segment, _, _ = _at(watched, place)
        here = slice(segment.first, place + 1)
        numbers, series = self.watch.numbers[here], watched.series[here]
        years, hours = (position[here] for position in self._positions)
        trend = self.watch.spec.settings.trend
        line = fit_slope(numbers, series, years, coverage=trend.confidence)
        by_hours = fit_slope(numbers, series, hours, coverage=trend.confidence)
        row = {
            "n_slope": line.n,
            "provisional": line.status == "provisional",
            "p_value": line.p_value,
            "theil_sen_per_year": line.theil_sen,
            "theil_sen_outside": line.theil_sen_outside if line.slope is not None else None,
            **_slope_columns("per_year", line),
            **_slope_columns("per_1000_h", by_hours),
            "days_to_limit_status": "insufficient",
        }
        if baseline is None or line.slope is None:
            return row
        absolute = watched.settings.limits.alarm
        limit = absolute or baseline.mean * (1.0 + watched.settings.levels.alarm)
        found = time_to_limit(
            line, limit, float(years[-1]), trend.horizon_years, coverage=trend.confidence
        )
        shift = 1.0 if watched.indicator.name in RATIOS else 0.0
        return row | {"limit": limit - shift} | _days(found)

    def _derived(self, name: str, watched: Watched, place: int) -> Iterator[Row]:
        """The same of a coefficient as people are shown it: leakage of its path, change of gap."""
        if not name.startswith("K_"):
            return
        path = name.removeprefix("K_")
        _, _, baseline = _at(watched, place)
        state = {"state": self._state(watched, place)}
        factor = self._flow_factors(place).get(path)
        if factor is not None:
            one = scaled(watched.indicator, f"leakage_{path}", "l/min", factor)
            row = _figures(one, place) | state
            if baseline is not None:
                row["baseline_mean"] = baseline.mean * factor
            yield row
        if baseline is not None:
            one = gap_change(watched.indicator, f"gap_change_{path}", baseline.mean)
            yield _figures(one, place) | state | {"baseline_mean": 0.0}

    def _flow_factors(self, place: int) -> dict[str, float]:
        """Flow of each free path per unit of its coefficient at the reference conditions."""
        key = self.watch.spec.file.oil_on(self._label(place))
        if key not in self._factors:
            self._factors[key] = self._factors_of(place)
        return self._factors[key]

    @cached_property
    def _factors(self) -> dict[str, dict[str, float]]:
        return {}

    def _mean_factors(self, place: int) -> dict[str, float]:
        """The same at what the night saw, on average: a ring shows at low pressures only."""
        fits = self.watch.history.fits
        while place > 0 and fits["night_factor"][place] is None:
            place -= 1
        columns, upper = fits["columns"][place], fits["night_factor"][place]
        if upper is None:
            return {}
        size = len(columns)
        factor = np.zeros((size, size))
        factor[np.triu_indices(size)] = upper
        sums = factor.T @ factor[:, size - 3]
        return dict(zip(columns[: size - 3], (sums / sums[size - 3]).tolist(), strict=False))

    def _factors_of(self, place: int) -> dict[str, float]:
        spec, history = self.watch.spec, self.watch.history
        reference = spec.settings.reference
        charge = _finite(history.column("mean_charge_over_case_bar")[place])
        try:
            motor = spec.motor(self._label(place), spec.file.flushing.mode)
            at = OperatingConditions.from_bar(
                reference.pressure_bar, reference.temperature_c, reference.speed_rpm, charge
            )
            row = regressors(motor, at)[0]
        except LeakageError:
            return {}
        names = [path.name for path in motor.column_paths]
        return dict(zip(names, row[: len(names)].tolist(), strict=True))

    def _attribution(self, name: str, place: int) -> Attribution | None:
        """Which path explains the change that an indicator tells in a night."""
        watched = self.watch.watched[name]
        # A coefficient speaks for its own path.
        if name.startswith("K_") or self._state(watched, place) not in (*RAISED, "common_cause"):
            return None
        factors = self._flow_factors(place) if name == REFERENCE else self._mean_factors(place)
        begin = self._onset(place)
        names, changes, baseline_nights, now_nights = [], [], [], []
        for path in factors:
            one = self.watch.watched.get(f"K_{path}")
            if one is None:
                continue
            segment, _, baseline = _at(one, place)
            if baseline is None:
                continue
            good = np.flatnonzero(np.isfinite(one.series[: place + 1]))
            before = good[(good >= segment.first) & (good <= self._end_of(baseline))]
            now = good[good >= max(begin, segment.first)][-NIGHTS_OF_NOW:]
            if len(before) < LEAST_CHANGE_NIGHTS or not len(now):
                continue
            names.append(path)
            changes.append(float(np.mean(one.series[now])) - baseline.mean)
            baseline_nights.append(one.series)
            now_nights.append((before, now, baseline))
        if not names:
            return None
        flows = np.array([factors[name] for name in names])
        covariance = _covariance_of_changes(baseline_nights, now_nights)
        return attribute(tuple(names), flows, np.array(changes), covariance)

    def _onset(self, place: int) -> int:
        """Place of the night on which the change began that some indicator tells."""
        begins = [place]
        for watched in self.watch.watched.values():
            segment, found, _ = _at(watched, place)
            onset = int(found.own.onset[place - segment.first])
            if onset >= 0 and self._state(watched, place) in (*RAISED, "common_cause"):
                begins.append(segment.first + onset)
        # A wear that goes on is judged by its latest nights.
        return min(begins)

    def _end_of(self, baseline: Baseline) -> int:
        return _place_of(self.watch.numbers, baseline.last_night)

    def _why_no_baseline(self, watched: Watched, place: int) -> str:
        segment, _, _ = _at(watched, place)
        good = int(np.isfinite(watched.series[segment.first : place + 1]).sum())
        if watched.indicator.name in (DEVIATION, OWN_REFERENCE):
            # Their series is only known in hindsight; every fitted night goes into it.
            gates = status_gates(self.watch.history)[segment.first : place + 1]
            good = sum(not reason for reason in gates)
        needed = watched.settings.baseline.provisional_nights
        return f"{good} of {needed} good nights for a baseline ({segment.reason})"

    def _why(self, name: str, watched: Watched, place: int, attribution: Attribution | None) -> str:
        """A state that is not ok, in words."""
        segment, found, _ = _at(watched, place)
        inside = place - segment.first
        state = self._state(watched, place)
        if state == "stale":
            nights = int(found.own.since_good[inside])
            return f"no trusted figure for {nights} nights: {watched.indicator.gated[place]}"
        parts = [self._size_words(name, watched, place)]
        if state in RAISED:
            parts += self._reference_words(name, place)
        parts.append(path_words(attribution))
        if state == "common_cause":
            parts.append(
                "the other motors of the oil circuit moved alike: oil, temperature or charge "
                "pressure, not this motor"
            )
        era = next(one for one in self.watch.eras if place < one.segment.end)
        health = sensor_health(self.watch.spec, self.watch.history, place, era.segment.first)
        parts.append(health.words)
        return "; ".join(part for part in parts if part)

    def _size_words(self, name: str, watched: Watched, place: int) -> str:
        segment, found, _ = _at(watched, place)
        here = slice(segment.first, segment.end)
        inside = place - segment.first
        numbers, series = self.watch.numbers[here], watched.series[here]
        size = change_size(numbers, series, found.own, inside)
        if size is None:
            # A step that the levels tell before the sum does: the nights that they count.
            good = np.flatnonzero(np.isfinite(series[: inside + 1]))
            first = good[-watched.settings.levels.on_nights :][:1]
            onset = np.full(len(series), -1, dtype=np.int64)
            onset[inside] = first[0] if len(first) else -1
            size = change_size(numbers, series, replace(found.own, onset=onset), inside)
        since = (
            None if size is None else self._label(_place_of(self.watch.numbers, size.since_night))
        )
        recent = found.own.deviation[: inside + 1]
        recent = recent[np.isfinite(recent)]
        percent = 100.0 * float(recent[-1]) if len(recent) else 0.0
        return size_words(name, percent, size, since)

    def _reference_words(self, indicator: str, place: int) -> list[str]:
        """How far the reference leakage moved with another indicator; the own where there is none.

        Of the nights since the change, as the indicator's own figure.
        """
        begin = self._onset(place)
        for name in (REFERENCE, OWN_REFERENCE):
            if name == indicator:
                return []
            segment, found, baseline = _at(self.watch.watched[name], place)
            if baseline is None:
                continue
            recent = found.own.deviation[max(begin - segment.first, 0) : place - segment.first + 1]
            recent = recent[np.isfinite(recent)][-NIGHTS_OF_NOW:]
            if len(recent):
                return [moved_words(name, 100.0 * float(np.mean(recent)))]
        return []

    def _alarm_row(
        self, name: str, watched: Watched, place: int, before: str, after: str
    ) -> Iterator[Row]:
        segment, found, _ = _at(watched, place)
        inside = place - segment.first
        label = self._label(place)
        end_us = night_labelled(label, self.watch.spec.settings.nights).end_us
        attribution = self._attribution(name, place)
        if after == "ok":
            reason = "a baseline was taken" if before == "insufficient" else "back below its levels"
        elif after == "insufficient":
            reason = f"a new baseline begins: {segment.reason}"
        else:
            reason = self._why(name, watched, place, attribution)
        way = "recovered" if before in RAISED else "baseline"
        if after in RAISED:
            by_sum = found.own.evidence[inside] > 1.0 or found.own.onset[inside] >= 0
            by_level = bool(found.own.deviation[inside] >= watched.settings.levels.warning)
            way = "both" if by_sum and by_level else "change" if by_sum else "level"
        elif after in ("stale", "common_cause"):
            way = after
        yield {
            **self._key(place),
            "time": UTC_EPOCH + dt.timedelta(microseconds=end_us),
            "indicator": name,
            "from_state": before,
            "to_state": after,
            "reason": reason,
            "deviation_percent": _percent(found.own.deviation[inside]),
            "way": way,
            "path": _path(name, after, attribution),
        }

    def _baseline_row(
        self, name: str, watched: Watched, segment: Segment, baseline: Baseline, frozen: int
    ) -> Row:
        era = next(one for one in self.watch.eras if frozen < one.segment.end)
        shift = 1.0 if name in RATIOS else 0.0
        row: Row = {
            **self._key(frozen),
            "indicator": name,
            "start": self._label(_place_of(self.watch.numbers, baseline.first_night)),
            "end": self._label(self._end_of(baseline)),
            "n": baseline.n,
            "mean": baseline.mean - shift,
            "sd": baseline.floored_sd,
            "unit": watched.indicator.unit,
            "phi": baseline.phi,
            "provisional": baseline.status == "provisional",
            "sloped": baseline.sloped,
            "reason": "; ".join(one for one in (segment.reason, baseline.reason) if one),
        }
        if era.own is not None:
            row |= {
                "own_pressure_bar": era.own.pressure_bar,
                "own_temperature_c": era.own.temperature_c,
                "own_speed_rpm": era.own.speed_rpm,
            }
        return row

    def _peer_row(self, place: int) -> Row:
        assert self.peers is not None
        value = _finite(float(np.expm1(self.peers.deviation[place])))
        watched = self.watch.watched[DEVIATION]
        segment, found, _ = _at(watched, place)
        corrected = found.corrected
        inside = place - segment.first
        state = "insufficient"
        if corrected is not None and corrected.has_baseline[inside]:
            state = ("ok", "warning", "alarm")[int(corrected.severity[inside])]
        n = int(self.peers.n_others[place])
        return {
            "indicator": PEER_DEVIATION,
            "unit": "1",
            "value": value,
            "n_nights": 1,
            "gated_reason": None if value is not None else "no figure of the circuit's motors",
            "state": state,
            "state_reason": "with one other motor: they diverge, nobody can tell which"
            if n == 1 and state in RAISED
            else None,
        }


def _path(name: str, state: str, attribution: Attribution | None) -> str | None:
    """The path behind a state, as `trends` and `alarms` name it; None where none can be named."""
    if state not in (*RAISED, "common_cause"):
        return None
    if name.startswith("K_"):
        return name.removeprefix("K_")
    if attribution is None or attribution.status not in ("path", "together"):
        return None
    return " and ".join(attribution.paths)


def _covariance_of_changes(
    series: Sequence[Array], nights: Sequence[tuple[NDArray[np.intp], NDArray[np.intp], Baseline]]
) -> Array:
    """Covariance of (mean now − baseline mean) of several coefficients, from the baseline's nights.

    Their scatter from night to night holds both the errors of the fits, with their correlation, and
    what the motor does by itself.
    """
    common = nights[0][0]
    for before, _, _ in nights[1:]:
        common = np.intersect1d(common, before)
    if len(common) < LEAST_CHANGE_NIGHTS:
        scatter = np.diag([baseline.sd**2 for _, _, baseline in nights])
    else:
        table = np.array([one[common] for one in series])
        spread = np.sqrt(np.diag(np.atleast_2d(np.cov(table))))
        winsorised = np.array([baseline.sd for _, _, baseline in nights])
        # The winsorised scatter for the size, all nights for the correlation.
        ratio = np.divide(winsorised, spread, out=np.ones_like(spread), where=spread > 0)
        scatter = np.atleast_2d(np.cov(table)) * np.outer(ratio, ratio)
    share = np.array(
        [
            (1.0 / len(now) * _memory(baseline) + (baseline.mean_error / baseline.sd) ** 2)
            if baseline.sd > 0
            else 0.0
            for _, now, baseline in nights
        ]
    )
    covariance: Array = scatter * np.sqrt(np.outer(share, share))
    return covariance


def _memory(baseline: Baseline) -> float:
    return (1.0 + baseline.phi) / (1.0 - baseline.phi)


def _at(watched: Watched, place: int) -> tuple[Segment, Monitoring, Baseline | None]:
    """Segment and monitoring of a night, and the baseline that serves it."""
    for segment, found in zip(watched.segments, watched.monitoring, strict=True):
        if place < segment.end:
            served = [
                baseline
                for baseline, first in zip(found.own.baselines, found.own.served_from, strict=True)
                if segment.first + first <= place
            ]
            return segment, found, served[-1] if served else None
    raise IndexError(place)


def _place_of(numbers: NDArray[np.int64], number: int) -> int:
    return int(np.searchsorted(numbers, number))


def _figures(indicator: Indicator, place: int) -> Row:
    return {
        "indicator": indicator.name,
        "unit": indicator.unit,
        "value": _finite(indicator.value[place]),
        "lower": _finite(indicator.lower[place]),
        "upper": _finite(indicator.upper[place]),
        "n_nights": int(indicator.n_nights[place]),
        "gated_reason": indicator.gated[place] or None,
        "outside_fitted_range": bool(indicator.outside[place]),
    }


def _slope_columns(name: str, line: Slope) -> Row:
    return {
        f"slope_{name}": line.slope,
        f"slope_{name}_lower": line.lower,
        f"slope_{name}_upper": line.upper,
    }


def _days(found: TimeToLimit) -> Row:
    def days(years: float | None) -> float | None:
        return None if years is None else years * DAYS_A_YEAR

    return {
        "days_to_limit": days(found.time),
        "days_to_limit_lower": days(found.lower),
        "days_to_limit_upper": days(found.upper),
        "days_to_limit_status": found.status,
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _percent(value: float) -> float | None:
    return 100.0 * float(value) if np.isfinite(value) else None


def by_night(rows: Iterator[Row]) -> Mapping[dt.date, list[Row]]:
    """Rows by their night."""
    nights: dict[dt.date, list[Row]] = {}
    for row in rows:
        nights.setdefault(row["night"], []).append(row)
    return nights
