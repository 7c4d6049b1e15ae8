"""The demo fleet's fits against its truth: accuracy, and how often the intervals hold.

Makes and fits the whole demo, then compares every night with the truth that the simulation left
beside its logs, which the pipeline never reads.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from benchmarks.day_fleets import search_every_night
from benchmarks.demo_run import COMMAND
from benchmarks.results_file import write_results

KEY = ["motor_id", "night", "flushing_mode"]


def main() -> None:
    """Measure and write `benchmarks/results/demo_truth.md`."""
    with tempfile.TemporaryDirectory() as folder:
        demo, output = Path(folder) / "demo", Path(folder) / "out"
        subprocess.run([COMMAND, "demo", demo], check=True, capture_output=True)
        config = demo / "configs" / "fleet.toml"
        search_every_night(config)
        subprocess.run(
            [COMMAND, "fit-fleet", config, "--output", output], check=True, capture_output=True
        )
        compare(demo, output)


def compare(demo: Path, output: Path) -> None:
    """Write the comparison of one demo's tables with its truth."""
    truth = json.loads((demo / "demo" / "truth.json").read_text("utf-8"))["motors"]
    fits = _table(output, "fits").filter(pl.col("is_primary"))
    parameters = _table(output, "parameters").join(fits.select(KEY), on=KEY)
    rows = [
        _row(motor_id, facts, fits, parameters, name)
        for motor_id, facts in sorted(truth.items())
        for name in (*_paths(facts), "reference leakage")
    ]
    starts = _table(output, "starts").join(fits.select(*KEY, best="cost"), on=KEY)
    below = starts.select(((pl.col("cost") - pl.col("best")) / pl.col("best")).min()).item()
    share = 100 * starts["at_minimum"].sum() / starts.height
    rows.append(["all", "", "lowest start / certificate − 1", f"{below:.1e}", "", "", "", ""])
    rows.append(["all", "", "starts at the minimum", f"{share:.1f} %", "", "", "", ""])
    fit = fits.group_by("motor_id").agg(pl.col("validation_fit_percent").median()).sort("motor_id")
    rows += [
        [motor_id, "", "median validation fit", f"{value:.1f} %", "", "", "", ""]
        for motor_id, value in fit.iter_rows()
    ]
    header = (
        "motor",
        "excited",
        "figure",
        "median of |estimate / truth − 1|, %",
        "nights identified",
        "intervals that hold, %",
        "median ±, %",
        "median systematic ±, %",
    )
    write_results("demo_truth", "The demo fleet against its truth", header, rows)


def _table(output: Path, name: str) -> pl.DataFrame:
    files = sorted((output / "tables" / name).glob("*/*.parquet"))
    return pl.concat(pl.read_parquet(path) for path in files)


def _paths(facts: dict[str, Any]) -> list[str]:
    return list(next(iter(facts["nights"].values()))["K_m3"])


def _row(
    motor_id: str, facts: dict[str, Any], fits: pl.DataFrame, parameters: pl.DataFrame, name: str
) -> list[str]:
    nights = facts["nights"]
    if name == "reference leakage":
        found = fits.filter(motor_id=motor_id).select(
            "night",
            value="reference_leakage_l_per_min",
            lower="reference_leakage_lower",
            upper="reference_leakage_upper",
            systematic="reference_leakage_systematic",
            verdict="reference_verdict",
        )
        truth = {night: one["reference_leakage_l_per_min"] for night, one in nights.items()}
    else:
        found = parameters.filter(motor_id=motor_id, parameter=f"K_{name}").select(
            "night", "value", "lower", "upper", "systematic", "verdict"
        )
        truth = {night: one["K_m3"][name] for night, one in nights.items()}
    true = np.array([truth[night.isoformat()] for night in found["night"]])
    values = found["value"].to_numpy()
    lower, upper = (found[side].cast(pl.Float64).to_numpy() for side in ("lower", "upper"))
    systematic = found["systematic"].cast(pl.Float64).to_numpy()
    some = np.isfinite(lower)
    held = (lower[some] <= true[some]) & (true[some] <= upper[some])
    known = np.isfinite(values.astype(float))
    deviation = np.abs(values[known].astype(float) / true[known] - 1)

    def percent(figures: np.ndarray, digits: int) -> str:
        return f"{100 * np.median(figures):.{digits}f}" if len(figures) else "–"

    return [
        motor_id,
        "yes" if facts["excited"] else "no",
        name,
        percent(deviation, 2),
        f"{(found['verdict'] == 'identified').sum()} of {found.height}",
        f"{100 * held.mean():.0f}" if some.any() else "–",
        percent((upper[some] - lower[some]) / 2 / true[some], 2),
        percent(systematic[some] / true[some], 1),
    ]


if __name__ == "__main__":
    main()
