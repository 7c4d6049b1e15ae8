"""Differences between the tables of two runs over the same nights."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from pipeline.schema import FIT_KEY_NAMES, FITS, PARAMETERS, QUALITY, SENSITIVITIES, Table

Array = NDArray[np.float64]

TABLES = (FITS, PARAMETERS, SENSITIVITIES, QUALITY)
OF_THE_RUN = frozenset({"run_id", "model_hash"})
"""They hash the config too, which says how the logs are written."""
ABSOLUTE = frozenset({"dual_residual"})
"""Relative figures themselves, and nothing but rounding."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """Differences between two runs."""

    largest: Mapping[str, float]  # largest relative difference by table
    where: Mapping[str, str]  # column and row of that difference
    # Number by table of differing cells that hold no floating-point number.
    others: Mapping[str, int]
    rows: Mapping[str, int]  # number by table of rows that only one of the two runs has
    # n_read, n_failed: numbers of log files that the other run read, and that it could not read.
    n_read: int
    n_failed: int


def compare(original: Path, other: Path, motors: tuple[str, ...] = ()) -> Comparison:
    """Compare the tables of two outputs, of some motors or of all.

    Differences are relative to the larger of two figures; of a systematic effect to the largest on
    the same indicator.
    """
    largest, where, others, rows = {}, {}, {}, {}
    for table in TABLES:
        pairs, rows[table.name] = _paired(table, original, other, motors)
        columns = _columns(table)
        found = {name: _relative(table, pairs, name) for name in columns if _is_float(table, name)}
        worst = max(found, key=lambda name: found[name].max(initial=0.0), default="")
        if worst and pairs.height:
            row = int(np.argmax(found[worst]))
            largest[table.name] = float(found[worst][row])
            key = " ".join(str(pairs[name][row]) for name in table.key)
            where[table.name] = f"{worst} of {key}"
        others[table.name] = sum(
            int(pairs[name].ne_missing(pairs[f"{name}_other"]).sum())
            for name in columns
            if name not in found
        )
    files = read_table(other, "input_files")
    failed = files.filter(pl.col("status") != "ok").height
    return Comparison(largest, where, others, rows, files.height - failed, failed)


def read_table(output: Path, name: str) -> pl.DataFrame:
    """All nights of a table."""
    files = sorted((output / "tables" / name).glob("*/*.parquet"))
    return pl.concat([pl.read_parquet(path) for path in files])


def _columns(table: Table) -> list[str]:
    left_out = OF_THE_RUN.union(table.key)
    return [name for name in table.schema if name not in left_out]


def _is_float(table: Table, name: str) -> bool:
    return table.schema[name] in (pl.Float64, pl.List(pl.Float64))


def _paired(
    table: Table, original: Path, other: Path, motors: tuple[str, ...]
) -> tuple[pl.DataFrame, int]:
    """Rows that both have, side by side, and how many only one has."""
    one, two = (
        rows.filter(pl.col("motor_id").is_in(motors)) if motors else rows
        for rows in (read_table(original, table.name), read_table(other, table.name))
    )
    pairs = one.join(two, on=list(table.key), suffix="_other", nulls_equal=True)
    return pairs, one.height + two.height - 2 * pairs.height


def _relative(table: Table, pairs: pl.DataFrame, name: str) -> Array:
    """Difference of each row; infinite where one is null or nan and the other is not."""
    one, two = pairs[name], pairs[f"{name}_other"]
    if table.schema[name] == pl.List(pl.Float64):
        scale = LISTS.get(name)
        cells = [
            _apart(x, y, scale(x) if scale and x.size else None)
            for x, y in ((_array(a), _array(b)) for a, b in zip(one, two, strict=True))
        ]
        return np.array([cell.max(initial=0.0) for cell in cells])
    a, b = _array(one), _array(two)
    return _apart(a, b, _scale(table, pairs, name, a, b))


def _scale(table: Table, pairs: pl.DataFrame, name: str, a: Array, b: Array) -> Array | None:
    if table is FITS and name in ABSOLUTE:
        return np.ones(a.size)
    if table is FITS and name == "within_block_inflation":
        return 10.0 * np.abs(a)  # rests on directions that a motor at one pressure hardly excites
    if table is FITS and "mean_error" in name:
        return _array(pairs["mean_flow_l_per_min"])
    if table is SENSITIVITIES and name == "effect":
        figure = pl.col("effect").abs().max().over([*FIT_KEY_NAMES, "indicator"])
        return _array(pairs.select(figure).to_series())
    return None


def _column_norms(upper: Array) -> Array:
    """Norm of the column of each element of a triangular factor."""
    matrix, places = _matrix(upper)
    norms: Array = np.linalg.norm(matrix, axis=0)[places[1]]
    return norms


def _deviations(upper: Array) -> Array:
    """Product of the standard deviations that each element of a covariance belongs to."""
    matrix, places = _matrix(upper)
    deviation = np.sqrt(np.diag(matrix))
    return np.maximum(deviation[places[0]] * deviation[places[1]], np.finfo(np.float64).tiny)


def _matrix(upper: Array) -> tuple[Array, tuple[NDArray[np.intp], NDArray[np.intp]]]:
    size = (np.sqrt(8 * upper.size + 1) - 1) / 2
    places = np.triu_indices(round(size))
    matrix = np.zeros((round(size),) * 2)
    matrix[places] = upper
    return matrix, places


def _largest_of_paths(coefficients: Array) -> Array:
    """Largest of the loss factors for each: what is not identified is only known beside it."""
    scale = np.full(coefficients.size, np.abs(coefficients[:-1]).max(initial=0.0))
    scale[-1:] = np.maximum(np.abs(coefficients[-1:]), 1e-3)
    return scale


def _largest_of_part(statistics: Array) -> Array:
    """Largest of its part for each: samples, flow, score of γ (k), three triangles over γ."""
    k = next(k for k in range(statistics.size) if 2 + k + 3 * k * (k + 1) // 2 == statistics.size)
    sizes = (1, 1, k, *[k * (k + 1) // 2] * 3)
    parts = np.split(np.abs(statistics), np.cumsum(sizes)[:-1])
    return np.concatenate([np.full(part.size, part.max(initial=0.0)) for part in parts])


LISTS = {
    "night_factor": _column_norms,
    "coefficient_covariance": _deviations,
    "coefficient_covariance_root": _column_norms,
    "coefficients": _largest_of_paths,
    "model_misfit_statistics": _largest_of_part,
}
"""Triangles of matrices: an element that nearly cancels is as exact as what it is made of."""


def _array(values: pl.Series | None) -> Array:
    if values is None:
        return np.empty(0)
    return values.cast(pl.Float64).to_numpy().astype(np.float64)


def _apart(a: Array, b: Array, scale: Array | None = None) -> Array:
    if a.size != b.size:
        return np.array([np.inf])
    same = (a == b) | (np.isnan(a) & np.isnan(b))
    scale = np.maximum(np.abs(a), np.abs(b)) if scale is None else scale
    with np.errstate(invalid="ignore", divide="ignore"):
        apart = np.where(same, 0.0, np.abs(a - b) / scale)
    return np.where(np.isnan(apart), np.inf, apart)
