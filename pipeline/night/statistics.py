"""From a night's kept samples to the statistics of its blocks, and the hash of what shaped them."""

from __future__ import annotations

import datetime as dt
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from leakage import Motor, OperatingConditions, Parametrisation, regressors
from leakage.block_statistics import factors, merge
from leakage.robust import huber_weights, weight_inflation
from pipeline.config import MotorSpec
from pipeline.config.nights import Night
from pipeline.config.nights import night as night_labelled
from pipeline.night.smoothing import smooth
from pipeline.night.time_base import Samples
from pipeline.night.windows import TRAINING, Block, HandSet, merge_neighbours, split_into_blocks

Array = NDArray[np.float64]

# Raise it when the code makes other statistics of the same samples: old blocks then never merge
# with new ones.
STATISTICS_VERSION = 2

# Keys that leave the columns of a free path as they are: they scale its coefficient, or only say
# how well something is known.
SCALE_ONLY = {
    "annular_gap": {"count", "radius_mm", "length_mm", "height_factor", "gap_um", "eccentricity"},
    "speed_curve": {"scale"},
    "laminar": {"count", "coefficient_m3"},
}
WORDS_AND_TOLERANCES = {
    "name",
    "source",
    "deformation_tolerance_percent",
    "curve_tolerance_percent",
    "pressure_viscosity_tolerance_percent",
    "density_tolerance_percent",
    "offset_tolerance",
    "gain_tolerance_percent",
}
# Where a channel stands in its log, which says nothing of its values.
WHERE_IT_STANDS = {"field"}


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
    inflation
        Factor on standard errors that robust weights ask for; 1 without them.
    model_hash
        Hash of all that shaped them.
    """

    samples: Samples
    conditions: OperatingConditions
    z: Array
    unsmoothed: Array
    short_block: NDArray[np.int64]
    blocks: tuple[Block, ...]
    factors: Array
    plain_factors: Array
    inflation: float
    model_hash: str

    def factors_of(self, part: str) -> Array:
        """Factors of the blocks of a part, as stored and in time order."""
        chosen = [block.part == part for block in self.blocks]
        found: Array = self.factors[np.array(chosen, dtype=bool)]
        return found

    def factor_of(self, part: str) -> Array:
        """Factor of all blocks of a part."""
        return merge(self.factors_of(part))

    def judged_on(self, part: str | None = None) -> Array:
        """Factor of the samples of a part as they are, or of the whole night."""
        chosen = [part is None or block.part == part for block in self.blocks]
        return merge(self.plain_factors[np.array(chosen, dtype=bool)])

    def parts_of(self, rows: NDArray[np.int64]) -> list[str]:
        """Part of some of the kept samples."""
        ends = np.cumsum([block.n for block in self.blocks])
        return [self.blocks[at].part for at in np.searchsorted(ends, rows, side="right").tolist()]

    def rows_of(self, part: str) -> NDArray[np.bool_]:
        """Which of the kept samples belong to a part, shape (n,)."""
        chosen = np.array([block.part == part for block in self.blocks], dtype=np.bool_)
        return np.repeat(chosen, [block.n for block in self.blocks])


def night_statistics(
    spec: MotorSpec, motor: Motor, night: Night, samples: Samples
) -> NightStatistics:
    """Regressors, smoothing, blocks, and their factors.

    Parameters
    ----------
    spec
        The motor's config.
    motor
        The motor as the physics knows it.
    night
        The night; blocks count from its start.
    samples
        The kept samples.

    Returns
    -------
    NightStatistics

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
    by_hand = HandSet.of(spec.file.periods, night)
    short = split_into_blocks(samples.time_us, night.start_us, settings.windows, by_hand)
    number = np.repeat(np.arange(len(short)), [block.n for block in short])
    z = smooth(unsmoothed, samples.index, number, samples.period_us, settings.smoothing)
    stored = merge_neighbours(short, settings.windows.maximum_blocks)
    borders = np.array([*(block.first_row for block in stored), len(z)])
    plain = factors(z, borders)
    made, inflation = plain, 1.0
    if settings.estimation.loss == "huber":
        training = np.repeat(
            [block.part == TRAINING for block in stored], [block.n for block in stored]
        )
        bounds = Parametrisation.of(motor).coefficient_bounds()
        weights = huber_weights(z[training], *bounds)
        weighted = z.copy()
        weighted[training] *= np.sqrt(weights)[:, None]
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
        inflation=inflation,
        model_hash=model_hash(spec, motor, night.date),
    )


