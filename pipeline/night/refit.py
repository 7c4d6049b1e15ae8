"""Nights fitted anew from their published rows, when settings of the fit changed: without a log.

Proven minimum, verdicts, intervals and figures by path are made from the blocks as stored, which
give what the samples would give. What needs samples keeps its rows, and `fits` marks it.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import polars as pl

from leakage import EstimationError, Motor, OperatingConditions
from leakage.estimation.block_statistics import merge, with_free_known, with_path_known
from leakage.estimation.sensitivities import effects_elsewhere
from pipeline.arrays import Array
from pipeline.config import MotorSpec
from pipeline.night.block_fit import (
    REFERENCE,
    BlockFit,
    conditions,
    fit_stored_blocks,
    in_form,
    scale_of,
)
from pipeline.night.fit import tolerances
from pipeline.night.fit_night import NightOutcome, PreviousModel
from pipeline.night.parameter_rows import parameter_rows
from pipeline.night.rows import (
    Row,
    Rows,
    agreement_columns,
    block_fit_columns,
    leakage_columns,
    mark_modes,
    previous_model_columns,
    reference_columns,
    upper_triangle,
)
from pipeline.night.stored_blocks import BLOCK_COLUMNS, StoredBlocks
from pipeline.schema import BLOCK_STATISTICS
from pipeline.schema.fits import OK

REFITTED_TABLES = ("fits", "parameters")
SENSITIVITIES_TABLES = ("sensitivities",)
JUDGED_TABLES = ("fits",)
KEPT_TABLES = ("fits", "sensitivities")


@dataclass(frozen=True, slots=True)
class PublishedNight:
    """Rows of a motor's night in the tables."""

    label: dt.date  # the night
    # fits, sensitivities: rows of these tables.
    fits: Sequence[Row]
    sensitivities: Sequence[Row]
    # Rows of `block_statistics` in order of time; None where there are none.
    blocks: pl.DataFrame | None


def refit(spec: MotorSpec, night: PublishedNight) -> NightOutcome | None:
    """Fit a night anew; None where the published rows do not suffice: the log has to be read.

    The motor has the settings that hold now, in the form in which it is to be fitted.
    """
    primary = spec.file.flushing.mode
    motor = spec.stated.motor(night.label, primary)
    fits = {row["flushing_mode"]: row for row in night.fits}
    if set(fits) != set(spec.file.flushing.modes) or night.blocks is None:
        return None
    if any(row["status"] != OK or row["sample_period_s"] is None for row in fits.values()):
        return None
    blocks = StoredBlocks.of(spec, night.blocks, motor.columns)
    if blocks is None:
        return None
    measured = _as_measured(blocks, motor, fits[primary])
    # Weighted blocks do not have the plain factor of the night.
    if measured and spec.settings.estimation.loss != "squared":
        return None
    charge_bar = next(iter(fits.values()))["mean_charge_over_case_bar"]
    at = conditions(spec, blocks, charge_bar)
    reference = reference_columns(spec)
    is_elsewhere = any(row | reference != row for row in fits.values())
    tables = REFITTED_TABLES + SENSITIVITIES_TABLES * is_elsewhere
    rows: Rows = {name: [] for name in tables}
    model = {}
    for mode in spec.file.flushing.modes:
        key = {"motor_id": spec.motor_id, "night": night.label, "flushing_mode": mode}
        before = fits[mode] | measured
        before |= _night_factor(spec, before)
        sensitivities = [row for row in night.sensitivities if row["flushing_mode"] == mode]
        if is_elsewhere:
            sensitivities = _sensitivities(spec, night.label, fits[mode], sensitivities, at[0])
            rows["sensitivities"] += [key | row for row in sensitivities]
        try:
            found = fit_stored_blocks(
                spec,
                night.label,
                mode,
                blocks,
                at,
                before["weight_inflation"],
                sensitivities,
            )
        except EstimationError:
            return None
        rows["fits"].append(_fits_row(spec, before, found, blocks))
        rows["parameters"] += [key | row for row in parameter_rows(spec, found)]
        model[mode] = tuple(found.fit.coefficients.tolist())
    mark_modes(rows["fits"], primary)
    return NightOutcome(night.label, OK, None, None, rows, model, tables=tables)


def refit_in_form(
    spec: MotorSpec, outcome: NightOutcome, published: PublishedNight | None
) -> NightOutcome | None:
    """A night's outcome in another form: with the rollers' scale estimated, or as stated.

    `spec` has the form, `published` the rows of a night that was not read. What needs samples
    stays, and so does the mark of a night that was read. None where the rows do not suffice.
    """
    rows = outcome.rows
    if published is None:
        kinds = {one: BLOCK_STATISTICS.schema[one] for one in BLOCK_COLUMNS}
        blocks = pl.DataFrame(rows["block_statistics"], kinds)
        published = PublishedNight(outcome.night, (), (), blocks)
    known = {name: rows.get(name, getattr(published, name)) for name in KEPT_TABLES}
    made = refit(spec, replace(published, **known))
    if made is None:
        return None
    is_refitted = {row["flushing_mode"]: row["is_refitted"] for row in rows["fits"]}
    fits = [row | {"is_refitted": is_refitted[row["flushing_mode"]]} for row in made.rows["fits"]]
    tables = outcome.tables and tuple(dict.fromkeys((*outcome.tables, *(made.tables or ()))))
    rows = {**rows, **made.rows, "fits": fits}
    return replace(outcome, rows=rows, model=made.model, tables=tables)


