"""Nights fitted anew from their stored statistics, when settings of the fit changed: without a log.

Certificate, verdicts, intervals and figures by path are made from the blocks as stored, which give
what the samples would give. What needs samples keeps its rows, and `fits` marks it.
"""

from __future__ import annotations

import datetime as dt
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from leakage import EstimationError, Fit, OperatingConditions
from leakage.block_statistics import merge
from leakage.identifiability import Excitation
from leakage.sensitivities import ErrorBudget
from pipeline.block_fit import fit_blocks
from pipeline.config import MotorSpec
from pipeline.errors import StoreError
from pipeline.motor_night import OK, NightOutcome, PreviousModel
from pipeline.night_fit import FittedMode
from pipeline.night_rows import (
    Row,
    Rows,
    agreement_columns,
    block_fit_columns,
    criteria_columns,
    leakage_columns,
    mark_modes,
    previous_model_columns,
)
from pipeline.parameter_rows import parameter_rows
from pipeline.schema import BLOCK_STATISTICS, FITS, PARAMETERS, Table
from pipeline.store import read_rows
from pipeline.windows import TRAINING

Array = NDArray[np.float64]

REFITTED_TABLES = ("fits", "parameters")
JUDGED_TABLES = ("fits",)
READ_TABLES = (FITS, PARAMETERS, BLOCK_STATISTICS)
NOT_READ = {"run_id", "pressure_histogram", "temperature_histogram", "speed_histogram"}
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
    """

    def __init__(self, output: Path, spec: MotorSpec) -> None:
        self._output = output
        self._spec = spec
        self._month = ""
        self._nights: dict[str, dict[dt.date, list[Row]]] = {}

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
        blocks = self._rows(BLOCK_STATISTICS, label)
        if set(fits) != set(spec.file.flushing.modes) or not blocks:
            return None
        if any(row["status"] != OK or row["sample_period_s"] is None for row in fits.values()):
            return None
        columns = {tuple(block["columns"]) for block in blocks}
        if columns != {spec.motor(label, spec.file.flushing.mode).columns}:
            return None
        parameters: dict[str, list[Row]] = {mode: [] for mode in fits}
        for row in self._rows(PARAMETERS, label):
            parameters[row["flushing_mode"]].append(row)
        rows: Rows = {name: [] for name in REFITTED_TABLES}
        model = {}
        try:
            for mode in spec.file.flushing.modes:
                found = self._fit(label, mode, fits[mode], blocks)
                before = previous.get(mode)
                rows["fits"].append(self._fits_row(fits[mode], found, blocks, before))
                rows["parameters"] += _parameters(spec, found, label, parameters[mode])
                model[mode] = tuple(found.fit.coefficients.tolist())
        except EstimationError:
            return None
        mark_modes(rows["fits"], spec.file.flushing.mode)
        return NightOutcome(label, OK, None, None, rows, model, tables=REFITTED_TABLES)

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
        month = f"{label:%Y-%m}"
        if month != self._month:
            self._nights = {one.name: self._read(one, month) for one in READ_TABLES}
            self._month = month
        return self._nights[table.name].get(label, [])

    def _read(self, table: Table, month: str) -> dict[dt.date, list[Row]]:
        columns = [name for name in table.schema if name not in NOT_READ]
        try:
            rows = read_rows(self._output, table, [self._spec.motor_id], columns, month)
        except StoreError:
            return {}
        nights: defaultdict[dt.date, list[Row]] = defaultdict(list)
        for row in rows.sort(table.key).to_dicts():
            nights[row["night"]].append(row)
        return nights

    def _fit(self, label: dt.date, mode: str, row: Row, blocks: Sequence[Row]) -> FittedMode:
        reference = self._spec.settings.reference
        charge = row["mean_charge_over_case_bar"]

        def excite(_: Fit) -> Excitation:
            return _excitation(row, blocks)

        found = fit_blocks(
            self._spec,
            label,
            mode,
            _factors(blocks, TRAINING),
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
            search=False,
        )
        return FittedMode.of(found, error=np.empty(0), budget=ErrorBudget(()), residuals=())

    def _fits_row(
        self,
        before: Row,
        found: FittedMode,
        blocks: Sequence[Row],
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
        # Blocks under a robust loss are weighted: they cannot tell how the samples agree.
        if estimation.loss == "squared":

            def judged_on(part: str) -> Array:
                return merge(_factors(blocks, part))

            row |= agreement_columns(self._spec, judged_on, found)
        factor = _factor(before["night_factor"], len(before["columns"]))
        row |= previous_model_columns(self._spec, factor, previous)
        return row | criteria_columns(row)


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


def _factors(blocks: Sequence[Row], part: str) -> Array:
    """Factors of the blocks of a part in time order; shape (b, c, c)."""
    size = len(blocks[0]["columns"])
    chosen = [_factor(block["statistics"], size) for block in blocks if block["part"] == part]
    return np.array(chosen).reshape(-1, size, size)


def _factor(upper: Sequence[float], size: int) -> Array:
    """A triangular factor from its stored triangle, row by row; shape (c, c)."""
    factor = np.zeros((size, size))
    factor[np.triu_indices(size)] = upper
    return factor


def _excitation(row: Row, blocks: Sequence[Row]) -> Excitation:
    """What the training samples saw, from their blocks."""
    training = [block for block in blocks if block["part"] == TRAINING]

    def limits(name: str) -> tuple[float, float]:
        return (
            min(block[f"minimum_{name}"] for block in training),
            max(block[f"maximum_{name}"] for block in training),
        )

    memory = row["correlation_time_s"]
    lengths = [(block["block_end"] - block["block_start"]).total_seconds() for block in training]
    return Excitation(
        minutes=row["n_training"] * row["sample_period_s"] / 60.0,
        pressure_bar=limits("pressure_bar"),
        temperature_c=limits("temperature_c"),
        speed_rpm=limits("speed_rpm"),
        correlation_time_s=np.inf if memory is None else memory,
        block_s=float(np.median(lengths)),
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
