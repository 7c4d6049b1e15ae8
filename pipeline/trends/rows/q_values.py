"""q-values of a night's slopes, over those of the whole fleet."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import polars as pl

from leakage.course.false_discoveries import benjamini_hochberg


def with_q_values(
    rows: pl.DataFrame, motor_ids: Sequence[str], false_discovery_rate: float
) -> pl.DataFrame:
    """A night's trends with q-values for some motors, each indicator's slopes a family.

    Those of other motors stay as they were published.
    """
    p_values = rows["p_value"].to_numpy()
    q_values = np.full(len(p_values), np.nan)
    known = np.flatnonzero(np.isfinite(p_values))
    _, family = np.unique(rows["indicator"].gather(known).to_list(), return_inverse=True)
    for one in range(family.max(initial=-1) + 1):
        places = known[family == one]
        q_values[places] = benjamini_hochberg(p_values[places])
    new = pl.col("motor_id").is_in(list(motor_ids))
    q_value = pl.Series(q_values, dtype=pl.Float64).fill_nan(None)
    return rows.with_columns(
        q_value=pl.when(new).then(q_value).otherwise(pl.col("q_value")),
        is_trend=pl.when(new).then(q_value < false_discovery_rate).otherwise(pl.col("is_trend")),
    )
