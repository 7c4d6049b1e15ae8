"""From a night's kept samples to the statistics of the blocks of its good parts, and their hash."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from leakage import Motor, OperatingConditions, regressors
from leakage.estimation.compression import CompressedSamples, compress
from leakage.estimation.sample_blocks import ChosenPeriods, split_into_blocks, within
from pipeline.arrays import SECOND_US, Array, Mask, Times
from pipeline.config import MotorSpec, Windows
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

    def parts_of(self, rows: NDArray[np.int64]) -> list[str]:
        """Part of some of the kept samples."""
        ends = np.cumsum([block.n for block in self.blocks])
        return [self.blocks[at].part for at in np.searchsorted(ends, rows, side="right").tolist()]


def night_statistics(
    spec: MotorSpec, motor: Motor, night: Night, samples: Samples
) -> NightStatistics:
    """Regressors, smoothing, blocks, and their factors.

    Raises ValidityError if the oil's viscosity is not known at a temperature; EstimationError if
    Huber's weights are asked for and there are fewer samples than coefficients.
    """
    settings = spec.settings
    conditions = operating_conditions(spec, samples)
    unsmoothed = np.empty((len(samples.index), len(motor.columns)), order="F")
    regressors(motor, conditions, out=unsmoothed[:, :-1])
    unsmoothed[:, -1] = samples.leakage_l_per_min
    by_hand = spec.file.periods.within(night)
    smoothing, windows = settings.smoothing, settings.windows
    made = compress(
        unsmoothed,
        samples.index,
        samples.period_us,
        split_into_blocks(samples.time_us, night.start_us, windows, by_hand),
        motor.coefficient_bounds(),
        maximum_blocks=windows.maximum_blocks,
        smoothing_s=smoothing.window_s,
        smoothing_of=smoothing.apply_to,
        loss=settings.estimation.loss,
    )
    return NightStatistics(
        **{field.name: getattr(made, field.name) for field in fields(made)},
        samples=samples,
        conditions=conditions,
        model_hash=model_hash(spec, motor, night.date),
    )


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


# A spread goes from the one to the other: single samples make none.
SPREAD_PERCENTILES = (5.0, 95.0)


def left_out(
    time_us: Times,
    period_us: int,
    night_start_us: int,
    settings: Windows,
    chosen_periods: ChosenPeriods,
) -> dict[str, Mask]:
    """Kept samples that are in no part of the night good enough to fit, by rule."""
    if chosen_periods:
        inside = within(time_us, chosen_periods.training + chosen_periods.validation)
        return {"outside_periods": ~inside}
    thin, short = np.zeros((2, len(time_us)), dtype=np.bool_)
    if settings.minimum_block_share > 0 and len(time_us):
        length = round(settings.block_s * SECOND_US)
        sizes = _lengths(np.diff((time_us - night_start_us) // length) > 0)
        thin = np.repeat(sizes < settings.minimum_block_share * (length / period_us), sizes)
    if settings.longest_gap_s is not None and not thin.all():
        rest = np.flatnonzero(~thin)
        sizes = _lengths(np.diff(time_us[rest]) > settings.longest_gap_s * SECOND_US)
        minutes = sizes * period_us / (60 * SECOND_US)
        short[rest] = np.repeat(minutes < settings.minimum_stretch_minutes, sizes)
    return {"thin_block": thin, "short_stretch": short}


def _lengths(between: Mask) -> NDArray[np.intp]:
    """Samples of each run, from the pairs of neighbours between which one ends."""
    return np.diff(np.flatnonzero(between) + 1, prepend=0, append=len(between) + 1)


def too_uniform(values: Mapping[str, NDArray[np.float64]], settings: Windows) -> str | None:
    """Channel that varies too little over the training samples to be fitted, in words; or None."""
    needed = {
        "pressure": (settings.minimum_pressure_spread_bar, "bar"),
        "speed": (settings.minimum_speed_spread_rpm, "rpm"),
        "temperature": (settings.minimum_temperature_spread_c, "°C"),
    }
    found = []
    for name, (limit, unit) in needed.items():
        if limit > 0 and len(values[name]):
            low, high = np.percentile(values[name], SPREAD_PERCENTILES)
            if high - low < limit:
                found.append(f"{name} spans {high - low:.3g} {unit}, {limit:g} are needed")
    return "; ".join(found) or None
