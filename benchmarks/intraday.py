"""Intraday check: healthy days of made plants, judged every six minutes.

Three film laws, and what is hard on a watch: wander with a memory, large slow
errors, a season on parts that do not follow the oil, a load that falls, one pressure; baselines of
8 and 15 nights, days of 90 minutes up to night 30. `--seeds N` are lives of each plant.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from leakage.watch import NightBlocks, Watch, WatchSettings
from leakage.watch.choices import INTRADAY_LEAST_RISE, INTRADAY_LIMIT
from leakage.watch.intraday import rises_so_far, sudden_rise
from tests.leakage.watch.made_machine import CB560, Plant, earlier_of

RESULTS = Path(__file__).parent / "results" / "intraday.md"
FIRST_SEED, NIGHTS, BLOCKS, EVERY = 200, 30, 45, 3
PLANTS: dict[str, dict[str, Any]] = {
    "film law as fitted": {"film": "barus"},
    "film along the slot": {"film": "slot"},
    "turbulent film": {"film": "turbulent"},
    "wander 1.2 %, memory 0.8": {"film": "slot", "wander": 0.012, "serial": 0.8},
    "slow errors and blocks of 1 %": {"film": "slot", "slow": 0.01, "block": 0.012},
    "season of 6 K on parts": {
        "film": "slot",
        "warmer_c": lambda night: 6.0 * np.sin(night / 10.0),
        "by_warmth": (0.003, 0.0, 0.002, 0.0),
    },
    "load falls by 40 %": {"film": "slot", "load": lambda night: 0.6 if night >= 20 else 1.0},
    "one pressure": {"film": "slot", "operating_point": "one pressure"},
}


class Day(NamedTuple):
    """A day: whether a rise was reported, and the largest figures of all its checks."""

    is_reported: bool
    evidence: float
    lower: float


def days(plant: dict[str, Any], seed: int) -> Iterator[Day]:
    """Healthy days of a life behind its baseline."""
    nights = Plant(blocks=BLOCKS, **plant).nights(NIGHTS, seed)
    n_baseline = 8 if seed % 2 else 15
    watch = Watch.begin(CB560, nights[:n_baseline], WatchSettings())
    for place in range(n_baseline, NIGHTS):
        checks = [
            rises_so_far(watch, until(nights[place], n), 1) for n in range(2, BLOCKS + 1, EVERY)
        ]
        rises = [rise for check in checks for rise in check if rise.change.value > 0.0]
        yield Day(
            any(sudden_rise(check) for check in checks),
            max((rise.evidence for rise in rises), default=-np.inf),
            max((rise.change.lower for rise in rises), default=-np.inf),
        )
        watch = watch.after(nights[place], earlier_of(nights[: place + 1]))


def until(night: NightBlocks, n: int) -> NightBlocks:
    """The night so far, of its first blocks."""
    parts = (night.middle_s, night.drives, night.flow, night.conditions)
    return NightBlocks(night.day, *(part[:n] for part in parts))


def row(name: str, checked: list[Day]) -> str:
    """A line of the table; the rate goes by the exponential tail of the largest tenth."""
    lower = np.sort([day.lower for day in checked])[::-1]
    tenth = lower[: max(len(lower) // 10, 2)]
    scale = max(float(tenth.mean() - tenth[-1]), 1e-9)
    rate = 36.5 * np.exp(-(INTRADAY_LEAST_RISE - tenth[-1]) / scale)
    reported = sum(day.is_reported for day in checked)
    evidence = max(day.evidence for day in checked)
    return (
        f"| {name} | {len(checked)} | {reported} | {evidence:.1f} | {100 * lower[0]:+.1f} % "
        f"| {rate:.1g} |"
    )


def text(plants: dict[str, list[Day]]) -> str:
    """The page of results."""
    every = [day for checked in plants.values() for day in checked]
    rows = [row(name, checked) for name, checked in {**plants, "all": every}.items()]
    return "\n".join(
        [
            "# Intraday check on healthy days\n",
            f"`python -m benchmarks intraday`. A rise is reported from an evidence of "
            f"{INTRADAY_LIMIT:g} and a lower end of {100 * INTRADAY_LEAST_RISE:g} %.\n",
            "| plant | days | rises reported | largest evidence | largest lower end "
            "| rises a motor-year by the tail of the lower ends |",
            "|---|---|---|---|---|---|",
            *rows,
            "",
        ]
    )


def main(options: list[str]) -> int:
    """Simulate, and write the results."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks intraday")
    parser.add_argument("--seeds", type=int, default=8)
    seeds = range(FIRST_SEED, FIRST_SEED + parser.parse_args(options).seeds)
    checked = {
        name: [day for seed in seeds for day in days(plant, seed)] for name, plant in PLANTS.items()
    }
    page = text(checked)
    RESULTS.write_text(page, "utf-8")
    sys.stdout.write(page)
    return 0
