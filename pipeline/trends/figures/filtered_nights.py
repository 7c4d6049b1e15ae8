"""Figures of nights that are too poor alone: the filter that each night of a motor informs.

A night's state hangs on that night and those before it since the last event. It is kept with the
night, so that a run follows its new nights alone.
"""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from leakage.course.night_filter import (
    FilterState,
    NightInformation,
    first_state,
    follow,
    night_information,
)
from leakage.course.temperature_correction import TemperatureCorrection
from pipeline.night.rows import upper_triangle
from pipeline.trends.figures.temperature import NIGHTS, FrozenCorrection, frozen_correction, warming
from pipeline.trends.nights.history import History
from pipeline.trends.nights.records import Layout, Records, symmetric_matrix, whole_matrix
from pipeline.trends.nights.segments import Segment, segments

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Informed nights after which their own coefficients scale the walk, the configured ones before.
NIGHTS_OF_SCALE = 10
# A coefficient's size is at least this part of the configured one, and a flushing's this [l/min].
LEAST_SCALE, LEAST_FLUSHING = 0.1, 1.0
LEVEL = 0.95
# A filtered figure counts up to these half-widths, relative to the coefficient's scale and to the
# leakage (model.md, section 5).
WIDEST_COEFFICIENT, WIDEST_LEAKAGE = 0.5, 0.1


def with_filter(history: History, until: dt.date) -> History:
    """A history whose nights from one on are followed by the filter, those before as they are."""
    records = history.records.copy()
    begin = history.place_from(until)
    for part in segments(history):
        if part.end > begin:
            _follow_segment(history, records, part, max(begin, part.first))
    return replace(history, records=records)


def _follow_segment(history: History, records: Records, part: Segment, begin: int) -> None:
    """Follow a segment's nights with statistics, from a place on."""
    layout, free, numbers = history.layout, np.array(history.layout.free), history.numbers
    learning = history.spec.settings.trend.baseline_nights
    places = part.first + np.flatnonzero(
        np.isfinite(records["factor"][part.first : part.end]).all(axis=1)
    )
    done, left = places[places < begin], places[places >= begin]
    scale, followed = _configured_scale(layout), 0
    state, last = first_state(scale), int(places[0]) if len(places) else part.first
    if len(done):
        last = int(done[-1])
        state, scale = _state_of(records[last], free)
        followed = int(records["followed"][last])
    frozen: FrozenCorrection | None = None
    looked_at = -1
    for place in left.tolist():
        here = records[part.first : place]
        good = int(np.count_nonzero(here["fitted"] | here["informed"]))
        if frozen is None and good != looked_at and (looked_at < 0 or good in NIGHTS):
            frozen = frozen_correction(replace(history, records=records), part.first, place)
        looked_at = good
        record, nights = records[place], int(numbers[place] - numbers[last])
        told = _information(layout, record, frozen.correction if frozen else None)
        state = follow(state, told, nights, scale, followed < learning)
        record["informed"] = state.informed
        followed += state.informed
        if followed == NIGHTS_OF_SCALE:
            scale = np.maximum(state.mean, LEAST_SCALE * scale)
        record["followed"], last = followed, place
        _keep(layout, record, state, scale)


def _configured_scale(layout: Layout) -> Array:
    """Sizes of the free coefficients as configured."""
    sizes = np.array(layout.configured)
    sizes[-1] = max(sizes[-1], LEAST_FLUSHING)
    found: Array = sizes[np.array(layout.free)]
    return found


def _information(
    layout: Layout, record: Any, correction: TemperatureCorrection | None
) -> NightInformation:
    """Information in a night with statistics, its loss factors being those of T₀."""
    free = np.array(layout.free)
    factor = whole_matrix(record["factor"], len(layout.columns))
    told = night_information(factor[None], np.array(layout.configured), free)
    noise, freedom = (np.nan_to_num(record[name][free]) for name in ("noise", "freedom"))
    told = replace(told, noise=noise, freedom=freedom)
    if correction is None or not correction.is_certain:
        return told
    # Columns times the factor on K; what the night's blocks differ by in temperature moves X'y.
    moved = told.explained + correction.per_kelvin * told.gram @ record["response"][free]
    factor_on = np.ones(len(free))
    factor_on[:-1] = warming(np.atleast_1d(record), correction)
    factor_on = factor_on[free]
    return replace(
        told,
        gram=told.gram * np.outer(factor_on, factor_on),
        explained=moved * factor_on,
        known=told.known * factor_on,
    )


def _keep(layout: Layout, record: Any, state: FilterState, scale: Array) -> None:
    """A state into the fields of a record that has it; what is not free is as configured."""
    free, n = np.array(layout.free), len(layout.free)
    spread = np.zeros((n, n))
    spread[np.ix_(free, free)] = state.covariance
    record["spread"], record["opened"] = upper_triangle(spread), state.opened
    record["mean"] = layout.configured
    for name, values in (
        ("mean", state.mean),
        ("noise_sum", state.noise),
        ("freedom_sum", state.freedom),
        ("scale", scale),
    ):
        record[name][free] = values


def _state_of(record: Any, free: Mask) -> tuple[FilterState, Array]:
    """A state and its scale from a record."""
    spread = symmetric_matrix(record["spread"], len(free))
    state = FilterState(
        record["mean"][free].copy(),
        spread[np.ix_(free, free)],
        record["noise_sum"][free].copy(),
        record["freedom_sum"][free].copy(),
        informed=bool(record["informed"]),
    )
    return state, record["scale"][free].copy()


@dataclass(frozen=True, slots=True, eq=False)
class Filtered:
    """A linear combination of the filtered coefficients over a motor's nights, shape (n,) each.

    With the half-width of its 95 % interval, nan in nights without information, and the number of
    nights behind it since the last event.
    """

    value: Array
    half: Array
    n_nights: NDArray[np.int32]

    def counts(self, widest: Array | float) -> Mask:
        """Nights whose figure is positive and known to within so much."""
        counts: Mask = (self.half <= widest) & (self.value > 0.0)
        return counts

    def why(self, place: int, size: float, widest: float) -> str:
        """Reason why the figure of a night does not count; empty if there is no figure."""
        if not np.isfinite(self.half[place]):
            return ""
        return (
            f"known to ± {100 * self.half[place] / size:.0f} % by {self.n_nights[place]} nights; "
            f"{100 * widest:.0f} % are needed"
        )


def filtered(records: Records, contrast: Array, known: Array | float = 0.0) -> Filtered:
    """A combination c'θ + known of each night's filtered coefficients.

    For m nights, the contrast c has shape (p + 1,) or (m, p + 1); the known flow is a number or has
    shape (m,).
    """
    contrast = np.broadcast_to(contrast, records["mean"].shape)
    spread = symmetric_matrix(records["spread"], contrast.shape[1])
    with np.errstate(invalid="ignore"):
        variance = np.einsum("ni,nij,nj->n", contrast, spread, contrast)
        freedom = np.maximum(np.nansum(records["freedom_sum"], axis=1), 1.0)
        half = stdtrit(freedom, 0.5 + LEVEL / 2) * np.sqrt(np.maximum(variance, 0.0))
        value = np.einsum("ni,ni->n", contrast, records["mean"]) + known
    informed = records["informed"]
    return Filtered(
        np.where(informed, value, np.nan), np.where(informed, half, np.nan), records["followed"]
    )
