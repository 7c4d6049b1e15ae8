"""The oil as measured, in words."""

from __future__ import annotations

import numpy as np

from pipeline.config.oil_samples import OilSample
from pipeline.night.time_base import VISCOSITIES
from pipeline.trends.nights.history import History
from pipeline.trends.sentences import day


def oil_as_measured(history: History, place: int) -> str:
    """Measured viscosity of a night's oil in words; empty if not measured."""
    ratio, sample = viscosity_ratio(history, place), _last_sample(history, place)
    if ratio is None:
        return ""
    by_log = any(name in history.spec.file.channels for name in VISCOSITIES)
    percent = 100.0 * (ratio - 1.0)
    size = f"{abs(percent):.0f} % {'thinner' if percent < 0 else 'thicker'} than its data sheet"
    words = "as its data sheet" if abs(percent) < 0.5 else size
    source = "by the log" if by_log or sample is None else f"on {day(sample.date)}"
    parts = [words, _since_then(history, place, by_log), water_in_oil(history, place)]
    return f"oil as measured {source}: {', '.join(part for part in parts if part)}"


def _since_then(history: History, place: int, by_log: bool) -> str:
    """That nights before the first analysis went by the data sheet; empty where none did."""
    night = history.nights[place]
    dates = [
        one.date
        for one in history.spec.samples_of(night)
        if one.viscosity_40_c_mm2_per_s is not None
    ]
    is_dated = history.spec.file.filled_on(night) is not None
    if by_log or is_dated or not dates or dates[0] <= history.nights[0]:
        return ""
    return f"by which the nights before {day(dates[0])} went"


def viscosity_ratio(history: History, place: int) -> float | None:
    """Measured viscosity over the data sheet's, of the last night that has it."""
    ratios = history.records["viscosity"][: place + 1]
    known = ratios[np.isfinite(ratios)]
    return float(known[-1]) if len(known) else None


def _last_sample(history: History, place: int) -> OilSample | None:
    """The last analysis of the viscosity until a night."""
    night = history.nights[place]
    return next(
        (
            one
            for one in reversed(history.spec.samples_of(night))
            if one.date <= night and one.viscosity_40_c_mm2_per_s is not None
        ),
        None,
    )


def water_in_oil(history: History, place: int) -> str:
    """Water content by the last analysis that has it, in words; empty without one."""
    night = history.nights[place]
    known = [
        one.water_mg_per_kg
        for one in history.spec.samples_of(night)
        if one.date <= night and one.water_mg_per_kg is not None
    ]
    return f"water {known[-1]:g} mg/kg" if known else ""
