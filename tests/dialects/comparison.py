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
    """Those that hold one value a row; lists are what these follow from."""
    left_out = OF_THE_RUN.union(table.key)
    return [
        name
        for name, kind in table.schema.items()
        if name not in left_out and not isinstance(kind, pl.List)
    ]


def _is_float(table: Table, name: str) -> bool:
    return table.schema[name] == pl.Float64


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


def _array(values: pl.Series) -> Array:
    return values.cast(pl.Float64).to_numpy().astype(np.float64)


def _apart(a: Array, b: Array, scale: Array | None = None) -> Array:
    same = (a == b) | (np.isnan(a) & np.isnan(b))
    scale = np.maximum(np.abs(a), np.abs(b)) if scale is None else scale
    with np.errstate(invalid="ignore", divide="ignore"):
        apart = np.where(same, 0.0, np.abs(a - b) / scale)
    return np.where(np.isnan(apart), np.inf, apart)
