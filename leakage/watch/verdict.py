"""What the watch says of a night."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from leakage.watch.nights import Estimate

STEPS, RAMPS, NOW_AND_THEN = "step", "ramp", "now and then"


@dataclass(frozen=True, slots=True)
class Change:
    """A change that has been told and is in force; dates are numbers of days.

    Attributes
    ----------
    cause, probability
        A path's name, ``all_gaps``, ``all_flows``, ``oil_grade``, ``temperature_sensor``,
        ``temperature_effect``, ``flushing``, ``back_as_before``, ``odd_nights``, ``tank`` or
        ``cannot_be_told``; its probability, where it cannot be told that of the likeliest.
    candidates
        Causes above 1 %, by probability.
    is_rise
        Whether the flow has risen.
    shape
        ``step``, ``ramp`` or ``now and then``.
    since, since_lower, since_upper
        First day, and its 95 % interval.
    told_on
        Day on which it was told.
    size
        Relative change of the flow at the motor's own conditions, now against before.
    path_growth
        Relative change of the named path's own flow; None where its share is below a tenth.
    grade
        ISO viscosity grade that does as much, of ``oil_grade``.
    goes_on
        Whether the same was told before.
    """

    cause: str
    probability: float
    candidates: Mapping[str, float]
    is_rise: bool
    shape: str
    since: int
    since_lower: int
    since_upper: int
    told_on: int
    size: Estimate
    path_growth: Estimate | None = None
    grade: int | None = None
    goes_on: bool = False

    @property
    def dates(self) -> tuple[int, int, int]:
        """First day, and the ends of its interval."""
        return self.since, self.since_lower, self.since_upper


def grown_as(change: Change, flow: Estimate) -> Estimate | None:
    """Growth of a change's path where the flow has changed by so much; None where it has none.

    The path's share is that of the baseline by which it was named, whatever era came since.
    """
    told = change.path_growth
    if told is None or not change.size.value:
        return None
    growth = told.value / change.size.value * flow.value
    by_share = (told.sd / told.value) ** 2 - (change.size.sd / change.size.value) ** 2
    sd = flow.sd * abs(told.value / change.size.value)
    return Estimate(growth, math.hypot(sd, growth * math.sqrt(max(by_share, 0.0))))


@dataclass(frozen=True, slots=True)
class Verdict:
    """What is known of a motor after a night.

    Attributes
    ----------
    evidence, limit
        ln R, and from where on it tells a change.
    lack_of_fit
        Root mean square share of the baseline's flow that the model misses.
    change
        The newest change in force; None where none is told.
    tonight, present
        Relative change of the flow against the first baseline, along the named cause: of this
        night, and of the last nights since the change.
    smallest
        Smallest change of all flows that ten nights like these would have told.
    distance
        Distance of the night's duty from the baseline's, in its standard deviations.
    """

    day: int
    evidence: float
    limit: float
    lack_of_fit: float
    change: Change | None
    tonight: Estimate
    present: Estimate
    smallest: float
    distance: float = field(default=0.0)
