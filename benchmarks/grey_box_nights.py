"""The project's own watch over simulated nights: fits, trends and states as a nightly run has them.

A night is fitted from its blocks (`leakage.estimation.block_fit`), its figures become rows
of the tables, and all that a run does with them after that is done: filter,
baselines, duty, states, explanations.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from benchmarks.machine_nights import MINUTES, Night
from benchmarks.simulated_nights import CONFIGS
from leakage import OperatingConditions
from leakage.course.balanced_baseline import DutyBlocks
from leakage.course.temperature_correction import temperature_response
from leakage.estimation.block_fit import SampleBlocks, fit_blocks
from leakage.estimation.block_statistics import merge, with_free_known
from leakage.estimation.identifiability import Excitation, judge_leakage
from leakage.estimation.multi_start import Parametrisation, SearchSettings
from leakage.estimation.slow_errors import short_blocks
from pipeline.arrays import Array
from pipeline.config import MotorSpec, load_fleet
from pipeline.night.rows import upper_triangle
from pipeline.schema import FITS, OPERATION, PARAMETERS, frame
from pipeline.trends.baselines.blocks import BlockFiles
from pipeline.trends.baselines.duty import with_duty
from pipeline.trends.figures.filtered_nights import with_filter
from pipeline.trends.nights.from_tables import rows_by_night
from pipeline.trends.nights.records import Layout
from pipeline.trends.stage import Part, standing_of
from pipeline.trends.states.model import with_misfit
from pipeline.trends.states.standing import RAISED, Standing

FIRST = dt.date(2026, 1, 2)
MOTOR, MODE = "CB560-01", "none"
NO_SEARCH = SearchSettings(starting_points=0)
MODEL_HASH = "simulated"
TRAINING_SHARE = 0.8


@cache
def simulated_motor() -> MotorSpec:
    """A CB560 of the shipped configs on a tank of its own; the speed varies: rollers are free."""
    fleet = load_fleet(CONFIGS / "fleet.toml")
    spec = next(one for one in fleet.motors if one.motor_id == MOTOR)
    alone = spec.file.model_copy(update={"oil_circuit": ""})
    return replace(spec, file=alone, roller_is_free=True)


@dataclass(slots=True)
class NightBlocks(BlockFiles):
    """Blocks of simulated nights, in place of those in files."""

    nights: Sequence[Night] = ()

    def of(
        self, _spec: MotorSpec, _layout: Layout, nights: Sequence[dt.date], _model: str
    ) -> DutyBlocks:
        """Blocks of some nights."""
        chosen = [(label, self.nights[(label - FIRST).days]) for label in nights]
        days = [label.toordinal() for label, _ in chosen]
        return DutyBlocks(
            np.concatenate([freed(one.factors) for _, one in chosen]),
            np.concatenate([one.means for _, one in chosen]),
            np.repeat(days, [len(one.factors) for _, one in chosen]),
        )

    of_baseline = of


def freed(factors: Array) -> Array:
    """Blocks with the rollers' flow as a path of its own."""
    spec = simulated_motor()
    motor, standard = spec.motor(FIRST, MODE), spec.stated.motor(FIRST, MODE).standard
    assert standard is not None
    place = motor.columns.index(standard.name)
    return with_free_known(factors, place, standard.configured_coefficient)


