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
LEVELS = {"warning": "--", "alarm": ":"}


def plot_course(tables: Tables, motor_id: str, ax: Axes | None = None) -> Axes:
    """Change of each gap of a motor over the nights, with 95 % intervals and levels of its state.

    The levels of a loss factor K are drawn as those of its gap, K ∝ h³.

    Raises
    ------
    UsageError
        ``unknown_motor``: the trends have no row of it.
    """
    trends = tables.table("trends").filter(motor_id=motor_id).sort("night").collect()
    if not trends.height:
        raise UsageError("unknown_motor", f"no trend of {motor_id} in the tables; run fit-fleet")
    rows = trends.filter(pl.col("indicator").str.starts_with(GAP_CHANGE)).drop_nulls("value")
    axes = ax or plt.subplots(figsize=(9, 4), layout="constrained")[1]
    axes.set(xlabel="night", ylabel="change of gap [%]", title=motor_id)
    if not rows.height:
        note = "no change of a gap is known yet: there is no baseline"
        axes.text(0.5, 0.5, note, ha="center", transform=axes.transAxes)
        return axes
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
        levels = trends.filter(indicator=f"K_{name}").drop_nulls("baseline_mean")
        for level, dashes in LEVELS.items():
            share = levels[f"{level}_limit"] / levels["baseline_mean"]
            percent = 100.0 * (share.cbrt() - 1.0)
            axes.plot(levels["night"], percent, dashes, lw=1.0, color=colour)
    for level, dashes in LEVELS.items():
        axes.plot([], [], dashes, lw=1.0, color="black", label=f"level of {level}")
    axes.axhline(0.0, color="0.7", lw=0.8)
    axes.tick_params(axis="x", rotation=30)
    axes.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))
    return axes
