"""Seconds from a plant's wide log of forty motors to its report: init, check, fit and report.

A night of an hour at 1 Hz in one CSV, four columns a motor; each command is a process of its own.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
import polars as pl

from benchmarks.night_kinds import CYCLES_S
from benchmarks.results_file import write_results
from benchmarks.simulated_nights import duty, motor
from benchmarks.whole_runs import elapsed
from leakage import OperatingConditions, total_flow_l_per_min

MOTORS = 40
MINUTES = 60
BEGIN_US = 1_768_341_600_000_000  # 2026-01-13T22:00:00 UTC
ANSWERS = ("motor_type=CB560", "oil=vg68")


def main() -> None:
    """Measure and write `benchmarks/results/wide_plant.md`."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        log = folder / "plant" / "wide.csv"
        log.parent.mkdir()
        _write(log)
        fleet = folder / "fleet" / "fleet.toml"
        known = [part for answer in ANSWERS for part in ("--answer", answer)]
        seconds = [
            ("init", _seconds("init", log, "--to", fleet.parent, "--write", *known)),
            ("check", _seconds("check", fleet)),
            ("fit-fleet", _seconds("fit-fleet", fleet, "--jobs", "2")),
            ("report", _seconds("report", fleet, "--jobs", "2")),
        ]
        n_pages = len(list((fleet.parent / "out" / "report").rglob("*.html")))
        size_mb = log.stat().st_size / 1e6
    seconds.append(("all", sum(number for _, number in seconds)))
    rows = [[name, f"{number:.1f}"] for name, number in seconds]
    title = f"A wide log of {MOTORS} motors ({size_mb:.0f} MB, {MINUTES} min) to {n_pages} pages"
    write_results("wide_plant", title, "command | seconds", rows)


def _write(log: Path) -> None:
    rng = np.random.default_rng(1)
    columns: dict[str, pl.Series] = {}
    for number in range(1, MOTORS + 1):
        seen = duty(MINUTES / 60.0, rng, 1.0, CYCLES_S)
        pressure, temperature, speed = seen.channels
        conditions = OperatingConditions.from_bar(pressure, temperature, speed)
        flow = total_flow_l_per_min(motor(), conditions)
        flow += 0.015 * rng.standard_normal(len(flow))
        units = {
            "dp [bar]": pressure,
            "T [°C]": temperature,
            "n [rpm]": speed,
            "leak [l/min]": flow,
        }
        for name, values in units.items():
            columns[f"W{number}_{name}"] = pl.Series(values).round(4)
    stamps = BEGIN_US + 1_000_000 * pl.int_range(len(flow), eager=True)
    time_us = stamps.cast(pl.Datetime("us", "UTC")).dt.strftime("%Y-%m-%dT%H:%M:%SZ")
    pl.DataFrame({"time": time_us, **columns}).write_csv(log)


def _seconds(*arguments: str | Path) -> float:
    return elapsed([sys.executable, "-m", "pipeline.cli", *map(str, arguments)]).elapsed_s
