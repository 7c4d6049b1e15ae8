"""A real pump's record cut into nights, as they are and with more leakage.

The record is no part of the project: `MOTOR_LEAKAGE_TEST_DATA` names the folder in which
`pump_rig/` has it, as for the tests.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from datetime import timedelta
from functools import cache, partial
from pathlib import Path

import numpy as np
import polars as pl

from benchmarks.watch.cb560 import VG46
from benchmarks.watch.simulator import BLOCK_S, History
from leakage import Constant, FilmPressure, Laminar, Motor, Parameter, regressors
from leakage.watch import Machine, NightBlocks
from validation.record import (
    FLOW,
    METER_READS_FROM,
    PRESSURE,
    SPEED_RPM,
    TEMPERATURE,
    TIME,
    conditions,
    read_records,
    windows,
)

FEWEST = 20  # samples of a block
BEGIN, MORE = 20, 1.1
GAP = Laminar("all_gaps", 1, Parameter("C_all", "m3", 5e-14, 1e-16, 1e-11))
CASE = Constant("case", Parameter("C_f", "l_per_min", 0.5, 0.0, 20.0))
PUMP = Motor("pump rig", (GAP, CASE), VG46, FilmPressure(share=0.0))
WATCHED = Machine(("all_gaps", "flushing"), ("all_gaps",), (46.0, 6.8))


def nights_of_record(
    minutes: int, nights: int, is_mixed: bool, seed: Sequence[int], begin: int | None
) -> Sequence[History]:
    """So many nights of the record with more leakage from `begin` on; a seed is for their order."""
    cut = list(_nights(minutes, nights))
    if is_mixed:
        cut = [cut[at] for at in np.random.default_rng([*seed]).permutation(len(cut))]
    worn = range(len(cut) if begin is None else begin, len(cut))
    more = np.where(np.isin(np.arange(len(cut)), worn), MORE, 1.0)
    seen = (replace(night, day=day, flow=more[day] * night.flow) for day, night in enumerate(cut))
    return [History(WATCHED, tuple(seen), more - 1.0, more - 1.0)]


# Minutes and number of nights, which overlap or follow each other.
CUTS = (
    ("27 nights of 10 min, one after another", 27, partial(nights_of_record, 10, 27, False)),
    ("90 nights of 60 min that overlap", 90, partial(nights_of_record, 60, 90, False)),
    ("90 nights of 60 min that overlap, mixed", 90, partial(nights_of_record, 60, 90, True)),
)


def folder() -> Path:
    """Where the record is, if it is there."""
    return Path(os.environ.get("MOTOR_LEAKAGE_TEST_DATA", "../shared/data")) / "pump_rig"


@cache
def _nights(minutes: int, nights: int) -> tuple[NightBlocks, ...]:
    rows, length = read_records(folder())[0].warm(), timedelta(minutes=minutes)
    step = (rows[TIME][-1] - rows[TIME][0] - length) / (nights - 1)
    return tuple(_night(window) for window in windows(rows, length, step))


def _night(rows: pl.DataFrame) -> NightBlocks:
    """Blocks of the samples at which the meter reads."""
    gap, case, *_ = regressors(PUMP, conditions(rows)).T
    blocks = (
        rows.select(
            ((pl.col(TIME) - pl.col(TIME).first()).dt.total_seconds() // BLOCK_S).alias("block"),
            pl.col(FLOW, TEMPERATURE, PRESSURE).cast(pl.Float64),
            gap=gap,
            case=case,
            rpm=SPEED_RPM,
        )
        .filter(pl.col(FLOW) >= METER_READS_FROM)
        .group_by("block", maintain_order=True)
        .agg(pl.all().mean(), n=pl.len())
        .filter(pl.col("n") >= FEWEST)
    )
    middle_s = BLOCK_S * (blocks["block"].to_numpy() + 0.5)
    drives, seen = blocks.select("gap", "case"), blocks.select(TEMPERATURE, PRESSURE, "rpm")
    return NightBlocks(0, middle_s, drives.to_numpy(), blocks[FLOW].to_numpy(), seen.to_numpy())
