"""Blocks of new samples, cleaned as the night does it, and the watch they are compared with."""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Mapping, MutableMapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from leakage import LeakageError, regressors
from leakage.estimation.sample_blocks import NONE_CHOSEN, split_into_blocks
from leakage.watch import Estimate, NightBlocks, Watch
from leakage.watch.choices import OPERATING_ERROR, OPERATING_FREE, OPERATING_MOST
from pipeline.arrays import SECOND_US, Array, Mask, Times
from pipeline.config import MotorSpec
from pipeline.config.nights import DAY, Night, nights_between
from pipeline.ingest import RawChannel
from pipeline.night.column_change import COLUMNS, USUAL_NIGHTS, column_change, usual_readings
from pipeline.night.fit_night import Insufficient, clean_channels
from pipeline.night.statistics import left_out, operating_conditions
from pipeline.night.stored_blocks import BLOCK_COLUMNS
from pipeline.night.time_base import Quality, Samples
from pipeline.night.viscosity import driven, sensor_ratio, viscosity_ratios
from pipeline.schema import BLOCK_STATISTICS, OPERATION
from pipeline.store.tables import read_rows
from pipeline.trends.nights.decisions import Decision
from pipeline.trends.nights.kept import decoded, key_of
from pipeline.trends.nights.layout import Layout
from pipeline.trends.states.course import watch_settings

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


# A rise that is told by itself within the day, and the probability that it is larger.
SUDDEN, SURE = 0.1, 0.975
# Stored blocks of a night that give a verdict on a rise.
LEAST_BLOCKS = 3


@dataclass(frozen=True, slots=True)
class NightsBefore:
    """Watch of a motor after its last published night."""

    watch: Watch
    layout: Layout
    last_night: dt.date
    merged: int = 1  # short blocks in one as the nights store it
    # That night's blocks, the begin of the first [µs since 1970], and the watch before it.
    newest: tuple[NightBlocks, int, Watch] | None = None
    usual: Mapping[str, float] = field(default_factory=dict)  # as of `usual_readings`

    @property
    def level(self) -> Estimate:
        """Change of the latest nights from the baseline."""
        return self.watch.verdict().present

    def rise(self, blocks: Blocks, night: dt.date) -> tuple[Estimate, bool]:
        """Rise of some blocks of a night over the nights before, and True if the watch tells one.

        Other operating conditions than the baseline's adds its error, as it does to the watch's own
        figures.
        """
        found = self.watch.after(night_blocks(self.layout, blocks, night), _no_nights).verdict()
        before, now = self.level, found.newest_night
        value = (1.0 + now.value) / (1.0 + before.value) - 1.0
        far = OPERATING_ERROR * min(max(found.distance - OPERATING_FREE, 0.0), OPERATING_MOST)
        sd = math.hypot(now.sd, before.sd, far) / (1.0 + before.value)
        change = found.change
        is_told = change is not None and change.told_on == found.day and change.is_rise
        return Estimate(value, sd), is_told

    def columns_changed(self, spec: MotorSpec, blocks: Blocks) -> str | None:
        """Why blocks look like those of other columns or units than the nights before."""
        temperature, pressure, speed = blocks.conditions.mean(axis=0).tolist()
        readings = (pressure, temperature, speed, float(blocks.means[:, -1].mean()))
        now = dict(zip(COLUMNS, readings, strict=True))
        return column_change(spec, self.usual, now) if self.usual else None

    def flow_since(self, begin_us: int) -> float | None:
        """Flow of the newest night since a time over that of the baseline; None without blocks."""
        if self.newest is None:
            return None
        night, first_us, watch = self.newest
        late = night.middle_s * SECOND_US + first_us >= begin_us
        if np.count_nonzero(late) < LEAST_BLOCKS:
            return None
        parts = (night.middle_s, night.drives, night.flow, night.conditions)
        found = watch.after(NightBlocks(night.day, *(one[late] for one in parts)), _no_nights)
        return 1.0 + found.verdict().newest_night.value

    def is_sudden(self, rise: Estimate) -> bool:
        """True for a rise beyond a tenth with as much evidence as a change of the nights needs.

        One odd night is no change, but such a rise is worth a look at once.
        """
        evidence = 0.5 * (rise.value / rise.sd) ** 2
        return (
            evidence >= self.watch.state.settings.limit and rise.probability_above(SUDDEN) >= SURE
        )


def night_blocks(layout: Layout, blocks: Blocks, night: dt.date) -> NightBlocks:
    """Blocks of a night so far as the watch takes those of a whole one."""
    return NightBlocks(
        night.toordinal(),
        (blocks.start_us - blocks.start_us[0]) / SECOND_US,
        layout.driven(blocks.means[:, :-1]),
        blocks.means[:, -1] - layout.fixed_flushing,
        blocks.conditions,
    )


def _no_nights(_: int) -> Sequence[NightBlocks]:
    """Within a day no baseline period begins."""
    return ()


def nights_before(
    output: Path, spec: MotorSpec, decisions: Sequence[Decision], content: bytes | None
) -> NightsBefore | str:
    """The motor's watch, by what the last run kept of it, or why there is none.

    Raises StoreError if a published table is damaged.
    """
    kept = decoded(content)
    if kept is None:
        return "the nightly run has not published a night yet"
    if kept.key != key_of(spec, decisions):
        return "other settings, events or resets than those of its watch: the nightly run redoes it"
    if kept.watch is None:
        return "too few nights for a baseline"
    newest_night, end = (kept.last_night + dt.timedelta(days=n) for n in (1, 2))
    if any(newest_night <= one.date <= end for one in spec.file.baseline_events):
        return "a new baseline begins"
    layout = Layout.of(spec, newest_night)
    machine = layout.machine(spec, kept.watch.period)
    watch = Watch.of_arrays(machine, watch_settings(spec), kept.watch.arrays)
    first = dt.date.fromordinal(kept.watch.day + 1)
    labels = [first + dt.timedelta(days=n) for n in range((newest_night - first).days)]
    rows = read_rows(output, BLOCK_STATISTICS, [spec.motor_id], BLOCK_COLUMNS, nights=labels)
    merged, newest = 1, None
    for night in rows.sort("night", "block_start").partition_by("night", maintain_order=True):
        stored = layout.blocks(spec, night)
        if stored is None:
            return "its last nights are of another model"
        first_us = int(night["block_start"].dt.timestamp("us")[0])
        newest = layout.night_blocks(stored), first_us, watch
        watch = watch.after(newest[0], _no_nights)
        length = (night["block_end"] - night["block_start"]).dt.total_microseconds().to_numpy()
        merged = max(1, round(float(np.median(length)) / block_us(spec)))
    usual = _usual(output, spec, kept.last_night)
    return NightsBefore(watch, layout, kept.last_night, merged, newest, usual)


def _usual(output: Path, spec: MotorSpec, last: dt.date) -> dict[str, float]:
    """Usual readings of the last nights of the baseline period."""
    begins = (one.date for one in spec.file.baseline_events if one.date <= last)
    first = max(last - (USUAL_NIGHTS - 1) * DAY, max(begins, default=dt.date.min))
    nights, columns = nights_between(first, last), tuple(COLUMNS.values())
    rows = read_rows(output, OPERATION, [spec.motor_id], columns, nights=nights)
    return usual_readings(rows.to_dicts())
