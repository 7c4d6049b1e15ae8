"""Operation in a log, and the figures that a night of it gives if the model describes the motor."""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Iterator

import numpy as np
import polars as pl

from leakage import LeakageError, Motor, OperatingConditions
from leakage.physics.motor import path_flows_l_per_min
from pipeline.arrays import SECOND_US, Array
from pipeline.config import MotorSpec
from pipeline.config.nights import night
from pipeline.ingest import RawLog
from pipeline.logs.files import reaches_us, slice_night
from pipeline.messages import plain
from pipeline.night.fit_night import Insufficient, clean_channels
from pipeline.night.time_base import Samples

# Simulated nights of benchmarks/results/coverage.md, loads of 15 to 90 s: the range of each input,
# 5th to 95th percentile, and the minutes of which 92 to 100 % told every path.
_RANGES = {"pressure": (260.0, "bar"), "speed": (96.0, "rpm"), "oil temperature": (12.0, "°C")}
_ENOUGH_MINUTES = 30.0
# Error of the flow [l/min at one sample a second] that gives that table's intervals of K from the
# spread of the columns alone: ±8.5 % of the piston ring's from 30 minutes, ±5.6 % from 60.
_ERROR_L_PER_MIN = 0.16
# A K is told if its half-width is at most half of it.
_WIDEST = 0.5
# Condition of columns that are multiples of one another but for rounding.
_MOST_ALIKE = 1e10
_MOST_NIGHTS = 30
_MOST_SAMPLES = 5000
# Conditions that vary by less tell nothing: the 5th to 95th percentile beside the median, and [K].
_VARIES, _VARIES_K = 0.3, 4.0
# Ranks of a flow and of what drives it agree at least so far, with noise and dead time.
_FOLLOWS = 0.2
_FEWEST = 200
# Oil in a line warms and cools slower than this, but for a few spikes.
_JUMP_C, _JUMP_S, _JUMPS_SHARE = 2.0, 10.0, 0.02
SWAPPED = "are columns swapped?"


def night_of_log(spec: MotorSpec, label: dt.date, log: RawLog) -> Samples | None:
    """The samples that a run keeps of a night of a log; None for none."""
    here = night(label, spec.settings.nights)
    channels = slice_night([log], here, reaches_us(spec))
    try:
        samples, _ = clean_channels(spec.file, spec.settings, here, channels)
    except Insufficient:
        return None
    return samples if len(samples.index) else None


def promise(spec: MotorSpec, label: dt.date, samples: Samples) -> str:
    """Running minutes of a night, the conditions in them, and what they tell, in words.

    Conditions are the 5th to 95th percentiles while the motor ran.
    """
    minutes = samples.n_turning * samples.period_us / SECOND_US / 60.0
    ran = f"the motor ran {minutes:.3g} minutes a night"
    inputs = [np.abs(samples.pressure_difference_bar), np.abs(samples.speed_rpm)]
    inputs.append(samples.oil_temperature_c)
    inputs = [one[:: max(1, one.size // _MOST_SAMPLES)] for one in inputs]
    reached, shares, is_usual = [], [], np.ones_like(inputs[0], dtype=np.bool_)
    for (name, (full, unit)), values in zip(_RANGES.items(), inputs, strict=True):
        low, high = np.percentile(values, (5, 95), method="nearest")
        is_usual &= (values >= low) & (values <= high)
        shares.append(min((high - low) / full, 1.0))
        reached.append(f"{name} {low:.3g} to {high:.3g} {unit} ({100 * shares[-1]:.0f} %)")
    ran += f", at {', '.join(reached)} of the range that tells every path within a night"
    windows = spec.settings.windows
    needed = windows.minimum_training_minutes / windows.training_share
    if minutes < needed:
        return f"{ran}: too little for a fit, which needs {needed:.3g} minutes"
    told = _paths_told(spec, label, [values[is_usual] for values in inputs], minutes, shares[1])
    return (
        f"{ran}: if the model describes the motor, leakage every night, {told}; first verdict on a "
        f"change after {spec.settings.trend.baseline_nights} nights"
    )


def _paths_told(
    spec: MotorSpec, label: dt.date, inputs: list[Array], minutes: float, speed_share: float
) -> str:
    """Nights after which the paths are identified, in words.

    What tells the paths by their dependence on speed is as wide as the speed's own range: the
    minutes that are enough grow with its square.
    """
    pressure, speed, temperature = inputs
    motor = spec.motor(label, spec.file.flushing.mode)
    try:
        conditions = OperatingConditions.from_bar(pressure, temperature, speed)
        widths = half_widths(motor, conditions, minutes)
    except LeakageError:
        return "paths cannot be judged: its conditions are outside the model's"
    enough = _ENOUGH_MINUTES / max(speed_share, 1e-3) ** 2
    nights = {name: max(enough / minutes, (w / _WIDEST) ** 2) for name, w in widths.items()}
    told = [math.ceil(number) for number in nights.values() if number <= _MOST_NIGHTS]
    untold = [plain(name) for name, number in nights.items() if number > _MOST_NIGHTS]
    words = "no path by itself"
    if told:
        after = "every night" if max(told) == 1 else f"after {max(told)} nights"
        words = f"{'other ' if untold else ''}paths {after}"
    return words + (f"; not identified at these conditions: {', '.join(untold)}" if untold else "")


def half_widths(motor: Motor, conditions: OperatingConditions, minutes: float) -> dict[str, float]:
    """Half-width of each free path's coefficient, relative to it, from minutes at conditions.

    Infinite where the path's flow cannot be told from the others' at these conditions.
    """
    flows = path_flows_l_per_min(motor, conditions)
    names = [path.name for path in motor.column_paths if np.any(flows[path.name])]
    columns = np.stack([flows[name] for name in names], axis=1)
    lengths = np.linalg.norm(columns, axis=0)
    seconds_a_sample = minutes * 60.0 / len(columns)
    # As in a regression of each column on the others: what is left of it tells its coefficient.
    correlation = (columns / lengths).T @ (columns / lengths)
    if np.linalg.cond(correlation) > _MOST_ALIKE:
        return dict.fromkeys(names, math.inf)
    spread = np.sqrt(np.diag(np.linalg.inv(correlation))) / lengths
    widths = _ERROR_L_PER_MIN * spread / math.sqrt(seconds_a_sample)
    return dict(zip(names, map(float, widths), strict=True))


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
        yield f"oil_temperature jumps as no oil does: {SWAPPED}"
    widths = ((p, _VARIES * np.median(p)), (t, _VARIES_K))
    drives = [one for one, width in widths if np.ptp(np.percentile(one, (5, 95))) > width]
    # Hotter oil is thinner: the flow rises with either.
    if drives and np.ptp(q) > 0 and all(_rank_correlation(one, q) < _FOLLOWS for one in drives):
        yield f"the drain flow follows neither pressure nor the oil's viscosity: {SWAPPED}"


def _rank_correlation(x: Array, y: Array) -> float:
    """Spearman's coefficient."""
    # Not SciPy's, which takes half a second to load before the first run of a fleet.
    return float(pl.select(pl.corr(pl.Series(x), pl.Series(y), method="spearman")).item())
