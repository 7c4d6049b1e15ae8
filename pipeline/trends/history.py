"""What the tables say of motors' nights, as arrays: all that trends are made from."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from pipeline.nights import nights_between
from pipeline.schema import FITS, OPERATION, PARAMETERS
from pipeline.store import read_rows

Array = NDArray[np.float64]

FIT_COLUMNS = (
    "motor_id",
    "night",
    "is_primary",
    "status",
    "reason",
    "flushing_mode",
    "columns",
    "coefficients",
    "coefficient_covariance",
    "night_factor",
    "n_kept",
    "interval_status",
    "reference_leakage_l_per_min",
    "reference_leakage_lower",
    "reference_leakage_upper",
    "reference_verdict",
    "reference_reason",
    "outside_fitted_range",
    "reference_pressure_bar",
    "reference_temperature_c",
    "reference_speed_rpm",
    "own_pressure_bar",
    "own_temperature_c",
    "own_speed_rpm",
    "validation_fit_percent",
    "oil",
    "model_hash",
    "mean_charge_over_case_bar",
)
PARAMETER_COLUMNS = (
    "motor_id",
    "night",
    "flushing_mode",
    "parameter",
    "value",
    "lower",
    "upper",
    "verdict",
    "reason",
)
OPERATION_COLUMNS = tuple(name for name in OPERATION.schema if name not in ("run_id", "oil"))


@dataclass(frozen=True, slots=True)
class Estimates:
    """A parameter over a motor's nights; shape (n,) each.

    Attributes
    ----------
    value
        nan where there is none.
    lower, upper
        95 % interval; nan where there is none.
    verdict, reason
        Of each night; empty where there is none.
    """

    value: Array
    lower: Array
    upper: Array
    verdict: tuple[str, ...]
    reason: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class History:
    """A motor's nights in order, as the tables have them.

    Attributes
    ----------
    motor_id
        The motor.
    nights
        Labels of all nights that have a row, increasing.
    fits
        Primary fits, one row a night.
    parameters
        Parameters of the primary fits by name.
    operation
        One row a night; null where the night had no samples.
    """

    motor_id: str
    nights: tuple[dt.date, ...]
    fits: pl.DataFrame
    parameters: Mapping[str, Estimates]
    operation: pl.DataFrame

    def column(self, name: str) -> Array:
        """A figure of the fits over the nights, nan where there is none; shape (n,)."""
        values: Array = self.fits[name].cast(pl.Float64).fill_null(np.nan).to_numpy()
        return values

    def operated(self, name: str) -> Array:
        """A figure of `operation` over the nights, nan where there is none; shape (n,)."""
        values: Array = self.operation[name].cast(pl.Float64).fill_null(np.nan).to_numpy()
        return values

    def words(self, name: str) -> list[str]:
        """A text of the fits over the nights, empty where there is none."""
        return self.fits[name].fill_null("").to_list()


def read_histories(
    output: Path, motor_ids: Sequence[str], tonight: dt.date | None = None
) -> dict[str, History]:
    """The published nights of some motors.

    Parameters
    ----------
    output
        Output folder.
    motor_ids
        Which motors; one without rows is left out.
    tonight
        Nights up to this one are part of the history though they have no row yet, so that a motor
        that went silent can be stale.

    Returns
    -------
    dict of str to History

    Raises
    ------
    StoreError
        If a table file is damaged.
    """
    fits = read_rows(output, FITS, motor_ids, FIT_COLUMNS).filter("is_primary")
    parameters = read_rows(output, PARAMETERS, motor_ids, PARAMETER_COLUMNS)
    operation = read_rows(output, OPERATION, motor_ids, OPERATION_COLUMNS)
    by_motor = fits.sort("night").partition_by("motor_id", as_dict=True)
    histories = {}
    for (motor_id,), found in sorted(by_motor.items()):
        own = _continued(found, tonight)
        nights = own.select("night", "flushing_mode")
        ran = nights.join(
            operation.filter(pl.col("motor_id") == motor_id),
            on="night",
            how="left",
            maintain_order="left",
        )
        estimated = parameters.filter(pl.col("motor_id") == motor_id).join(
            nights, on=["night", "flushing_mode"], how="semi"
        )
        labels = tuple(own["night"].to_list())
        histories[str(motor_id)] = History(
            str(motor_id), labels, own, _estimates(estimated, nights), ran
        )
    return histories


def _continued(fits: pl.DataFrame, tonight: dt.date | None) -> pl.DataFrame:
    """A motor's nights with those up to tonight that have no row."""
    last = fits["night"][-1]
    missing = [] if tonight is None or tonight <= last else nights_between(last, tonight)[1:]
    if not missing:
        return fits
    reason = "no log covers this night"
    rows = [{"night": night, "status": "no_new_data", "reason": reason} for night in missing]
    return pl.concat([fits, pl.DataFrame(rows, schema=dict(fits.schema), orient="row")])


def _estimates(parameters: pl.DataFrame, nights: pl.DataFrame) -> dict[str, Estimates]:
    result = {}
    for (name,), rows in sorted(parameters.partition_by("parameter", as_dict=True).items()):
        aligned = nights.select("night").join(rows, on="night", how="left", maintain_order="left")
        value, lower, upper = (
            aligned[column].fill_null(np.nan).to_numpy() for column in ("value", "lower", "upper")
        )
        verdict, reason = (
            tuple(aligned[column].fill_null("").to_list()) for column in ("verdict", "reason")
        )
        result[str(name)] = Estimates(value, lower, upper, verdict, reason)
    return result
