"""Pictures of docs/evidence.md."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from pipeline.notebook import Tables
from pipeline.report.charts import COLOURS as PENS
from validation.record import FLOW, TIME, Record

SOURCE = (
    "Axial piston pump, valve plate UT3: Silesian University of Technology, Appl. Sci. 2024, "
    "14(16), 7183."
)
WIDTH = 1400
COLOURS = 64
SHOWN_MINUTES = (70.0, 80.0)  # of the warm part: a held-out block


def draw(record: Record, predicted: pl.Series, cuts: Tables, folder: Path) -> None:
    """Write the picture of one record: the fit, and its stability.

    `predicted` is the flow of each row of the record's warm part.
    """
    folder.mkdir(parents=True, exist_ok=True)
    figure = Figure(figsize=(10.0, 4.5), layout="constrained")
    figure.suptitle("A real pump")
    figure.supxlabel(SOURCE, fontsize=8)
    axes = figure.subplots(1, 2)
    _course(axes[0], record.warm(), predicted)
    _windows(axes[1], cuts, f"{record.name}-windows")
    path = folder / f"real_machines_{record.name}.png"
    figure.savefig(path, dpi=150)
    picture = Image.open(path).convert("RGB")
    picture.thumbnail((WIDTH, WIDTH))
    picture.quantize(COLOURS).save(path, optimize=True)


def _course(axes: Axes, rows: pl.DataFrame, predicted: pl.Series) -> None:
    minutes = (rows[TIME] - rows[TIME][0]).dt.total_seconds().cast(pl.Float64).to_numpy() / 60.0
    shown = (minutes >= SHOWN_MINUTES[0]) & (minutes < SHOWN_MINUTES[1])
    flows = {"measured": rows[FLOW], "predicted": predicted}
    for pen, (name, flow) in zip(PENS, flows.items(), strict=False):
        axes.plot(minutes[shown], flow.to_numpy()[shown], color=pen, label=name)
    axes.set(title="Leak-line flow, ten held-out minutes", xlabel="minutes", ylabel="l/min")
    axes.legend()


def _windows(axes: Axes, cuts: Tables, motor_id: str) -> None:
    fits = cuts.fits().filter(pl.col("motor_id") == motor_id).collect()
    leakage = fits["fitted_leakage_l_per_min"].to_numpy()
    total = fits["fitted_leakage_total_l_per_min"].to_numpy()
    minutes = np.arange(0.0, 5.0 * len(leakage), 5.0)
    axes.plot(minutes, leakage, color=PENS[0])
    axes.fill_between(minutes, leakage - total, leakage + total, alpha=0.2)
    title = "Reference leakage of 20-minute windows, total ±"
    axes.set(title=title, xlabel="begin, minutes", ylabel="l/min")
