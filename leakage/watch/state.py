"""State of a motor's watch after a night."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from leakage.watch import choices
from leakage.watch.attribution import Attribution
from leakage.watch.baseline import Baseline
from leakage.watch.causes import Cause, causes_of, is_path
from leakage.watch.evidence import Causes, Evidence
from leakage.watch.levels import Level, levels_along, surroundings
from leakage.watch.nights import Array, Estimate, Machine, WatchSettings
from leakage.watch.verdict import Change
from leakage.watch.wander import Wander
from leakage.watch.window import Sums, Window

NOTHING = -math.inf
UNCHANGED = Estimate(0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Standing:
    """The change in force: as it is told, and the direction that its size is taken along.

    `along` has shape (q,) and `of_flow` is what a unit of it is of the flow; `before` is the change
    of the flow before it, against the first baseline. While it is not adopted, `found` is its
    attribution by the nights so far, `prior` what was in force before, and `tank` what the tank's
    other motors say.
    """

    change: Change
    along: Array
    of_flow: float
    before: Estimate
    found: Attribution | None = None
    prior: Standing | None = None
    tank: Estimate | None = None


@dataclass(frozen=True, slots=True)
class State:
    """What is kept of a motor.

    Attributes
    ----------
    baseline, window, sums, wander
        What the first nights fix, the nights, their sums, and what they do by themselves.
    undone
        Causes that undo what was adopted.
    first_start
        Day of the first candidate start.
    n_baseline, n_nights
        Nights of the era's baseline, and all of the era.
    due
        Number of nights with which the wander is estimated anew; 0: never.
    often
        Evidence that odd nights have become frequent.
    evidence
        ln R of the newest night.
    era_from
        Day from which an era of its own is to begin; None: none is.
    carried
        Change of the flow at the era's beginning against the first baseline.
    standing
        The change in force; None: none is told.
    """

    machine: Machine
    settings: WatchSettings
    baseline: Baseline
    window: Window
    sums: Sums
    wander: Wander
    undone: tuple[Cause, ...]
    first_start: int
    n_baseline: int
    n_nights: int
    due: int
    often: float = NOTHING
    evidence: float = NOTHING
    era_from: int | None = None
    carried: Estimate = UNCHANGED
    standing: Standing | None = None

    @property
    def day(self) -> int:
        """The newest night."""
        return int(self.window.days[-1])

    @property
    def is_settling(self) -> bool:
        """A change has been told, and is not adopted yet."""
        return self.standing is not None and self.standing.found is not None

    def place(self, day: int) -> int:
        """Place of the first night from a day on."""
        return int(np.searchsorted(self.window.days, day))

    def level_along(self, direction: Array) -> Level:
        """Level of the window's nights along a direction of shape (q,)."""
        # A change in force is none of the surroundings.
        end = len(self.window)
        if self.standing is not None and self.standing.found is not None:
            end = self.place(self.standing.found.start)
        around = surroundings(self.window, self.sums, self.baseline.own_row, direction, end)
        return levels_along(self.window, direction, self.wander, self.baseline, around)

    def growth_of(self, cause: str, flow: Estimate) -> Estimate | None:
        """Relative change of a named path's own flow, from that of all.

        None where its share of all is too small. The share is as uncertain as the path's
        coefficient in the baseline.
        """
        if cause not in self.machine.paths or not is_path(cause):
            return None
        place = self.machine.paths.index(cause)
        own = float(self.baseline.all_paths[place])
        share = own * float(self.baseline.share[place])
        if share < choices.LEAST_SHARE_TO_TELL:
            return None
        growth, sd = flow.value / share, float(self.baseline.path_sd[place]) / own
        return Estimate(growth, math.hypot(flow.sd / share, growth * sd))

    def evidence_now(self) -> Evidence:
        """All that the evidence of the newest night is made from."""
        causes = Causes.of([*causes_of(self.machine, self.baseline), *self.undone])
        return Evidence(
            self.window, self.sums, self.wander, causes, self.baseline.duty_error, self.n_nights
        )
