"""From a night's kept samples to the statistics of the blocks of its good parts, and their hash."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from leakage import Motor, OperatingConditions, regressors
from leakage.estimation.sample_blocks import CompressedSamples, compress, split_into_blocks
from pipeline.arrays import Array
from pipeline.config import MotorSpec
from pipeline.config.hashes import model_hash
from pipeline.config.nights import Night
from pipeline.config.settings import Model
from pipeline.night.time_base import Samples
from pipeline.night.viscosity import driven


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NightStatistics(CompressedSamples):
    """A night's kept samples with their columns and the statistics of its blocks."""

    samples: Samples  # the kept samples
    conditions: OperatingConditions  # what drives their leakage, shape (n,)
    model_hash: str  # hash of all that shaped them
    # Measured viscosity over the data sheet's by block; None where it is the data sheet's.
    viscosity_ratios: Array | None = None

    def with_viscosity(self, ratios: Array | None, columns: Sequence[str]) -> NightStatistics:
        """Return the same with the oil as measured, by block; None: as on its data sheet."""
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
            viscosity_ratios=ratios,
        )

    def parts_of(self, rows: NDArray[np.int64]) -> list[str]:
        """Return part of some of the kept samples."""
        ends = np.cumsum([block.n for block in self.blocks])
        return [self.blocks[at].part for at in np.searchsorted(ends, rows, side="right").tolist()]


def night_statistics(
    spec: MotorSpec, motor: Motor, night: Night, samples: Samples, *, is_merged: bool = True
) -> NightStatistics:
    """Return a night's regressors, smoothed where that is asked for, its blocks and their factors.

    Raises ValidityError if the oil's viscosity is not known at a temperature.
    """
    settings = spec.settings
    conditions = operating_conditions(spec, samples)
    unsmoothed = np.empty((len(samples.index), len(motor.columns)), order="F")
    regressors(motor, conditions, out=unsmoothed[:, :-1])
    unsmoothed[:, -1] = samples.leakage_l_per_min
    by_hand = spec.file.periods.within(night)
    windows = settings.windows.blocks()
    made = compress(
        unsmoothed,
        samples.index,
        samples.period_us,
        split_into_blocks(samples.time_us, night.start_us, windows, by_hand),
        maximum_blocks=windows.maximum_blocks if is_merged else len(samples.index),
        smoothing_s=settings.smoothing.window_s,
    )
    return NightStatistics(
        **{field.name: getattr(made, field.name) for field in fields(made)},
        samples=samples,
        conditions=conditions,
        model_hash=model_hash(spec, motor, night.date),
    )


def operating_conditions(spec: MotorSpec, samples: Samples) -> OperatingConditions:
    """Return conditions of the kept samples that drive the leakage, from one side or from both."""
    return OperatingConditions.from_bar(
        np.abs(samples.pressure_difference_bar),
        samples.oil_temperature_c,
        np.abs(samples.speed_rpm),
        charge_over_case_bar(spec.settings.model, samples)
        if spec.settings.model.two_sided
        else None,
    )


def charge_over_case_bar(model: Model, samples: Samples) -> Array:
    """Return charge above case pressure: from channels where logged, else as configured."""
    logged = samples.low_pressures_bar
    constant = np.full(len(samples.index), model.charge_pressure_bar)
    if (low_port := logged.get("low_port_pressure")) is not None:
        # Under back-drive the ports change sides.
        constant = low_port + np.minimum(samples.pressure_difference_bar, 0.0)
    charge = logged.get("charge_pressure", constant)
    case = logged.get("case_pressure", np.full(len(samples.index), model.case_pressure_bar))
    difference: Array = np.maximum(charge - case, 0.0)
    return difference
