"""Nights fitted anew from their stored statistics, when settings of the fit changed: without a log.

Certificate, verdicts, intervals and figures by path are made from the blocks as stored, which give
what the samples would give. What needs samples keeps its rows, and `fits` marks it.
"""

from __future__ import annotations

import datetime as dt
import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from leakage import EstimationError, Fit, OperatingConditions
from leakage.block_statistics import merge
from leakage.identifiability import Excitation
from leakage.sensitivities import ErrorBudget
from pipeline.config import MotorSpec
from pipeline.errors import StoreError
from pipeline.night.block_fit import fit_blocks
from pipeline.night.fit import FittedMode
from pipeline.night.fit_night import OK, NightOutcome, PreviousModel
from pipeline.night.parameter_rows import parameter_rows
from pipeline.night.rows import (
    Row,
    Rows,
    agreement_columns,
    block_fit_columns,
    criteria_columns,
    leakage_columns,
    mark_modes,
    previous_model_columns,
    search_columns,
    start_rows,
)
from pipeline.night.stored_blocks import (
    BLOCK_COLUMNS,
    block_length_s,
    have_columns,
    span,
    training_of,
    triangular_factors,
)
from pipeline.night.windows import TRAINING
from pipeline.schema import BLOCK_STATISTICS, FITS, PARAMETERS, Table
from pipeline.store.tables import read_rows

log = logging.getLogger(__name__)

Array = NDArray[np.float64]

REFITTED_TABLES = ("fits", "parameters")
STARTS_TABLES = ("starts",)
JUDGED_TABLES = ("fits",)
# Columns of `parameters` that need samples, or the starts.
KEPT_OF_PARAMETERS = ("systematic", "spread_over_starts")
KEPT_OF_FITS = ("reference_leakage_systematic", "own_conditions_leakage_systematic")


class StoredNights:
    """The published statistics of a motor's nights.

    Parameters
    ----------
    output
        Output folder.
    spec
        The motor, with the settings that hold now.
    with_starts
        Whether to search from all starts, too; no estimate depends on it.
    """

    def __init__(self, output: Path, spec: MotorSpec, *, with_starts: bool = False) -> None:
        self._output = output
        self._spec = spec
        self._with_starts = with_starts
        self._tables = REFITTED_TABLES + STARTS_TABLES * with_starts
        self._month = ""
        self._nights: dict[str, dict[dt.date, pl.DataFrame]] = {}

    def refit(self, label: dt.date, previous: PreviousModel) -> NightOutcome | None:
        """Fit a night anew.

        Parameters
        ----------
        label
            The night.
        previous
            The motor's model before, by flushing mode.

        Returns
        -------
        NightOutcome or None
            None where the stored statistics do not suffice: the log has to be read.
        """
        spec = self._spec
        fits = {row["flushing_mode"]: row for row in self._rows(FITS, label)}
        stored = self._of_night(BLOCK_STATISTICS, label)
        if set(fits) != set(spec.file.flushing.modes) or stored is None:
            return None
        if any(row["status"] != OK or row["sample_period_s"] is None for row in fits.values()):
            return None
        columns = spec.motor(label, spec.file.flushing.mode).columns
        if not have_columns(stored, columns):
            return None
        blocks = _Blocks.of(stored, len(columns))
        parameters: dict[str, list[Row]] = {mode: [] for mode in fits}
        for row in self._rows(PARAMETERS, label):
            parameters[row["flushing_mode"]].append(row)
        rows: Rows = {name: [] for name in self._tables}
        model = {}
        try:
            for mode in spec.file.flushing.modes:
                found = self._fit(label, mode, fits[mode], blocks)
                before = previous.get(mode)
                rows["fits"].append(self._fits_row(fits[mode], found, blocks, before))
                rows["parameters"] += _parameters(spec, found, label, parameters[mode])
                if self._with_starts:
                    key = {"motor_id": spec.motor_id, "night": label, "flushing_mode": mode}
                    rows["starts"] += [key | row for row in start_rows(found.fit)]
                model[mode] = tuple(found.fit.coefficients.tolist())
        except EstimationError:
            return None
        mark_modes(rows["fits"], spec.file.flushing.mode)
        return NightOutcome(label, OK, None, None, rows, model, tables=self._tables)

    def refitted(self) -> set[dt.date]:
        """Nights whose fits were made from their statistics."""
        try:
            columns = ("night", "is_refitted")
            rows = read_rows(self._output, FITS, [self._spec.motor_id], columns)
        except StoreError:
            return set()
        return set(rows.filter("is_refitted")["night"])

    def judge(self, label: dt.date, previous: PreviousModel) -> NightOutcome | None:
        """Judge another model before on a night that is fitted; as :meth:`refit`."""
        rows, model = [], {}
        for row in self._rows(FITS, label):
            if row["status"] != OK or row["night_factor"] is None:
                return None
            factor = _factor(row["night_factor"], len(row["columns"]))
            before = previous.get(row["flushing_mode"])
            rows.append(row | previous_model_columns(self._spec, factor, before))
            model[row["flushing_mode"]] = tuple(row["coefficients"])
        if not rows:
            return None
        return NightOutcome(label, OK, None, None, {"fits": rows}, model, tables=JUDGED_TABLES)

    def _rows(self, table: Table, label: dt.date) -> list[Row]:
        """Rows of the motor in a night; none where its month's files are absent or damaged."""
        rows = self._of_night(table, label)
        return [] if rows is None else rows.to_dicts()

    def _of_night(self, table: Table, label: dt.date) -> pl.DataFrame | None:
        month = f"{label:%Y-%m}"
        if month != self._month:
            self._nights, self._month = {}, month
        if table.name not in self._nights:
            self._nights[table.name] = self._read(table, month)
        return self._nights[table.name].get(label)

    def _read(self, table: Table, month: str) -> dict[dt.date, pl.DataFrame]:
        columns = BLOCK_COLUMNS
        if table is not BLOCK_STATISTICS:
            columns = tuple(name for name in table.schema if name != "run_id")
        try:
            rows = read_rows(self._output, table, [self._spec.motor_id], columns, month)
        except StoreError as error:
            log.warning("%s; no night of %s is made from it", error, month)
            return {}
        nights = rows.sort(table.key).partition_by("night", as_dict=True, maintain_order=True)
        return {key[0]: part for key, part in nights.items()}

    def _fit(self, label: dt.date, mode: str, row: Row, blocks: _Blocks) -> FittedMode:
        reference = self._spec.settings.reference
        charge = row["mean_charge_over_case_bar"]

        def excite(_: Fit) -> Excitation:
            return _excitation(row, blocks)

        found = fit_blocks(
            self._spec,
            label,
            mode,
            blocks.training,
            excite,
            (
                OperatingConditions.from_bar(
                    reference.pressure_bar, reference.temperature_c, reference.speed_rpm, charge
                ),
                OperatingConditions.from_bar(
                    row["own_pressure_bar"], row["own_temperature_c"], row["own_speed_rpm"], charge
                ),
            ),
            row["weight_inflation"],
            search=self._with_starts,
        )
        return FittedMode.of(found, error=np.empty(0), budget=ErrorBudget(()))

    def _fits_row(
        self,
        before: Row,
        found: FittedMode,
        blocks: _Blocks,
        previous: tuple[float, ...] | None,
    ) -> Row:
        reference, estimation = self._spec.settings.reference, self._spec.settings.estimation
        row = before | block_fit_columns(found) | leakage_columns(found)
        row |= {
            name: before[name]
            for name in KEPT_OF_FITS
            if row[name.replace("_systematic", "_l_per_min")] is not None
        }
        row |= {
            "is_refitted": True,
            "reference_pressure_bar": reference.pressure_bar,
            "reference_temperature_c": reference.temperature_c,
            "reference_speed_rpm": reference.speed_rpm,
        }
        if self._with_starts:
            row |= search_columns(found.fit)
        # Blocks under a robust loss are weighted: they cannot tell how the samples agree.
        if estimation.loss == "squared":

            def judged_on(part: str) -> Array:
                return merge(blocks.of_part(part))

            row |= agreement_columns(self._spec, judged_on, found)
        factor = _factor(before["night_factor"], len(before["columns"]))
        row |= previous_model_columns(self._spec, factor, previous)
        return row | criteria_columns(row)


