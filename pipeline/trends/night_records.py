"""Records of a motor's nights for the trends: numbers only, of fixed size.

Trends read all nights of a motor every night. Words and the other columns of the tables are needed
only for the nights that are published.
"""

from __future__ import annotations

import datetime as dt
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from leakage.estimation.block_statistics import with_free_known
from leakage.estimation.identifiability import OUTSIDE as OUTSIDE_THE_SAMPLES
from leakage.estimation.identifiability import TOLD
from leakage.estimation.model_verdict import MISFIT_NUMBERS
from leakage.estimation.multi_start import Parametrisation
from pipeline.config import MotorSpec
from pipeline.night.stored_blocks import StoredBlocks
from pipeline.schema.fits import OK

Array = NDArray[np.float64]
# A structured array, one record a night.
Records = NDArray[Any]

FLUSHING = "C_f"
# A night alone tells a leakage where its statistical half-width is no wider; else the filter does.
WIDEST_ALONE = 0.02
# Duty of a night: that of its baseline, another one that the baseline has seen, or outside of it.
AS_BASELINE, BALANCED, OUTSIDE = 0, 1, 2
HISTOGRAMS = ("pressure_histogram", "temperature_histogram", "speed_histogram")
BINS = (20, 28, 15)
OPERATED = (
    "running_hours",
    "mean_temperature_c",
    "share_reversed",
    "pressure_zero_bar",
    "pressure_zero_standard_error_bar",
    "flow_zero_l_per_min",
    "flow_zero_standard_error_l_per_min",
)
REFERENCE = "reference_leakage_l_per_min", "reference_leakage_lower", "reference_leakage_upper"
REFERENCE_CONDITIONS = "reference_pressure_bar", "reference_temperature_c", "reference_speed_rpm"
OWN = "own_pressure_bar", "own_temperature_c", "own_speed_rpm"
SINGLE = {
    "charge": "mean_charge_over_case_bar",
    "blocks": "n_interval_blocks",
    "viscosity": "viscosity_ratio",
}
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
    "coefficient_response",
    "night_factor",
    "interval_status",
    "reference_verdict",
    "reference_reason",
    "model_hash",
    "model_misfit_statistics",
    *REFERENCE,
    *REFERENCE_CONDITIONS,
    *OWN,
    *SINGLE.values(),
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
OPERATION_COLUMNS = ("motor_id", "night", "kept_hours", *OPERATED, *HISTOGRAMS)
# Value, ends, verdict and reason of a coefficient that a night has not.
NOTHING_SAID = (None,) * 5
# Words stand in for those of a night that is not published anew, which nobody sees.
GATED = "gated"


