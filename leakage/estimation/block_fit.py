"""The fit of a motor to blocks of samples: of a night, and of a frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from leakage.arrays import Array, Mask
from leakage.estimation.blocks import merge, with_free_known
from leakage.estimation.identifiability import Excitation, Identification, identify
from leakage.estimation.misfit import Misfit, misfit
from leakage.estimation.proven_minimum import Fit, ProvenMinimum, certify, fit
from leakage.estimation.slow_errors import SlowErrors, slow_errors, whiten, with_level
from leakage.physics.motor import Motor


@dataclass(frozen=True, slots=True, eq=False)
class SampleBlocks:
    """Blocks of samples in time order, with all that a fit needs of them."""

    factors: Array  # triangular factor of each, shape (b, c, c)
    # number, block_s: place of each on the clock, in blocks, shape (b,), and their usual
    # length [s].
    number: NDArray[np.int64]
    block_s: float
    trains: Mask  # mask of those that train, shape (b,)
    means: Array  # mean temperature [°C], pressure [bar] and speed [rpm] of each, shape (b, 3)
    excitation: Excitation  # range of the samples

    def with_free_known(self, place: int, coefficient: float) -> SampleBlocks:
        """Return the blocks with the known flow as a path of its own; arguments as for a factor."""
        return replace(self, factors=with_free_known(self.factors, place, coefficient))


@dataclass(frozen=True, slots=True, eq=False)
class BlockEstimate:
    """Estimates from blocks of samples."""

    fit: Fit  # estimates from all blocks
    training: ProvenMinimum  # the fit to the blocks that train, which is validated on the others
    whole: Array  # the merged factor of all blocks, shape (c, c)
    fitted: Array  # the factor that the estimates minimise, shape (c, c)
    slow: SlowErrors  # memory of the errors from block to block
    whitened: Array  # the factors without that memory, shape (b, c, c)
    misfit: Misfit | None  # structured misfit; None where the blocks are too few

    def identify(self, excitation: Excitation) -> Identification:
        """Return verdicts and intervals by the samples alone, of this range."""
        return identify(self.fit, self.whitened, excitation, self.slow)


def fit_blocks(blocks: SampleBlocks, motor: Motor) -> BlockEstimate:
    """Fit a motor to blocks of samples, columns as ``motor.columns``.

    Raises EstimationError if there are fewer training samples than free coefficients.
    """
    lower, upper = motor.coefficient_bounds()
    fixed = lower == upper
    training = certify(merge(blocks.factors[blocks.trains]), lower, upper)
    whole = merge(blocks.factors)
    slow = slow_errors(blocks.factors, blocks.number, fixed, lower, whole)
    white = whiten(blocks.factors, blocks.number, slow)
    fitted = merge(white) if slow.are_slow else whole
    best = fit(fitted, motor)
    # An estimate on a bound: the slopes ask for what no gap can do.
    if slow.are_slow and (slow.scales or not best.proven_minimum.off_bounds[~fixed].all()):
        fitted = with_level(blocks.factors, blocks.number, slow)
        best = fit(fitted, motor)
    if slow.hides_level(blocks.number):
        # The level would be left to a single block, from which nobody can tell how sure it is.
        adding = slow_errors(blocks.factors, blocks.number, fixed, lower, whole, scales=False)
        adding = replace(adding, evidence=slow.evidence)
        white = whiten(blocks.factors, blocks.number, adding)
    return BlockEstimate(
        fit=best,
        training=training,
        whole=whole,
        fitted=fitted,
        slow=slow,
        whitened=white,
        misfit=misfit(
            blocks.factors, blocks.number, best.coefficients, fixed, blocks.means, slow.scales
        ),
    )
