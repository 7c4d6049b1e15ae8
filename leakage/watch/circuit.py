"""A motor's change beside those of the other motors of its oil circuit over the same nights.

Change = median of the others + own part, each with its error (model.md, 7c.5).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from leakage.watch import choices
from leakage.watch.nights import Estimate


@dataclass(frozen=True, slots=True)
class CircuitChange:
    """A motor's change, split: the circuit's, which is the median of the others, and its own part.

    `n_alike` of the `n_others` other motors show the like by themselves.
    """

    size: Estimate
    of_circuit: Estimate
    own: Estimate
    n_others: int
    n_alike: int

    @property
    def is_common(self) -> bool:
        """True if most of the others, two at least, show the like and nothing is left of its own.

        A single other motor is no vote.
        """
        most = max(choices.LEAST_ALIKE, self.n_others // 2 + 1)
        is_shown = self.n_alike >= most and not self.of_circuit.holds_zero
        return is_shown and self.own.holds_zero

    @property
    def probability(self) -> float:
        """Probability that the own part is less than half of the change."""
        half, sd = abs(self.size.value) / 2.0, max(self.own.sd, 1e-12)
        return float(ndtr((half - self.own.value) / sd) - ndtr((-half - self.own.value) / sd))


def circuit_change(size: Estimate, others: Sequence[Estimate]) -> CircuitChange | None:
    """Return a motor's change beside those of two others or more; None where there are fewer.

    The median errs by 1.25 / √n of what each errs, or of how much they differ where that is more;
    the own part also by a tenth of the circuit's change, as motors follow the same oil unlike.

    Examples
    --------
    >>> others = [Estimate(0.03, 0.01), Estimate(0.04, 0.01), Estimate(0.08, 0.01)]
    >>> split = circuit_change(Estimate(0.12, 0.01), others)
    >>> round(split.of_circuit.value, 2), round(split.own.value, 2), split.is_common
    (0.04, 0.08, False)
    """
    if len(others) < choices.LEAST_ALIKE:
        return None
    values, sds = np.array([(other.value, other.sd) for other in others]).T
    middle = float(np.median(values))
    scatter = MAD_TO_SD * float(np.median(np.abs(values - middle)))
    sd = SD_OF_MEDIAN * max(float(np.median(sds)), scatter) / math.sqrt(len(others))
    own_sd = math.hypot(size.sd, sd, choices.CIRCUIT_ERROR, choices.CIRCUIT_SPREAD * abs(middle))
    return CircuitChange(
        size,
        Estimate(middle, math.hypot(sd, choices.CIRCUIT_ERROR)),
        Estimate(size.value - middle, own_sd),
        len(others),
        sum(_is_alike(other, size) for other in others),
    )


# Standard deviation of normal errors over their median absolute deviation, and of their median over
# that of their mean.
MAD_TO_SD, SD_OF_MEDIAN = 1.48, 1.25


def _is_alike(other: Estimate, size: Estimate) -> bool:
    """Return whether another motor's change has the same sign and, within errors, size."""
    if other.value * size.value <= 0.0:
        return False
    if abs(other.value) < choices.ALIKE_SD * math.hypot(other.sd, choices.CIRCUIT_ERROR):
        return False
    low, high = sorted((abs(other.value), abs(size.value)))
    is_near = high - low <= choices.ALIKE_SD * math.hypot(other.sd, size.sd)
    return is_near or high <= choices.ALIKE_RATIO * low
