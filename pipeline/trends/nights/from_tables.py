"""Records of nights from the rows of `fits`, `parameters`, `operation` and `block_statistics`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import polars as pl
from numpy.typing import NDArray

from leakage.course.night_filter import night_information
from leakage.estimation.block_statistics import merge
from leakage.estimation.identifiability import OUTSIDE as OUTSIDE_THE_SAMPLES
from leakage.estimation.identifiability import TOLD
from leakage.estimation.model_verdict import MISFIT_NUMBERS
from pipeline.config import MotorSpec
from pipeline.night.rows import upper_triangle
from pipeline.schema.fits import OK
from pipeline.trends.nights.history import History
from pipeline.trends.nights.records import (
    BINS,
    HISTOGRAMS,
    OPERATED,
    SINGLE,
    Layout,
    NightWords,
    Records,
    blank_records,
    triangle,
    whole_matrix,
)

Array = NDArray[np.float64]

# A night alone tells a leakage where its statistical half-width is no wider; else the filter does.
WIDEST_ALONE = 0.02
REFERENCE = "reference_leakage_l_per_min", "reference_leakage_lower", "reference_leakage_upper"
REFERENCE_CONDITIONS = "reference_pressure_bar", "reference_temperature_c", "reference_speed_rpm"
OWN = "own_pressure_bar", "own_temperature_c", "own_speed_rpm"
KEY = ("motor_id", "night")
FITTED = ("is_primary", "status", "reason", "flushing_mode", "interval_status", "model_hash")
STATISTICS = ("columns", "coefficients", "coefficient_covariance", "coefficient_response")
VERDICTS = ("reference_verdict", "reference_reason", "model_misfit_statistics")
AT_REFERENCE = (*REFERENCE, *REFERENCE_CONDITIONS, *OWN, *SINGLE.values())
FIT_COLUMNS = (*KEY, *FITTED, *STATISTICS, "night_factor", *VERDICTS, *AT_REFERENCE)
FIGURE = ("parameter", "value", "lower", "upper", "verdict", "reason")
PARAMETER_COLUMNS = (*KEY, "flushing_mode", *FIGURE)
OPERATION_COLUMNS = (*KEY, "kept_hours", *OPERATED, *HISTOGRAMS)
# Value, ends, verdict and reason of a coefficient that a night has not.
NOTHING_SAID = (None,) * 5


def rows_by_night(
    specs: Sequence[MotorSpec],
    layouts: Mapping[str, Layout],
    fits: pl.DataFrame,
    parameters: pl.DataFrame,
    operation: pl.DataFrame,
) -> dict[str, History]:
    """Histories of some motors from rows of `fits`, `parameters` and `operation`, by motor.

    They have no nights without a row. The layouts are by motor.
    """
    by_motor = [
        {str(key[0]): part for key, part in rows.partition_by("motor_id", as_dict=True).items()}
        for rows in (fits.filter("is_primary").sort("night"), parameters, operation)
    ]
    found = {}
    for spec in specs:
        own = by_motor[0].get(spec.motor_id)
        if own is None:
            continue
        layout = layouts[spec.motor_id]
        records, words = records_of(
            spec,
            layout,
            own,
            by_motor[1].get(spec.motor_id, parameters.clear()),
            by_motor[2].get(spec.motor_id, operation.clear()),
        )
        found[spec.motor_id] = History(spec, layout, records, dict(enumerate(words)))
    return found


def records_of(
    spec: MotorSpec,
    layout: Layout,
    fits: pl.DataFrame,
    parameters: pl.DataFrame,
    operation: pl.DataFrame,
) -> tuple[Records, list[NightWords]]:
    """Records of a motor's nights, from their rows."""
    records = blank_records(layout, fits["night"].to_list())
    has_intervals = fits["interval_status"].str.starts_with(OK).fill_null(False)
    records["fitted"] = (fits["status"] == OK) & has_intervals
    records["mode"] = _texts(fits, "flushing_mode")
    records["model"] = _texts(fits, "model_hash")
    for name, column in SINGLE.items():
        records[name] = _numbers(fits, column)
    for place, column in enumerate(OWN):
        records["own"][:, place] = _numbers(fits, column)
    records["misfit"] = _vectors(fits, "model_misfit_statistics", MISFIT_NUMBERS)
    expected = list(layout.columns)
    same = np.array([columns == expected for columns in fits["columns"].to_list()], dtype=np.bool_)
    for name, column, size in (
        ("theta", "coefficients", len(layout.columns) - 2),
        ("covariance", "coefficient_covariance", triangle(len(layout.columns) - 2)),
        ("response", "coefficient_response", len(layout.columns) - 2),
        ("factor", "night_factor", triangle(len(layout.columns))),
    ):
        records[name] = np.where(same[:, None], _vectors(fits, column, size), np.nan)
    # Nights of before have none.
    records["response"] = np.nan_to_num(records["response"])
    _fill_noise(layout, records)
    _fill_operation(records, fits, operation)
    statuses = _status_words(fits)
    reference = _fill_reference(spec, records, fits)
    coefficients = _fill_figures(layout, records, fits, parameters)
    words = [
        NightWords(status, status or why, tuple(status or one for one in each))
        for status, why, each in zip(statuses, reference, coefficients, strict=True)
    ]
    return records, words


