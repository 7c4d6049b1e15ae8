"""The one fit of a motor to blocks of samples: of a night, and of a frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from leakage.estimation.block_statistics import merge, with_free_known
from leakage.estimation.certificate import Certificate, certify
from leakage.estimation.identifiability import Excitation, Identification, identify
from leakage.estimation.least_squares import Fit, fit
from leakage.estimation.model_verdict import Misfit, misfit
from leakage.estimation.multi_start import Parametrisation, SearchSettings
from leakage.estimation.slow_errors import (
    ShortBlocks,
    SlowErrors,
    short_blocks,
    slow_errors,
    whitened,
)
from leakage.physics.motor import Motor

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class SampleBlocks:
    """Blocks of samples in time order, with all that a fit needs of them.

    Attributes
    ----------
    factors
        Triangular factor of each, shape (b, c, c); of weighted samples under a robust loss.
    short
        Short blocks from which they were merged.
    trains
        Mask of those that train, shape (b,).
    means
        Mean temperature [°C], pressure [bar] and speed [rpm] of each, shape (b, 3).
    excitation
        Range of the samples.
    """

    factors: Array
    short: ShortBlocks
    trains: NDArray[np.bool_]
    means: Array
    excitation: Excitation

    def with_free_known(self, place: int, coefficient: float) -> SampleBlocks:
        """The blocks with the known flow as a path of its own; arguments as for a factor."""
        factors = with_free_known(self.factors, place, coefficient)
        # Means of blocks that no others were merged into are those of their factors, to the bit.
        if len(self.short.n) == len(factors):
            return replace(self, factors=factors, short=short_blocks(factors, self.short.number))
        means = np.insert(self.short.means, place, self.short.means[:, -2] / coefficient, axis=1)
        means[:, -2] = 0.0
        return replace(self, factors=factors, short=replace(self.short, means=means))


@dataclass(frozen=True, slots=True, eq=False)
class BlockEstimate:
    """Estimates from blocks of samples.

    Attributes
    ----------
    fit
        Estimates from all blocks.
    training
        The fit to the blocks that train, which is validated on the others.
    whole
        The merged factor of all blocks, shape (c, c).
    slow
        Memory of the errors from block to block.
    whitened
        The factors without that memory, shape (b, c, c).
    misfit
        What the blocks say of the model; None where they are too few.
    """

    fit: Fit
    training: Certificate
    whole: Array
    slow: SlowErrors
    whitened: Array
    misfit: Misfit | None

    def identified(self, excitation: Excitation, inflation: float = 1.0) -> Identification:
        """Verdicts and intervals by the samples alone; arguments as of :func:`identify`."""
        return identify(self.fit, self.whitened, excitation, inflation, self.slow)


def fit_blocks(
    blocks: SampleBlocks,
    motor: Motor,
    settings: SearchSettings | None = None,
    generator: np.random.Generator | None = None,
) -> BlockEstimate:
    """Fit a motor to blocks of samples.

    Parameters
    ----------
    blocks
        Blocks, columns as ``motor.columns``.
    motor
        Paths with their parameters and bounds.
    settings, generator
        Settings of the search, and the source of its starting points; None: no search.

    Returns
    -------
    BlockEstimate

    Raises
    ------
    EstimationError
        If there are fewer training samples than free coefficients.
    """
    lower, upper = Parametrisation.of(motor).coefficient_bounds()
    fixed = lower == upper
    training = certify(merge(blocks.factors[blocks.trains]), lower, upper)
    whole = merge(blocks.factors)
    slow = slow_errors(blocks.factors, blocks.short, fixed, lower, whole)
    white = whitened(blocks.factors, blocks.short, slow)
    found = fit(merge(white) if slow.are_slow else whole, motor, settings, generator)
    return BlockEstimate(
        fit=found,
        training=training,
        whole=whole,
        slow=slow,
        whitened=white,
        misfit=misfit(blocks.factors, blocks.short, found.coefficients, fixed, blocks.means),
    )
