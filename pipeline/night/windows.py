"""The parts of a night that are good enough to fit.

Samples outside of every good part, or of the periods set by hand, are left out and counted.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from leakage.estimation.sample_blocks import ChosenPeriods, within
from pipeline.arrays import SECOND_US, Mask, Times
from pipeline.config import Windows

# A spread goes from the one to the other: single samples make none.
SPREAD_PERCENTILES = (5.0, 95.0)


def left_out(
    time_us: Times,
    period_us: int,
    night_start_us: int,
    settings: Windows,
    chosen_periods: ChosenPeriods,
) -> dict[str, Mask]:
    """Kept samples that are in no part of the night good enough to fit, by rule."""
    if chosen_periods:
        inside = within(time_us, chosen_periods.training + chosen_periods.validation)
        return {"outside_periods": ~inside}
    thin, short = np.zeros((2, len(time_us)), dtype=np.bool_)
    if settings.minimum_block_share > 0 and len(time_us):
        length = round(settings.block_s * SECOND_US)
        sizes = _lengths(np.diff((time_us - night_start_us) // length) > 0)
        thin = np.repeat(sizes < settings.minimum_block_share * (length / period_us), sizes)
    if settings.longest_gap_s is not None and not thin.all():
        rest = np.flatnonzero(~thin)
        sizes = _lengths(np.diff(time_us[rest]) > settings.longest_gap_s * SECOND_US)
        minutes = sizes * period_us / (60 * SECOND_US)
        short[rest] = np.repeat(minutes < settings.minimum_stretch_minutes, sizes)
    return {"thin_block": thin, "short_stretch": short}


def _lengths(between: Mask) -> NDArray[np.intp]:
    """Samples of each run, from the pairs of neighbours between which one ends."""
    return np.diff(np.flatnonzero(between) + 1, prepend=0, append=len(between) + 1)


def too_uniform(values: Mapping[str, NDArray[np.float64]], settings: Windows) -> str | None:
    """Channel that varies too little over the training samples to be fitted, in words; or None."""
    needed = {
        "pressure": (settings.minimum_pressure_spread_bar, "bar"),
        "speed": (settings.minimum_speed_spread_rpm, "rpm"),
        "temperature": (settings.minimum_temperature_spread_c, "°C"),
    }
    found = []
    for name, (limit, unit) in needed.items():
        if limit > 0 and len(values[name]):
            low, high = np.percentile(values[name], SPREAD_PERCENTILES)
            if high - low < limit:
                found.append(f"{name} spans {high - low:.3g} {unit}, {limit:g} are needed")
    return "; ".join(found) or None
