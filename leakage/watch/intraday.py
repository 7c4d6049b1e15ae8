"""The night so far as the newest night of a watch: has the flow risen within the day?

By the watch's own likelihood ratio of a step in the newest night, without the deduction for an odd
night, as such a rise is worth a look at once. A break late in a long day would drown in it, so the
latest minutes are tried as the newest night, too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leakage.arrays import Array
from leakage.watch import choices
from leakage.watch.nights import Estimate, NightBlocks
from leakage.watch.state import on_first_baseline, present
from leakage.watch.watch import Watch, with_night


@dataclass(frozen=True, slots=True)
class Rise:
    """Flow of some blocks over that of the nights before.

    `evidence` is ln of the likelihood ratio of a step in the night so far, or of the change itself
    where that is less: beside a change in force a night may say much that is not new.
    """

    evidence: float
    change: Estimate

    @property
    def is_sudden(self) -> bool:
        """True where it is reported."""
        return (
            self.evidence >= choices.INTRADAY_LIMIT
            and self.change.lower >= choices.INTRADAY_LEAST_RISE
        )


def rises_so_far(watch: Watch, blocks: NightBlocks, merged: int) -> tuple[Rise, ...]:
    """Return rise of the latest blocks of a night, of more and more of them, at last of all.

    `watch`: After the nights before. `blocks`: Short ones; the watch knows the errors of those that
    hold `merged` of them.
    """
    n = len(blocks.flow)
    lengths = [length for length in choices.INTRADAY_BLOCKS if length < n]
    return tuple(rise_of(watch, _latest(blocks, length, merged)) for length in (*lengths, n))


def sudden_rise(rises: Sequence[Rise]) -> Rise | None:
    """Return the rise that is reported: of the fewest blocks that show it; None without a rise.

    It goes on in the latest blocks.
    """
    sudden = (rise for rise in rises if rise.is_sudden and is_going_on(rises, rise.change.value))
    return next(sudden, None)


def is_going_on(rises: Sequence[Rise], reported: float) -> bool:
    """Return False if the latest blocks show that half of a rise is gone."""
    return rises[0].change.upper >= choices.INTRADAY_SHARE * reported


def rise_of(watch: Watch, night: NightBlocks) -> Rise:
    """Return rise of a night's blocks over the present level of the nights before."""
    state = with_night(watch.state, night)
    evidence, newest = state.evidence_now(), np.array([len(state.window) - 1])
    step = float(np.logaddexp.reduce(evidence.of_starts(newest).log_ratio, axis=None))
    before, now = present(watch.state), on_first_baseline(state, slice(-1, None))
    ratio = (1.0 + now.value) / (1.0 + before.value)
    sd = math.hypot(now.sd, ratio * before.sd) / (1.0 + before.value)
    gain = np.array([[((ratio - 1.0) / sd) ** 2]])
    own = 0.5 * float(evidence.temper(gain, newest)[0, 0])
    return Rise(min(step, own), Estimate(ratio - 1.0, sd))


def _latest(blocks: NightBlocks, length: int, merged: int) -> NightBlocks:
    """Return the latest blocks, neighbours merged as they are stored."""
    first = np.arange(len(blocks.flow) - length, len(blocks.flow), merged)
    counts = np.diff(first, append=len(blocks.flow))

    def means(values: Array) -> Array:
        sums: Array = np.add.reduceat(values, first)
        return (sums.T / counts).T

    parts = (blocks.middle_s, blocks.drives, blocks.flow, blocks.conditions)
    return NightBlocks(blocks.day, *map(means, parts))
