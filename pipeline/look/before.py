"""A motor's watch as the last published night left it: what new blocks are compared with."""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from leakage.watch import Estimate, NightBlocks, Watch
from leakage.watch.choices import DUTY_ERROR, DUTY_FREE, DUTY_MOST
from pipeline.arrays import SECOND_US
from pipeline.config import MotorSpec
from pipeline.look.blocks import Blocks, block_us
from pipeline.night.stored_blocks import BLOCK_COLUMNS
from pipeline.schema import BLOCK_STATISTICS
from pipeline.store.tables import read_rows
from pipeline.trends.nights.decisions import Decision
from pipeline.trends.nights.kept import decoded, key_of
from pipeline.trends.nights.layout import Layout
from pipeline.trends.states.course import watch_settings

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

    @property
    def level(self) -> Estimate:
        """Change of the latest nights from the baseline."""
        return self.watch.verdict().present

    def rise(self, blocks: Blocks, night: dt.date) -> tuple[Estimate, bool]:
        """Rise of some blocks of a night over the nights before, and True if the watch tells one.

        Another duty than the baseline's adds its error, as it does to the watch's own figures.
        """
        found = self.watch.after(night_blocks(self.layout, blocks, night), _no_nights).verdict()
        before, now = self.level, found.tonight
        value = (1.0 + now.value) / (1.0 + before.value) - 1.0
        far = DUTY_ERROR * min(max(found.distance - DUTY_FREE, 0.0), DUTY_MOST)
        sd = math.hypot(now.sd, before.sd, far) / (1.0 + before.value)
        change = found.change
        is_told = change is not None and change.told_on == found.day and change.is_rise
        return Estimate(value, sd), is_told

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
        return 1.0 + found.verdict().tonight.value

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
    """Within a day no era begins."""
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
    tonight, end = (kept.last_night + dt.timedelta(days=n) for n in (1, 2))
    if any(tonight <= one.date <= end for one in spec.file.baseline_events):
        return "a new baseline begins"
    layout = Layout.of(spec, tonight)
    machine = layout.machine(spec, kept.watch.era)
    watch = Watch.of_arrays(machine, watch_settings(spec), kept.watch.arrays)
    first = dt.date.fromordinal(kept.watch.day + 1)
    labels = [first + dt.timedelta(days=n) for n in range((tonight - first).days)]
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
    return NightsBefore(watch, layout, kept.last_night, merged, newest)
