"""A real pump's record cut into nights, as they are and with more leakage.

The record is no part of the project: `MOTOR_LEAKAGE_TEST_DATA` names the folder in which
`pump_rig/` has it, as for the tests.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import timedelta
from functools import cache
from pathlib import Path

import numpy as np
import polars as pl

from benchmarks.watch.cb560 import VG46
from benchmarks.watch.simulator import BLOCK_S, History
from leakage import (
    Constant,
    FilmPressure,
    Laminar,
    Motor,
    OperatingConditions,
    Parameter,
    regressors,
)
from leakage.watch import Machine, NightBlocks
from validation.record import FLOW, PRESSURE, TEMPERATURE, TIME, read_records, windows

VARIABLE = "MOTOR_LEAKAGE_TEST_DATA"
METER_READS_FROM = 1.7  # l/min, as in `validation/pump_rig`
RPM = 1485.0
FEWEST = 20  # samples of a block
BEGIN, MORE = 20, 1.1
GAP = Laminar("all_gaps", 1, Parameter("C_all", "m3", 5e-14, 1e-16, 1e-11))
CASE = Constant("case", Parameter("C_f", "l_per_min", 0.5, 0.0, 20.0))
PUMP = Motor("pump rig", (GAP, CASE), VG46, FilmPressure(share=0.0))
WATCHED = Machine(("all_gaps", "flushing"), ("all_gaps",), (46.0, 6.8))


@dataclass(frozen=True, slots=True)
class Cut:
    """Nights of a record: so long, one after another or so many that overlap."""

    minutes: int
    nights: int
    is_mixed: bool = False
    is_worn: bool = False

    def make(self, seed: Sequence[int], _: int) -> Sequence[History]:
        """The record's nights, all of them; a seed is for their order."""
        nights = list(_nights(self.minutes, self.nights))
        if self.is_mixed:
            nights = [nights[at] for at in np.random.default_rng([*seed]).permutation(len(nights))]
        more = np.where(self.is_worn & (np.arange(len(nights)) >= BEGIN), MORE, 1.0)
        seen = (replace(one, day=day, flow=more[day] * one.flow) for day, one in enumerate(nights))
        return [History(WATCHED, tuple(seen), more - 1.0, more - 1.0)]


# Nights that overlap; and ten minutes, one after another.
CUTS = {
    f"{words}{', +10 % from night 20 on' if worn else ''}": replace(cut, is_worn=worn)
    for words, cut in {
        "27 nights of 10 min, one after another": Cut(10, 27),
        "90 nights of 60 min that overlap": Cut(60, 90),
        "90 nights of 60 min that overlap, mixed": Cut(60, 90, is_mixed=True),
    }.items()
    for worn in (False, True)
}


def folder() -> Path:
    """Where the record is, if it is there."""
    return Path(os.environ.get(VARIABLE, "../shared/data")) / "pump_rig"


@cache
def _nights(minutes: int, nights: int) -> tuple[NightBlocks, ...]:
    rows, length = read_records(folder())[0].warm(), timedelta(minutes=minutes)
    step = (rows[TIME][-1] - rows[TIME][0] - length) / (nights - 1)
    return tuple(_night(one) for one in windows(rows, length, step))


def _night(rows: pl.DataFrame) -> NightBlocks:
    """Blocks of the samples at which the meter reads."""
    second = (rows[TIME] - rows[TIME][0]).dt.total_seconds().to_numpy().astype(float)
    channels = (rows[name].cast(pl.Float64).to_numpy() for name in (PRESSURE, TEMPERATURE, FLOW))
    pressure, temperature, flow = channels
    reads = flow >= METER_READS_FROM
    block = (second // BLOCK_S).astype(int)
    kept = [at for at in np.unique(block) if (reads & (block == at)).sum() >= FEWEST]
    columns = regressors(PUMP, OperatingConditions.from_bar(pressure, temperature, RPM))
    seen = np.column_stack([temperature, pressure, np.full(len(flow), RPM)])
    means = [
        np.array([one[reads & (block == at)].mean(axis=0) for at in kept])
        for one in (columns[:, :2], flow, seen)
    ]
    return NightBlocks(0, BLOCK_S * (np.array(kept) + 0.5), *means)