def _as_measured(blocks: StoredBlocks, motor: Motor, before: Row) -> Row:
    """The night's factor by the oil as measured; empty where it is by that already."""
    if before.get("viscosity_ratio") == blocks.viscosity_ratio:
        return {}
    return {
        "viscosity_ratio": blocks.viscosity_ratio,
        "columns": list(motor.columns),
        "night_factor": upper_triangle(merge(blocks.factors)),
    }


def _night_factor(spec: MotorSpec, row: Row) -> Row:
    """Columns of the night's factor in the form in which the motor is fitted."""
    motor, columns = spec.stated.motor(row["night"], row["flushing_mode"]), row["columns"]
    fitted = list(spec.motor(row["night"], row["flushing_mode"]).columns)
    if columns == fitted or motor.standard is None:
        return {}
    move = with_free_known if spec.roller_is_free else with_path_known
    (moved,) = move(_square(row)[None], *scale_of(motor))
    return {"columns": fitted, "night_factor": upper_triangle(moved)}


def _square(row: Row) -> Array:
    """The night's factor of a row of `fits`."""
    factor = np.zeros((len(row["columns"]),) * 2)
    factor[np.triu_indices(len(factor))] = row["night_factor"]
    return factor


def as_published(night: PublishedNight) -> NightOutcome | None:
    """A fitted night as published, to be judged by another model; None as of :func:`refit`."""
    if not night.fits or any(
        row["status"] != OK or row["night_factor"] is None for row in night.fits
    ):
        return None
    rows = {"fits": list(night.fits)}
    model = {row["flushing_mode"]: tuple(row["coefficients"]) for row in night.fits}
    return NightOutcome(night.label, OK, None, None, rows, model, tables=JUDGED_TABLES)


def judged(spec: MotorSpec, outcome: NightOutcome, previous: PreviousModel) -> NightOutcome:
    """A night with its motor's model before, by flushing mode, judged on it."""
    known = [row.get("night_factor") for row in outcome.rows.get("fits", [])]
    if outcome.status != OK or None in known:
        return outcome
    fits = [
        row | previous_model_columns(spec, _square(row), previous.get(row["flushing_mode"]))
        for row in outcome.rows["fits"]
    ]
    return replace(outcome, rows={**outcome.rows, "fits": fits})


def is_refit(outcome: NightOutcome) -> bool:
    """Tell a night that was fitted from its published rows, and not only judged."""
    return outcome.tables is not None and set(REFITTED_TABLES) <= set(outcome.tables)


def _fits_row(spec: MotorSpec, before: Row, found: BlockFit, blocks: StoredBlocks) -> Row:
    """A row of `fits`; what needs samples is as before."""
    row = before | block_fit_columns(found) | leakage_columns(spec, found)
    row |= {"is_refitted": True} | reference_columns(spec)
    # Blocks under a robust loss are weighted: they cannot tell how the samples agree.
    if spec.settings.estimation.loss == "squared":
        motor = found.stated.fit.motor

        def judged_on(part: str) -> Array:
            return in_form(spec, motor, blocks.factor_of(part))

        row |= agreement_columns(spec, judged_on, found.training)
    return row


def _sensitivities(
    spec: MotorSpec, night: dt.date, before: Row, known: Sequence[Row], at: OperatingConditions
) -> list[Row]:
    """Rows of `sensitivities` at other reference conditions; those of the coefficients stay."""
    motor = spec.stated.motor(night, before["flushing_mode"])
    coefficients = dict(zip(before["columns"], before["coefficients"], strict=False))
    by_source: dict[str, dict[str, float]] = {}
    for row in known:
        by_source.setdefault(row["source"], {})[row["indicator"]] = row["effect"]
    paths = motor.coefficient_paths
    names = [path.coefficient_name if path else "" for path in paths]
    found = effects_elsewhere(
        motor,
        tolerances(spec, night),
        np.array([coefficients[name] for name in motor.columns[:-2]]),
        {
            source: (np.array([some.get(name, 0.0) for name in names]), some[REFERENCE])
            for source, some in by_source.items()
        },
        OperatingConditions.from_bar(
            before["reference_pressure_bar"],
            before["reference_temperature_c"],
            before["reference_speed_rpm"],
            before["mean_charge_over_case_bar"],
        ),
        at,
    )
    return [
        row | {"effect": found.get(row["source"], row["effect"])}
        if row["indicator"] == REFERENCE
        else row
        for row in known
    ]
