"""Blocks of new samples, cleaned as the night does it."""

from __future__ import annotations

from collections.abc import MutableMapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leakage import LeakageError, regressors
from leakage.estimation.sample_blocks import NONE_CHOSEN, split_into_blocks
from pipeline.arrays import SECOND_US, Array, Mask, Times
from pipeline.config import MotorSpec
from pipeline.config.nights import Night
from pipeline.ingest import RawChannel
from pipeline.night.fit_night import Insufficient, clean_channels
from pipeline.night.statistics import operating_conditions
from pipeline.night.time_base import Quality, Samples
from pipeline.night.viscosity import driven, sensor_ratio, viscosity_ratios
from pipeline.night.windows import left_out

# Reasons of `quality` that say nothing of a cause.
NO_CAUSE = ("any", "incomplete", "guard", "gap")


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Short blocks in order of time."""

    start_us: Times  # begin of each, UTC microseconds, shape (b,)
    means: Array  # means of the statistics' columns, shape (b, c)
    # Mean temperature [°C], pressure difference [bar] and speed [rpm], shape (b, 3).
    conditions: Array

    @classmethod
    def none(cls) -> Blocks:
        """No block."""
        return cls(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3)))

    def only(self, chosen: slice | Mask) -> Blocks:
        """Some of them."""
        return Blocks(self.start_us[chosen], self.means[chosen], self.conditions[chosen])

    @classmethod
    def of_rows(cls, rows: Sequence[Sequence[float]]) -> Blocks:
        """Blocks that a state keeps."""
        table = np.array(rows, dtype=np.float64)
        return cls(table[:, 0].astype(np.int64), table[:, 4:], table[:, 1:4])

    @property
    def rows(self) -> tuple[tuple[float, ...], ...]:
        """The same for a state: begin, conditions, means."""
        table = np.column_stack([self.start_us, self.conditions, self.means])
        return tuple(map(tuple, table.tolist()))

    def merged(self, n: int) -> Blocks:
        """Means of each `n` neighbours, of which the last may be fewer; they keep the first begin.

        Stored blocks are as long, and the watch knows the errors of those.
        """
        first = np.arange(0, len(self.start_us), n)
        counts = np.diff(first, append=len(self.start_us))[:, None]
        means, conditions = (
            np.add.reduceat(one, first) / counts for one in (self.means, self.conditions)
        )
        return Blocks(self.start_us[first], means, conditions)


def block_us(spec: MotorSpec) -> int:
    """Length of a short block [µs]."""
    return round(spec.settings.windows.block_s * SECOND_US)


def blocks_within(
    spec: MotorSpec,
    night: Night,
    channels: MutableMapping[str, RawChannel],
    first_us: int,
    end_us: int,
) -> tuple[Blocks, str]:
    """Blocks of a part of a night with kept samples, and why there is none; else an empty text.

    The samples begin a little before the part, whose blocks begin and end on `first_us` and
    `end_us` [µs since 1970].
    """
    try:
        samples, quality = clean_channels(spec.file, spec.settings, night, channels)
        thin = left_out(
            samples.time_us,
            samples.period_us,
            night.start_us,
            # What follows is not there yet: no stretch of it is too short.
            spec.settings.windows.model_copy(update={"longest_gap_s": None}),
            NONE_CHOSEN,
        )["thin_block"]
        inside = ~thin & (samples.time_us >= first_us) & (samples.time_us < end_us)
        samples = samples.only(inside)
        if not inside.any():
            return Blocks.none(), _cause(quality)
        motor = spec.motor(night.date, spec.file.flushing.mode)
        columns = np.empty((len(samples.index), len(motor.columns)))
        regressors(motor, operating_conditions(spec, samples), out=columns[:, :-1])
    except (Insufficient, LeakageError) as why:
        return Blocks.none(), getattr(why, "reason", str(why))
    columns[:, -1] = samples.leakage_l_per_min
    conditions = np.column_stack(
        [
            samples.oil_temperature_c,
            np.abs(samples.pressure_difference_bar),
            np.abs(samples.speed_rpm),
        ]
    )
    found = split_into_blocks(samples.time_us, night.start_us, spec.settings.windows)
    first = [one.first_row for one in found]
    n = np.array([one.n for one in found])[:, None]
    means, conditions = (np.add.reduceat(one, first) / n for one in (columns, conditions))
    ratios = _viscosity_ratios(spec, night, samples, np.array(first), conditions[:, 0])
    if isinstance(ratios, str):
        return Blocks.none(), ratios
    if ratios is not None:
        means = np.where(driven(motor.columns), means / ratios[:, None], means)
    return Blocks(np.array([one.start_us for one in found]), means, conditions), ""


def _viscosity_ratios(
    spec: MotorSpec, night: Night, samples: Samples, first: NDArray[np.int64], celsius: Array
) -> Array | str | None:
    """Measured viscosity over the data sheet's of blocks by their first samples, shape (b,).

    As in :func:`sensor_ratio`, by block: the samples of other blocks may come with another look.
    """
    oil, by_sensor = spec.oil_on(night.date).oil(), np.full(len(first), np.nan)
    owner = np.searchsorted(first, np.arange(len(samples.index)), side="right") - 1
    for place in range(len(first)) if samples.viscosities else ():
        ratio = sensor_ratio(oil, samples.only(owner == place))
        if isinstance(ratio, str):
            return ratio
        if ratio is not None:
            by_sensor[place] = ratio.at(celsius[place])
    return viscosity_ratios(spec, night.date, celsius, by_sensor)


def _cause(quality: tuple[Quality, ...]) -> str:
    """Rule that refused most of some samples, in words."""
    told = [one for one in quality if one.reason not in NO_CAUSE and one.n_samples]
    most = max(told, key=lambda one: one.n_refused / one.n_samples, default=None)
    if most is None or not most.n_refused:
        return "no complete samples"
    if most.reason == "standstill":
        return "the motor stands still"
    return f"{most.channel.replace('_', ' ')}: {most.reason.replace('_', ' ')}"
