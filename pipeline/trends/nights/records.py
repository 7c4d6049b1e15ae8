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
from leakage.estimation.model_verdict import MISFIT_NUMBERS
from leakage.estimation.multi_start import Parametrisation
from pipeline.config import MotorSpec
from pipeline.night.stored_blocks import StoredBlocks

Array = NDArray[np.float64]
# A structured array, one record a night.
Records = NDArray[Any]

FLUSHING = "C_f"
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
SINGLE = {
    "charge": "mean_charge_over_case_bar",
    "blocks": "n_interval_blocks",
    "viscosity": "viscosity_ratio",
}
# Words stand in for those of a night that is not published anew, which nobody sees.
GATED = "gated"


@dataclass(frozen=True, slots=True)
class Layout:
    """Coefficients of a motor's nights."""

    paths: tuple[str, ...]  # those with a free coefficient, in the order of the columns
    coefficients: tuple[str, ...]  # their names, and that of the flushing where it is estimated
    columns: tuple[str, ...]  # of the statistics
    configured: tuple[float, ...]  # θ
    free: tuple[bool, ...]  # whether each of θ is estimated
    # Place of the cam rollers among the paths where their scale is estimated, and how much of the
    # known flow it is as stated; None otherwise.
    standard: tuple[int, float] | None = None

    @classmethod
    def of(cls, spec: MotorSpec, night: dt.date) -> Layout:
        """The layout of a motor; which night does not matter."""
        motor = spec.motor(night, spec.file.flushing.mode)
        coefficients = tuple(path.coefficient_name for path in motor.column_paths)
        flushing = (FLUSHING,) if spec.file.flushing.mode == "estimated" else ()
        parameters = Parametrisation.of(motor)
        lower, upper = parameters.coefficient_bounds()
        names = tuple(path.name for path in motor.column_paths)
        standard = None
        if spec.roller_is_free:
            stated = spec.stated.motor(night, spec.file.flushing.mode).standard
            if stated is not None:
                standard = names.index(stated.name), stated.configured_coefficient
        return cls(
            names,
            coefficients + flushing,
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


# Motors of a type share these.
@lru_cache(maxsize=64)
def record_type(layout: Layout) -> np.dtype[Any]:
    """Type of a record."""
    n, theta = len(layout.coefficients), len(layout.columns) - 2
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
            # U of the covariance U'U of θ.
            ("root", "f8", triangle(theta)),
            # What a change of b does to θ, as the night's blocks differ in temperature.
            ("response", "f8", theta),
            ("factor", "f8", triangle(len(layout.columns))),
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
            # with U of the covariance of the baseline's, ln of the flow over what it says, and the
            # share of the baseline's blocks behind it.
            ("duty", "i1"),
            ("duty_then", "f8", theta),
            ("duty_now", "f8", theta),
            ("duty_root", "f8", triangle(theta)),
            ("duty_flow", "f8"),
            ("duty_share", "f8"),
            *layout.filtered,
        ]
    )


@lru_cache(maxsize=64)
def record_digest(layout: Layout) -> str:
    """Hash of what a record means."""
    text = "|".join((str(record_type(layout).descr), *layout.coefficients, *layout.columns))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


@dataclass(frozen=True, slots=True)
class NightWords:
    """Why a night, its reference leakage or a coefficient does not count; empty where it does."""

    status: str
    reference: str
    coefficients: tuple[str, ...]


def triangle(size: int) -> int:
    """Numbers of an upper triangle."""
    return size * (size + 1) // 2


def whole_matrix(upper: Array, size: int) -> Array:
    """Upper triangular matrices from their triangles row by row, shape (…, size, size)."""
    matrix = np.zeros((*upper.shape[:-1], size, size))
    matrix[(..., *triangle_places(size))] = upper
    return matrix


def symmetric_matrix(upper: Array, size: int) -> Array:
    """The same of symmetric matrices: the triangle has each pair once."""
    matrix = whole_matrix(upper, size)
    return matrix + np.triu(matrix, 1).swapaxes(-1, -2)


@lru_cache(maxsize=16)
def triangle_places(size: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns of the numbers of an upper triangle."""
    first, second = np.triu_indices(size)
    return first, second


def blank_records(layout: Layout, nights: Sequence[dt.date]) -> Records:
    """Records of nights of which nothing is known."""
    records = np.repeat(_blank_record(layout), len(nights))
    records["night"] = np.array(nights, dtype="M8[D]")
    return records


@lru_cache(maxsize=64)
def _blank_record(layout: Layout) -> Records:
    record = np.zeros(1, dtype=record_type(layout))
    for name, (kind, *_) in (record.dtype.fields or {}).items():
        if kind.base == np.float64:
            record[name] = np.nan
    return record