def night_rows(night: Night, label: dt.date) -> dict[str, list[dict[str, object]]]:
    """Rows of `fits`, `parameters` and `operation` of a night."""
    spec = simulated_motor()
    motor, key = spec.motor(label, MODE), {"motor_id": spec.motor_id, "night": label}
    blocks = freed(night.factors)
    n = len(blocks)
    excitation = Excitation(*((float(low), float(high)) for low, high in night.spans))
    found = fit_blocks(
        SampleBlocks(
            blocks,
            short_blocks(blocks, np.arange(n)),
            np.arange(n) < round(TRAINING_SHARE * n),
            night.means,
            excitation,
        ),
        motor,
        NO_SEARCH,
        np.random.default_rng(0),
    )
    fit, verdicts = found.fit, found.identified(excitation)
    temperature, pressure, speed = night.means.mean(axis=0).tolist()
    active = ~(fit.certificate.fixed | fit.certificate.at_lower | fit.certificate.at_upper)
    response = temperature_response(
        found.whitened, fit.coefficients, active, night.means[:, 0] - temperature
    )
    at = spec.settings.reference
    conditions = (at.pressure_bar, at.temperature_c, at.speed_rpm)
    reference = judge_leakage(fit, verdicts, excitation, OperatingConditions.from_bar(*conditions))
    half = reference.interval.half_width if reference.interval else np.nan
    root = np.zeros((len(fit.coefficients),) * 2)
    if verdicts.distribution is not None:
        on = verdicts.distribution.active
        root[np.ix_(on, on)] = verdicts.distribution.covariance_root()
    leakage = reference.leakage_l_per_min
    fits = key | {
        "flushing_mode": MODE,
        "is_primary": True,
        "status": "ok",
        "interval_status": "ok" if verdicts.distribution is not None else "none",
        "n_interval_blocks": verdicts.n_blocks,
        "columns": list(motor.columns),
        "coefficients": fit.coefficients.tolist(),
        "coefficient_covariance_root": upper_triangle(root),
        "coefficient_response": response.tolist(),
        "night_factor": upper_triangle(merge(blocks)),
        "reference_leakage_l_per_min": leakage,
        "reference_leakage_lower": leakage - half,
        "reference_leakage_upper": leakage + half,
        "reference_verdict": reference.verdict,
        "reference_reason": reference.reason,
        "own_pressure_bar": pressure,
        "own_temperature_c": temperature,
        "own_speed_rpm": speed,
        "model_hash": MODEL_HASH,
        **{
            f"reference_{name}": value
            for name, value in zip(
                ("pressure_bar", "temperature_c", "speed_rpm"), conditions, strict=True
            )
        },
    }
    parameters = [
        key
        | {
            "flushing_mode": MODE,
            "parameter": path.coefficient_name,
            "value": float(value),
            "lower": float(value - one.interval.half_width) if one.interval else None,
            "upper": float(value + one.interval.half_width) if one.interval else None,
            "verdict": one.verdict,
            "reason": one.reason,
        }
        for path, value, one in zip(
            Parametrisation.of(motor).paths, fit.coefficients, verdicts.coefficients, strict=True
        )
        if path is not None
    ]
    operation = key | {
        "kept_hours": MINUTES / 60.0,
        "running_hours": 12.0,
        "mean_temperature_c": temperature,
        "share_reversed": 0.0,
        **dict(
            zip(
                ("pressure_histogram", "temperature_histogram", "speed_histogram"),
                night.histograms,
                strict=True,
            )
        ),
    }
    return {"fits": [fits], "parameters": parameters, "operation": [operation]}


Rows = dict[str, list[dict[str, object]]]


def standing(nights: Sequence[Night], rows: Sequence[Rows]) -> Standing:
    """Standing of a motor over its nights, from their rows."""
    spec = simulated_motor()
    frames = (
        frame(table, [row for one in rows for row in one[table.name]])
        for table in (FITS, PARAMETERS, OPERATION)
    )
    layouts = {spec.motor_id: Layout.of(spec, FIRST)}
    history = rows_by_night([spec], layouts, *frames)[spec.motor_id]
    first, blocks = dt.date.min, NightBlocks(CONFIGS, (), nights=nights)
    filtered = with_misfit(with_filter(history, first), first)
    return standing_of(Part.of(with_duty(filtered, first, blocks)), None, None)


@dataclass(frozen=True, slots=True)
class Watch:
    """What the project says of a motor."""

    # Nights with a warning or an alarm of a leakage, of the drain flow or of a loss factor.
    raised: NDArray[np.bool_]
    # Paths that are named ten nights after the first of them from a night on.
    named: tuple[str, ...]
    is_common: bool  # a change of all flows is told then


def watched(found: Standing, begin: int, after: int = 10) -> Watch:
    """States from a night on, and the explanation of the first that is raised."""
    raised = np.any([np.isin(found.told[name], RAISED) for name in found.watched], axis=0)
    told = np.flatnonzero(raised[begin:])
    if not len(told):
        return Watch(raised, (), False)
    last = min(begin + int(told[0]) + after, len(raised) - 1)
    why = found.explained(last)
    return Watch(raised, why.named if why else (), bool(why and why.is_common))
