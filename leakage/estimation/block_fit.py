"""The one fit of a motor to blocks of samples, with verdicts: of a night, and of a frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leakage.estimation.block_statistics import merge
from leakage.estimation.certificate import Certificate, certify
from leakage.estimation.identifiability import Excitation, Identification, identify
from leakage.estimation.least_squares import Fit, fit
from leakage.estimation.model_verdict import Misfit, misfit
from leakage.estimation.multi_start import Parametrisation, SearchSettings
from leakage.estimation.slow_errors import ShortBlocks, slow_errors, whitened
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


@dataclass(frozen=True, slots=True, eq=False)
class BlockEstimate:
    """Estimates from blocks of samples, with verdicts by the samples alone.

    Attributes
    ----------
    fit
        Estimates from all blocks.
    training
        The fit to the blocks that train, which is validated on the others.
    identification
        Verdicts and intervals.
    whitened
        The factors without the memory of slow errors, shape (b, c, c).
    misfit
        What the blocks say of the model; None where they are too few.
    """

    fit: Fit
    training: Certificate
    identification: Identification
    whitened: Array
    misfit: Misfit | None


def fit_blocks(
    blocks: SampleBlocks,
    motor: Motor,
    settings: SearchSettings,
    generator: np.random.Generator,
    inflation: float = 1.0,
) -> BlockEstimate:
    """Fit a motor to blocks of samples, and judge every coefficient.

    Parameters
    ----------
    blocks
        Blocks, columns as ``motor.columns``.
    motor
        Paths with their parameters and bounds.
    settings, generator
        Settings of the search, and the source of its starting points.
    inflation
        Factor on standard errors that robust weights ask for; 1 without them.

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
    unweighted = merge(blocks.factors)
    slow = slow_errors(blocks.factors, blocks.short, fixed, lower, unweighted)
    white = whitened(blocks.factors, blocks.short, slow)
    found = fit(merge(white) if slow.are_slow else unweighted, motor, settings, generator)
    return BlockEstimate(
        fit=found,
        training=training,
        identification=identify(found, white, blocks.excitation, inflation, slow),
        whitened=white,
        misfit=misfit(blocks.factors, blocks.short, found.coefficients, fixed, blocks.means),
    )
