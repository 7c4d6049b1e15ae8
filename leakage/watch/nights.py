"""What the watch is given: a machine's paths, its nights' blocks, settings; and an estimate."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from leakage.errors import ShapeError

Array = NDArray[np.float64]

DAYS_A_YEAR = 365.0
# Name of the path that a flushing is, and of the flow that the motor type states.
FLUSHING, KNOWN = "flushing", "known"
# ISO viscosity grades, kinematic viscosity at 40 and 100 °C [mm²/s] (mineral oils, VI about 100).
ISO_GRADES = ((32.0, 5.4), (46.0, 6.8), (68.0, 8.7), (100.0, 11.4))
_TWO_SIDED_95 = float(ndtri(0.975))


@dataclass(frozen=True, slots=True)
class NightBlocks:
    """Means of a night's blocks of samples, in order of time.

    Parameters
    ----------
    day
        Number of the calendar night: days since any fixed date.
    middle_s
        Middle of each block, shape (b,), [s].
    drives
        Mean flow a unit of each path's coefficient, shape (b, p), [l/min a unit]; a flow that is
        known is a path whose coefficient is 1.
    flow
        Mean measured flow, shape (b,), [l/min].
    conditions
        Mean oil temperature [°C], size of the pressure difference [bar] and of the speed [rpm],
        shape (b, 3).

    Raises
    ------
    ShapeError
        If the arrays are not of one number of blocks, or there is no block.
    """

    day: int
    middle_s: Array
    drives: Array
    flow: Array
    conditions: Array

    def __post_init__(self) -> None:
        n = len(self.middle_s)
        shapes = self.drives.shape[:1], self.flow.shape, self.conditions.shape
        if not n or shapes != ((n,), (n,), (n, 3)):
            raise ShapeError(
                "night_blocks", f"a night of {n} blocks has arrays of shapes {shapes}; give one row"
            )


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
        """Evidence from which a change is told, ln(365 / rate)."""
        return math.log(DAYS_A_YEAR / self.false_alarms_per_year)


@dataclass(frozen=True, slots=True)
class Estimate:
    """A figure with its standard error.

    Examples
    --------
    >>> one = Estimate(0.10, 0.02)
    >>> round(one.lower, 4), round(one.upper, 4), round(one.probability_above(0.10), 2)
    (0.0608, 0.1392, 0.5)
    """

    value: float
    sd: float

    @property
    def lower(self) -> float:
        """Lower end of the 95 % interval."""
        return self.value - _TWO_SIDED_95 * self.sd

    @property
    def upper(self) -> float:
        """Upper end of the 95 % interval."""
        return self.value + _TWO_SIDED_95 * self.sd

    @property
    def holds_zero(self) -> bool:
        """True if the interval holds 0."""
        return self.lower <= 0.0 <= self.upper

    def probability_above(self, level: float) -> float:
        """Probability that the true figure is above a level."""
        return float(ndtr((self.value - level) / max(self.sd, 1e-12)))

    def scaled(self, factor: float) -> Estimate:
        """The estimate times a factor."""
        return Estimate(self.value * factor, self.sd * abs(factor))
