"""What the watch is given, machine, nights' blocks and settings, and what it says of a night."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from scipy.special import ndtr, ndtri

from leakage.arrays import Array
from leakage.watch import choices

DAYS_A_YEAR = 365.0
# Name of the path that a flushing is, and of the flow that the motor type states.
FLUSHING, KNOWN = "flushing", "known"
# Several causes at once are a candidate, and no name.
SEVERAL = "several"
# ISO viscosity grades, kinematic viscosity at 40 and 100 °C [mm²/s] (mineral oils, VI about 100).
ISO_GRADES = ((32.0, 5.4), (46.0, 6.8), (68.0, 8.7), (100.0, 11.4))
TWO_SIDED_95 = float(ndtri(0.975))


@dataclass(frozen=True, slots=True)
class NightBlocks:
    """Means of a night's blocks of samples, in order of time.

    `day`: Number of the calendar night: days since any fixed date.
    `middle_s`: Middle of each block, shape (b,), [s].
    `drives`: Mean flow a unit of each path's coefficient, shape (b, p), [l/min a unit]; a flow that
    is known is a path whose coefficient is 1.
    `flow`: Mean measured flow, shape (b,), [l/min].
    `conditions`: Mean oil temperature [°C], size of the pressure difference [bar] and of the speed
    [rpm], shape (b, 3).
    """

    day: int
    middle_s: Array
    drives: Array
    flow: Array
    conditions: Array


@dataclass(frozen=True, slots=True)
class Machine:
    """What is watched: names of the paths, which of them are gaps, and the oil.

    `oil` is the kinematic viscosity at 40 and 100 °C [mm²/s]; without it neither another grade nor
    a temperature sensor is among the causes.
    """

    paths: tuple[str, ...]
    gaps: tuple[str, ...]
    oil: tuple[float, float] | None = None
    grades: tuple[tuple[float, float], ...] = ISO_GRADES


@dataclass(frozen=True, slots=True)
class WatchSettings:
    """Rate of false alarms a motor-year, and the nights before the first candidate change."""

    false_alarms_per_year: float = 0.04
    baseline_nights: int = 8

    @property
    def limit(self) -> float:
        """Evidence from which a change is detected, ln(365 / rate) and what estimates cost."""
        return math.log(DAYS_A_YEAR / self.false_alarms_per_year) + choices.ESTIMATED


@dataclass(frozen=True, slots=True)
class Estimate:
    """A figure with its standard error.

    Examples
    --------
    >>> rise = Estimate(0.10, 0.02)
    >>> round(rise.lower, 4), round(rise.upper, 4), round(rise.probability_above(0.10), 2)
    (0.0608, 0.1392, 0.5)
    """

    value: float
    sd: float

    @property
    def lower(self) -> float:
        """Lower end of the 95 % interval."""
        return self.value - TWO_SIDED_95 * self.sd

    @property
    def upper(self) -> float:
        """Upper end of the 95 % interval."""
        return self.value + TWO_SIDED_95 * self.sd

    @property
    def holds_zero(self) -> bool:
        """True if the interval holds 0."""
        return self.lower <= 0.0 <= self.upper

    def probability_above(self, level: float) -> float:
        """Return probability that the true figure is above a level."""
        return float(ndtr((self.value - level) / max(self.sd, 1e-12)))

    def scaled(self, factor: float) -> Estimate:
        """Return the estimate times a factor."""
        return Estimate(self.value * factor, self.sd * abs(factor))


STEPS, RAMPS, NOW_AND_THEN = "step", "ramp", "now and then"


@dataclass(frozen=True, slots=True)
class Change:
    """A change that has been detected and is in force; dates are numbers of days."""

    # cause, probability: A path's name, ``all_gaps``, ``all_flows``, ``oil_grade``,
    # ``temperature_sensor``, ``temperature_effect``, ``flushing``, ``back_as_before``,
    # ``odd_nights``, ``channels``, ``tank`` or ``not_identified``; its probability, where it cannot
    # be identified that of the likeliest.
    cause: str
    probability: float
    candidates: Mapping[str, float]  # Causes above 1 %, by probability.
    # Causes that the nights cannot tell apart, the likeliest among them: no shares within.
    alike: tuple[str, ...]
    is_rise: bool  # Whether the flow has risen.
    shape: str  # ``step``, ``ramp`` or ``now and then``.
    # since, since_lower, since_upper: First day, and its 95 % interval.
    since: int
    since_lower: int
    since_upper: int
    detected_on: int  # Day on which it was detected.
    size: Estimate  # Relative change of the flow at the motor's own conditions, now against before.
    # Relative change of the named path's own flow; None where its share is below a tenth.
    path_growth: Estimate | None = None
    grade: int | None = None  # ISO viscosity grade that does as much, of ``oil_grade``.
    continues: bool = False  # Whether the same was detected before.

    @property
    def several(self) -> float:
        """Probability of several causes at once."""
        return self.candidates.get(SEVERAL, 0.0)

    @property
    def is_several(self) -> bool:
        """True if several causes at once have most of the probability."""
        return self.several >= choices.MOSTLY

    @property
    def dates(self) -> tuple[int, int, int]:
        """First day, and the ends of its interval."""
        return self.since, self.since_lower, self.since_upper


def grown_as(change: Change, flow: Estimate) -> Estimate | None:
    """Return the growth of a change's path, the flow having changed so; None where it has none.

    The path's share is that of the baseline by which it was named, whatever baseline period came
    since.
    """
    before = change.path_growth
    if before is None or not change.size.value:
        return None
    growth = before.value / change.size.value * flow.value
    by_share = (before.sd / before.value) ** 2 - (change.size.sd / change.size.value) ** 2
    sd = flow.sd * abs(before.value / change.size.value)
    return Estimate(growth, math.hypot(sd, growth * math.sqrt(max(by_share, 0.0))))


@dataclass(frozen=True, slots=True)
class Verdict:
    """What is known of a motor after a night."""

    day: int
    # evidence, limit: ln R, and from where on it shows a change.
    evidence: float
    limit: float
    lack_of_fit: float  # Root mean square share of the baseline's flow that the model misses.
    change: Change | None  # The newest change in force; None where none is detected.
    # newest_night, present: Relative change of the flow against the first baseline, along
    # the named cause: of this night, and of the last nights since the change.
    newest_night: Estimate
    present: Estimate
    # Smallest change of all flows that ten nights like these would have detected; None where no
    # night may hold a change yet.
    smallest: float | None
    is_beyond: bool = False  # Whether this night alone is beyond `smallest`, nothing in force.
    # misfit, usual_misfit: Share of the flow that the conditions do not explain, the most of the
    # last two nights and of the first baseline's.
    misfit: float = 0.0
    usual_misfit: float = 0.0
    is_elsewhere: bool = False  # Whether this night operates otherwise than the baseline's.
