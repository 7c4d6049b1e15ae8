"""Rows of `baselines` and `change_points`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from leakage.course.baseline import Baseline
from leakage.course.change_points import find_changes
from leakage.course.slope import LEAST_NIGHTS
from pipeline.trends.states.standing import CHANGED, Standing

Row = dict[str, Any]

# An indicator that has changed is described anew on the night on which it is told and every week
# for four weeks, then every four weeks.
WEEK, MONTH = 7, 28


def baseline_rows(standing: Standing, places: Sequence[int]) -> Iterator[Row]:
    """Rows of `baselines` that were frozen in some nights."""
    wanted = set(places)
    for name, watched in standing.watched.items():
        for baseline, served in zip(
            watched.found.baselines, watched.found.served_from, strict=True
        ):
            if served - 1 in wanted:
                yield _baseline_row(standing, name, baseline, served - 1)


def _baseline_row(standing: Standing, name: str, baseline: Baseline, frozen: int) -> Row:
    watched = standing.watched[name]
    indicator = watched.indicator
    own = standing.era(frozen).own
    start, end = (
        standing.label(standing.history.place_of(number))
        for number in (baseline.first_night, baseline.last_night)
    )
    row: Row = {
        **standing.key(frozen),
        "indicator": name,
        "start": start,
        "end": end,
        "n": baseline.n,
        "mean": baseline.mean - indicator.shift,
        "sd": baseline.floored_sd,
        "unit": indicator.unit,
        "phi": baseline.phi,
        "provisional": baseline.status == "provisional",
        "sloped": baseline.sloped,
        "reason": "; ".join(
            one for one in (watched.segment(frozen).reason, baseline.reason) if one
        ),
    }
    if own is not None:
        row |= {
            "own_pressure_bar": own.pressure_bar,
            "own_temperature_c": own.temperature_c,
            "own_speed_rpm": own.speed_rpm,
        }
    return row


def change_point_rows(standing: Standing, places: Sequence[int]) -> Iterator[Row]:
    """Rows of `change_points` as they are seen from some nights: steps of changed indicators."""
    for name in standing.watched:
        due = _due(standing, name)
        for place in places:
            if due[place]:
                yield from _steps(standing, name, place)


def _due(standing: Standing, name: str) -> NDArray[np.bool_]:
    """Nights on which an indicator that has changed is described."""
    states = np.array(standing.told[name])
    changed = np.isin(states, CHANGED)
    if not changed.any():
        return changed
    places = np.arange(len(states))
    begins = np.append(True, states[1:] != states[:-1])
    numbers = standing.history.numbers
    age = numbers - numbers[np.maximum.accumulate(np.where(begins, places, 0))]
    due: NDArray[np.bool_] = changed & (age % np.where(age <= MONTH, WEEK, MONTH) == 0)
    return due


def _steps(standing: Standing, name: str, place: int) -> Iterator[Row]:
    watched = standing.watched[name]
    first = watched.segment(place).first
    here = slice(first, place + 1)
    series, numbers = watched.series[here], standing.history.numbers[here]
    if int(np.isfinite(series).sum()) < LEAST_NIGHTS:
        return
    found = find_changes(numbers, series)
    for step in found.steps:
        at = int(np.searchsorted(numbers, step.night))
        level = abs(float(np.nanmedian(series[:at] if at else series)))
        # Smaller steps are what sensors and oil do by themselves.
        if level and abs(step.size) >= watched.indicator.floor * level:
            yield {
                **standing.key(place),
                "indicator": name,
                "change_night": standing.label(first + at),
                "size_percent": 100.0 * step.size / level,
                "model": found.model.replace("_", " "),
            }
