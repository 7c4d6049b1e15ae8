"""The course of a motor's gaps over the nights, on Matplotlib axes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import matplotlib.pyplot as plt
import polars as pl

from pipeline.errors import UsageError
from pipeline.notebook.results import Tables
from pipeline.palette import COLOURS, path_places

if TYPE_CHECKING:
    from matplotlib.axes import Axes

GAP_CHANGE = "gap_change_"


def plot_course(tables: Tables, motor_id: str, ax: Axes | None = None) -> Axes:
    """Change of each gap of a motor over the nights, with 95 % intervals and the lowest limits.

    Raises
    ------
    UsageError
        ``unknown_motor``: the trends have no gap of it.
    """
    rows = (
        tables.table("trends")
        .filter(
            pl.col("motor_id") == motor_id,
            pl.col("indicator").str.starts_with(GAP_CHANGE),
            pl.col("value").is_not_null(),
        )
        .sort("night")
        .collect()
    )
    if not rows.height:
        raise UsageError("unknown_motor", f"no trend of a gap of {motor_id}; run fit-fleet")
    axes = ax or plt.subplots(figsize=(9, 4))[1]
    names = pl.col("indicator").str.strip_prefix(GAP_CHANGE)
    courses = rows.with_columns(path=names).partition_by("path", as_dict=True, maintain_order=True)
    places = path_places(str(name) for (name,) in courses)
    for (name,), part in courses.items():
        colour = COLOURS[places[str(name)] % len(COLOURS)]
        label = str(name).replace("_", " ")
        axes.plot(part["night"], part["value"], lw=1.3, color=colour, label=label)
        known = part.drop_nulls(("lower", "upper"))
        axes.fill_between(
            known["night"], known["lower"], known["upper"], color=colour, alpha=0.15, lw=0
        )
    for column, style in (("warning_limit", ":"), ("alarm_limit", "--")):
        limit = rows[column].min()
        if isinstance(limit, float):
            axes.axhline(limit, color="0.4", ls=style, lw=1, label=column.replace("_", " "))
    unit = rows["unit"][0]
    axes.set(xlabel="night", ylabel=f"change of gap [{unit}]", title=motor_id)
    axes.legend(fontsize="small")
    return axes