@dataclass(frozen=True, slots=True)
class Layout:
    """Coefficients of a motor's nights.

    Attributes
    ----------
    paths
        Paths with a free coefficient, in the order of the statistics' columns.
    coefficients
        Names of those coefficients, and of the flushing where it is estimated.
    columns
        Columns of the statistics.
    configured
        θ as configured.
    free
        True for each coefficient of θ that is estimated.
    standard
        Place of the cam rollers among the paths where their scale is estimated, and how much of
        the known flow it is as stated; None otherwise.
    """

    paths: tuple[str, ...]
    coefficients: tuple[str, ...]
    columns: tuple[str, ...]
    configured: tuple[float, ...]
    free: tuple[bool, ...]
    standard: tuple[int, float] | None = None

    @classmethod
    def of(cls, spec: MotorSpec, night: dt.date) -> Layout:
        """The layout of a motor; which night does not matter."""
        motor = spec.motor(night, spec.file.flushing.mode)
        names = tuple(path.coefficient_name for path in motor.column_paths)
        flushing = (FLUSHING,) if spec.file.flushing.mode == "estimated" else ()
        parameters = Parametrisation.of(motor)
        lower, upper = parameters.coefficient_bounds()
        stated = spec.stated.motor(night, spec.file.flushing.mode).standard
        names_of_paths = tuple(path.name for path in motor.column_paths)
        standard = None
        if stated is not None and stated.name in names_of_paths:
            standard = names_of_paths.index(stated.name), stated.configured_coefficient
        return cls(
            names_of_paths,
            names + flushing,
            tuple(motor.columns),
            tuple(path.configured_coefficient if path else 0.0 for path in parameters.paths),
            tuple((lower < upper).tolist()),
            standard,
        )

    @property
    def stated_columns(self) -> tuple[str, ...]:
        """Columns of the statistics as stored, the cam rollers in the known flow."""
        rollers = None if self.standard is None else self.standard[0]
        return tuple(name for place, name in enumerate(self.columns) if place != rollers)

    def blocks(self, spec: MotorSpec, rows: pl.DataFrame) -> StoredBlocks | None:
        """Blocks of a night's rows, in their columns; None where they are of another model."""
        stored = StoredBlocks.of(spec, rows.sort("block_start"), self.stated_columns)
        if stored is None or self.standard is None:
            return stored
        return replace(stored, factors=with_free_known(stored.factors, *self.standard))

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of a record."""
        n, theta = len(self.coefficients), len(self.columns) - 2
        return np.dtype(
            [
                ("night", "M8[D]"),
                ("fitted", "?"),
                ("outside", "?"),
                ("mode", "S9"),
                ("model", "S16"),
                ("kept_hours", "f8"),
                ("reference", "f8", 3),
                ("figures", "f8", (n, 3)),
                ("theta", "f8", theta),
                ("covariance", "f8", triangle(theta)),
                # What a change of b does to θ, as the night's blocks differ in temperature.
                ("response", "f8", theta),
                ("factor", "f8", triangle(len(self.columns))),
                ("own", "f8", 3),
                # What the blocks say of the model, as `Misfit.numbers`.
                ("misfit", "f8", MISFIT_NUMBERS),
                # τ and what noise explains, of ten nights over their mean leakage.
                ("misfit_of_ten", "f8", 2),
                *((name, "f8") for name in SINGLE),
                *((name, "f8") for name in OPERATED),
                *((name, "u4", bins) for name, bins in zip(HISTOGRAMS, BINS, strict=True)),
                # Errors as the blocks see them, from which the filter has λ.
                ("noise", "f8", theta),
                ("freedom", "f8", theta),
                # Against the baseline at the night's own duty: `AS_BASELINE` and so on, θ of both
                # with the covariance of the baseline's, ln of the flow over what it says, and the
                # share of the baseline's blocks behind it.
                ("duty", "i1"),
                ("duty_then", "f8", theta),
                ("duty_now", "f8", theta),
                ("duty_error", "f8", triangle(theta)),
                ("duty_flow", "f8"),
                ("duty_share", "f8"),
                *self.filtered,
            ]
        )

    @property
    def filtered(self) -> tuple[tuple[Any, ...], ...]:
        """Fields that the filter fills, of a night and those before it."""
        theta = len(self.columns) - 2
        return (
            ("informed", "?"),
            ("opened", "?"),
            # Informed nights so far.
            ("followed", "i4"),
            ("mean", "f8", theta),
            ("spread", "f8", triangle(theta)),
            ("scale", "f8", theta),
            ("noise_sum", "f8", theta),
            ("freedom_sum", "f8", theta),
        )

    @property
    def digest(self) -> str:
        """Hash of what a record means."""
        text = "|".join((str(self.dtype.descr), *self.coefficients, *self.columns))
        return hashlib.sha256(text.encode()).hexdigest()[:16]


@dataclass(frozen=True, slots=True)
class NightWords:
    """Reasons why figures of a night do not count; empty where they do.

    Attributes
    ----------
    status
        For all figures.
    reference
        For the leakage at the reference conditions.
    coefficients
        For each coefficient of the layout.
    """

    status: str
    reference: str
    coefficients: tuple[str, ...]


def triangle(size: int) -> int:
    """Numbers of an upper triangle.

    Examples
    --------
    >>> triangle(6)
    21
    """
    return size * (size + 1) // 2


def whole_matrix(upper: Array, size: int) -> Array:
    """Upper triangular matrices from their triangles row by row, shape (…, size, size)."""
    matrix = np.zeros((*upper.shape[:-1], size, size))
    matrix[(..., *_places(size))] = upper
    return matrix


@lru_cache(maxsize=16)
def _places(size: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    first, second = np.triu_indices(size)
    return first, second


def blank_records(layout: Layout, nights: Sequence[dt.date]) -> Records:
    """Records of nights of which nothing is known."""
    records = np.zeros(len(nights), dtype=layout.dtype)
    for name, (kind, *_) in (layout.dtype.fields or {}).items():
        if kind.base == np.float64:
            records[name] = np.nan
    records["night"] = np.array(nights, dtype="M8[D]")
    return records


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
        for night, mode, name, *rest in parameters.select(
            "night", "flushing_mode", "parameter", "value", "lower", "upper", "verdict", "reason"
        ).iter_rows()
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
