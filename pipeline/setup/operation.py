"""Operation in a log: how long and at which conditions, and columns that look swapped."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator

import numpy as np
import polars as pl

from pipeline.arrays import SECOND_US, Array
from pipeline.config import MotorSpec
from pipeline.config.nights import night
from pipeline.ingest import RawLog
from pipeline.logs.files import reaches_us, slice_night
from pipeline.night.fit_night import MINIMUM_TRAINING_MINUTES, clean_channels
from pipeline.night.time_base import Insufficient, Samples

# Simulated nights of benchmarks/results/coverage.md, loads of 15 to 90 s: the range of each input,
# 5th to 95th percentile. Of those of 30 minutes and more 92 to 100 % estimated every path.
_RANGES = {"pressure": (260.0, "bar"), "speed": (96.0, "rpm"), "oil temperature": (12.0, "°C")}
# Conditions that vary by less tell nothing: the 5th to 95th percentile beside the median, and [K].
_VARIES, _VARIES_K = 0.3, 4.0
# Ranks of a flow and of what drives it agree at least so far, with noise and dead time.
_FOLLOWS = 0.2
_FEWEST, _MOST_RANKED = 200, 20_000
# Oil in a line warms and cools slower than this, but for a few spikes.
_JUMP_C, _JUMP_S, _JUMPS_SHARE = 2.0, 10.0, 0.02


def night_of_log(spec: MotorSpec, label: dt.date, log: RawLog) -> Samples | None:
    """The samples that a run keeps of a night of a log; None for none."""
    here = night(label, spec.settings.nights)
    channels = slice_night([log], here, reaches_us(spec))
    try:
        samples, _ = clean_channels(spec.file, spec.settings, here, channels)
    except Insufficient:
        return None
    return samples if len(samples.index) else None


def operation(spec: MotorSpec, samples: Samples) -> str:
    """Running minutes of a night, the conditions in them, and what they are enough for, in words.

    Conditions are the 5th to 95th percentiles while the motor ran.
    """
    minutes = samples.n_turning * samples.period_us / SECOND_US / 60.0
    pressure, speed = np.abs(samples.pressure_difference_bar), np.abs(samples.speed_rpm)
    inputs = (pressure, speed, samples.oil_temperature_c)
    reached = []
    for (name, (full, unit)), values in zip(_RANGES.items(), inputs, strict=True):
        low, high = np.percentile(values, (5, 95), method="nearest")
        share = min((high - low) / full, 1.0)
        reached.append(f"{name} {low:.3g} to {high:.3g} {unit} ({100 * share:.0f} %)")
    ran = (
        f"the motor ran {minutes:.3g} minutes a night, at {', '.join(reached)} of the range that "
        "identifies every path within 30 minutes"
    )
    needed = MINIMUM_TRAINING_MINUTES / spec.settings.windows.training_share
    if minutes < needed:
        return f"{ran}: too little for a fit, which needs {needed:.3g} minutes"
    return f"{ran}; first verdict on a change after {spec.settings.trend.baseline_nights} nights"


def swapped(samples: Samples) -> Iterator[str]:
    """Notes on channels whose columns may be another's."""
    if samples.index.size < _FEWEST:
        return
    p, t, q = (
        np.abs(samples.pressure_difference_bar),
        samples.oil_temperature_c,
        samples.leakage_l_per_min,
    )
    close = np.diff(samples.time_us) <= _JUMP_S * SECOND_US
    if float(np.mean(np.abs(np.diff(t))[close] > _JUMP_C)) > _JUMPS_SHARE:
        yield "oil_temperature jumps as no oil does: are columns swapped?"
    widths = ((p, _VARIES * np.median(p)), (t, _VARIES_K))
    drives = [values for values, width in widths if np.ptp(np.percentile(values, (5, 95))) > width]
    # Hotter oil is thinner: the flow rises with either.
    if drives and np.ptp(q) > 0 and all(_rank_correlation(drive, q) < _FOLLOWS for drive in drives):
        how = "follows neither pressure nor the oil's viscosity"
        yield f"the drain flow {how}: are columns swapped?"


def _rank_correlation(x: Array, y: Array) -> float:
    """Spearman's coefficient."""
    # Not SciPy's, which takes half a second to load before the first run of a fleet.
    thin = slice(None, None, max(len(x) // _MOST_RANKED, 1))
    ranks = pl.corr(pl.Series(x[thin]), pl.Series(y[thin]), method="spearman")
    return float(pl.select(ranks).item())
