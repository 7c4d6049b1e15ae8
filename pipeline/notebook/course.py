"""The course of a motor's leakage over the nights, on Matplotlib axes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import matplotlib.pyplot as plt

from pipeline.errors import UsageError
from pipeline.notebook.results import Tables
from pipeline.palette import COLOURS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LEAKAGE = "own_leakage"


def plot_course(tables: Tables, motor_id: str, ax: Axes | None = None) -> Axes:
    """Leakage of a motor at its own conditions over the nights, with its 95 % interval.

    The nights of the baseline are shaded; a dotted line marks each night in which a change was
    told.

    Raises
    ------
    UsageError
        ``unknown_motor``: the watch has no row of it.
    """
    watch = tables.watch(motor_id).collect()
    if not watch.height:
        raise UsageError("unknown_motor", f"no night of {motor_id} in the tables; run fit-fleet")
    axes = ax or plt.subplots(figsize=(9, 4), layout="constrained")[1]
    axes.set(xlabel="night", ylabel="leakage [l/min]", title=motor_id)
    rows = watch.drop_nulls(f"{LEAKAGE}_l_per_min")
    if not rows.height:
        axes.text(0.5, 0.5, watch["sentence"][-1], ha="center", transform=axes.transAxes)
        return axes
    lower, upper = (rows[f"{LEAKAGE}_{end}"] for end in ("lower", "upper"))
    axes.fill_between(rows["night"], lower, upper, color=COLOURS[0], alpha=0.2, lw=0)
    value = rows[f"{LEAKAGE}_l_per_min"]
    axes.plot(rows["night"], value, lw=1.3, color=COLOURS[0], label="at its own conditions")
    eras = watch.select("baseline_start", "baseline_end").drop_nulls()
    for first, last in eras.unique(maintain_order=True).rows():
        axes.axvspan(first, last, color="0.5", alpha=0.15, lw=0)
    for night in watch["told_on"].drop_nulls().unique():
        axes.axvline(night, ls=":", lw=1.0, color="black")
    axes.set_ylim(bottom=0.0)
    axes.tick_params(axis="x", rotation=30)
    axes.legend(fontsize="small")
    return axes