# Column by column, as an expression of Polars takes longer for the one row of tonight.


def _numbers(rows: pl.DataFrame, column: str) -> Array:
    """A column, nan where it is null."""
    return np.asarray(rows[column].to_numpy(), dtype=np.float64)


def _texts(rows: pl.DataFrame, column: str) -> list[str]:
    """A column, empty where it is null."""
    return [text or "" for text in rows[column].to_list()]


def _vectors(rows: pl.DataFrame, column: str, size: int) -> Array:
    """A column of lists as an array, nan where a list is absent or of another length."""
    lists = rows[column].to_arrow()
    result = np.full((len(lists), size), np.nan)
    offsets = lists.offsets.to_numpy()
    whole = np.diff(offsets) == size
    whole &= np.asarray(lists.is_valid())
    if whole.any():
        values = lists.values.to_numpy(zero_copy_only=False)
        result[whole] = values[offsets[:-1][whole, None] + np.arange(size)]
    return result


def _fill_noise(layout: Layout, records: Records) -> None:
    """Errors of fitted nights from their covariance: V = S⁻¹MS⁻¹, λ_j = M_jj / S_jj."""
    size, free = len(layout.free), np.array(layout.free)
    columns = whole_matrix(records["factor"], size + 2)[:, :, :-2]
    gram = np.einsum("nij,nik->njk", columns, columns)
    upper = whole_matrix(records["covariance"], size)
    covariance = upper + np.swapaxes(np.triu(upper, 1), 1, 2)
    meat = np.einsum("nij,njk,nki->ni", gram, covariance, gram)
    # A coefficient at its bound has no variance, and its night tells no error.
    known = records["fitted"] & (np.einsum("nii->ni", covariance)[:, free] > 0.0).all(axis=1)
    records["noise"][known] = (meat / np.einsum("nii->ni", gram))[known]
    records["freedom"][known] = 1.0


def _fill_operation(records: Records, fits: pl.DataFrame, operation: pl.DataFrame) -> None:
    rows = fits.select("night").join(operation, on="night", how="left", maintain_order="left")
    for name in ("kept_hours", *OPERATED):
        records[name] = _numbers(rows, name)
    for name, bins in zip(HISTOGRAMS, BINS, strict=True):
        records[name] = np.nan_to_num(_vectors(rows, name, bins))


def _status_words(fits: pl.DataFrame) -> list[str]:
    """Reason why a night has no usable fit, by night; empty where it has one."""
    words = []
    columns = (fits[name].to_list() for name in ("status", "reason", "interval_status"))
    for status, reason, interval in zip(*columns, strict=True):
        if status == OK:
            words.append("" if interval == OK else interval or "no intervals")
        else:
            words.append(": ".join(one for one in (status.replace("_", " "), reason) if one))
    return words


