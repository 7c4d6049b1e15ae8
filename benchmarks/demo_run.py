"""How long the whole demo takes, and how much memory a worker needs for a long log.

The demo's goal: logs and fits of 450 motor-nights in under three minutes on two cores; a worker
under 1 GiB for a 24-hour log at 10 Hz.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import polars as pl

from benchmarks.results_file import write_results

COMMAND = Path(sys.executable).with_name("motor-leakage")


def main() -> None:
    """Measure and write `benchmarks/results/demo_run.md`."""
    with tempfile.TemporaryDirectory() as folder:
        whole = _run(Path(folder) / "whole")
        day = _run(Path(folder) / "day", "--nights", "1", "--minutes", "1435", "--rate", "10")
    rows = [
        ["whole demo, 75 nights of 90 min at 5 Hz: logs", f"{whole['demo_s']:.1f} s"],
        ["whole demo: fits and tables", f"{whole['fit_s']:.1f} s"],
        ["whole demo: both (goal: under 180 s)", f"{whole['demo_s'] + whole['fit_s']:.1f} s"],
        ["whole demo: largest worker", f"{whole['peak_mib']:.0f} MiB"],
        ["one night of 23 h 55 min at 10 Hz, six motors: logs", f"{day['demo_s']:.1f} s"],
        ["one such night: fits and tables", f"{day['fit_s']:.1f} s"],
        ["one such night: largest worker (goal: under 1024 MiB)", f"{day['peak_mib']:.0f} MiB"],
    ]
    write_results("demo_run", "The demo fleet", ("What", "Measured"), rows)


def _run(folder: Path, *demo_options: str) -> dict[str, float]:
    """Make a demo fleet and fit it, each as a command of its own."""
    begin = time.perf_counter()
    subprocess.run([COMMAND, "demo", folder, *demo_options], check=True, capture_output=True)
    middle = time.perf_counter()
    config = folder / "configs" / "fleet.toml"
    output = folder / "out"
    subprocess.run(
        [COMMAND, "fit-fleet", config, "--output", output], check=True, capture_output=True
    )
    end = time.perf_counter()
    outcomes = pl.concat(
        pl.read_parquet(path) for path in output.glob("tables/motor_outcomes/*/*.parquet")
    )
    peak = float(outcomes["peak_memory_mib"].max() or 0.0)  # type: ignore[arg-type]
    return {"demo_s": middle - begin, "fit_s": end - middle, "peak_mib": peak}
