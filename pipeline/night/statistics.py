"""From a night's kept samples to the statistics of its blocks, and the hash of what shaped them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from leakage import Motor, OperatingConditions, regressors
from leakage.block_statistics import factors, merge
from leakage.multi_start import Parametrisation
from leakage.robust import huber_weights, weight_inflation
from leakage.sample_blocks import (
    TRAINING,
    Block,
    means_inside,
    merge_neighbours,
    owners,
    split_into_blocks,
)
from pipeline.config import MotorSpec
from pipeline.config.hashes import model_hash
from pipeline.config.nights import Night
from pipeline.config.periods import ChosenPeriods
from pipeline.config.settings import Model
from pipeline.night.smoothing import smooth
from pipeline.night.time_base import Samples
from pipeline.night.viscosity import driven

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class NightStatistics:
    """A night's kept samples with their columns and the statistics of its blocks.

    Attributes
    ----------
    samples
        The kept samples.
    conditions
        What drives their leakage, shape (n,).
    z
        Their columns, smoothed where that was asked for; shape (n, c).
    unsmoothed
        The same before smoothing; z itself where none was asked for.
    short_block
        Number of each sample's block before neighbours are merged, whose borders no smoothing
        crosses; shape (n,).
    blocks
        Blocks as they are stored.
    factors
        Triangular factor of each, shape (b, c, c); of weighted samples under a robust loss.
    plain_factors
        The same without weights: what a fit is judged on.
    short_means
        What each stored block keeps of the short blocks that were merged into it: place, samples
        and means but of the ones of each, in a row; None where none were.
    inflation
        Factor on standard errors that robust weights ask for; 1 without them.
    model_hash
        Hash of all that shaped them.
    viscosity_ratios
        Measured viscosity over the data sheet's by block; None where it is the data sheet's.
    """

    samples: Samples
    conditions: OperatingConditions
    z: Array
    unsmoothed: Array
    short_block: NDArray[np.int64]
    blocks: tuple[Block, ...]
    factors: Array
    plain_factors: Array
    short_means: tuple[list[float] | None, ...]
    inflation: float
    model_hash: str
    viscosity_ratios: Array | None = None

    def with_viscosity(self, ratios: Array | None, columns: Sequence[str]) -> NightStatistics:
        """The same with the oil as measured, by block; None: as on its data sheet."""
        if ratios is None:
            return self
        scale = np.where(driven(columns), 1.0 / ratios[:, None], 1.0)
        of_samples = np.repeat(scale, [block.n for block in self.blocks], axis=0)
        z = self.z * of_samples
        return replace(
            self,
            z=z,
            unsmoothed=z if self.unsmoothed is self.z else self.unsmoothed * of_samples,
            factors=self.factors * scale[:, None, :],
            plain_factors=self.plain_factors * scale[:, None, :],
            viscosity_ratios=ratios,
        )

    def judged_on(self, part: str | None = None) -> Array:
        """Factor of the samples of a part as they are, or of the whole night."""
        chosen = [part is None or block.part == part for block in self.blocks]
        return merge(self.plain_factors[np.array(chosen, dtype=bool)])

    def parts_of(self, rows: NDArray[np.int64]) -> list[str]:
        """Part of some of the kept samples."""
        ends = np.cumsum([block.n for block in self.blocks])
        return [self.blocks[at].part for at in np.searchsorted(ends, rows, side="right").tolist()]

    def rows_of(self, part: str) -> NDArray[np.bool_]:
        """Mask of the kept samples of a part, shape (n,)."""
        chosen = np.array([block.part == part for block in self.blocks], dtype=np.bool_)
        return np.repeat(chosen, [block.n for block in self.blocks])

    def training_error(self, coefficients: Array) -> Array:
        """Prediction errors of the training samples [l/min], shape (n,)."""
        error: Array = self.z[self.rows_of(TRAINING)] @ -np.concatenate([coefficients, (1.0, -1.0)])
        return error


def night_statistics(
    spec: MotorSpec, motor: Motor, night: Night, samples: Samples
) -> NightStatistics:
    """Regressors, smoothing, blocks, and their factors.

    Raises
    ------
    ValidityError
        If the oil's viscosity is not known at a temperature.
    EstimationError
        If Huber's weights are asked for and there are fewer samples than coefficients.
    """
    settings = spec.settings
    conditions = operating_conditions(spec, samples)
    unsmoothed = np.empty((len(samples.index), len(motor.columns)))
    regressors(motor, conditions, out=unsmoothed[:, :-1])
    unsmoothed[:, -1] = samples.leakage_l_per_min
    by_hand = ChosenPeriods.of(spec.file.periods, night)
    short = split_into_blocks(samples.time_us, night.start_us, settings.windows, by_hand)
    number = np.repeat(np.arange(len(short)), [block.n for block in short])
    z = smooth(unsmoothed, samples.index, number, samples.period_us, settings.smoothing)
    stored = merge_neighbours(short, settings.windows.maximum_blocks)
    borders = np.array([*(block.first_row for block in stored), len(z)])
    plain = factors(z, borders)
    made, inflation, weighted = plain, 1.0, z
    if settings.estimation.loss == "huber":
        bounds = Parametrisation.of(motor).coefficient_bounds()
        weights = huber_weights(z, *bounds)
        weighted = z * np.sqrt(weights)[:, None]
        made, inflation = factors(weighted, borders), weight_inflation(weights)
    return NightStatistics(
        samples=samples,
        conditions=conditions,
        z=z,
        unsmoothed=unsmoothed,
        short_block=number,
        blocks=stored,
        factors=made,
        plain_factors=plain,
        short_means=_short_means(weighted, short, stored),
        inflation=inflation,
        model_hash=model_hash(spec, motor, night.date),
    )


def _short_means(
    z: Array, short: Sequence[Block], stored: Sequence[Block]
) -> tuple[list[float] | None, ...]:
    """Place, samples and means of the short blocks within each stored one."""
    if len(short) == len(stored):
        return (None,) * len(stored)
    n, means = means_inside(z, short)
    owner = owners(short, stored)
    start_us = np.array([block.start_us for block in short])
    length_us = short[0].end_us - short[0].start_us
    place = (start_us - np.array([block.start_us for block in stored])[owner]) // length_us
    table = np.column_stack([place, n, np.delete(means, -3, axis=1)])
    parts = (table[owner == place] for place in range(len(stored)))
    return tuple(part.ravel().tolist() if len(part) > 1 else None for part in parts)


def operating_conditions(spec: MotorSpec, samples: Samples) -> OperatingConditions:
    """Conditions of the kept samples that drive the leakage, from one side or from both."""
    return OperatingConditions.from_bar(
        np.abs(samples.pressure_difference_bar),
        samples.oil_temperature_c,
        np.abs(samples.speed_rpm),
        charge_over_case_bar(spec.settings.model, samples)
        if spec.settings.model.two_sided
        else None,
    )


def mean_charge_bar(spec: MotorSpec, samples: Samples) -> float | None:
    """Mean charge above case pressure; None in a model of one side."""
    if not spec.settings.model.two_sided:
        return None
    return float(np.mean(charge_over_case_bar(spec.settings.model, samples)))


def charge_over_case_bar(model: Model, samples: Samples) -> Array:
    """Charge above case pressure: from channels where logged, else as configured."""
    logged = samples.low_pressures_bar
    constant = np.full(len(samples.index), model.charge_pressure_bar)
    if (low_port := logged.get("low_port_pressure")) is not None:
        # Under back-drive the ports change sides.
        constant = low_port + np.minimum(samples.pressure_difference_bar, 0.0)
    charge = logged.get("charge_pressure", constant)
    case = logged.get("case_pressure", np.full(len(samples.index), model.case_pressure_bar))
    difference: Array = np.maximum(charge - case, 0.0)
    return difference