def _fill_reference(spec: MotorSpec, records: Records, fits: pl.DataFrame) -> list[str]:
    """Leakage at the reference conditions, where it can be trusted; otherwise why not."""
    asked = spec.settings.reference
    now = (asked.pressure_bar, asked.temperature_c, asked.speed_rpm)
    before = np.column_stack([_numbers(fits, name) for name in REFERENCE_CONDITIONS])
    elsewhere = np.isfinite(before).all(axis=1) & (before != now).any(axis=1)
    verdicts, reasons = _texts(fits, "reference_verdict"), _texts(fits, "reference_reason")
    records["outside"] = [verdict in OUTSIDE_THE_SAMPLES for verdict in verdicts]
    for place, column in enumerate(REFERENCE):
        records["reference"][:, place] = _numbers(fits, column)
    value, low, high = records["reference"].T
    words = []
    for verdict, reason, other, half in zip(
        verdicts, reasons, elsewhere.tolist(), ((high - low) / (2 * value)).tolist(), strict=True
    ):
        if other:
            words.append("fitted for other reference conditions, and its statistics are not there")
        elif half > WIDEST_ALONE:
            words.append(too_wide(half))
        else:
            words.append(_gate(verdict, reason))
    trusted = records["fitted"] & np.array([not one for one in words], dtype=np.bool_)
    records["reference"][~trusted] = np.nan
    return words


def too_wide(half: float) -> str:
    """Words for a leakage that a night alone does not tell well enough, by its relative ±."""
    return f"known to ± {100 * half:.1f} % only; {100 * WIDEST_ALONE:.0f} % are needed"


def _fill_figures(
    layout: Layout, records: Records, fits: pl.DataFrame, parameters: pl.DataFrame
) -> list[tuple[str, ...]]:
    """Each coefficient where it is identified; otherwise why not."""
    said = {
        (night, mode, name): tuple(rest)
        for night, mode, name, *rest in parameters.select(PARAMETER_COLUMNS[1:]).iter_rows()
        if mode is not None
    }
    columns = []
    for place, name in enumerate(layout.coefficients):
        found = [
            said.get((night, mode, name), NOTHING_SAID)
            for night, mode in fits.select("night", "flushing_mode").iter_rows()
        ]
        values = np.array([one[:3] for one in found], dtype=np.float64)
        records["figures"][:, place] = values.reshape(-1, 3)
        verdicts, reasons = ([one[end] or "" for one in found] for end in (3, 4))
        # Nothing was estimated where a coefficient is held fixed.
        words = [
            _gate("" if verdict == "fixed" else verdict, reason)
            for verdict, reason in zip(verdicts, reasons, strict=True)
        ]
        trusted = records["fitted"] & np.array([not one for one in words], dtype=np.bool_)
        records["figures"][~trusted, place] = np.nan
        columns.append(words)
    return list(zip(*columns, strict=True)) if columns else [()] * fits.height


def _gate(verdict: str, reason: str) -> str:
    """Reason why a figure does not count, from its verdict; empty if it counts."""
    if verdict in TOLD:
        return ""
    return reason or verdict.replace("_", " ") or "no figure"


def add_blocks(spec: MotorSpec, layout: Layout, records: Records, blocks: pl.DataFrame) -> None:
    """Put what the blocks of nights without a fit tell into their records."""
    free = np.array(layout.free)
    for (label,), rows in blocks.partition_by("night", as_dict=True).items():
        record = records[int(np.searchsorted(records["night"], np.datetime64(label)))]
        hashes = set(rows["model_hash"].to_list())
        stored = layout.blocks(spec, rows)
        if len(hashes) != 1 or stored is None:
            continue
        record["model"], record["own"] = hashes.pop(), stored.means()
        record["factor"] = upper_triangle(merge(stored.factors))
        if stored.viscosity_ratio is not None:
            record["viscosity"] = stored.viscosity_ratio
        told = night_information(stored.factors, np.array(layout.configured), free)
        record["noise"][free], record["freedom"][free] = told.noise, told.freedom