@dataclass(frozen=True, slots=True)
class _Blocks:
    """The blocks of a night: rows, and their triangular factors of shape (b, c, c)."""

    rows: pl.DataFrame
    factors: Array

    @classmethod
    def of(cls, rows: pl.DataFrame, size: int) -> _Blocks:
        return cls(rows, triangular_factors(rows, size))

    def of_part(self, part: str) -> Array:
        chosen: Array = self.factors[(self.rows["part"] == part).to_numpy()]
        return chosen

    @property
    def training(self) -> Array:
        return self.of_part(TRAINING)


def is_refit(outcome: NightOutcome) -> bool:
    """Whether a night was fitted from its statistics, and not only judged."""
    return outcome.tables is not None and set(REFITTED_TABLES) <= set(outcome.tables)


def judged(spec: MotorSpec, outcome: NightOutcome, previous: PreviousModel) -> NightOutcome:
    """A night just fitted, with the model before judged on it, which its fit did not know."""
    if outcome.status != OK:
        return outcome
    rows = []
    for row in outcome.rows["fits"]:
        factor = _factor(row["night_factor"], len(row["columns"]))
        before = previous.get(row["flushing_mode"])
        rows.append(row | previous_model_columns(spec, factor, before))
    return replace(outcome, rows={**outcome.rows, "fits": rows})


def _factor(upper: Sequence[float], size: int) -> Array:
    """A triangular factor from its stored triangle, row by row; shape (c, c)."""
    factor = np.zeros((size, size))
    factor[np.triu_indices(size)] = upper
    return factor


def _excitation(row: Row, blocks: _Blocks) -> Excitation:
    """What the training samples saw, from their blocks."""
    training, memory = training_of(blocks.rows), row["correlation_time_s"]
    return Excitation(
        minutes=row["n_training"] * row["sample_period_s"] / 60.0,
        pressure_bar=span(training, "pressure_bar"),
        temperature_c=span(training, "temperature_c"),
        speed_rpm=span(training, "speed_rpm"),
        correlation_time_s=np.inf if memory is None else memory,
        block_s=block_length_s(training),
    )


def _parameters(
    spec: MotorSpec, found: FittedMode, label: dt.date, before: Sequence[Row]
) -> list[Row]:
    """Rows of `parameters`; what needs samples or starts is as before."""
    kept = {row["parameter"]: row for row in before}
    key = {"motor_id": spec.motor_id, "night": label, "flushing_mode": found.name}
    rows = []
    for row in parameter_rows(spec, found):
        old = kept.get(row["parameter"], {})
        rows.append(key | row | {name: old.get(name) for name in KEPT_OF_PARAMETERS})
    return rows