def operating_conditions(spec: MotorSpec, samples: Samples) -> OperatingConditions:
    """What drives the leakage of the kept samples, from one side or from both."""
    return OperatingConditions.from_bar(
        np.abs(samples.pressure_difference_bar),
        samples.oil_temperature_c,
        np.abs(samples.speed_rpm),
        _charge_over_case_bar(spec, samples) if spec.settings.model.two_sided else None,
    )


def condition(
    spec: MotorSpec, samples: Samples, bar: float, celsius: float, rpm: float
) -> OperatingConditions:
    """One condition at which a leakage is asked for; charge and case pressure as in the night."""
    charge = None
    if spec.settings.model.two_sided:
        charge = float(np.mean(_charge_over_case_bar(spec, samples)))
    return OperatingConditions.from_bar(bar, celsius, rpm, charge)


def _charge_over_case_bar(spec: MotorSpec, samples: Samples) -> Array:
    """Charge above case pressure: from channels where logged, else as configured."""
    logged, model = samples.low_pressures_bar, spec.settings.model
    constant = np.full(len(samples.index), model.charge_pressure_bar)
    charge = logged.get("charge_pressure", logged.get("low_port_pressure", constant))
    case = logged.get("case_pressure", np.full(len(samples.index), model.case_pressure_bar))
    difference: Array = np.maximum(charge - case, 0.0)
    return difference


def model_hash(spec: MotorSpec, motor: Motor, night: dt.date) -> str:
    """Hash of all that shapes the statistics of a night; blocks of different hash never merge.

    Counts, radii, lengths and bounds of free gaps are left out: they scale loss factors into gap
    heights and leave the columns as they are. So are tolerances and words.
    """
    free = {path.name for path in motor.column_paths}
    paths = [
        {"name": declared.name}
        | declared.model_dump(
            exclude=WORDS_AND_TOLERANCES
            | (SCALE_ONLY[declared.law] if declared.name in free else set())
        )
        for declared in spec.motor_type.path
    ]
    settings = spec.settings.model_dump(
        include={
            "nights",
            "time_base",
            "cleaning",
            "transport_delay",
            "smoothing",
            "windows",
            "model",
            "estimation",
        },
        exclude={
            "windows": {
                "minimum_kept_share",
                "minimum_training_minutes",
                "minimum_pressure_spread_bar",
                "minimum_speed_spread_rpm",
                "minimum_temperature_spread_c",
            },
            "model": {"film_pressure_share_tolerance", "charge_pressure_tolerance_bar"},
            "estimation": set(type(spec.settings.estimation).model_fields) - {"loss"},
        },
    )
    document: dict[str, Any] = {
        "version": STATISTICS_VERSION,
        "columns": motor.columns,
        "paths": paths,
        "oil": spec.oil_on(night).model_dump(exclude=WORDS_AND_TOLERANCES),
        "settings": settings,
        "channels": {
            name: channel.model_dump(exclude=WORDS_AND_TOLERANCES | WHERE_IT_STANDS)
            for name, channel in spec.file.channels.items()
        },
    }
    by_hand = HandSet.of(spec.file.periods, night_labelled(night, spec.settings.nights))
    if by_hand:
        document["periods"] = [by_hand.training, by_hand.validation]
    return hash_of(document)


def hash_of(document: Mapping[str, Any]) -> str:
    """Short hash of a JSON document, the same on every machine."""
    text = json.dumps(document, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
