"""Nights fitted anew from their published rows, when settings of the fit changed: without a log.

What needs samples keeps its rows.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import polars as pl

from leakage import EstimationError, OperatingConditions
from leakage.estimation.sensitivities import effects_elsewhere
from pipeline.config import MotorSpec
from pipeline.night.fit import REFERENCE, conditions, fit_stored_blocks, tolerances
from pipeline.night.fit_night import NightOutcome
from pipeline.night.rows import (
    Rows,
    coefficient_names,
    fit_columns,
    of_fit,
    parameter_rows,
    reference_columns,
)
from pipeline.night.statistics import BLOCK_COLUMNS, StoredBlocks
from pipeline.schema import BLOCKS, Row
from pipeline.schema.fits import OK

REFITTED_TABLES = ("nights", "fits", "parameters")
FROM_TABLES = (*REFITTED_TABLES, "error_budget")


@dataclass(frozen=True, slots=True)
class PublishedNight:
    """Rows of a motor's night in the tables."""

    label: dt.date  # the night
    rows: Mapping[str, Sequence[Row]]  # by name, of `FROM_TABLES`
    # Rows of `blocks` in order of time; None where there are none.
    blocks: pl.DataFrame | None


def refit(spec: MotorSpec, night: PublishedNight) -> NightOutcome | None:
    """Fit a night anew; None where the published rows do not suffice: the log has to be read."""
    modes, primary = spec.file.flushing.modes, spec.file.flushing.mode
    fits = {row["flushing_mode"]: row for row in night.rows["fits"]}
    own = next(iter(night.rows["nights"]), {})
    if set(fits) != set(modes) or own.get("status") != OK or night.blocks is None:
        return None
    motor = spec.stated.motor(night.label, primary)
    blocks = StoredBlocks.of(spec, night.blocks, motor.columns)
    if blocks is None:
        return None
    at, reference = conditions(spec, blocks), reference_columns(spec)
    is_elsewhere = any(row | reference != row for row in fits.values())
    rows: Rows = {"fits": [], "parameters": [], "error_budget": []}
    for mode in modes:
        key = {"motor_id": spec.motor_id, "night": night.label, "flushing_mode": mode}
        budget = [row for row in night.rows["error_budget"] if row["flushing_mode"] == mode]
        if is_elsewhere:
            budget = _budget(spec, night.label, fits[mode], budget, at[0], blocks.charge_bar)
        try:
            made = fit_stored_blocks(spec, night.label, mode, blocks, at, budget)
        except EstimationError:
            return None
        # What needs samples is as before.
        figures = fit_columns(spec, made, blocks) | {"is_primary": mode == primary}
        rows["fits"].append(fits[mode] | figures)
        rows["parameters"] += [key | row for row in parameter_rows(spec, made)]
        rows["error_budget"] += [key | row for row in budget]
    if not is_elsewhere:
        del rows["error_budget"]
    rows["nights"] = [own | of_fit(rows["fits"])]
    return NightOutcome(night.label, OK, None, None, rows, tables=tuple(rows))


def refit_read(spec: MotorSpec, outcome: NightOutcome) -> NightOutcome:
    """Fit a night that was just read for another scale of the rollers, where its rows suffice."""
    if outcome.status != OK:
        return outcome
    blocks = pl.DataFrame(
        outcome.rows["blocks"], {name: BLOCKS.schema[name] for name in BLOCK_COLUMNS}
    )
    made = refit(spec, PublishedNight(outcome.night, outcome.rows, blocks))
    return outcome if made is None else replace(outcome, rows={**outcome.rows, **made.rows})


def _budget(
    spec: MotorSpec,
    night: dt.date,
    before: Row,
    known: Sequence[Row],
    at: OperatingConditions,
    charge_bar: float | None,
) -> list[Row]:
    """Rows of `error_budget` at other reference conditions; those of the coefficients stay."""
    motor = spec.stated.motor(night, before["flushing_mode"])
    coefficients = dict(zip(before["coefficient_names"], before["coefficients"], strict=True))
    names = coefficient_names(motor)
    by_source: dict[str, dict[str, float]] = {}
    for row in known:
        by_source.setdefault(row["source"], {})[row["indicator"]] = row["effect"]
    effects = effects_elsewhere(
        motor,
        tolerances(spec, night),
        np.array([coefficients[name] for name in names]),
        {
            source: (np.array([some.get(name, 0.0) for name in names]), some[REFERENCE])
            for source, some in by_source.items()
        },
        OperatingConditions.from_bar(
            before["reference_pressure_bar"],
            before["reference_temperature_c"],
            before["reference_speed_rpm"],
            charge_bar,
        ),
        at,
    )
    return [
        row | {"effect": effects.get(row["source"], row["effect"])}
        if row["indicator"] == REFERENCE
        else row
        for row in known
    ]
